"""A line through fields of height: what a plane, a ball and a gap are along it, through either
camera.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.translation.cross_section import (
    HeightMap,
    SectionLine,
    SectionPlane,
    cut_section,
    format_csv,
    sample_bilinear,
)

CAMERA = Camera(rows=60, cols=80, fx_px=70.0, fy_px=66.0, cx_px=38.0, cy_px=31.0)
Z_MM = 25.0
ASLANT = rigid.from_parts((1.5, -2.0, 3.0), (6.0, -9.0, 80.0))
mm = st.floats(-7.0, 7.0)
lines = st.builds(lambda a, b, c, d: SectionLine(begin_mm=(a, b), end_mm=(c, d)), mm, mm, mm, mm)
sheets = st.sampled_from(
    [
        SectionPlane(camera=CAMERA, plane_z_mm=Z_MM),
        SectionPlane(camera=CAMERA, plane_z_mm=Z_MM, camera_from_source=ASLANT),
    ]
)


def _heights(sheet: SectionPlane, height) -> np.ndarray:
    return np.array(
        [
            [height(*sheet.backproject_to_mm(col, row)) for col in range(CAMERA.cols)]
            for row in range(CAMERA.rows)
        ]
    )


@given(sheet=sheets, x=mm, y=mm)
def test_a_place_of_the_plane_is_found_again_in_the_picture(sheet, x, y):
    (at,) = sheet.project_to_px([(x, y)])
    assert sheet.backproject_to_mm(*at) == pytest.approx((x, y), abs=1e-9)


@given(line=lines, slope=st.tuples(mm, mm, mm))
def test_a_plane_is_a_straight_line(line, slope):
    a, b, c = slope
    rows, cols = np.mgrid[0 : CAMERA.rows, 0 : CAMERA.cols]
    sheet = SectionPlane(camera=CAMERA, plane_z_mm=Z_MM)
    x = (cols - CAMERA.cx_px) / CAMERA.fx_px * Z_MM
    y = (rows - CAMERA.cy_px) / CAMERA.fy_px * Z_MM
    (profile,) = cut_section(
        line,
        [HeightMap(name="f", title="f", place="source", heights_mm=a * x + b * y + c, plane=sheet)],
    ).profiles
    points = line.points_mm()
    np.testing.assert_allclose(profile.heights_mm, points @ (a, b) + c, atol=1e-9)


@settings(max_examples=30)
@given(line=lines, sheet=sheets)
def test_a_line_the_other_way_has_the_same_heights_the_other_way(line, sheet):
    values = np.random.default_rng(3).normal(size=CAMERA.shape)
    values[10:14, 20:30] = np.nan
    field = HeightMap(name="f", title="f", place="source", heights_mm=values, plane=sheet)
    there, back = (
        cut_section(each, [field]).profiles[0].heights_mm
        for each in (line, SectionLine(begin_mm=line.end_mm, end_mm=line.begin_mm))
    )
    np.testing.assert_allclose(there, back[::-1], atol=1e-6)


@pytest.mark.parametrize("from_source", [None, ASLANT])
@pytest.mark.parametrize("aside_mm", [0.0, 1.5, 2.6])
def test_a_ball_is_cut_along_its_chord(from_source, aside_mm):
    sheet = SectionPlane(camera=CAMERA, plane_z_mm=Z_MM, camera_from_source=from_source)
    radius = 6.0
    reach = 3.5
    lifted = math.sqrt(radius**2 - reach**2)

    def height(x, y):
        return math.sqrt(max(radius**2 - x**2 - y**2, 0.0)) - lifted

    heights = _heights(sheet, height)
    pressed = HeightMap(
        name="b", title="b", place="source", heights_mm=heights, plane=sheet, contact=heights > 0
    )
    found = cut_section(SectionLine(begin_mm=(-5.0, aside_mm), end_mm=(5.0, aside_mm)), [pressed])
    (profile,) = found.profiles
    half = math.sqrt(reach**2 - aside_mm**2)
    left, right = profile.contact_edges_mm
    # within half a pixel of 0.36 mm
    assert (left, right) == pytest.approx((5.0 - half, 5.0 + half), abs=0.25)
    inside = np.abs(found.along_mm - 5.0) < half
    true = np.sqrt(radius**2 - aside_mm**2 - (found.along_mm - 5.0) ** 2) - lifted
    np.testing.assert_allclose(profile.heights_mm[inside], true[inside], atol=0.01)


def test_nothing_is_known_outside_the_picture_and_beside_a_gap():
    values = np.arange(12.0).reshape(3, 4)
    values[1, 2] = np.nan
    at = np.array(
        [
            (0, 0),
            (0.5, 0),
            (3, 2),
            (-0.1, 0),
            (3.1, 0),
            (1.5, 1),
            (1, 1),
            (2, 0.5),
            (3, 1),
            (np.nan, 1),
        ]
    )
    found = sample_bilinear(values, at.astype(np.float64))
    np.testing.assert_array_equal(found, [0, 0.5, 11, np.nan, np.nan, np.nan, 5, np.nan, 7, np.nan])


def test_a_table_has_a_row_for_each_place_and_nothing_where_nothing_is_known():
    values = np.full(CAMERA.shape, 0.25)
    values[:, 40:] = np.nan
    field = HeightMap(
        name="depth",
        title="Depth",
        place="source",
        heights_mm=values,
        plane=SectionPlane(camera=CAMERA, plane_z_mm=Z_MM),
    )
    table = format_csv(
        cut_section(SectionLine(begin_mm=(-1.0, 0.0), end_mm=(3.0, 0.0)), [field], count=3)
    ).splitlines()
    assert table == ["along_mm,depth_mm", "0.0000,0.25000", "2.0000,", "4.0000,"]
