from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pipeline.core.arrays import freeze
from pipeline.core.errors import CalibrationError, MeshProblem
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.values.frames import Truth
from pipeline.io import hdf5
from pipeline.physics import lattice
from pipeline.physics.lattice import Lattice
from pipeline.physics.shear import TangentialLoad
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors import alignment
from pipeline.sensors.spec import load_sensor

ELBOW = shapes.make_shape("notched_elbow").mesh
SENSORS = ("digit", "gelsight_mini", "soft_bubble")
# bilinear chords between pixels at a chamfer's edge; the solver itself is 50 times finer
SURFACE_MM = 0.005
# the nearest pixel to the apex, and chords of the dome between lattice nodes
REACH_TOLERANCE_MM = 0.02
SAMPLE = Path(__file__).resolve().parents[4] / "sample_data" / "recordings" / "first_touch.h5"


def pressed_by(depth_mm, twist_deg=0.0, lean_deg=0.0, x_mm=-3.0, y_mm=-3.0):
    turn = rigid.rotation(np.deg2rad([0.0, 0.0, twist_deg])) @ rigid.rotation(
        np.deg2rad([lean_deg, 0.0, 0.0])
    )
    return rigid.translation(x_mm, y_mm, -depth_mm) @ turn


def plane(z_mm=0.0):
    corners = np.array(
        [[-200.0, -200.0, z_mm], [200.0, -200.0, z_mm], [200.0, 200.0, z_mm], [-200.0, 200.0, z_mm]]
    )
    return Mesh(
        vertices_mm=freeze(corners), triangles=freeze(np.array([[0, 2, 1], [0, 3, 2]], np.int32))
    )


def test_the_elbow_is_a_closed_body_that_faces_outward():
    edges = Counter(
        (int(a), int(b)) for t in ELBOW.triangles for a, b in zip(t, np.roll(t, -1), strict=True)
    )
    assert all(n == 1 and edges[b, a] == 1 for (a, b), n in edges.items())
    corners = ELBOW.vertices_mm[ELBOW.triangles]
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    face_area = 3.5 * (12.75 + 20.25) - 2.0 * 1.55
    assert volume == pytest.approx(8.0 * face_area, rel=0.03)  # less the chamfer
    assert volume > 0


def test_the_face_of_the_elbow_is_level_at_zero_and_its_chamfer_rises_one_to_one():
    on = Lattice(x0_mm=-2.0, y0_mm=-2.0, step_mm=0.05, shape=(480, 270))
    z = lattice.rasterise_mesh(ELBOW.vertices_mm, ELBOW.triangles, on)
    x = on.x_mm()[None, :]
    y = on.y_mm()[:, None]
    upright = (np.abs(x) < 1.75) & (y > 5.0) & (y < 20.0)
    assert np.abs(z - np.maximum(0.0, 0.5 - (1.75 - np.abs(x))))[upright].max() < 1e-9
    assert np.isinf(z[(x > 2.0) & (y > 2.0)]).all()


def test_an_outline_that_is_too_thin_for_its_chamfer_is_refused():
    with pytest.raises(MeshProblem, match="chamfer"):
        shapes.make_chamfered_prism([(0, 0), (4, 0), (4, 1), (0, 1)], 2.0, 0.6, "blade")


@pytest.mark.parametrize("name", SENSORS)
def test_in_contact_the_surface_is_that_of_the_object(name):
    """Back-projected contact pixels lie on the mesh at its true pose: depth, mask, pose and
    camera agree.
    """
    spec = load_sensor(name)
    press = simulate_press(ELBOW, pressed_by(0.5, twist_deg=20.0), spec, seed=None)
    truth = press.truth
    points = spec.camera.back_project(spec.rest_depth_mm - truth.indentation_mm)[truth.contact]
    in_object = rigid.apply(rigid.invert(truth.sensor_from_object), points)
    on_face = np.abs(in_object[:, 2]) < 1e-3
    z = np.maximum(0.0, in_object[:, 2])
    assert press.converged
    assert len(points) > 100
    # Pressed 12 mm deeper than a gel, the bubble lies against the flanks of the bar as well.
    assert on_face.mean() > (0.6 if spec.kind == "gel" else 0.4)
    assert (z < 0.5 if spec.kind == "gel" else z < 8.0).all()
    assert in_object[:, 2].min() > (-SURFACE_MM if spec.kind == "gel" else -0.05)


def test_two_sensors_touch_the_same_point_of_the_object():
    digit = load_sensor("digit")
    mini = load_sensor("gelsight_mini")
    pose = pressed_by(0.5, twist_deg=10.0)
    truths = {s.name: simulate_press(ELBOW, pose, s, seed=None).truth for s in (digit, mini)}
    expected = (
        alignment.resolve_alignment(digit, mini).target_from_source
        @ truths["digit"].sensor_from_object
    )
    assert np.abs(expected - truths["gelsight_mini"].sensor_from_object).max() < 1e-9


def reach_mm(spec):
    """How far the middle of the sensor at rest stands out of the plane z = 0 of the alignment
    frame.
    """
    apex = np.array([[0.0, 0.0, float(spec.membrane.depth_at(0.0, 0.0))]])
    return float(rigid.apply(spec.alignment_from_sensor, apex)[0, 2])


@pytest.mark.parametrize("name", ["gelslim", *SENSORS])
def test_a_flat_object_presses_each_sensor_by_its_reach_more(name):
    """The depth that makes up for softness is part of the alignment, so that it is in every
    pairing too.
    """
    spec = load_sensor(name)
    depth_mm = 0.4
    assert (reach_mm(spec) == 0.0) == (spec.kind == "gel")
    press = simulate_press(plane(), rigid.translation(0.0, 0.0, -depth_mm), spec, seed=None)
    deepest = float(press.truth.indentation_mm.max())
    assert deepest == pytest.approx(depth_mm + reach_mm(spec), abs=REACH_TOLERANCE_MM)
    of_gel = alignment.resolve_alignment(spec, load_sensor("gelslim")).target_from_source
    apex = rigid.apply(of_gel, np.array([[0.0, 0.0, float(spec.membrane.depth_at(0.0, 0.0))]]))[
        0, 2
    ]
    assert apex - 20.0 == pytest.approx(reach_mm(spec), abs=1e-9)  # the GelSlim rests at 20 mm


def test_a_plane_pushes_the_whole_pad_by_its_depth():
    spec = load_sensor("digit")
    press = simulate_press(plane(), rigid.translation(0.0, 0.0, -0.3), spec, seed=None)
    assert np.abs(press.truth.indentation_mm - 0.3).max() < SURFACE_MM
    assert press.truth.contact.all()


def test_a_bubble_bridges_the_inner_corner_that_a_gel_does_not_reach_either():
    press = simulate_press(ELBOW, pressed_by(0.6), load_sensor("soft_bubble"), seed=None)
    covered = press.truth.indentation_mm > 0.5
    # most of what has moved is not in contact
    assert press.truth.contact.sum() < 0.5 * covered.sum()
    assert press.truth.indentation_mm.min() < -0.1  # and the air makes the rest bulge


@pytest.mark.parametrize("name", ["gelslim", *SENSORS])
def test_a_miss_is_the_reference(name):
    press = simulate_press(ELBOW, pressed_by(-30.0), load_sensor(name), seed=None)
    assert not press.truth.indentation_mm.any()
    assert not press.truth.contact.any()
    assert press.force_n == 0.0


@given(
    depth=st.floats(-2.0, 3.0),
    twist=st.floats(-180, 180),
    lean=st.floats(-45, 45),
    x=st.floats(-12, 12),
    y=st.floats(-12, 12),
)
@example(depth=3.0, twist=0.0, lean=0.0, x=0.0, y=0.0)
@settings(max_examples=12)
def test_any_pose_gives_finite_frames_that_converge_or_go_through_the_pad(depth, twist, lean, x, y):
    for name in ("gelsight_mini", "soft_bubble"):
        spec = load_sensor(name)
        press = simulate_press(ELBOW, pressed_by(depth, twist, lean, x, y), spec, seed=1)
        # perhaps outside the view
        lowest_mm = rigid.apply(press.truth.sensor_from_object, ELBOW.vertices_mm)[:, 2].min()
        # at the pad's back no gel is left, either
        through = spec.gel is not None and (
            lowest_mm <= spec.rest_depth_mm.max() - spec.gel.thickness_mm + 1e-6
        )
        assert press.converged or through
        assert np.isfinite(press.truth.indentation_mm).all()
        assert np.isfinite(press.image).all()


def test_a_press_deeper_than_the_gel_has_not_converged():
    assert not simulate_press(
        ELBOW, pressed_by(5.0), load_sensor("gelsight_mini"), seed=None
    ).converged


@pytest.mark.parametrize(
    "bad", [np.full((4, 4), np.nan), np.diag([1.0, 1.0, -1.0, 1.0]), np.eye(3)]
)
def test_an_invalid_pose_is_refused(bad):
    with pytest.raises(CalibrationError, match="the object's pose"):
        simulate_press(ELBOW, bad, load_sensor("digit"), seed=None)


def test_a_load_drags_the_gel_and_its_markers_and_nothing_else():
    spec = load_sensor("gelslim")
    pose = pressed_by(0.4)
    still = simulate_press(ELBOW, pose, spec, seed=None)
    dragged = simulate_press(
        ELBOW, pose, spec, seed=None, load=TangentialLoad(displacement_mm=(0.2, 0.0))
    )
    assert still.shear_mm is None
    assert dragged.shear_mm is not None
    assert 0.02 < dragged.shear_mm[..., 0][still.truth.contact].mean() <= 0.2
    np.testing.assert_array_equal(dragged.truth.indentation_mm, still.truth.indentation_mm)
    assert (dragged.image != still.image).any()


def test_the_same_seed_gives_the_same_bytes():
    spec = load_sensor("soft_bubble")
    one, again, other = (
        simulate_press(ELBOW, pressed_by(0.5), spec, seed=s).image.tobytes() for s in (2, 2, 3)
    )
    assert one == again != other


def test_the_sample_recording_holds_the_truth_of_every_frame():
    recording = hdf5.read(SAMPLE)
    try:
        assert [s.sensor for s in recording.streams] == ["gelslim", "digit", "soft_bubble"]
        assert SAMPLE.stat().st_size < 8e6
        assert recording.object_mesh is not None
        touched = {}
        for stream in recording.streams:
            truths = [stream.truth(i) for i in range(stream.n_frames)]
            assert all(isinstance(t, Truth) and t.sensor_from_object is not None for t in truths)
            touched[stream.sensor] = [bool(t.contact.any()) for t in truths]
            assert not touched[stream.sensor][0]
            assert not touched[stream.sensor][-1]
        assert sum(touched["soft_bubble"]) > sum(touched["gelslim"]) >= 8
        assert touched["gelslim"] == touched["digit"]
    finally:
        recording.close()
