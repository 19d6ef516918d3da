"""The illumination of a gel, and what every light model can do with it."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

from pipeline.base.arrays import Floats
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.illumination.constants import StepRule
from pipeline.stages.depth.illumination.image_patch import ImagePatch

IlluminationModel = Literal["described", "trusted", "near", "leds", "shadow_leds", "field"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Illumination:
    """Parameters of the light that a frame is read by.

    model: "described" and "trusted" are the LEDs of the sensor's description; trusted light is known to explain the
    image. "near" scales the described light by what LEDs close to the gel change of it. "leds" and "shadow_leds" are
    LEDs fitted to the sensor instance, as deviations from the description. "field" is a smooth shading field.
    """

    model: IlluminationModel = "described"
    parameters: tuple[float, ...] = ()  # of fitted models: deviations (`led_light`, `shadow_light`), or coefficients
    from_context: bool = False  # fitted to the context frames, not to the frame itself

    def __post_init__(self) -> None:
        """Accept the parameters as an array, as a file holds them."""
        object.__setattr__(self, "parameters", tuple(float(value) for value in self.parameters))

    @property
    def is_trusted(self) -> bool:
        """Whether LEDs of a usual instance explain the image, so that each pixel counts by its certainty."""
        return self.model in {"leds", "trusted"}

    @property
    def is_bound_to_place(self) -> bool:
        """Whether touches at one place err alike: the light is not fitted to each by itself, or by LEDs alone."""
        return self.model in {"described", "trusted", "near", "shadow_leds"}

    @property
    def is_fitted_leds(self) -> bool:
        """Whether the LEDs differ from the description."""
        return self.model == "leds" and any(self.parameters)


class RenderedChange(NamedTuple):
    """Change of the light of a surface against the reference image, before the lens, each (rows, cols, 3)."""

    change: Floats  # grey levels
    rate_x: Floats  # its derivatives by the slopes, grey levels per mm/mm
    rate_y: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """A light model, prepared for one image patch."""

    source: SensorSpec
    patch: ImagePatch
    step_rule: StepRule  # how an iteration moves the slopes
    confidence: Floats  # (rows, cols, 3) weight of each colour, at most 1
    blur_px: float  # standard deviation of the lens blur, in image pixels
    max_depth_mm: float  # largest indentation that is rendered

    def render(self, surface_mm: Floats, gx: Floats, gy: Floats) -> RenderedChange:
        """Render the light of a surface (rows, cols) with these slopes."""
        raise NotImplementedError
