"""Constants of the gel illumination models and of the surface refinement, each with its unit and
source.

"Chosen" means that `docs/experiments.md` compares the value with neighbours a third less and half
as much again.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class IlluminationConstants:
    """Grey levels are those of 8-bit images; slopes are in mm/mm; shares are of 1."""

    # Surface refinement
    iterations: int = 4  # where light is chosen; two leave 20 % more error on a GelSlim
    surface_iterations: int = 5  # of a frame's surface
    # The same in light that explains the image: walls rise for longer, after some in plain light.
    first_iterations: int = 2
    trusted_iterations: int = 10
    # largest change of an iteration that is the last: noise makes the next ones worse
    settled_mm: float = 0.005
    # the same as a share of the largest indentation, where that is less
    settled_share: float = 0.02
    cg_steps: int = 4  # conjugate-gradient steps of an iteration; 12 come no nearer
    fine_cg_steps: int = 3  # the same at full resolution, where only walls are raised
    grid_cells: int = 160  # along the longer side of the refinement grid (chosen)
    # larger residuals are dust, reflections, or another sensor instance (chosen)
    huber_grey: float = 20.0
    # grey^2 per squared slope: weight of level gel outside the changed region
    outside_weight: float = 1e4
    bulge_mm: float = -0.5  # lowest indentation: no gel bulges out farther

    # LED fit, see `parameter_fit`
    # along the longer side: half the refinement grid determines the LEDs as well
    led_grid_cells: int = 80
    fit_iterations: int = 4
    fit_refinements: int = 2  # surface refinements in each iteration of the fit
    fit_cg_steps: int = 8
    rate_step: float = 0.15  # standard deviations, for numerical derivatives
    # Mahalanobis length of one step: walls are not linear in the LED parameters
    max_fit_step: float = 4.0
    noise_grey: float = 6.0  # standard deviation of a colour that no LEDs explain (chosen)
    pull: float = 100.0  # grey^2 per squared slope: regularises the projection onto surfaces
    projection_cg_steps: int = 3
    black_grey: float = 2.0  # camera values at or below carry no information
    white_grey: float = 252.0  # camera values at or above carry no information

    # Field fit, see `field_light`
    field_iterations: int = 3
    field_refinements: int = 2
    first_field_refinements: int = 3
    # depths of the surface that the parabola goes through
    field_depth_factors: tuple[float, ...] = (0.8, 1.0, 1.25)
    min_field_samples: int = 60  # fewer determine no field
    min_relative_change: float = 0.1  # of the relative change q: slopes, not noise
    field_noise: float = 0.05  # of q: what no smooth field explains
    # lens blur spans six pixels; a touch and its surroundings 80
    field_independent_pixels: float = 200.0

    # Choice of the model, see `selection` Of the change, left by the described LEDs, plain and
    # trusted: simulated instances that no fitted LEDs explain 0.29 to 0.59 and 0.17 to 0.56; a real
    # GelSlim from 0.66 and 0.58, a real DIGIT from 0.74 and 0.62.
    explained_share: float = 0.6
    # described / field misfit under noise: a real GelSlim to 2.54, a real Mini from 2.59
    field_gain: float = 2.57
    # of a recording, that decide on a field: one real Mini touch in 67 misses the gain alone
    field_touches: int = 2
    hopeless_field_gain: float = 1.5  # after any iteration: two more gain a factor of 1.4 at most


CONSTANTS = IlluminationConstants()


@dataclass(frozen=True, slots=True, kw_only=True)
class StepRule:
    """How one refinement iteration moves the slopes, and how it makes them a surface."""

    pull: float  # grey^2 per squared slope: holds a step back where the colours determine little
    max_slope: float  # mm/mm
    weighted: bool  # solve for the surface nearest to the slopes, each weighted by its certainty

    def pack_limits(self) -> tuple[np.float32, np.float32, np.float32, np.float32]:
        """(pull, Huber limit, steepest slope, outside weight) as the kernel takes them."""
        huber = np.float32(CONSTANTS.huber_grey)
        outside = np.float32(CONSTANTS.outside_weight)
        return np.float32(self.pull), huber, np.float32(self.max_slope), outside


# 1.43 mm/mm is 55 degrees: the light hardly changes beyond. Walls next to edges have slopes of 2 to
# 3. In light that is not the instance's own, colours are less certain than they are clear, so that
# slopes count alike and are shrunk.
DESCRIBED_STEP = StepRule(pull=500.0, max_slope=1.43, weighted=False)
TRUSTED_STEP = StepRule(pull=100.0, max_slope=4.0, weighted=True)
FIELD_STEP = StepRule(pull=20.0, max_slope=1.43, weighted=False)
