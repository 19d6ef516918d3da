"""Predict a target's imprint from a source's contact with a few parameters: transferred, extrapolated and draped.

The source's contact is laid over the target's image (rotated, scaled, translated), continues straight beyond the
source's view, and supports a membrane that is free elsewhere: a screened Laplace equation with soft supports. The
support is a plane that may tilt, less the curvature of the target's rest surface. Lengths are millimetres where both
images are metric, else widths of a tile.
"""

import math
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from pipeline.base.arrays import Doubles, Floats
from pipeline.imprints.continuation import BoundaryRidges, detect_boundary_ridges

GRID = 24  # cells across the target's image
_MARGIN = 6  # cells around it, at whose edge the membrane is at rest
_FADE = 0.1  # of the source's view, over which extrapolated contact fades out
_VIEW_MARGIN = 0.03  # margin of the source's view that is ignored
_BLUR = 0.75  # of a cell: blur of the contact, so that no thin ridge falls between cells


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferModel:
    """Parameters from a source's contact to a target's imprint; lengths in the unit of the images."""

    is_mirrored: bool = False  # the source's image is flipped left to right first
    rotation_rad: float = 0.0  # then rotated, from right towards down
    log_scale: float = 0.0  # then scaled by exp of this
    right: float = 0.0  # then translated
    down: float = 0.0
    tilt_right: float = 0.0  # slope of the support, in heights of the contact per half a target image
    tilt_down: float = 0.0
    rest_curvature: float = 0.1  # how much lower it is half an image away, for the rest surface's curvature
    log_reach: float = 0.45  # how far from its view's centre the source's contact continues, in widths of the view
    log_width: float = -0.2  # of extrapolated ridges, in cells
    log_stiffness: float = 1.2  # of the support
    log_leak: float = -2.4  # of the membrane's return to rest

    @property
    def scale(self) -> float:
        """Units of the target per unit of the source; 1 where both are true millimetres."""
        return math.exp(self.log_scale)

    def values(self) -> Doubles:
        """Return the free parameters, in the order of `FREE_PARAMETERS`."""
        return np.array([getattr(self, name) for name in FREE_PARAMETERS])


FREE_PARAMETERS = tuple(f.name for f in fields(TransferModel) if f.name != "is_mirrored")


@dataclass(frozen=True, kw_only=True)  # no slots: cached properties
class ImprintPair:
    """One touch observed by both sensors, in images whose centres are the origin."""

    name: str
    contact: Floats  # (rows, cols) 0..1, of the source
    source_size: tuple[float, float]  # (width, height) of that picture
    imprint: Floats  # (rows, cols) of the target, positive where pushed in; any unit unless `is_metric`
    target_size: tuple[float, float]
    is_metric: bool = False

    @cached_property
    def boundary_ridges(self) -> BoundaryRidges:
        """Ridges that leave the source's view."""
        return detect_boundary_ridges(self.contact)

    @property
    def cells(self) -> tuple[int, int]:
        """(rows, cols) of the coarse grid over the target's image."""
        width, height = self.target_size
        return max(8, round(GRID * height / width)), GRID

    @cached_property
    def coarse_imprint(self) -> Floats:
        """The imprint on that grid."""
        import cv2

        rows, cols = self.cells
        return np.asarray(cv2.resize(self.imprint, (cols, rows), interpolation=cv2.INTER_AREA), np.float32)


def transfer_imprint(pair: ImprintPair, how: TransferModel) -> Floats:
    """Return the expected imprint on the pair's coarse grid (rows, cols), in heights of the contact."""
    right, down = _places(pair)
    support = _support(pair, how, right, down)
    across, along = (2 * right / pair.target_size[0], 2 * down / pair.target_size[1])
    height = 1.0 + how.tilt_right * across + how.tilt_down * along - how.rest_curvature * (across**2 + along**2)
    firm = math.exp(how.log_stiffness) * support**2 * (height > 0)
    draped = _drape(firm, height, math.exp(how.log_leak))
    inside = slice(_MARGIN, -_MARGIN)
    return np.asarray(draped[inside, inside], np.float32)


def _places(pair: ImprintPair) -> tuple[Doubles, Doubles]:
    """Return (right, down) of the cells and their margin, from the image's centre."""
    rows, cols = pair.cells
    width, height = pair.target_size
    right = ((np.arange(-_MARGIN, cols + _MARGIN) + 0.5) / cols - 0.5) * width
    down = ((np.arange(-_MARGIN, rows + _MARGIN) + 0.5) / rows - 0.5) * height
    across, along = np.meshgrid(right, down)
    return across, along


def _support(pair: ImprintPair, how: TransferModel, right: Doubles, down: Doubles) -> Doubles:
    """Return the contact's support of every cell, 0..1."""
    import cv2

    cos, sin = math.cos(how.rotation_rad) / how.scale, math.sin(how.rotation_rad) / how.scale
    back_right = cos * (right - how.right) + sin * (down - how.down)
    back_down = -sin * (right - how.right) + cos * (down - how.down)
    back_right = -back_right if how.is_mirrored else back_right
    rows, cols = pair.contact.shape
    width, height = pair.source_size
    x_px = (back_right / width + 0.5) * cols - 0.5
    y_px = (back_down / height + 0.5) * rows - 0.5
    cell_px = pair.target_size[0] / GRID / how.scale / width * cols
    known = np.asarray(cv2.GaussianBlur(pair.contact, (0, 0), max(_BLUR * cell_px / 2, 0.5)))
    known = np.minimum(known / max(float(np.percentile(known, 98.5)), 0.05), 1.0).astype(np.float32)
    here = cv2.remap(known, x_px.astype(np.float32), y_px.astype(np.float32), cv2.INTER_LINEAR)
    seen_x, seen_y = _VIEW_MARGIN * cols, _VIEW_MARGIN * rows
    seen = (x_px >= seen_x) & (x_px <= cols - 1 - seen_x) & (y_px >= seen_y) & (y_px <= rows - 1 - seen_y)
    far = np.hypot(x_px - (cols - 1) / 2, y_px - (rows - 1) / 2)
    fades = np.clip((math.exp(how.log_reach) * cols - far) / (_FADE * cols) + 0.5, 0.0, 1.0)
    beyond = _extrapolate(pair.boundary_ridges, x_px, y_px, math.exp(how.log_width) * cell_px) * fades
    return np.where(seen, np.asarray(here, np.float64), beyond)


def _extrapolate(rays: BoundaryRidges, x_px: Doubles, y_px: Doubles, width_px: float) -> Doubles:
    """Return the contact that the ridges add at points of the source's image plane."""
    out = np.zeros_like(x_px)
    for x, y, right, down, strength in zip(
        rays.x_px, rays.y_px, rays.right, rays.down, rays.strength, strict=True
    ):  # a loop: all few ridges at once would not fit the cache
        along = (x_px - x) * right + (y_px - y) * down
        across = (x_px - x) * down - (y_px - y) * right
        np.maximum(out, strength * np.exp(-0.5 * (across / width_px) ** 2) * (along > -2), out=out)
    return out


def _drape(firm: Doubles, height: Doubles, leak: float) -> Floats:
    """Solve the membrane (rows, cols): five-point Laplacian, held at `height` by springs `firm`, at rest around."""
    from scipy.linalg import solveh_banded

    rows, cols = firm.shape
    n = rows * cols
    bands = np.zeros(
        (cols + 1, n), np.float32
    )  # half the time of float64; a step of the fit changes imprints by percents
    bands[-1] = (4.0 + leak + firm).ravel()
    bands[-2, 1:] = -1.0
    bands[-2, cols::cols] = 0.0  # the last cell of a row is no neighbour of the next row's first
    bands[0, cols:] = -1.0
    held = (firm * np.maximum(height, 0.0)).ravel().astype(np.float32)
    lies = solveh_banded(bands, held, overwrite_ab=True, check_finite=False)
    return np.asarray(lies, np.float32).reshape(rows, cols)
