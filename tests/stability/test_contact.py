"""Contact of gel and bubble: it pushes and never pulls, nothing overlaps, no force acts through a
gap.

Hertz, punch, cone and the clamped membrane are in tests/pipeline/test_physics_closed_forms.py.
"""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.physics import bubble, gel
from tests.stability.rows import row
from tests.stability.scenes import KINDS, indentation_mm, seeds, small

OVERLAP_MM = 2 * gel.TOLERANCE_MM  # what the solve may leave, on either side of the surface


@row(13, "a gel: p >= 0, no overlap left, and p only where the surfaces meet", share=0.1)
@given(
    st.sampled_from(KINDS),
    st.sampled_from(["digit", "gelslim"]),
    st.floats(-3, 0).map(lambda e: 10**e),
    seeds,
)
def test_gel_complementarity(kind, name, depth, seed):
    spec = small(name)
    overlap = indentation_mm(spec, kind, np.random.default_rng(seed)) * depth - 1e-3
    answer = gel.press_gel(spec.gel, spec.pixel_mm, overlap)
    gap = answer.indentation_mm - overlap
    assert np.isfinite(answer.pressure_kpa).all()
    assert (answer.pressure_kpa >= 0).all()
    assert np.array_equal(answer.contact, answer.pressure_kpa > 0)
    assert answer.force_n >= 0
    if answer.converged:
        assert gap.min() >= -OVERLAP_MM
        assert np.abs(gap[answer.contact]).max(initial=0) <= OVERLAP_MM
    assert (answer.force_n > 0) == bool(answer.contact.any())


@row(
    13,
    "a gel: pressing deeper never lowers the force nor shrinks the contact of a ball",
    share=0.05,
)
@given(st.floats(0.02, 0.5), st.floats(1.05, 2.0))
def test_gel_monotone(depth_mm, factor):
    spec = small("digit")
    y, x = ((np.arange(n) - (n - 1) / 2) * spec.pixel_mm for n in spec.camera.shape)
    ball = -(x[None, :] ** 2 + y[:, None] ** 2) / 8.0
    light, firm = (
        gel.press_gel(spec.gel, spec.pixel_mm, ball + d) for d in (depth_mm, depth_mm * factor)
    )
    assert firm.force_n >= light.force_n
    assert (firm.contact >= light.contact).mean() >= 1 - 1e-3
    assert firm.pressure_kpa.max() >= light.pressure_kpa.max() * (1 - 1e-3)


def ceiling_of(spec, on, rng):
    """A ball or a slanting plane that reaches below the dome."""
    apex = float(bubble.compute_rest_height_mm(spec.bubble, on).max())
    x = on.x_mm()[None, :] - rng.uniform(-10, 10)
    y = on.y_mm()[:, None] - rng.uniform(-8, 8)
    ball = (x * x + y * y) / (2 * rng.uniform(3, 40))
    plane = np.abs(x) * rng.uniform(0, 0.5) + 0 * y
    return apex - rng.uniform(0.1, 5.0) + (ball if rng.random() < 0.5 else plane)


@row(13, "a bubble: lambda >= 0, under the object, and lambda only where it touches", share=0.03)
@given(st.sampled_from([1.0, 0.5]), seeds)
def test_bubble_complementarity(step_mm, seed):
    spec = small("soft_bubble")
    on = bubble.make_lattice(spec.bubble, step_mm)
    ceiling = ceiling_of(spec, on, np.random.default_rng(seed))
    answer = bubble.press_bubble(spec.bubble, ceiling, on)
    height = bubble.compute_rest_height_mm(spec.bubble, on) + answer.deviation_mm
    free = bubble.find_free_nodes(spec.bubble, on)
    assert np.isfinite(answer.deviation_mm).all()
    assert (answer.contact_pressure_kpa >= 0).all()
    assert answer.pressure_kpa >= spec.bubble.pressure_kpa
    assert (ceiling - height)[free].min() >= -2 * bubble.TOLERANCE_MM
    held = answer.contact & free
    assert np.abs(ceiling - height)[held].max(initial=0.0) <= 2 * bubble.TOLERANCE_MM
    # The air does the work: what holds the membrane down is never more than the pressure over the
    # whole rim.
    assert (
        answer.force_n
        <= 2e-3
        * answer.pressure_kpa
        * np.pi
        * spec.bubble.half_width_mm
        * spec.bubble.half_height_mm
    )


@row(13, "a bubble: mirrored objects leave mirrored shapes", share=0.02)
@given(st.sampled_from(["left-right", "up-down"]), seeds)
def test_bubble_mirror(how, seed):
    spec = small("soft_bubble")
    on = bubble.make_lattice(spec.bubble, 1.0)
    change = {"left-right": np.fliplr, "up-down": np.flipud}[how]
    ceiling = ceiling_of(spec, on, np.random.default_rng(seed))
    a = bubble.press_bubble(spec.bubble, ceiling, on)
    b = bubble.press_bubble(spec.bubble, np.ascontiguousarray(change(ceiling)), on)
    assert np.abs(change(a.deviation_mm) - b.deviation_mm).max() <= 4 * bubble.TOLERANCE_MM
    assert abs(a.pressure_kpa - b.pressure_kpa) <= 1e-3 * a.pressure_kpa
