from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.geometry.camera import Camera
from pipeline.core.graph import StageResult
from pipeline.core.values.results import Cloud, DepthMap, TargetDepth
from pipeline.translation.catalogue import BUILT_IN
from pipeline.translation.pixel_trace import trace_forward, trace_to_source

CAMERA = Camera(rows=4, cols=5, fx_px=10.0, fy_px=10.0, cx_px=2.0, cy_px=1.5)
WINDOW = np.zeros((4, 3), np.float32)
IDENTITY = np.arange(20, dtype=np.int32).reshape(4, 5)


def result(name, output):
    return StageResult(
        name=name,
        method=BUILT_IN.stage(name).methods[0],
        output=output,
        state="computed",
        ms=0.0,
        notes=(),
        digest="",
    )


@pytest.fixture
def results():
    """The same camera on both sides: every contact pixel lands on itself."""
    indentation = np.full((4, 5), 0.01, np.float32)
    contact = np.zeros((4, 5), bool)
    contact[1:3, 1:4] = True
    indentation[contact] = 0.5
    depth_mm = (20 - indentation).astype(np.float32)
    depth = DepthMap(
        indentation_mm=indentation,
        depth_mm=depth_mm,
        contact=contact,
        camera=CAMERA,
        source_index=IDENTITY,
    )
    pixels = np.flatnonzero(contact).astype(np.int32)
    points = CAMERA.back_project(depth_mm).reshape(-1, 3)[pixels].astype(np.float32)
    cloud = Cloud(points_mm=points, source_index=pixels, grid_shape=(4, 5), field_of_view_mm=WINDOW)
    index = np.full(20, -1, np.int32)
    index[pixels] = np.arange(len(pixels))
    seen = index.reshape(4, 5) >= 0
    view = TargetDepth(
        in_view=np.ones((4, 5), bool),
        depth_mm=np.where(seen, depth_mm, np.nan).astype(np.float32),
        contact=seen,
        indentation_mm=np.where(seen, indentation, 0).astype(np.float32),
        camera=CAMERA,
        source_index=index.reshape(4, 5),
    )
    return {
        "depth": result("depth", depth),
        "cloud": result("cloud", cloud),
        "target_depth": result("target_depth", view),
    }


def test_forward_then_backward_returns_the_pixel(results):
    for row in (1, 2):
        for col in (1, 2, 3):
            last = trace_forward(results, row, col, 5)[-1]
            assert (
                trace_to_source(results, "target_depth", last.row * 5 + last.col) == row * 5 + col
            )


def test_a_trace_says_why_it_ends(results):
    marks = trace_forward(results, 0, 0, 5)
    assert [mark.text for mark in marks[1:]] == ["0.010 mm, not in contact", "not in the cloud"]
    assert trace_to_source(results, "target_depth", 0) == -1


def test_a_point_outside_the_target_image_says_by_how_much(results):
    moved = results["cloud"].output.points_mm + np.float32((8.0, 0.0, 0.0))
    cloud = Cloud(
        points_mm=moved,
        source_index=results["cloud"].output.source_index,
        grid_shape=(4, 5),
        field_of_view_mm=WINDOW,
    )
    last = trace_forward({**results, "cloud": result("cloud", cloud)}, 1, 3, 5)[-1]
    assert last.text == "outside the image by 3 px"


def test_a_point_behind_a_nearer_surface_is_called_hidden(results):
    points = results["cloud"].output.points_mm.copy()
    points[0] *= 1.1  # along its own ray, 2 mm farther away
    cloud = Cloud(
        points_mm=points,
        source_index=results["cloud"].output.source_index,
        grid_shape=(4, 5),
        field_of_view_mm=WINDOW,
    )
    last = trace_forward({**results, "cloud": result("cloud", cloud)}, 1, 1, 5)[-1]
    assert last.text == "(1, 1), hidden by a surface 1.95 mm nearer"


def test_the_marks_read_from_source_to_target(results):
    assert [mark.text for mark in trace_forward(results, 1, 2, 5)] == [
        "(2, 1)",
        "0.500 mm",
        "(0.00, -0.98, 19.50) mm",
        "(2, 1), 0.500 mm in",
    ]


@pytest.mark.parametrize(
    ("x_px", "y_px", "out_px"),
    [(2, -6, 6), (2, 9, 6), (-4, 1, 4), (8, 1, 4), (-4, -6, 6), (8, 9, 6)],
)
def test_a_point_outside_of_the_picture_says_by_how_much_of_whichever_side(
    results, x_px, y_px, out_px
):
    cloud = results["cloud"].output
    points = cloud.points_mm.copy()
    points[0] = ((x_px - CAMERA.cx_px) * 2.0, (y_px - CAMERA.cy_px) * 2.0, 20.0)
    results["cloud"] = result("cloud", replace(cloud, points_mm=points))
    last = trace_forward(results, *divmod(int(cloud.source_index[0]), CAMERA.cols), CAMERA.cols)[-1]
    assert last.text == f"outside the image by {out_px} px"


def test_a_value_given_in_place_of_a_slot_is_traced_as_if_its_method_had_made_it(results):
    given = {**results, "depth": replace(results["depth"], method=None, state="given")}
    assert trace_forward(given, 1, 2, 5) == trace_forward(results, 1, 2, 5)
