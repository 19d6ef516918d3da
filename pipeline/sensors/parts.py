"""Parts of a sensor description: mechanics, optics, markers and limits."""

from dataclasses import MISSING, field, fields
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from pipeline.core.arrays import Floats, freeze
from pipeline.core.derived import derive_once
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import Camera
from pipeline.core.typed_data import convert
from pipeline.sensors.descriptions import DESCRIPTION, DescriptionSection

# degrees, half image sizes, or grey levels
LightNumber = Annotated[float, Meta(ge=-1000.0, le=1000.0)]
LobeWidth = Annotated[float, Meta(gt=0.0, le=1000.0)]


class NumberRange(NamedTuple):
    """Unit, limits and key of a number in a description."""

    unit: str
    low: float
    high: float
    key: str  # "" = field name without its unit


def declare_number(
    unit: str, low: float, high: float, default: float | None = None, *, key: str = ""
) -> Any:
    """A dataclass field that is a number of a description; required without a default."""
    metadata = {"number": NumberRange(unit, low, high, key)}
    return field(default=MISSING if default is None else default, metadata=metadata)


@frozen
class Gel:
    """A bonded elastic layer."""

    thickness_mm: float = declare_number("mm", 0.01, 100.0)
    youngs_kpa: float = declare_number("kPa", 0.1, 1e7)
    poisson: float = declare_number("1", 0.0, 0.5)


@frozen
class Bubble:
    """A pre-stretched membrane over an elliptic rim, inflated with sealed air."""

    half_width_mm: float = declare_number("mm", 1.0, 500.0)
    half_height_mm: float = declare_number("mm", 1.0, 500.0)
    height_mm: float = declare_number("mm", 0.0, 500.0)
    pressure_kpa: float = declare_number("kPa", 0.0, 100.0)  # gauge pressure without contact
    dead_volume_mm3: float = declare_number("mm^3", 0.0, 1e7)  # air behind the rim plane
    depth_noise_mm: float = declare_number("mm", 0.0, 50.0)  # standard deviation of one depth value


@frozen
class DepthCamera:
    """Errors of a bubble's depth camera.

    The defaults are those of time of flight, whose images have no gaps.

    The standard deviation of one value is `Bubble.depth_noise_mm` as a root mean square over the
    rest shape; over the image it follows distance ** `distance_power` / cos(incidence) **
    `grazing_power`.
    """

    # returned light falls with the squared distance
    distance_power: float = declare_number("1", 0.0, 8.0, 2.0)
    # noise grows with the root of 1 / cos(incidence)
    grazing_power: float = declare_number("1", 0.0, 8.0, 0.5)
    grain_px: float = declare_number("px", 0.0, 20.0, 0.8)  # correlation width of the noise
    # difference of neighbours beyond which pixels fly
    jump_mm: float = declare_number("mm", 0.0, 1000.0, 2.0)
    # of the pixels at a jump: depth between near and far
    flying_share: float = declare_number("1", 0.0, 1.0, 0.5)
    max_incidence_deg: float = declare_number("deg", 0.0, 90.0, 90.0)  # beyond it no light returns
    gap_share: float = declare_number("1", 0.0, 1.0, 0.0)  # of all pixels: random gaps
    step_mm: float = declare_number("mm", 0.0, 100.0, 0.0)  # quantisation of depth


@frozen
class Led:
    """An LED at the gel's edge: the direction it shines from, and its light."""

    azimuth_deg: LightNumber  # 0 = from the right (+x), 90 = from below (+y), in the image
    elevation_deg: LightNumber
    # grey levels added to a surface that faces it
    rgb: tuple[LightNumber, LightNumber, LightNumber]


@frozen
class Glow:
    """A Gaussian lobe of colour in the reference image.

    Lengths in half image sizes from the centre.
    """

    x: LightNumber  # -1 = left edge, 1 = right edge
    y: LightNumber  # -1 = top edge, 1 = bottom edge
    width: LobeWidth  # at which the lobe has fallen to 1/e
    height: LobeWidth
    rgb: tuple[LightNumber, LightNumber, LightNumber]  # grey levels at its centre


@frozen
class Optics:
    """Illumination that maps the gel's slope to colour."""

    base_rgb: tuple[float, float, float]  # reference colour without glows, grey levels 0..255
    leds: tuple[Led, ...]
    falloff: float = declare_number("1", 0.0, 1.0)  # share of an LED's light lost across the image
    vignette: float = declare_number("1", 0.0, 1.0)  # share of light lost in the corners
    blur_px: float = declare_number("px", 0.0, 100.0)
    noise_grey: float = declare_number("grey", 0.0, 255.0)
    glows: tuple[Glow, ...] = ()
    # share of an LED's light missing right behind a dent
    shadow: float = declare_number("1", 0.0, 1.0, 0.0)
    # elevation of the missing light
    shadow_deg: float = declare_number("deg", 1.0, 89.0, 20.0, key="shadow_elevation")


@frozen
class Markers:
    """A grid of dark dots printed under the gel surface."""

    pitch_mm: float = declare_number("mm", 0.1, 100.0)
    radius_mm: float = declare_number("mm", 0.0, 50.0)
    darkness: float = declare_number("1", 0.0, 1.0)  # 1 = black
    # between the two halves of a dot along x; 0 = single
    doubling_mm: float = declare_number("mm", 0.0, 50.0, 0.0)
    # largest displacement of a dot along each axis
    jitter_mm: float = declare_number("mm", 0.0, 50.0, 0.0)
    # radial shift of the corners by the lens; > 0 outward
    distortion: float = declare_number("1", -0.5, 0.5, 0.0)
    rotation_deg: float = 0.0
    # of the dot nearest to the image centre: right, down
    phase_mm: tuple[float, float] = (0.0, 0.0)


@frozen
class SensorLimits:
    """Limits of contact and indentation, and errors of measured depth."""

    contact_min_mm: float = declare_number("mm", 0.0, 100.0)  # smallest indentation of contact
    indentation_max_mm: float = declare_number("mm", 1e-3, 100.0)
    # Error of measured depth in contact; for a gel that of a touch of slope 1 under the described
    # LEDs (`depth_error`).
    depth_rms_mm: float = declare_number("mm", 0.0, 100.0, 0.0)  # 0 = not measured
    # of an instance with other LEDs
    depth_rms_other_instance_mm: float = declare_number("mm", 0.0, 100.0, 0.0)
    depth_correlation_mm: float = 1.0  # correlation length of that error
    # largest smoothed change from the reference without contact: grey levels or mm
    no_contact_change: float


@derive_once
def compute_reference_light(camera: Camera, optics: Optics) -> Floats:
    """Grey levels (rows, cols, 3) float32 of a gel without contact, before markers and lens
    blur.
    """
    x = ((np.arange(camera.cols) + 0.5) / camera.cols * 2 - 1)[None, :]
    y = ((np.arange(camera.rows) + 0.5) / camera.rows * 2 - 1)[:, None]
    light = np.empty((*camera.shape, 3))
    light[:] = optics.base_rgb
    for glow in optics.glows:
        lobe = np.exp(-(((x - glow.x) / glow.width) ** 2) - ((y - glow.y) / glow.height) ** 2)
        light += lobe[..., None] * np.array(glow.rgb)
    lens = 1.0 - optics.vignette * ((x * x + y * y) / 2) ** 2
    return freeze((light * lens[..., None]).astype(np.float32))


@derive_once
def compute_mean_reference_light(camera: Camera, optics: Optics) -> Floats:
    """Mean of `compute_reference_light` of each colour (3,), grey levels."""
    return freeze(compute_reference_light(camera, optics).reshape(-1, 3).mean(axis=0))


T = TypeVar("T")


class _Lights(msgspec.Struct, kw_only=True, frozen=True):
    """The lists of [optics]."""

    leds: Annotated[tuple[Led, ...], Meta(min_length=1)]
    glows: tuple[Glow, ...] = ()


def parse_part(kind: type[T], s: DescriptionSection) -> T:
    """A part that has only numbers; raises CalibrationError."""
    return kind(**parse_numbers(kind, s))


def parse_numbers(kind: type[Any], s: DescriptionSection) -> dict[str, float]:
    """Field name -> value of the numbers in a section, checked by each field's `NumberRange`."""
    values: dict[str, float] = {}
    for f in fields(kind):
        number: NumberRange | None = f.metadata.get("number")
        if number is not None:
            key = number.key or f.name.removesuffix(f"_{number.unit.lower().replace('^', '')}")
            if f.default is MISSING or s.has(key):
                values[f.name] = s.read_number(key, number.unit, number.low, number.high)
    return values


def parse_limits(s: DescriptionSection, change_unit: str) -> SensorLimits:
    """[limits]; `change_unit` is the unit of `no_contact_change`, grey or mm."""
    values = parse_numbers(SensorLimits, s)
    if s.has("depth_correlation") or "depth_rms_mm" in values:
        values["depth_correlation_mm"] = s.read_number("depth_correlation", "mm", 1e-3, 100.0)
    return SensorLimits(
        **values, no_contact_change=s.read_number("no_contact_change", change_unit, 0.0, 255.0)
    )


def parse_optics(s: DescriptionSection, data: dict[str, Any], path: Path) -> Optics:
    """[optics] with the lists of LEDs and glows in the description `data`."""
    lights = convert(data["optics"], _Lights, DESCRIPTION, path, within="optics")
    s.known_keys.update(_Lights.__struct_fields__)
    base = s.read_vector("base", "rgb", 0.0, 255.0)
    return Optics(base_rgb=base, leds=lights.leds, glows=lights.glows, **parse_numbers(Optics, s))
