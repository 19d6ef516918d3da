"""Constants of the contact by load (`contact`, `pressure`)."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactSettings:
    """All constants of the contact by load; pressures are in mm/mm, see `pressure`.

    Without another source: of the solver and the norm, chosen on every second simulated touch of three sensors; of the
    contact's edge and parts, on all of them and on real balls, objects and film (`docs/experiments.md`).
    """

    cells_max: int = 160  # along the longer side of the image
    # Of the solver: five times as many change the contact's IoU by .005 at most.
    steps_coarse: tuple[int, ...] = (8, 8, 8)  # of descent on cells of twice the width; each updates the price of load
    steps: int = 8  # on the cells
    steps_warm: int = 6  # from the pressure of a similar surface
    steps_refit: int = 12  # on the coarse cells, of the contact alone: 60 change nothing
    continued_share: float = 0.5  # of the gel's thickness, by which load at the border goes on beyond the image
    margin_share: float = 2.0  # of the gel's thickness: the layer beyond the image
    level_mm: float = 1.2  # length l from which on waves are known by their height rather than by their slope
    ridge: float = 0.03
    price_share: float = 0.04  # price of load, of the load-weighted mean pressure
    price_min: float = 0.001  # mm/mm: what noise of a camera makes
    blob_mm: float = 0.08  # standard deviation: about what lens and smoothing blur an edge by
    edge_blob_mm: float = 0.06  # the same of the pressure whose edge is the contact's
    contact_share: float = 0.44  # of the mean pressure nearby: contact
    mean_mm: float = 1.0  # standard deviation of that mean's weights
    mean_share: float = 0.08  # of the mean pressure of the whole image, from which on pressure counts in that mean
    mean_cells: int = 2  # along that standard deviation
    reach_mm: float = 2.0  # of that mean: pressure by errors of slopes lies within about a gel's thickness of a contact
    total_share: float = 0.25  # of the mean pressure of the whole image: contact anywhere
    pressure_min: float = 0.012  # mm/mm: contact anywhere
    # Of the mean pressure of the whole image: by so much a part of the contact exceeds the mean nearby somewhere. Balls
    # on real sensors .38 to 1.7, simulated contacts .9 and more; corners of real GelSlims up to .43, of DIGITs .39.
    part_share: float = 0.4
    part_mm2: float = 0.12  # smaller parts are noise
    least_share: float = 0.5  # of a sensor's smallest indentation, which counts from the bulge around a contact
    around_share: float = 1.0  # of the gel's thickness around a contact, where the level of the surface is compared
    crumb_px: int = 4  # of the image: what is left of a part where it is that shallow
    cell_share: float = 0.99  # of a cell that must have been measured
    fade_shares: tuple[float, float] = (
        0.2,
        0.6,
    )  # of the gel's thickness from the contact: from measured to mechanical


CONTACT = ContactSettings()
