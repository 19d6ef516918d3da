"""The slot *view*: the cloud as the target's camera would see it."""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import freeze
from pipeline.engine.graph import Method, unless
from pipeline.pictures.layers import Layer, grid_layer, membrane_layer
from pipeline.pictures.picture import INDENTATION, Picture, of_heights, rest_mm
from pipeline.stages import known_truth
from pipeline.stages.project import stage
from pipeline.stages.slot import Mark, Seen, Slot
from pipeline.values.results import TargetView

SURFACE = Method(
    slot="view",
    name="surface",
    title="Surface",
    help="triangles between neighbouring pixels",
    run=unless(stage.without_contact, stage.project),
    params=stage.ProjectParams,
    reads=("cloud", "target"),
    version=4,
)
PAPER = Method(
    slot="view",
    name="paper",
    title="Paper",
    help="single points, as in the equations (D_T'' and M_T'')",
    run=unless(stage.without_contact, stage.project),
    params=stage.PaperParams,
    reads=("cloud", "target"),
)


def picture(view: TargetView, seen: Seen) -> Picture:
    """Target depth as indentation where there is a surface, with the mask's outline."""
    shown = freeze(np.asarray(rest_mm(seen.target, view.camera) - view.depth_mm, dtype=np.float32))
    caption = f"{INDENTATION}; mask outlined"
    return of_heights(shown, view.depth_mm, view.contact, view.camera, seen.target, seen.display, caption)


def layers(view: TargetView, seen: Seen, picture: Picture) -> tuple[Layer, ...]:
    """The surface that the target would see, over its faint rest surface."""
    rest = rest_mm(seen.target, view.camera)
    shown = rest - seen.display.stretch(seen.target) * (rest - view.depth_mm)
    return (grid_layer("view", view.camera.back_project(shown), picture.pixels), membrane_layer(seen.target))


def _follow(view: TargetView, before: Mark) -> Mark:
    """The target pixel that a cloud point falls on: several points may share one where the target is coarser."""
    where = before.point_mm
    if where is None:
        return Mark(slot="view", index=-1, text="not carried over")
    x_px, y_px, visible = (a[0] for a in view.camera.project(np.array([where])))
    if not visible:
        out_x = max(-x_px, x_px - view.camera.cols + 1, 0.0)
        out_y = max(-y_px, y_px - view.camera.rows + 1, 0.0)
        return Mark(slot="view", index=-1, point_mm=where, text=f"outside the image by {max(out_x, out_y):.0f} px")
    row, col = int(np.floor(y_px + 0.5)), int(np.floor(x_px + 0.5))
    seen_mm = float(view.depth_mm[row, col])
    index, place = -1, f"({col}, {row})"
    if not np.isfinite(seen_mm):
        text = f"{place}, cut away at a depth jump"
    elif where[2] > seen_mm + stage.SAME_SURFACE_MM:
        text = f"{place}, hidden behind what is {where[2] - seen_mm:.2f} mm nearer"
    else:
        pushed = float(view.indentation_mm[row, col])
        index = row * view.camera.cols + col
        text = f"{place}, " + (f"{pushed:.3f} mm in" if view.contact[row, col] else "does not reach the membrane")
    return Mark(slot="view", index=index, row=row, col=col, point_mm=where, text=text)


SLOT = Slot(
    name="view",
    title="Target view",
    legend="what the target sees",
    place="target",
    methods=(SURFACE, PAPER),
    picture=picture,
    layers=layers,
    follow=_follow,
    truth=known_truth.view,
)
