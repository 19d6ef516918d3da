"""Whether a gel's images are mirrored, where the reference image alone does not show it.

A GelSight Mini's LEDs look nearly alike from left and right. A touch shows it: the slopes of a
calibration table are those of a surface, d(gx)/dy = d(gy)/dx; in a mirrored image one of the two is
reversed, and half of what a dent shows belongs to no surface.
"""

from pipeline.core.arrays import Floats, Image
from pipeline.physics.optics import compute_slopes
from pipeline.physics.reference_colours import MirrorDirection, compare_colours
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.gel.settings import CONTACT
from pipeline.stages.depth.gel.slopes import ChangedImage
from pipeline.stages.depth.illumination.light import look_up_slopes
from pipeline.stages.depth.poisson import integrate_slopes


def describe_mirroring(reference: Image, source: SensorSpec, changed: ChangedImage) -> str:
    """How a touch shows that the images are mirrored, as a clause.

    "" where it does not, or they are not.
    """
    how = None if source.optics is None else compare_colours(reference, source).possible_mirroring
    if how is None or not looks_mirrored(changed, how):
        return ""
    return f"the images look mirrored {how}: only then are the touch's slopes those of a surface"


def looks_mirrored(changed: ChangedImage, direction: MirrorDirection) -> bool:
    """Whether a touch's slopes are closer to those of a surface with one of the two reversed."""
    _, cells = changed.patches
    gx, gy = look_up_slopes(cells, changed.calibration)
    mirrored = (-gx, gy) if direction == "left to right" else (gx, -gy)
    shares = [_compute_curl_share(*g, cells.pixel_mm) for g in (mirrored, (gx, gy))]
    return shares[0] < CONTACT.mirrored_curl * shares[1]


def _compute_curl_share(gx: Floats, gy: Floats, pixel_mm: float) -> float:
    """The share of the squared slopes that belongs to no surface."""
    slopes = compute_slopes(integrate_slopes(gx, gy, pixel_mm), pixel_mm)
    residual = sum(float(((a - b) ** 2).sum()) for a, b in zip((gx, gy), slopes, strict=True))
    return residual / max(float((gx**2 + gy**2).sum()), 1e-9)
