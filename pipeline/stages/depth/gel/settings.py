"""Constants of the nodes of a gel's depth: one class for each node, each constant with its unit and
source.

"Chosen" means that `docs/experiments.md` compares the value with neighbours a third less and half
as much again. Grey levels are those of 8-bit images; slopes are in mm/mm; shares are of 1.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
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


CONTACT = ContactSettings()
