"""What a target sensor shows of a touch that a source felt, as a few numbers say: carried, continued, and draped.

The source's touching parts are laid over the target's picture (turned, scaled, shifted), go on straight beyond the
source's view, and hold up a membrane that hangs freely elsewhere: a screened Laplace equation with soft supports. What
supports it is a plane that may be tilted, less the fall of the target's own rest surface. Units are what the pictures
are measured in: millimetres where both are metric, else the width of a tile.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from pipeline.alignment.fit.continuation import BoundaryRidges, detect_boundary_ridges
from pipeline.base.arrays import Doubles, Floats

GRID = 24  # cells across the target's picture
_MARGIN = 6  # cells around it, at whose edge the membrane rests
_ENDS_OVER = 0.1  # of the source's view, over which what is continued fades out
_VIEW = 0.03  # of the source's view at its border that is not looked at
_WIDEST = 0.75  # of a cell, by which what touches is spread so that no thin ridge falls between cells


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferModel:
    """How touches of a source become a target's; lengths in the unit of the pictures, angles in radians."""

    is_mirrored: bool = False  # the source's picture is flipped left to right first
    rotation_rad: float = 0.0  # then turned, from right towards down
    log_scale: float = 0.0  # then made larger by exp of this
    right: float = 0.0  # then shifted
    down: float = 0.0
    tilt_right: float = 0.0  # slope of what touches, in heights of the contact per half a picture of the target
    tilt_down: float = 0.0
    rest_curvature: float = 0.1  # how much lower it stands half a picture away, for the rest surface's own curvature
    log_reach: float = 0.45  # how far from its view's middle what the source feels goes on, in its view's widths
    log_width: float = -0.2  # of what is continued, in cells
    log_stiffness: float = 1.2  # how firmly the membrane is held up
    log_leak: float = -2.4  # how soon it falls back to rest

    @property
    def scale(self) -> float:
        """Units of the target per unit of the source; 1 where both are millimetres and true to them."""
        return math.exp(self.log_scale)

    def values(self) -> Doubles:
        """The numbers, in the order of `FREE`."""
        return np.array([getattr(self, name) for name in FREE_PARAMETERS])


FREE_PARAMETERS = tuple(f.name for f in fields(TransferModel) if f.name != "is_mirrored")


@dataclass(frozen=True, kw_only=True)  # no slots: the continuation is worked out once, when it is asked for
class ImprintPair:
    """One touch as both sensors felt it, in pictures whose middles are the origin."""

    name: str
    contact: Floats  # (rows, cols) 0..1, of the source
    source_size: tuple[float, float]  # (width, height) of that picture
    imprint: Floats  # (rows, cols) of the target, positive where pushed in; any unit where `metric` is False
    target_size: tuple[float, float]
    is_metric: bool = False

    @cached_property
    def boundary_ridges(self) -> BoundaryRidges:
        """What leaves the source's view."""
        return detect_boundary_ridges(self.contact)

    @property
    def cells(self) -> tuple[int, int]:
        """(rows, cols) of the coarse grid that stands for the target's picture."""
        width, height = self.target_size
        return max(8, round(GRID * height / width)), GRID

    @cached_property
    def coarse_imprint(self) -> Floats:
        """The imprint on that grid."""
        import cv2

        rows, cols = self.cells
        return np.asarray(cv2.resize(self.imprint, (cols, rows), interpolation=cv2.INTER_AREA), np.float32)


def transfer_imprint(pair: ImprintPair, how: TransferModel) -> Floats:
    """The imprint expected on the pair's coarse grid (rows, cols), in heights of the contact."""
    right, down = _places(pair)
    support = _support(pair, how, right, down)
    across, along = (2 * right / pair.target_size[0], 2 * down / pair.target_size[1])
    height = 1.0 + how.tilt_right * across + how.tilt_down * along - how.rest_curvature * (across**2 + along**2)
    firm = math.exp(how.log_stiffness) * support**2 * (height > 0)
    draped = _draped(firm, height, math.exp(how.log_leak))
    inside = slice(_MARGIN, -_MARGIN)
    return np.asarray(draped[inside, inside], np.float32)


def _places(pair: ImprintPair) -> tuple[Doubles, Doubles]:
    """(right, down) of the cells, with those around the picture, from its middle."""
    rows, cols = pair.cells
    width, height = pair.target_size
    right = ((np.arange(-_MARGIN, cols + _MARGIN) + 0.5) / cols - 0.5) * width
    down = ((np.arange(-_MARGIN, rows + _MARGIN) + 0.5) / rows - 0.5) * height
    across, along = np.meshgrid(right, down)
    return across, along


def _support(pair: ImprintPair, how: TransferModel, right: Doubles, down: Doubles) -> Doubles:
    """How far what touches reaches every cell, 0..1."""
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
    known = np.asarray(cv2.GaussianBlur(pair.contact, (0, 0), max(_WIDEST * cell_px / 2, 0.5)))
    known = np.minimum(known / max(float(np.percentile(known, 98.5)), 0.05), 1.0).astype(np.float32)
    here = cv2.remap(known, x_px.astype(np.float32), y_px.astype(np.float32), cv2.INTER_LINEAR)
    seen_x, seen_y = _VIEW * cols, _VIEW * rows
    seen = (x_px >= seen_x) & (x_px <= cols - 1 - seen_x) & (y_px >= seen_y) & (y_px <= rows - 1 - seen_y)
    far = np.hypot(x_px - (cols - 1) / 2, y_px - (rows - 1) / 2)
    fades = np.clip((math.exp(how.log_reach) * cols - far) / (_ENDS_OVER * cols) + 0.5, 0.0, 1.0)
    beyond = _continued(pair.boundary_ridges, x_px, y_px, math.exp(how.log_width) * cell_px) * fades
    return np.where(seen, np.asarray(here, np.float64), beyond)


def _continued(rays: BoundaryRidges, x_px: Doubles, y_px: Doubles, width_px: float) -> Doubles:
    """What the rays add at places of the source's picture, or rather beyond it."""
    out = np.zeros_like(x_px)
    for x, y, right, down, strength in zip(
        rays.x_px, rays.y_px, rays.right, rays.down, rays.strength, strict=True
    ):  # one after the other: they are a handful, and all at once they would not fit the cache
        along = (x_px - x) * right + (y_px - y) * down
        beside = (x_px - x) * down - (y_px - y) * right
        np.maximum(out, strength * np.exp(-0.5 * (beside / width_px) ** 2) * (along > -2), out=out)
    return out


def _draped(firm: Doubles, height: Doubles, leak: float) -> Floats:
    """The membrane (rows, cols): five-point Laplacian, held at `height` by springs `firm`, at rest around."""
    from scipy.linalg import solveh_banded

    rows, cols = firm.shape
    n = rows * cols
    bands = np.zeros((cols + 1, n), np.float32)  # half the time; a step of the fit moves imprints by percents
    bands[-1] = (4.0 + leak + firm).ravel()
    bands[-2, 1:] = -1.0
    bands[-2, cols::cols] = 0.0  # the last cell of a row is no neighbour of the next row's first
    bands[0, cols:] = -1.0
    held = (firm * np.maximum(height, 0.0)).ravel().astype(np.float32)
    lies = solveh_banded(bands, held, overwrite_ab=True, check_finite=False)
    return np.asarray(lies, np.float32).reshape(rows, cols)
