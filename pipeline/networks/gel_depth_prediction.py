"""What the network of `networks.gel_depth` predicts, as tensors in training and as arrays when OpenCV runs it."""

from typing import Any, NamedTuple

PHYSICS_CONTACT_LOGIT = 2.0  # logit of a pixel that physics holds for contact; minus that of any other


class GelDepthPrediction(NamedTuple):
    """Outputs of the gel depth network, each (n, rows, cols) float32 unless said otherwise.

    Lengths are in units of the depth of the physical contact.
    """

    surface: Any  # indentation: the physical one plus `correction`, positive toward the camera
    correction: Any  # added to the physical indentation
    contact_logit: Any  # of the network
    contact_logit_correction: Any  # `contact_logit` minus the logit of the physical contact
    log_error_scale: Any  # log of the Laplace scale of the error of `surface` times the depth factor
    log_depth_factor: Any  # (n,) log of the factor that brings `surface` to the true depth
