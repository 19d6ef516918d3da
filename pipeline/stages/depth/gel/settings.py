"""Constants of the nodes of a gel's depth: one class for each node, each constant with its unit and
source.

"Chosen" means that `docs/experiments.md` compares the value with neighbours a third less and half
as much again. Grey levels are those of 8-bit images; slopes are in mm/mm; shares are of 1.
"""

from pipeline.core.frozen import frozen


@frozen
class RestSettings:
    """Constants of the node *rest*: of the check of a frame, and of the coarse light of an
    instance.
    """

    # grey levels: at most in a pixel that was lost, and more than that in its reference
    black_grey: int = 2
    lit_grey: int = 8
    lost_share: float = 0.25  # of the pixels: with more, a frame is refused

    # Coarse light, see `coarse_light`
    slope_step: float = 0.05  # mm/mm, of the derivative of the described light
    # alternations of light and dents; two more change the light by 1 to 4 %
    light_iterations: int = 3
    # share of the mean curvature that pulls the 36 numbers to the description
    light_ridge: float = 0.4
    # grey^2, the same pull where touches show little: a thousand times a block's noise
    light_doubt: float = 160.0
    # of a channel; real instances have up to 0.6, images of another instance 1.4
    turn_max: float = 1.0


@frozen
class ChangeSettings:
    """Constants of the node *change*; evidence is in nats."""

    # Blocks and dents, see `coarse_light`
    # blocks along the longer side: 10 px of a Mini; more do not decide better
    blocks_along: int = 32
    # blobs of pressure along the longer side, about 1 mm apart; one more beyond each border
    knots_along: int = 20
    # standard deviation of a blob over the distance of two: the sum of all is flat to 1 %
    blob_share: float = 0.6
    unmarked_min: float = 0.2  # share of a block that markers must leave visible
    # of the non-negative fit: the misfit changes by less than 1 % beyond
    pressure_iterations: int = 150
    # largest step over the largest pressure of an iteration that is the last: with 3e-4, areas of
    # soft balls move by 3 %
    pressure_settled: float = 1e-4
    # share of the largest pull: with less, pressure spreads where it moves nothing
    pressure_cost: float = 0.0007
    # blocks' worth of the mean squared change that an unlikely drift costs, beside a dent
    stiffness: float = 8.0
    noise_grey: float = 0.4  # of a block: camera, compression, what markers leave

    # Prior of the drift beside a dent
    gain_std: float = 0.04  # 3 % (`benchmarks.drift`) and a little more
    offset_std: float = 5.0  # grey; of the ramp from the centre to the border as well
    shift_std: float = 2.0  # px
    # correlation of the colours' drift: 0.75 for light of a random colour
    common_share: float = 0.8

    # Evidence of a dent and of light, see `change`
    light_std: float = 4.0  # grey of the longest wave of a field of light, falling by its number
    light_common_share: float = 0.9
    light_waves: int = 7  # along each axis
    floor_grey: float = 0.15  # least noise of a block
    # mm, of a knot; the likeliest counts
    pressure_stds: tuple[float, ...] = (0.003, 0.01, 0.03, 0.1, 0.3)
    # times `light_std`; the likeliest counts
    light_scales: tuple[float, ...] = (0.3, 1.0, 3.0, 10.0)
    # 96 soft balls and 40 tools of each gel, 200 drifted references, real balls, objects and clips.
    # Untouched: up to 40 (a dithered film; simulated -500 to 10, by JPEG up to 60); weakest touches
    # 85 (a rug), 150 (a film).
    press_evidence: float = 75.0
    none_evidence: float = 30.0
    # Evidence of light over that of the dent: spots from 10 on, glints 5 and more, dents by the
    # described light of another instance up to 4.
    light_ratio_press: float = 4.0
    light_ratio_none: float = 5.0
    # no dent, however unlikely the drift is: spots of a fifth of the view from 30 on
    light_ratio_certain: float = 15.0
    # Nats by which drift is likelier beside a dent: drifted references up to 5, the largest balls
    # 25 to 50.
    unlikely_drift: float = 12.0
    # A smooth dent, which the linear light of the blocks measures as well as anything: its radius
    # at half its depth in distances of knots (soft balls of .13 mm from 2.3), and its steepest
    # slope (small balls have more than .3 mm/mm).
    smooth_knots: float = 2.0
    smooth_slope: float = 0.25
    # That slope times the radius over the depth: 1.4 for a paraboloid, more where the view cuts it:
    # the second by the share of the view. Balls of 30 to 120 mm have 1.1 to 1.9, light presses of
    # tools from 1.8 at a tenth of the view, faces and tools of every gel 2.0 to 7.4.
    smooth_steepness: tuple[float, float] = (1.5, 2.0)
    # share of the squared change that is left: tools from .1, soft balls up to .09
    smooth_residual: float = 0.095
    # Beside a smooth dent, drift as costly as this is nearly none. It is held back where the
    # residual grows by less than the first factor, not at all from the second: most without drift
    # grow by up to 1.4, with drift by 1.3 to 60.
    still_stiffness: float = 200.0
    still_residuals: tuple[float, float] = (1.25, 1.6)
    # Contact of a coarse dent: load over its load-weighted mean, and depth over the deepest. Areas
    # of soft balls are .8 to 1.1 of the true ones; without the second, faint load far from the dent
    # makes some 1.4.
    load_share: float = 0.35
    dent_share: float = 0.15

    # Drift that is removed, see `drift`
    drift_blocks_along: int = (
        54  # along the longer side: more do not improve the fit of smooth changes
    )
    drift_block_min_px: int = 8
    # of the weights in successive fits, before the noise's
    drift_scales_grey: tuple[float, ...] = (24.0, 12.0, 6.0, 3.0)
    drift_agreement_grey: float = 1.5  # residual up to which a block agrees, where noise is low
    # the same in standard deviations of a block's noise, where that is more
    drift_agreement_sigmas: float = 3.0
    drift_agreement_min: float = 0.3  # share of the blocks; fewer may be part of a touch
    # Share by which more blocks agree than without drift: up to the first it is left alone, from
    # the second removed.
    drift_agreement_gain: tuple[float, float] = (0.25, 0.35)
    # of gain, offset (grey), ramp (grey to the border), shift (px)
    drift_prior_std: tuple[float, ...] = (0.05, 8.0, 10.0, 1.5)
    drift_block_noise_grey: float = 0.5
    drift_gain_max: float = 0.2  # more is no drift: another sensor instance, or a failed LED
    drift_grey_max: float = 30.0
    drift_shift_max_px: float = 8.0
    drift_exposure_min: float = 0.1  # deviation from 1 of a common gain
    drift_exposure_max: float = 3.0  # the gain, or its inverse
    # between which a block's ratio to the reference is a gain
    drift_exposure_grey: tuple[float, float] = (16.0, 250.0)
    drift_exposure_tolerance: float = 0.04  # relative deviation from the common gain
    drift_exposure_share: float = 0.5  # of the blocks that agree
    drift_iterations: int = 4
    drift_shift_tolerance_px: float = 0.05
    drift_shift_min_px: float = 0.1  # smaller shifts are ignored: interpolation would blur more
    drift_note_gain: float = 0.012  # changes that get a note
    drift_note_grey: float = 2.5
    drift_note_px: float = 0.4
    # All drift together: two simulated instances that a drift explains 23 to 49; gain 3 %, ramp 12,
    # 2 px: 11.
    drift_instance_drift_grey: float = 18.0
    # change of three quarters of an image whose reference is of another instance
    drift_foreign_grey: float = 7.0


@frozen
class StepRule:
    """How one refinement iteration moves the slopes, and how it makes them a surface."""

    pull: float  # grey^2 per squared slope: holds a step back where the colours determine little
    # mm/mm; 1.43 is 55 degrees: the light hardly changes beyond. Walls next to edges have slopes
    # of 2 to 3.
    max_slope: float = 1.43
    # solve for the surface nearest to the slopes, each weighted by its certainty
    weighted: bool = False


@frozen
class LightSettings:
    """Constants of the node *light*, which chooses an illumination and fits its parameters."""

    min_context_touches: int = 2  # one tells no more than the frame itself
    iterations: int = 4  # of a surface; two leave 20 % more error on a GelSlim

    # Standard deviations between sensor instances, as `simulation.variation` draws them.
    azimuth_deg: float = 8.0
    elevation_deg: float = 3.0
    # of the logarithm of a whole LED, and of each of its colours
    log_power: float = 0.12
    log_colour: float = 0.08
    # fall-off, vignette, log blur, log shadow, shadow elevation (degrees)
    others: tuple[float, ...] = (0.05, 0.08, 0.15, 0.25, 3.0)
    elevation_limits_deg: tuple[float, float] = (5.0, 80.0)
    # of the brightness that the gain of near LEDs is compared with
    reference_blur_px: float = 3.0

    # LED fit, see `parameter_fit`
    fit_iterations: int = 4
    fit_refinements: int = 2  # surface refinements in each iteration of this and the field fit
    fit_cg_steps: int = 8
    rate_step: float = 0.15  # standard deviations, for numerical derivatives
    # Mahalanobis length of one step: walls are not linear in the LED parameters
    max_fit_step: float = 4.0
    noise_grey: float = 6.0  # standard deviation of a colour that no LEDs explain (chosen)
    projection_cg_steps: int = 3
    black_grey: float = 2.0  # camera values at or below carry no information
    white_grey: float = 252.0  # camera values at or above carry no information
    # LEDs are accepted where deviance / max_deviance + excess / max_excess is at most 1: deviance
    # t' C^-1 t, and the share of the change that is left beyond noise. Simulated instances reach up
    # to 0.99 of the limit, one in fifty more; single balls on a real Mini from 1.19, other real
    # instances from 2.1.
    max_deviance: float = 70.0
    max_excess: float = 0.28
    independent_pixels: float = 800.0  # of one touch
    misfit_noise_grey: float = 1.5  # grey levels of misfit per pixel that are noise
    # This sum beyond which a fit ends: as described, after one step, two, ... 238 accepted fits
    # (`benchmarks/simulated_depth.py`) have at most 1.97, 1.65, 1.78 and 1.25; all of 15 touches on
    # a real GelSlim have more than 2 after two steps.
    hopeless: tuple[float, ...] = (2.32, 1.9, 1.9, 1.4, 1.0)
    # Share of the deviance of random instances below which the description stands: walls and
    # shadows on instances as described have up to this in three touches of four, others 0.22 or
    # more.
    as_described: float = 0.2

    # Field fit, see `field_light`
    field_iterations: int = 3
    # of several touches together: a third deepens all by 4 %, and rounds them
    joint_field_iterations: int = 2
    first_field_refinements: int = 3
    # depths of the surface that the parabola goes through
    field_depth_factors: tuple[float, ...] = (0.8, 1.0, 1.25)
    min_field_samples: int = 60  # fewer determine no field
    min_relative_change: float = 0.1  # of the relative change q: slopes, not noise
    field_noise: float = 0.05  # of q: what no smooth field explains
    # lens blur spans six pixels; a touch and its surroundings 80
    field_independent_pixels: float = 200.0

    # Choice of the model, see `selection`. Of the change, left by the described LEDs, plain and
    # trusted: simulated instances that no fitted LEDs explain 0.29 to 0.59 and 0.17 to 0.56; a real
    # GelSlim from 0.66 and 0.58, a real DIGIT from 0.74 and 0.62.
    explained_share: float = 0.6
    # described / field misfit under noise: a real GelSlim to 2.54, a real Mini from 2.59
    field_gain: float = 2.57
    # of a recording, that decide on a field: one real Mini touch in 67 misses the gain alone
    field_touches: int = 2
    # Standard deviation of a recording's field over the colours of a dent in it: with the first, no
    # frame fits its own, from the second each does (`docs/experiments.md`).
    field_known: tuple[float, float] = (0.03, 0.05)
    hopeless_field_gain: float = 1.5  # after any iteration: two more gain a factor of 1.4 at most


@frozen
class SlopesSettings:
    """Constants of the node *slopes*, and of the window in which it looks."""

    # Where the image has changed, see `change_detection`
    block_px: int = 8  # width of the blocks that changes are averaged over
    blocks_min: int = 40  # along the longer side, for the estimate of noise
    low_share: float = 0.35  # of the no-touch limit: a touched region extends down to this change
    drift_factor: float = 2.5  # times the image's typical change: less is drift of the light
    # of the block changes that is typical of the image, of which a touch may fill most
    typical_quantile: float = 0.25
    # standard deviation in blocks: a touch is smooth over it, noise is not
    smoothing_blocks: float = 1.2
    # times the noise: untouched frames of a dithered film reach 15, its touches 16 to 100
    noise_factor: float = 16.0
    # around the visible change: the gel relaxes to rest within about this distance
    margin_mm: float = 2.0
    blend_share: float = 0.5  # of the margin, over which the surface is blended to rest
    # of the deepest point: the part of a coarse dent that is surely indented
    dent_share: float = 0.25

    # noise of one grey level moves what is clipped at 255 down to here
    saturated_grey: int = 254
    saturated_share: float = 0.01  # of the changed region; more is warned of
    level_pixels: int = 1000  # outside the changed region, whose median is the level of a surface


@frozen
class SurfaceSettings:
    """Constants of the node *surface*: of the refinement, which chooses light as well."""

    iterations: int = 5
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
    # In light that is not the instance's own, colours are less certain than they are clear, so that
    # slopes count alike and are shrunk.
    described_step: StepRule = StepRule(pull=500.0)
    trusted_step: StepRule = StepRule(pull=100.0, max_slope=4.0, weighted=True)
    field_step: StepRule = StepRule(pull=20.0)
    no_blur_px: float = 0.3  # a Gaussian this narrow changes nothing

    # of the depth: where a wall is raised
    wall_ranges: tuple[tuple[float, float], ...] = ((0.1, 0.5), (0.3, 0.8), (0.6, 1.0))
    deepest_percent: float = 99.5  # percentile that stands for the depth
    min_depth_mm: float = 0.02  # shallower surfaces have no walls
    wall_ridge: float = 1e-6  # of the normal equations' trace
    wall_margin_mm: float = 1.5  # around the dent, within which raised walls fade to what is there

    # around a coarse dent: slopes farther away are shadows. 42 balls on a real DIGIT: 1 mm, or .4
    # of the deepest point, measures them as well (`docs/experiments.md`).
    reach_mm: float = 0.5


@frozen
class ContactSettings:
    """Constants of the node *contact*.

    Without another source they were chosen by presses of the training objects on simulated sensor
    instances and by flat faces.
    """

    # Pressure, see `depth.contact`
    smoothing_px: float = 1.0  # standard deviation of its blur, and of the blur of level faces
    # farther than lens and smoothing spread an edge: where the peak nearby is looked for, and where
    # the surroundings of a region begin
    near_mm: float = 0.25
    pressure_min: float = 0.02  # mm/mm: noise and an inexact light make as much
    # of the median pressure of a region's core: ends balls on real gels near their visible rim
    # (`benchmarks/real_depth.py`); simulated instances alone would give 0.24 or less
    median_share: float = 0.32
    core_share: float = 0.16  # of the region's peak pressure
    part_share: float = 0.25  # of that peak: a part without a pixel of this much is left out
    # peak nearby over the median between which it counts as a ridge, and the limit there as a
    # share of such a peak
    ridge_ratios: tuple[float, float] = (1.7, 3.5)
    ridge_share: float = 0.6
    # gel within this distance (about its thickness) of a deeper point, and shallower than this
    # share of it, hangs there: balls on real gels, as `median_share`
    hanging_mm: float = 2.0
    hanging_share: float = 0.25
    hanging_cells: int = 8  # that distance, on a coarser grid
    box_margin_px: int = 8  # beyond what is indented: no filter of the contact reaches farther
    # of the depth of the nearest rim: a face that deep is in contact as well
    flat_depth_share: float = 0.8
    # of the region's steep slopes: the gel falls away next to a contact, but not on a face
    flat_slope_share: float = 0.3
    step_px: int = 7  # extent of a smoothed step, to both sides

    # Certain pressure, by which a surface is levelled
    certain_blur_px: float = 1.5  # standard deviation of its blur (chosen)
    certain_cells: int = 220  # of its grid, along the longer side
    certain_slope: float = 0.04  # mm/mm: relative pressure that noise does not reach
    certain_share: float = 0.1  # the same as a share of the peak
    grain_share: float = 0.5  # of the peak: a speck with this much pressure is no noise
    speck_mm2: float = 0.15  # smaller contacts are camera noise
    # gaps that a rough ball or a book leaves between its threads (`benchmarks/real_things.py`)
    hole_mm2: float = 0.5

    # False contacts, see `remove_false_contacts`
    flank: float = 0.12  # mm/mm
    flank_share: float = 0.1  # of a region's pixels
    # of the steepest tenth of the deepest region, where a light touch has nothing steeper
    flank_of_deepest: float = 0.7
    # of a region's own depth: simulated second touches of 0.05 mm and more have 0.64 to 1.1
    prominence: float = 0.5
    # around a region: the flanks of a dent lie partly outside its contact
    flanks_mm: float = 0.8
    # Of the change: balls have at most 0.6 in one direction, other objects 0.83, spots of light
    # from 0.94 on (`benchmarks/real_depth.py`, `real_things.py`, `drift.py`).
    one_direction: float = 0.85
    # of the deepest region: corners next to a real GelSlim's presses reach 0.36
    border_share: float = 0.4

    # Rest level and far field, see `rest_level`
    coarse_cells: int = 56  # of the coarse grid, along the longer side
    # gel thicknesses from pressure: the gel is neither indented nor pulled down there
    quiet_distance: float = 0.7
    # of the rim's depth: an enclosed patch that deep is the inside of a face
    face_share: float = 0.7
    # the same for a patch at the image border, which slightly wrong slopes lift as well
    cut_face_share: float = 0.87
    relief_share: float = 0.3  # of the whole relief: smallest depth of a face's rim
    # percentile that stands for the lowest part: a bulge, or the surroundings of a face
    lowest_percent: float = 2.0
    # of the whole relief: quiet parts with less spread need no correction
    rest_spread_share: float = 0.2
    spread_percent: float = 5.0  # percentile from either end that bounds that spread
    rest_weight: float = 0.3  # of a cell at rest, against one of a step between two cells
    iterations: int = 24  # of conjugate gradients
    tolerance: float = 1e-3  # of the first residual
    cell_touched: float = 0.5  # share of a cell
    far_share_min: float = 0.02  # of the pixels: fewer far pixels give no level
    far_tolerance_mm: float = 2e-3  # of the far field, which is a tenth of a millimetre
    far_iterations: int = 12
    # gel thicknesses from the contact between which the measured surface passes into the far field
    fade_distances: tuple[float, float] = (0.2, 0.6)

    # Depth map
    full_share: float = 0.9  # of the view: a larger contact leaves too little gel at rest
    # curl of mirrored over plain slopes: identifies 9 of 10 balls on a real Mini
    mirrored_curl: float = 0.8
    # Expected error, see `result`: 706 simulated presses of four gels
    unexplained_factor: float = 2.6
    steep_percent: float = 95.0  # percentile of the slopes in contact
    steepness_range: tuple[float, float] = (0.2, 1.6)  # mm/mm: range of those presses


REST = RestSettings()
CHANGE = ChangeSettings()
LIGHT = LightSettings()
SLOPES = SlopesSettings()
SURFACE = SurfaceSettings()
CONTACT = ContactSettings()
