"""What a sensor description is made of: mechanics, optics, markers and limits, as frozen values."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Gel:
    """A bonded elastic layer."""

    thickness_mm: float
    youngs_kpa: float
    poisson: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Bubble:
    """A pre-stretched membrane over an elliptic rim, inflated with sealed air."""

    half_width_mm: float
    half_height_mm: float
    height_mm: float
    pressure_kpa: float  # gauge, untouched
    dead_volume_mm3: float  # air behind the rim plane
    depth_noise_mm: float  # standard deviation of one depth reading


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthCamera:
    """How a bubble's depth camera errs; the defaults are those of time of flight, whose pictures have no gaps.

    The standard deviation of one reading is `Bubble.depth_noise_mm`, as a root mean square over the untouched
    bubble; over the picture it follows distance ** `distance_power` / cos(incidence) ** `grazing_power`.
    """

    distance_power: float = 2.0  # light that comes back falls with the square of the distance
    grazing_power: float = 0.5  # and with the cosine of the incidence, of which the noise is the root
    grain_px: float = 0.8  # width of the noise's grain: neighbours share light, or a matching window
    jump_mm: float = 2.0  # a bend between neighbours beyond this is a jump, where pixels fly
    flying_share: float = 0.5  # of the pixels at a jump: these read a depth between near and far
    steepest_deg: float = 90.0  # incidence beyond which nothing comes back; 90 = always something
    gap_share: float = 0.0  # of all pixels, without a reading for no reason
    step_mm: float = 0.0  # readings are multiples of this


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
    falloff: float  # share of an LED's light lost from its own side to the far side of the image
    vignette: float  # share of light lost in the corners
    blur_px: float
    noise_grey: float
    glows: tuple[Glow, ...] = ()
    shadow: float = 0.0  # share of an LED's light that is missing right behind a dent
    shadow_deg: float = 20.0  # how steeply that light comes in: the lower, the longer the shadow


@dataclass(frozen=True, slots=True, kw_only=True)
class Markers:
    """A grid of dark dots printed under the gel surface."""

    pitch_mm: float
    radius_mm: float
    darkness: float  # 1 = black
    twin_mm: float = 0.0  # distance, across the image, of the two halves of a doubled dot; 0 = a single dot
    jitter_mm: float = 0.0  # how far, at most and along each axis, a dot is printed off its place
    bend: float = 0.0  # share by which the lens draws the grid's corners outward; below 0 inward
    turn_deg: float = 0.0
    phase_mm: tuple[float, float] = (0.0, 0.0)  # of the dot nearest to the image centre, right and down


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What counts as a touch, and what is beyond the sensor."""

    contact_min_mm: float  # smallest indentation that counts
    indentation_max_mm: float
    depth_rms_mm: float  # of measured depth where it touches; 0 = nobody has measured it
    depth_correlation_mm: float  # length over which that error hangs together
    no_touch: float  # largest smoothed change from the reference of an untouched frame: grey levels, or mm of a bubble
