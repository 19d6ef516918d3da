from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.digests import compute_cached_digest
from pipeline.core.errors import MeshProblem, SettingProblem
from pipeline.core.geometry import rigid
from pipeline.core.geometry.distance_grid import load_distance_grid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.progress import Cancelled
from pipeline.core.values.results import DepthErrorModel, PoseStep, make_depth_map
from pipeline.physics.simulation.press import simulate_press
from pipeline.physics.simulation.shapes import make_shape
from pipeline.sensors.spec import load_sensor
from pipeline.stages.pose.registration.model import prepare_object
from pipeline.stages.pose.registration.observability import assess_observability
from pipeline.stages.pose.registration.ranking import make_judge
from pipeline.stages.pose.registration.scene import extract_scene
from pipeline.stages.pose.registration.search import MISSING_CONTACT_WARNING
from pipeline.stages.pose.signed_distances import (
    PoseParams,
    estimate_or_track_pose,
    estimate_pose,
    estimate_pose_icp,
    estimate_pose_planar,
    skip_without_contact,
    track_pose,
)
from pipeline.views import point_views
from tests.pipeline.stages.pose.registration.solids import (
    CAMERA,
    REST_MM,
    ball,
    extruded,
    l_bar,
    notched_wedge,
    observe_depth,
    rod,
    slab,
    touch_of,
)

POSITION_TOLERANCE_MM = 0.1  # one pixel of the test camera on the gel
TURN_TOLERANCE_DEG = 1.0  # one pixel over the 6 mm of the contact
# how far off the first guess of a held direction is
HELD_MM = 0.36
HELD_DEG = 4.0
NOISE_MM = 0.03  # of photometric depth
UPSIDE_DOWN = rigid.rotation([np.pi, 0.0, 0.0])  # the object's +z toward the camera


def lying(x_mm, y_mm, depth_mm, height_mm, angle_deg, tilt_deg=(0.0, 0.0), origin_mm=(0.0, 0.0)):
    """sensor_from_object of an object whose top, at `height_mm`, is pressed `depth_mm` into the
    gel.
    """
    return (
        rigid.translation(x_mm, y_mm, REST_MM + height_mm - depth_mm)
        @ rigid.rotation([0.0, 0.0, np.deg2rad(angle_deg)])
        @ UPSIDE_DOWN
        @ rigid.rotation(np.deg2rad([*tilt_deg, 0.0]))
        @ rigid.translation(-origin_mm[0], -origin_mm[1], 0.0)
    )


def error(found, truth):
    """(mm at the middle of the contact, degrees) between two poses."""
    middle = found.scene_mm.mean(axis=0).astype(float)
    difference = found.sensor_from_object @ rigid.invert(truth)
    return np.linalg.norm(rigid.apply(difference, middle) - middle), rigid.rotation_angle_deg(
        difference
    )


@pytest.mark.parametrize("angle_deg", [20.0, 145.0, 290.0])
def test_an_l_bar_is_found_from_any_angle(angle_deg):
    truth = lying(1.0, -0.5, 0.6, 4.0, angle_deg, tilt_deg=(1.5, -2.0), origin_mm=(5.0, 3.5))
    mm, deg = error(estimate_pose(observe_depth(l_bar(), truth), l_bar().mesh, PoseParams()), truth)
    assert mm < POSITION_TOLERANCE_MM
    assert deg < TURN_TOLERANCE_DEG


@pytest.mark.parametrize("noise_mm", [0.0, NOISE_MM])
def test_a_notched_wedge_is_found_and_nothing_of_it_is_weak(noise_mm):
    truth = lying(-0.8, 0.7, 0.8, 2.0, 70.0, tilt_deg=(4.0, -2.0))
    found = estimate_pose(
        observe_depth(notched_wedge(), truth, noise_mm=noise_mm), notched_wedge().mesh, PoseParams()
    )
    mm, deg = error(found, truth)
    assert mm < POSITION_TOLERANCE_MM
    assert deg < TURN_TOLERANCE_DEG
    assert found.weak_directions == ()
    assert found.fitness > 0.95


@pytest.mark.parametrize("angle_deg", [11.0, 41.0])
def test_a_contact_far_wider_than_the_search_distance_is_found_between_two_angles(angle_deg):
    """Half an angle off, the ends of three bars, alike in three directions, are 10 mm from where
    they touch.
    """
    bars = make_shape("three_lines").mesh
    bubble = load_sensor("soft_bubble")
    pose = rigid.rotation((0.01, -0.01, 0.0)) @ rigid.rotation((0.0, 0.0, np.deg2rad(angle_deg)))
    pose[2, 3] = -9.0 - rigid.apply(pose, bars.vertices_mm)[:, 2].min()
    press = simulate_press(bars, pose, bubble, seed=None)
    touch = make_depth_map(
        bubble.rest_depth_mm, press.indentation_mm, press.contact, bubble.camera, ()
    )
    found = estimate_pose(touch, bars, PoseParams())
    _, turn_deg = error(found, press.sensor_from_object)
    assert found.fitness > 0.95
    assert found.rmse_mm < POSITION_TOLERANCE_MM
    assert min(turn_deg, abs(turn_deg - 120.0)) < TURN_TOLERANCE_DEG


def test_a_rod_slides_along_its_axis_and_says_so():
    found = estimate_pose(
        observe_depth(rod(), lying(1.0, 0.5, 0.8, 3.0, 0.0)), rod().mesh, PoseParams()
    )
    assert "moves along x" in found.weak_directions
    assert len(found.weak_directions) == 2, "it also rolls about itself"
    assert "moves along x: not observable, kept where the contact's middle is" in found.notes
    assert found.sensor_from_object is not None
    assert abs(found.sensor_from_object[0, 3] - found.scene_mm[:, 0].mean()) < POSITION_TOLERANCE_MM
    axis = found.sensor_from_object[:3, 0]
    assert np.degrees(np.arccos(abs(axis[0]))) < TURN_TOLERANCE_DEG
    assert abs(found.sensor_from_object[1, 3] - 0.5) < POSITION_TOLERANCE_MM
    slide_mm = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    assert np.abs(found.observable @ slide_mm).max() < 0.1, "the projector takes the slide away"


def test_a_plate_leaves_three_directions_open():
    found = estimate_pose(
        observe_depth(slab(), lying(0.0, 0.0, 0.5, 5.0, 0.0)), slab().mesh, PoseParams()
    )
    assert set(found.weak_directions) == {"moves along x", "moves along y", "rotates about z"}
    assert all("not observable" in note for note in found.notes[:3])


def test_a_flat_box_is_placed_by_the_outline_of_its_contact():
    corners = [(-4, -2), (4, -2), (4, 2), (-4, 2)]
    box = extruded(corners, [corners], 0.0, 6.0)
    truth = lying(1.3, -0.9, 0.5, 6.0, 17.0)
    found = estimate_pose(observe_depth(box, truth), box.mesh, PoseParams(face="+z"))
    middle_mm = rigid.apply(found.sensor_from_object, [0.0, 0.0, 6.0])
    assert (
        np.linalg.norm(middle_mm - rigid.apply(truth, [0.0, 0.0, 6.0])) < 2 * POSITION_TOLERANCE_MM
    )
    # either way round: the box is symmetric
    along = abs(found.sensor_from_object[:3, 0] @ truth[:3, 0])
    assert np.degrees(np.arccos(min(along, 1.0))) < TURN_TOLERANCE_DEG
    assert "moves along x: determined only by the outline of the contact" in found.notes


def test_the_same_input_gives_the_same_bytes():
    touch = observe_depth(notched_wedge(), lying(0.3, 0.2, 0.8, 2.0, 30.0))
    one, two = (estimate_pose(touch, notched_wedge().mesh, PoseParams()) for _ in range(2))
    assert one.sensor_from_object.tobytes() == two.sensor_from_object.tobytes()
    assert one.scene_mm.tobytes() == two.scene_mm.tobytes()


def test_keeping_steps_does_not_change_the_pose():
    touch = observe_depth(notched_wedge(), lying(0.3, 0.2, 0.8, 2.0, 30.0))
    kept, plain = (
        estimate_pose(touch, notched_wedge().mesh, PoseParams(keep_steps=keep))
        for keep in (True, False)
    )
    np.testing.assert_allclose(
        kept.steps[-1].sensor_from_object, kept.sensor_from_object, atol=1e-12
    )
    assert plain.steps == ()
    assert compute_cached_digest(kept) == compute_cached_digest(plain)
    assert kept.stop_reason == plain.stop_reason
    assert kept.stop_reason.startswith("converged: ")


def test_the_step_history_begins_at_a_start():
    touch = observe_depth(notched_wedge(), lying(0.3, 0.2, 0.8, 2.0, 30.0))
    found = estimate_pose(touch, notched_wedge().mesh, PoseParams(keep_steps=True))
    result = point_views.summarise_steps(found)
    first = found.steps[0]
    last = found.steps[-1]
    assert first.rmse_mm > 3 * last.rmse_mm, "a first guess lies farther off than the answer"
    assert (first.max_correspondence_mm, last.max_correspondence_mm) == (2.0, 0.5)
    assert all(
        len(curve.values) == len(found.steps) == len(result.descriptions) for curve in result.curves
    )
    assert result.phase_starts, "the search reaches farther than the registration after it"
    assert found.stop_reason in result.stop_reason
    assert (
        point_views.summarise_steps(estimate_pose(touch, notched_wedge().mesh, PoseParams()))
        is None
    )


def test_correspondences_lie_on_the_object_and_outliers_are_marked():
    touch = observe_depth(notched_wedge(), lying(0.3, 0.2, 0.8, 2.0, 30.0))
    found = estimate_pose(touch, notched_wedge().mesh, PoseParams(keep_steps=True))
    at = np.array([0.3, -0.2, 26.0])
    radius_mm = 6.0
    step = PoseStep(
        sensor_from_object=rigid.translation(*at),
        rmse_mm=1.0,
        fitness=1.0,
        max_correspondence_mm=0.4,
    )
    (state,) = point_views.split_steps(replace(found, steps=(step,)))
    correspondences = point_views.compute_correspondences(
        state, load_distance_grid(ball(radius_mm))
    )
    # farther off the lattice is coarser: 0.024 mm there
    near = np.abs(correspondences.distance_mm) < 1.0
    assert near.sum() > 20
    from_middle_mm = np.linalg.norm(correspondences.nearest_mm[near] - at, axis=1)
    np.testing.assert_allclose(from_middle_mm, radius_mm, atol=0.03)
    np.testing.assert_array_equal(
        correspondences.is_inlier, np.abs(correspondences.distance_mm) <= 0.4
    )
    assert 0 < correspondences.is_inlier.sum() < len(correspondences.is_inlier)


def test_scene_points_lie_on_the_membrane_at_their_pixels():
    touch = observe_depth(notched_wedge(), lying(0.3, 0.2, 0.8, 2.0, 30.0))
    found = estimate_pose(touch, notched_wedge().mesh, PoseParams(max_points=200))
    assert found.scene_mm.shape == (200, 3)
    assert touch.contact.ravel()[found.source_index].all()
    np.testing.assert_array_equal(found.scene_mm[:, 2], touch.depth_mm.ravel()[found.source_index])


def test_no_contact_and_no_mesh_are_answered_without_work():
    level = np.full(CAMERA.shape, REST_MM)
    untouched = touch_of(level, np.zeros(CAMERA.shape, bool))
    touched = observe_depth(slab(), lying(0.0, 0.0, 0.5, 5.0, 0.0))
    assert skip_without_contact(touched, slab().mesh, PoseParams()) is None
    for found in (
        estimate_pose(untouched, slab().mesh, PoseParams()),
        estimate_pose(touched, None, PoseParams()),
    ):
        assert found.sensor_from_object is None
        assert len(found.notes) == 1
    assert "no contact" in skip_without_contact(untouched, None, PoseParams()).notes[0]
    assert "no object mesh" in skip_without_contact(touched, None, PoseParams()).notes[0]


def test_too_few_points_give_no_pose_with_a_reason():
    contact = np.zeros(CAMERA.shape, bool)
    contact[50:53, 60:63] = True
    found = estimate_pose(
        touch_of(np.where(contact, REST_MM - 0.3, REST_MM), contact), slab().mesh, PoseParams()
    )
    assert found.sensor_from_object is None
    assert "only 9 contact points" in found.notes[0]


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_a_mesh_in_another_unit_gives_no_pose_and_names_its_size(scale):
    bar = l_bar()
    scaled = Mesh(vertices_mm=bar.mesh.vertices_mm * scale, triangles=bar.mesh.triangles)
    found = estimate_pose(
        observe_depth(bar, lying(1.0, -0.5, 0.6, 4.0, 20.0, origin_mm=(5.0, 3.5))),
        scaled,
        PoseParams(n_starts=12),
    )
    assert found.sensor_from_object is None
    assert f"{12 * scale:.3g} mm long" in found.notes[0]
    assert "unit" in found.notes[0]


def test_a_mesh_without_surface_and_an_unknown_face_are_refused():
    touch = observe_depth(slab(), lying(0.0, 0.0, 0.5, 5.0, 0.0))
    empty = Mesh(vertices_mm=np.zeros((3, 3)), triangles=np.zeros((1, 3), np.int32))
    with pytest.raises(MeshProblem, match="zero area"):
        estimate_pose(touch, empty, PoseParams())
    with pytest.raises(SettingProblem, match="face"):
        estimate_pose(touch, slab().mesh, PoseParams(face="up"))


@pytest.mark.parametrize("doing", ["registering", "refining", "leaves open", "fit as well"])
def test_pose_estimation_can_be_cancelled(doing):
    class Impatient:
        def step(self, fraction, text):
            if doing in text:
                raise Cancelled

    with pytest.raises(Cancelled):
        estimate_pose(
            observe_depth(slab(), lying(0.0, 0.0, 0.5, 5.0, 0.0)),
            slab().mesh,
            PoseParams(n_starts=6),
            Impatient(),
        )


def test_covariance_is_that_of_repeated_noisy_measurements():
    rng = np.random.default_rng(3)
    points = rng.uniform(-4, 4, (400, 3))
    normals = rng.standard_normal((400, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    arms = points - points.mean(axis=0)
    jacobian = np.concatenate([np.cross(arms, normals), normals], axis=1)
    solved = np.linalg.lstsq(jacobian, NOISE_MM * rng.standard_normal((400, 4000)), rcond=None)[0]
    result = assess_observability(points, normals, points.mean(axis=0), NOISE_MM)
    # 4000 draws: 1 %
    np.testing.assert_allclose(np.sqrt(np.diag(result.covariance)), solved.std(axis=1), rtol=0.06)
    np.testing.assert_allclose(result.observable, np.eye(6), atol=1e-12)
    assert result.weak_directions == ()


def test_a_sphere_patch_rolls_in_three_ways():
    rng = np.random.default_rng(4)
    normals = rng.standard_normal((500, 3)) * 0.2 + (0.0, 0.0, -1.0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    result = assess_observability(5.0 * normals, normals, 5.0 * normals.mean(axis=0), NOISE_MM)
    assert len(result.weak_directions) == 3
    np.testing.assert_allclose(result.observable @ result.observable, result.observable, atol=1e-9)
    turn_about_centre = np.concatenate(
        [np.eye(3)[0], np.cross(np.eye(3)[0], 5.0 * normals.mean(axis=0))]
    )
    assert np.abs(result.observable @ turn_about_centre).max() < 0.05


def test_equally_good_rotated_poses_are_reported():
    corners = [(-4, -2), (4, -2), (4, 2), (-4, 2)]
    box = extruded(corners, [corners], 0.0, 6.0)
    found = estimate_pose(
        observe_depth(box, lying(1.3, -0.9, 0.5, 6.0, 17.0)), box.mesh, PoseParams(face="+z")
    )
    assert len(found.alternatives) == 1
    between = found.alternatives[0] @ rigid.invert(found.sensor_from_object)
    assert rigid.rotation_angle_deg(between) == pytest.approx(180.0, abs=2 * TURN_TOLERANCE_DEG)
    assert any(
        note.startswith("2 poses fit equally well: turned by") and "about z" in note
        for note in found.notes
    )


def test_a_pose_that_only_one_place_explains_has_no_alternative():
    truth = lying(1.0, -0.5, 0.6, 4.0, 20.0, tilt_deg=(1.5, -2.0), origin_mm=(5.0, 3.5))
    assert (
        estimate_pose(observe_depth(l_bar(), truth), l_bar().mesh, PoseParams()).alternatives == ()
    )


def test_a_pose_with_missing_contact_has_a_warning():
    truth = lying(1.0, -0.5, 0.6, 4.0, 20.0, origin_mm=(5.0, 3.5))
    whole = observe_depth(l_bar(), truth)
    there = rigid.apply(
        rigid.invert(truth), CAMERA.back_project(whole.depth_mm).reshape(-1, 3).astype(float)
    )
    # an arm that was too light to be seen
    lost = whole.contact & (there[:, 1] > 4.0).reshape(CAMERA.shape)
    part = replace(
        whole,
        depth_mm=np.where(lost, np.float32(REST_MM), whole.depth_mm),
        contact=whole.contact & ~lost,
        indentation_mm=np.where(lost, np.float32(0.0), whole.indentation_mm),
    )
    assert MISSING_CONTACT_WARNING in estimate_pose(part, l_bar().mesh, PoseParams()).notes
    assert MISSING_CONTACT_WARNING not in estimate_pose(whole, l_bar().mesh, PoseParams()).notes


def test_a_near_touch_is_tracked_and_a_far_one_searched():
    bar = notched_wedge()
    before = estimate_pose(
        observe_depth(bar, lying(0.3, 0.2, 0.8, 2.0, 30.0)), bar.mesh, PoseParams()
    )
    for angle_deg, is_followed in ((33.0, True), (150.0, False)):
        truth = lying(0.5, 0.1, 0.8, 2.0, angle_deg)
        found = track_pose(
            observe_depth(bar, truth), bar.mesh, PoseParams(), before.sensor_from_object
        )
        mm, deg = error(found, truth)
        assert mm < POSITION_TOLERANCE_MM
        assert deg < TURN_TOLERANCE_DEG
        assert ("tracked from the pose of the previous touch" in found.notes) == is_followed
        assert (found.starts_tried == 0) == is_followed


def noisy(touch):
    """With noise on the whole membrane, touched or not."""
    noise = NOISE_MM * np.random.default_rng(3).standard_normal(touch.depth_mm.shape)
    return touch_of(touch.depth_mm + noise, touch.contact)


@pytest.mark.parametrize(
    ("solid", "place"),
    [(l_bar(), (1.0, -0.5, 0.6, 4.0, 20.0)), (notched_wedge(), (0.3, 0.2, 0.8, 2.0, 30.0))],
)
@pytest.mark.parametrize(
    ("shift_mm", "turn_deg"),
    [
        ((1.5, -1.0, 0.3), (0.0, 0.0, 15.0)),
        ((-1.5, 1.0, 0.5), (3.0, 3.0, -15.0)),
        ((1.0, 1.5, 0.3), (4.0, -4.0, 18.0)),
    ],
)
def test_a_touch_farther_on_is_found_to_the_end_and_not_turned_over(
    solid, place, shift_mm, turn_deg
):
    truth = lying(*place, tilt_deg=(1.5, -2.0))
    touch = noisy(observe_depth(solid, truth))
    middle = touch.camera.back_project(touch.depth_mm)[touch.contact].mean(axis=0)
    turn = (
        rigid.translation(*middle)
        @ rigid.rotation(np.deg2rad(turn_deg))
        @ rigid.translation(*-middle)
    )
    found = track_pose(touch, solid.mesh, PoseParams(), rigid.translation(*shift_mm) @ turn @ truth)
    mm, deg = error(found, truth)
    assert mm < POSITION_TOLERANCE_MM
    assert deg < TURN_TOLERANCE_DEG


@pytest.mark.parametrize("angle_deg", [17.0, 197.0])
def test_of_equally_good_poses_the_nearest_to_the_previous_is_returned(angle_deg):
    corners = [(-4, -2), (4, -2), (4, 2), (-4, 2)]
    box = extruded(corners, [corners], 0.0, 6.0)
    touch = observe_depth(box, lying(1.3, -0.9, 0.5, 6.0, 17.0))
    # too far off to be followed
    before = rigid.translation(30.0, 0.0, 0.0) @ lying(1.3, -0.9, 0.5, 6.0, angle_deg)
    found = track_pose(touch, box.mesh, PoseParams(face="+z"), before)
    assert found.starts_tried > 0
    assert len(found.alternatives) == 1
    assert (
        rigid.rotation_angle_deg(found.sensor_from_object @ rigid.invert(before))
        < TURN_TOLERANCE_DEG
    )


def test_a_face_close_to_the_membrane_is_not_missing_contact():
    truth = lying(0.0, 0.0, 0.3, 5.0, 10.0, tilt_deg=(0.0, 2.0))
    scene = extract_scene(noisy(observe_depth(slab(), truth)), 1500, 0)
    plate = prepare_object(slab().mesh, 0)
    by = make_judge(scene, plate.grid, plate.model, 750, 15_000, 2.0)
    assert by.misfit_mm([truth])[0] < 1.2 * NOISE_MM


def test_light_contact_within_the_depth_error_does_not_reject_a_pose():
    truth = lying(0.0, 0.0, 0.3, 5.0, 10.0, tilt_deg=(0.0, 2.0))
    touch = observe_depth(slab(), truth)
    light = touch.contact & (touch.indentation_mm < 0.15)
    assert 0.1 < light.sum() / touch.contact.sum() < 0.6
    depth = touch.depth_mm + np.where(light, np.float32(0.08), np.float32(0.0))
    lost = replace(touch, depth_mm=depth, contact=touch.contact & ~light)
    result, exact = (
        extract_scene(replace(lost, error=error), 1500, 0)
        for error in (DepthErrorModel(rms_mm=0.05, correlation_mm=1.0), None)
    )
    plate = prepare_object(slab().mesh, 0)
    told_mm, exact_mm = (
        make_judge(scene, plate.grid, plate.model, 750, 15_000, 2.0).misfit_mm([truth])[0]
        for scene in (result, exact)
    )
    assert told_mm < 0.05
    assert exact_mm > 0.3, "where depth is exact, what does not touch is not there"


def test_a_generated_touch_counts_by_its_expected_error():
    """The network missed half of a wedge's sides.

    The wedge sticks out there within the predicted error.
    """
    truth = lying(0.3, 0.2, 0.8, 2.0, 30.0)
    touch = observe_depth(notched_wedge(), truth)
    outside_contact = ~touch.contact & (
        np.arange(touch.contact.shape[1]) > touch.contact.shape[1] // 2
    )
    wrong = replace(
        touch,
        depth_mm=touch.depth_mm + np.where(outside_contact, np.float32(0.4), np.float32(0.0)),
        contact=touch.contact,
        in_view=np.ones_like(touch.contact),
        is_generated=True,
    )
    unsure = np.where(outside_contact, np.float32(0.2), np.float32(0.001))
    wedge = prepare_object(notched_wedge().mesh, 0)

    def misfit_mm(felt_touch):
        scene = extract_scene(felt_touch, 1500, 0)
        return make_judge(scene, wedge.grid, wedge.model, 750, 15_000, 2.0).misfit_mm([truth])[0]

    silent = misfit_mm(wrong)
    result = misfit_mm(replace(wrong, expected_error_mm=unsure))
    assert result < 0.6 * silent
    recorded = replace(wrong, is_generated=False, expected_error_mm=unsure)
    assert misfit_mm(recorded) == silent, "a recording has an error of its own"


def test_an_object_smaller_than_its_contact_has_a_unit_warning():
    bar = l_bar()
    small = replace(bar.mesh, vertices_mm=0.1 * bar.mesh.vertices_mm)
    found = estimate_pose(
        observe_depth(bar, lying(0.3, 0.2, 0.8, 2.0, 30.0)), small, PoseParams(n_starts=12)
    )
    assert any("is smaller than its contact" in note and "unit" in note for note in found.notes)


def test_the_stage_tracks_only_after_a_touch_with_a_pose():
    bar = l_bar()
    touch = observe_depth(bar, lying(0.3, 0.2, 0.8, 2.0, 30.0))
    params = PoseParams()
    before = estimate_or_track_pose(touch, bar.mesh, None, params)
    assert before.starts_tried > 0
    assert estimate_or_track_pose(touch, bar.mesh, before, params).starts_tried == 0
    lost = estimate_pose(touch, None, params)
    assert estimate_or_track_pose(touch, bar.mesh, lost, params).starts_tried == before.starts_tried


def test_alternatives_are_tracked_too():
    bar = l_bar()
    truth = lying(1.0, -0.5, 0.6, 4.0, 20.0, tilt_deg=(1.5, -2.0), origin_mm=(5.0, 3.5))
    wrong = lying(1.0, -0.5, 0.6, 4.0, 200.0, tilt_deg=(1.5, -2.0), origin_mm=(5.0, 3.5))
    mm, _ = error(
        track_pose(observe_depth(bar, truth), bar.mesh, PoseParams(), wrong, alternatives=(truth,)),
        truth,
    )
    assert mm < POSITION_TOLERANCE_MM


def test_the_planar_method_moves_in_the_plane_only():
    truth = lying(1.0, -0.5, 0.6, 4.0, 10.0, origin_mm=(5.0, 3.5))
    found = estimate_pose_planar(
        observe_depth(l_bar(), truth), l_bar().mesh, PoseParams(face="+z", keep_steps=True)
    )
    assert found.sensor_from_object is not None
    assert found.covariance is None
    assert found.notes[0].startswith("paper 2D: in-plane turn and shift only")
    assert len(found.steps) >= 1


def test_icp_finds_a_wedge_without_ambiguity_estimate():
    truth = lying(-0.8, 0.7, 0.8, 2.0, 70.0, tilt_deg=(4.0, -2.0))
    touch = observe_depth(notched_wedge(), truth, noise_mm=0.01)
    found, again, plain = (
        estimate_pose_icp(
            touch, notched_wedge().mesh, PoseParams(face="+z", n_starts=24, keep_steps=kept)
        )
        for kept in (True, True, False)
    )
    mm, deg = error(found, truth)
    assert mm < POSITION_TOLERANCE_MM
    assert deg < TURN_TOLERANCE_DEG
    assert found.sensor_from_object.tobytes() == again.sensor_from_object.tobytes()
    np.testing.assert_array_equal(found.steps[-1].sensor_from_object, found.sensor_from_object)
    assert found.steps[0].rmse_mm > found.steps[-1].rmse_mm
    assert plain.steps == ()
    assert (found.covariance, found.observable, found.starts_tried) == (None, None, 24)
    assert found.notes[0].startswith("icp:")


def test_a_mesh_with_missing_vertices_is_refused():
    broken = Mesh(vertices_mm=slab().mesh.vertices_mm, triangles=np.array([[0, 1, 999]], np.int32))
    with pytest.raises(MeshProblem, match="does not have"):
        estimate_pose(observe_depth(slab(), lying(0.0, 0.0, 0.5, 5.0, 0.0)), broken, PoseParams())


def pressed_deep(solid, turn_deg, spin_deg, depth_mm):
    """sensor_from_object of a solid turned about x, then about z, its outermost place `depth_mm`
    into the gel.
    """
    turn = rigid.rotation([0.0, 0.0, np.deg2rad(spin_deg)]) @ rigid.rotation(
        [np.deg2rad(turn_deg), 0.0, 0.0]
    )
    corners = rigid.apply(turn, solid.mesh.vertices_mm)
    low = corners[corners[:, 2] < corners[:, 2].min() + 0.3].mean(axis=0)
    return rigid.translation(-low[0], -low[1], REST_MM - depth_mm - corners[:, 2].min()) @ turn


def bar_of(length_mm, side_mm):
    square = [(0.0, 0.0), (length_mm, 0.0), (length_mm, side_mm), (0.0, side_mm)]
    return extruded(square, [square], 0.0, side_mm)


@pytest.mark.parametrize(("turn_deg", "spin_deg"), [(43.0, 25.0), (46.0, 0.0), (50.0, 40.0)])
def test_a_box_on_its_edge_is_found_with_all_eight_poses_that_fit_as_well(turn_deg, spin_deg):
    box = bar_of(20.0, 5.0)
    truth = pressed_deep(box, turn_deg, spin_deg, 0.6)
    found = estimate_pose(observe_depth(box, truth), box.mesh, PoseParams())
    assert found.fitness > 0.99
    assert found.rmse_mm < 0.02
    assert len(found.alternatives) == 7
    assert any(note.startswith("8 poses fit equally well") for note in found.notes)
    turns = [rigid.invert(truth) @ p for p in (found.sensor_from_object, *found.alternatives)]
    onto_itself = [
        np.abs(np.abs(turn[:3, :3]).round(1) - np.abs(turn[:3, :3]).round(0)).max()
        for turn in turns
    ]
    assert max(onto_itself) <= 0.1, "each takes the axes of the box to themselves"


def test_a_short_cylinder_on_its_rim_is_found_by_edge_starts():
    stub = rod(4.904, 6.279, 96)
    turn = rigid.rotation([0.0, 0.0, np.deg2rad(353.051)]) @ rigid.rotation(
        [0.0, np.deg2rad(52.5), 0.0]
    )
    corners = rigid.apply(turn, stub.mesh.vertices_mm)
    low = corners[corners[:, 2] < corners[:, 2].min() + 0.3].mean(axis=0)
    truth = rigid.translation(-low[0], -low[1], REST_MM - 0.984 - corners[:, 2].min()) @ turn
    found = estimate_pose(observe_depth(stub, truth), stub.mesh, PoseParams())
    assert found.fitness > 0.99
    assert found.rmse_mm < 0.02


def test_a_fit_far_above_the_noise_has_a_warning():
    wide = bar_of(14.0, 5.0)
    narrow = bar_of(14.0, 4.4)
    found = estimate_pose(
        observe_depth(wide, pressed_deep(wide, 45.0, 10.0, 1.4)),
        rod(1.2, 14.0, 48).mesh,
        PoseParams(n_starts=24),
    )
    assert found.fitness > 0.5
    assert any("where the depth's error makes up" in note for note in found.notes)
    fine = estimate_pose(
        observe_depth(narrow, pressed_deep(narrow, 45.0, 10.0, 1.0)),
        narrow.mesh,
        PoseParams(n_starts=24),
    )
    assert not any("where the depth's error makes up" in note for note in fine.notes)


def gently(x, y):
    return 4.0 - x**2 / 60.0 - y**2 / 140.0 + 0.1 * np.sin(x / 2.0 + y / 5.0) * np.cos(y / 2.5)


@pytest.mark.parametrize("angle_deg", [33.0, 200.0])
def test_a_gently_curved_body_is_not_held_where_the_data_determine_it(angle_deg):
    rows, cols = np.mgrid[-60:61, -60:61] * 0.25
    body = sheet(cols, rows, gently(cols, rows))
    truth = lying(0.4, -0.3, 1.2, 4.0, angle_deg, tilt_deg=(1.0, -1.0))
    depth, contact = height_felt(truth, gently)
    touch = touch_of(depth + 0.01 * np.random.default_rng(5).standard_normal(depth.shape), contact)
    found = track_pose(
        touch, body, PoseParams(), truth @ rigid.from_parts([0.3, -0.2, 0.0], [0.0, 0.0, 4.0])
    )
    mm, deg = error(found, truth)
    assert found.weak_directions == ()
    assert mm < HELD_MM / 4
    assert deg < HELD_DEG / 4


def height_felt(truth, height):
    """(z of the membrane, contact) of a gel that follows the surface z = height(x, y) of the
    object.
    """
    x, y = CAMERA.rays()
    ray = np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.ones(CAMERA.shape)], axis=-1)
    inverse = rigid.invert(truth)
    depth = np.full(CAMERA.shape, REST_MM - 1.0)
    for _ in range(30):
        p = (depth[..., None] * ray) @ inverse[:3, :3].T + inverse[:3, 3]
        depth = depth + (p[..., 2] - height(p[..., 0], p[..., 1]))
    contact = depth < REST_MM
    return np.minimum(depth, REST_MM), contact


def sheet(x, y, z):
    """A closed body: the surface z over a grid, walls and a flat bottom at -2."""
    n_rows, n_cols = z.shape
    top = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    vertices = np.concatenate([top, top * (1, 1, 0) - (0, 0, 12.0)])
    k = np.arange(n_rows * n_cols).reshape(n_rows, n_cols)
    a = k[:-1, :-1].ravel()
    b = k[:-1, 1:].ravel()
    c = k[1:, :-1].ravel()
    d = k[1:, 1:].ravel()
    up = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])
    ring = np.concatenate([k[0, :-1], k[:-1, -1], k[-1, :0:-1], k[:0:-1, 0]])
    after = np.roll(ring, -1)
    low = len(top)
    walls = np.concatenate(
        [np.stack([ring, ring + low, after + low], 1), np.stack([ring, after + low, after], 1)]
    )
    triangles = np.concatenate([up, up[:, ::-1] + low, walls]).astype(np.int32)
    return Mesh(vertices_mm=vertices, triangles=triangles)


def test_the_outline_of_a_ball_does_not_determine_its_rotation():
    body = ball(6.0)
    depth, contact = height_felt(
        lying(0.3, 0.2, 0.8, 6.0, 0.0), lambda x, y: np.sqrt(np.maximum(36.0 - x**2 - y**2, 1.0))
    )
    found = estimate_pose(touch_of(depth, contact), body, PoseParams())
    assert len(found.weak_directions) == 3
    assert not any("outline" in note for note in found.notes)


def test_the_slide_of_a_tilted_plate_is_not_called_an_axis_of_the_sensor():
    truth = (
        rigid.translation(0.0, 0.0, REST_MM - 0.6)
        @ rigid.rotation([np.deg2rad(4.0), 0.0, 0.0])
        @ UPSIDE_DOWN
        @ rigid.translation(0.0, 0.0, -5.0)
    )
    found = estimate_pose(observe_depth(slab(), truth), slab().mesh, PoseParams())
    assert "moves along y" not in found.weak_directions
    assert "moves along (0.00, 1.00, 0.07)" in found.weak_directions
