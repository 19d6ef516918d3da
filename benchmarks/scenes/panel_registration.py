"""How a lab's images of depth lie on its images of touch: for the question about real depth.

Not a question itself. In the clips of a GelSlim 4.0 the two are not of one frame: depth is shown
larger and aside. One scale along each axis and one shift are looked for, for all clips together,
that bring the edges of the depth onto what changes in the touch: Pearson's correlation of the means
over the frames with contact.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

_EDGE_BLUR_PX = 1.0
_WIDE_BLUR_PX = 1.5  # of the depth's edges: what presses has flanks
# percentile at which a change is cut; the panels' frame
_HIGH = 97.0
_FRAME_PX = 3
_LEAST_COMMON = 0.35  # of the panel
_SCALES = np.arange(1.0, 1.9, 0.2)
_SHIFTS_PX = np.arange(-9.0, 19.0, 4.5)
_STEPS = (0.08, 0.08, 4.0, 4.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelMap:
    """Where a pixel of the touch lies on the depth: scaled around the panel's middle, then
    shifted.
    """

    scale_x: float
    scale_y: float
    shift_x_px: float
    shift_y_px: float

    def warp(self, field):
        """A field of the depth's panel on the touch (rows, cols), and where it is known there."""
        rows, cols = field.shape
        x, y = np.meshgrid(np.arange(cols) - 0.5 * (cols - 1), np.arange(rows) - 0.5 * (rows - 1))
        x = (self.scale_x * x + self.shift_x_px + 0.5 * (cols - 1)).astype(np.float32)
        y = (self.scale_y * y + self.shift_y_px + 0.5 * (rows - 1)).astype(np.float32)
        known = (x >= 0) & (x <= cols - 1) & (y >= 0) & (y <= rows - 1)
        return cv2.remap(field, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), known


def edges(pictures, depths, still):
    """What changes in a clip's touches, and the edges of their depths: means (rows, cols) over
    the frames given.
    """
    changed = np.mean(
        [np.abs(_smooth(one.astype(np.float32) - still)).sum(axis=2) for one in pictures], axis=0
    )
    steep = np.mean([np.hypot(*np.gradient(_smooth(depth))) for depth in depths], axis=0)
    changed, steep = (
        np.minimum(a, np.percentile(a, _HIGH)).astype(np.float32) for a in (changed, steep)
    )
    return _smooth(changed), cv2.GaussianBlur(steep, (0, 0), _WIDE_BLUR_PX)


def fit_panel_map(of_clips) -> PanelMap:
    """One lay for all clips, given by their `edges`."""
    from scipy import optimize

    def unlike(at):
        return -float(
            np.mean(
                [
                    _alike(PanelMap(**dict(zip(PanelMap.__slots__, at, strict=True))), *clip)
                    for clip in of_clips
                ]
            )
        )

    grid = [
        (sx, sy, x, y) for sx in _SCALES for sy in _SCALES for x in _SHIFTS_PX for y in _SHIFTS_PX
    ]
    best = np.array(min(grid, key=unlike))
    simplex = np.vstack([best, best + np.diag(_STEPS)])
    found = optimize.minimize(
        unlike, best, method="Nelder-Mead", options={"initial_simplex": simplex}
    ).x
    return PanelMap(**dict(zip(PanelMap.__slots__, (float(v) for v in found), strict=True)))


def correlate(a, b, where=...) -> float:
    """Pearson's correlation; 0 where one of them is level."""
    a = a[where].ravel()
    b = b[where].ravel()
    return float(np.corrcoef(a, b)[0, 1]) if np.ptp(a) > 0 and np.ptp(b) > 0 else 0.0


def _alike(lay: PanelMap, changed, steep) -> float:
    there, known = lay.warp(steep)
    known[:_FRAME_PX] = known[-_FRAME_PX:] = known[:, :_FRAME_PX] = known[:, -_FRAME_PX:] = False
    return correlate(there, changed, known) if known.mean() >= _LEAST_COMMON else 0.0


def _smooth(image):
    return cv2.GaussianBlur(image, (0, 0), _EDGE_BLUR_PX)
