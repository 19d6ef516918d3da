"""What a sensor description is made of: mechanics, optics, markers and limits, as frozen values."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, field
from typing import Any, NamedTuple


class NumberRange(NamedTuple):
    """How a description gives a number."""

    unit: str
    low: float
    high: float
    key: str  # "" = the field's name without its unit


def declare_number(unit: str, low: float, high: float, otherwise: float | None = None, *, key: str = "") -> Any:
    """A field that is a number of a description; `otherwise` where it may be left out."""
    metadata = {"number": NumberRange(unit, low, high, key)}
    return field(default=MISSING if otherwise is None else otherwise, metadata=metadata)


@dataclass(frozen=True, slots=True, kw_only=True)
class Gel:
    """A bonded elastic layer."""

    thickness_mm: float = declare_number("mm", 0.01, 100.0)
    youngs_kpa: float = declare_number("kPa", 0.1, 1e7)
    poisson: float = declare_number("1", 0.0, 0.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Bubble:
    """A pre-stretched membrane over an elliptic rim, inflated with sealed air."""

    half_width_mm: float = declare_number("mm", 1.0, 500.0)
    half_height_mm: float = declare_number("mm", 1.0, 500.0)
    height_mm: float = declare_number("mm", 0.0, 500.0)
    pressure_kpa: float = declare_number("kPa", 0.0, 100.0)  # gauge, untouched
    dead_volume_mm3: float = declare_number("mm^3", 0.0, 1e7)  # air behind the rim plane
    depth_noise_mm: float = declare_number("mm", 0.0, 50.0)  # standard deviation of one depth reading


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthCamera:
    """How a bubble's depth camera errs; the defaults are those of time of flight, whose pictures have no gaps.

    The standard deviation of one reading is `Bubble.depth_noise_mm`, as a root mean square over the untouched
    bubble; over the picture it follows distance ** `distance_power` / cos(incidence) ** `grazing_power`.
    """

    distance_power: float = declare_number(
        "1", 0.0, 8.0, 2.0
    )  # light that comes back falls with the square of the distance
    grazing_power: float = declare_number("1", 0.0, 8.0, 0.5)  # and with the cosine of the incidence, by its root
    grain_px: float = declare_number(
        "px", 0.0, 20.0, 0.8
    )  # width of the noise's grain: neighbours share light or a window
    jump_mm: float = declare_number(
        "mm", 0.0, 1000.0, 2.0
    )  # a bend between neighbours beyond this is a jump, where pixels fly
    flying_share: float = declare_number(
        "1", 0.0, 1.0, 0.5
    )  # of the pixels at a jump: these read a depth between near and far
    max_incidence_deg: float = declare_number("deg", 0.0, 90.0, 90.0)  # incidence beyond which nothing comes back
    gap_share: float = declare_number("1", 0.0, 1.0, 0.0)  # of all pixels, without a reading for no reason
    step_mm: float = declare_number("mm", 0.0, 100.0, 0.0)  # readings are multiples of this


@dataclass(frozen=True, slots=True, kw_only=True)
class Led:
    """A light at the gel's edge: where it stands (azimuth of the side it shines from) and what it adds."""

    azimuth_deg: float  # 0 = from the right (+x), 90 = from below (+y), in the image
    elevation_deg: float
    rgb: tuple[float, float, float]  # grey levels that a surface facing it gains


@dataclass(frozen=True, slots=True, kw_only=True)
class Glow:
    """A coloured patch of the untouched picture: a Gaussian lobe, in halves of the image from its centre."""

    x: float  # -1 = left edge, 1 = right edge
    y: float  # -1 = top edge, 1 = bottom edge
    width: float  # where the lobe has fallen to 1/e
    height: float
    rgb: tuple[float, float, float]  # grey levels at its middle


@dataclass(frozen=True, slots=True, kw_only=True)
class Optics:
    """How the gel's slope becomes colour."""

    base_rgb: tuple[float, float, float]  # untouched colour under the glows, grey levels 0..255
    leds: tuple[Led, ...]
    falloff: float = declare_number(
        "1", 0.0, 1.0
    )  # share of an LED's light lost from its own side to the far side of the image
    vignette: float = declare_number("1", 0.0, 1.0)  # share of light lost in the corners
    blur_px: float = declare_number("px", 0.0, 100.0)
    noise_grey: float = declare_number("grey", 0.0, 255.0)
    glows: tuple[Glow, ...] = ()
    shadow: float = declare_number("1", 0.0, 1.0, 0.0)  # share of an LED's light that is missing right behind a dent
    shadow_deg: float = declare_number("deg", 1.0, 89.0, 20.0, key="shadow_elevation")  # of that light


@dataclass(frozen=True, slots=True, kw_only=True)
class Markers:
    """A grid of dark dots printed under the gel surface."""

    pitch_mm: float = declare_number("mm", 0.1, 100.0)
    radius_mm: float = declare_number("mm", 0.0, 50.0)
    darkness: float = declare_number("1", 0.0, 1.0)  # 1 = black
    doubling_mm: float = declare_number(
        "mm", 0.0, 50.0, 0.0
    )  # across the image, between the halves of a doubled dot; 0 = single
    jitter_mm: float = declare_number("mm", 0.0, 50.0, 0.0)  # at most, along each axis, that a dot is off its place
    distortion: float = declare_number(
        "1", -0.5, 0.5, 0.0
    )  # share by which the lens draws the grid's corners outward; below 0 inward
    rotation_deg: float = 0.0
    phase_mm: tuple[float, float] = (0.0, 0.0)  # of the dot nearest to the image centre, right and down


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorLimits:
    """What counts as a touch, and what is beyond the sensor."""

    contact_min_mm: float = declare_number("mm", 0.0, 100.0)  # smallest indentation that counts
    indentation_max_mm: float = declare_number("mm", 1e-3, 100.0)
    # Of measured depth where it touches; of a gel, of a touch of slope 1 read by the described lamps (`depth_error`).
    depth_rms_mm: float = declare_number("mm", 0.0, 100.0, 0.0)  # 0 = nobody has measured it
    depth_rms_other_instance_mm: float = declare_number(
        "mm", 0.0, 100.0, 0.0
    )  # by lamps of another unit, that the touch has to tell
    depth_correlation_mm: float = 1.0  # length over which that error hangs together
    no_contact_change: (
        float  # largest smoothed change from the reference of an untouched frame: grey levels, or mm of a bubble
    )
