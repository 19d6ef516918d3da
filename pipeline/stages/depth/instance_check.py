"""Whether a recording is of the sensor instance that its calibration was made on, by the reference
images of both.

LEDs, paint and glue differ between instances, and with them the image of a gel at rest, by far more
than the light and the lens of one instance drift. The check measures what `gel.drift` cannot
explain of the one image by the other.
"""

import numpy as np

from pipeline.calibration.calibration_table import Calibration, make_thumbnail
from pipeline.core.arrays import Image
from pipeline.core.derived import derive_once
from pipeline.core.errors import StageWarning
from pipeline.stages.depth.gel import coarse_light, drift

# Median difference in grey levels. One simulated instance after drift: 0.2; two: 1.2 to 1.8 (Minis
# with equal LEDs, one pair in ten), others from 4; one real Mini in six recordings, maybe of
# several days: 0.3 to 2.5; another real Mini: 8 to 22. An instance that differs by less is measured
# alike.
_OTHER_INSTANCE_GREY = 3.0
_BLOCK_PX = 8


def check_sensor_instance(calibration: Calibration, reference: Image) -> tuple[str, ...]:
    """A warning where the reference image (rows, cols, 3) of a recording is not of the
    calibration's instance.

    Empty for a calibration without a reference image, as one from the sensor's description.
    """
    calibrated = calibration.reference_thumbnail
    if calibrated is None:
        return ()
    difference_grey, is_drift = _compare_references(reference, calibrated)
    if difference_grey <= _OTHER_INSTANCE_GREY and is_drift:
        return ()
    why = (
        f"the reference images differ by {difference_grey:.0f} grey levels beyond drift"
        if is_drift
        else "the light of the reference images differs by more than one instance drifts"
    )
    return (
        StageWarning(
            f"the calibration may be of another instance, or of other light: {why}; calibrate "
            "this one"
        ),
    )


@derive_once
def _compare_references(reference: Image, calibrated: Image) -> tuple[float, bool]:
    """Median difference beyond drift in grey levels, and whether one instance can drift so far."""
    import cv2

    now = make_thumbnail(reference)
    if now.shape != calibrated.shape:
        now = np.asarray(
            cv2.resize(now, calibrated.shape[1::-1], interpolation=cv2.INTER_AREA), np.uint8
        )
    fitted, *_ = drift.fit_drift(now, calibrated)
    drifted = (
        calibrated.astype(np.float32) if fitted is None else drift.apply_drift(calibrated, fitted)
    )
    means = (coarse_light.compute_block_means(image, _BLOCK_PX) for image in (now, drifted))
    difference = np.abs(next(means) - next(means)).max(axis=2)
    mean_grey = float(calibrated.mean())
    return float(np.median(difference)), fitted is None or not fitted.exceeds_instance_drift(
        mean_grey
    )
