"""Another unit of length gives other numbers and the same answer, to one part in a million.

Everything that is a length is scaled by a thousand either way: micrometres in the place of
millimetres.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.geometry import rigid
from pipeline.core.geometry.membrane import Membrane
from pipeline.physics import bubble, gel
from pipeline.sensors.alignment import Alignment
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.pose.registration.observability import Tolerances, assess_observability
from pipeline.stages.target_depth.surface_projection import project_cloud
from tests.stability.rows import row
from tests.stability.scenes import (
    KINDS,
    aligned,
    depth_map,
    indentation_mm,
    projection,
    seeds,
    small,
)

SAME = 1e-6  # relative
FACTORS = st.sampled_from([1e3, 1e-1, 0.3, 25.4, 1e6])


def in_units(spec, k):
    m = spec.membrane
    stretched = Membrane(
        x0_mm=m.x0_mm * k, y0_mm=m.y0_mm * k, step_mm=m.step_mm * k, z_mm=m.z_mm * k
    )
    return replace(spec, membrane=stretched, rest_depth_mm=spec.rest_depth_mm * k)


def moved_in_units(matrix, k):
    scaled = matrix.copy()
    scaled[:3, 3] *= k
    return scaled


@row(4, "adapt and project in another unit of length")
@given(st.sampled_from(KINDS), st.sampled_from(["surface", "paper"]), FACTORS, seeds)
def test_adapt_and_project(kind, mode, k, seed):
    rng = np.random.default_rng(seed)
    source = small("gelslim")
    target = small("soft_bubble", 0.5)
    pushed = indentation_mm(source, kind, rng)
    way = aligned(source, target)
    turn = rigid.rotation(rng.uniform(-0.2, 0.2, 3))
    way = Alignment(
        alignment_from_source=turn @ way.alignment_from_source,
        target_from_alignment=way.target_from_alignment,
    )
    scaled = Alignment(
        alignment_from_source=moved_in_units(way.alignment_from_source, k),
        target_from_alignment=moved_in_units(way.target_from_alignment, k),
    )
    depth = depth_map(source, pushed)
    ours = project_cloud(
        back_project_depth(depth, way, BackProjectionParams()),
        target,
        projection(mode, jump_mm=1.0),
    )
    there = replace(depth, depth_mm=depth.depth_mm.astype(np.float64) * k)
    theirs = project_cloud(
        back_project_depth(there, scaled, BackProjectionParams()),
        in_units(target, k),
        projection(mode, jump_mm=k),
    )
    both = (ours.source_index >= 0) & (theirs.source_index >= 0)
    # float32 points round differently: a point on the border of two pixels, or of a limit, may fall
    # either way.
    assert ((ours.source_index >= 0) ^ (theirs.source_index >= 0)).sum() <= 0.01 * both.sum() + 2
    apart = both & ~(np.abs(theirs.depth_mm / k - ours.depth_mm) <= SAME * ours.depth_mm)
    assert apart.sum() <= 0.01 * both.sum() + 2


@row(4, "a pressed gel in another unit of length", share=0.1)
@given(st.sampled_from(KINDS), FACTORS, seeds)
def test_gel(kind, k, seed):
    spec = small("digit")
    overlap = indentation_mm(spec, kind, np.random.default_rng(seed)) * 0.2 - 0.01
    ours = gel.press_gel(spec.gel, spec.pixel_mm, overlap)
    pad = replace(spec.gel, thickness_mm=spec.gel.thickness_mm * k)
    theirs = gel.press_gel(pad, spec.pixel_mm * k, overlap * k, tolerance_mm=k * gel.TOLERANCE_MM)
    # Both are solved to a tenth of a micrometre; where they stop is the same step but for the
    # rounding of float32.
    assert np.abs(theirs.indentation_mm / k - ours.indentation_mm).max() <= 2 * gel.TOLERANCE_MM
    assert abs(theirs.force_n / k**2 - ours.force_n) <= 1e-3 * ours.force_n + 1e-6


@row(4, "what a contact determines, in another unit of length")
@given(st.integers(20, 300), st.sampled_from([10.0, 1e3, 25.4, 1e6]), seeds)
def test_observability(n, k, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-5, 5, (n, 3)) * (1, 1, rng.choice([0, 0.2, 1]))
    normals = rng.standard_normal((n, 3)) * (rng.choice([0, 1e-3, 1]), rng.choice([0, 1e-3, 1]), 1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ours = assess_observability(points, normals, points.mean(axis=0), 0.03)
    theirs = assess_observability(
        points * k,
        normals,
        k * points.mean(axis=0),
        0.03 * k,
        tolerances=Tolerances(mm=0.2 * k, deg=1.0),
    )
    assert len(ours.weak_directions) == len(theirs.weak_directions)
    units = np.array([1.0] * 3 + [k] * 3)
    back = theirs.covariance / np.outer(units, units)
    assert np.abs(back - ours.covariance).max() <= SAME * np.abs(ours.covariance).max()
    assert (
        np.abs(theirs.observable * units[None, :] / units[:, None] - ours.observable).max()
        <= 10 * SAME
    )


@row(4, "a pressed bubble in another unit of length", share=0.02)
@given(st.sampled_from([0.3, 25.4, 1e3]), seeds)
def test_bubble(k, seed):
    spec = small("soft_bubble")
    rng = np.random.default_rng(seed)
    on = bubble.make_lattice(spec.bubble, 1.0)
    x, y = rng.uniform(-10, 10, 2)
    r_sq = (on.x_mm()[None, :] - x) ** 2 + (on.y_mm()[:, None] - y) ** 2
    ceiling = (
        bubble.compute_rest_height_mm(spec.bubble, on).max() - rng.uniform(0.5, 4.0) + r_sq / 30.0
    )
    ours = bubble.press_bubble(spec.bubble, ceiling, on)
    b = spec.bubble
    theirs_bubble = replace(
        b,
        half_width_mm=b.half_width_mm * k,
        half_height_mm=b.half_height_mm * k,
        height_mm=b.height_mm * k,
        dead_volume_mm3=b.dead_volume_mm3 * k**3,
    )
    there = replace(on, x0_mm=on.x0_mm * k, y0_mm=on.y0_mm * k, step_mm=on.step_mm * k)
    theirs = bubble.press_bubble(
        theirs_bubble, ceiling * k, there, tolerance_mm=k * bubble.TOLERANCE_MM
    )
    assert np.abs(theirs.deviation_mm / k - ours.deviation_mm).max() <= 2 * bubble.TOLERANCE_MM
    assert abs(theirs.pressure_kpa - ours.pressure_kpa) <= 1e-4 * ours.pressure_kpa
