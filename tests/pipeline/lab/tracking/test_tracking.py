"""Tracking without a mesh on simulated presses, whose motion is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.errors import FileProblem
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import load_mesh
from pipeline.core.values.results import DepthErrorModel
from pipeline.lab.tracking import patch_map, tracker
from pipeline.lab.tracking import track_recording as track_module
from pipeline.lab.tracking.surface_registration import (
    average_surfaces,
    make_surface,
    register_surfaces,
)
from pipeline.lab.tracking.track_record import (
    format_patch,
    format_table,
    is_track_folder,
    read_record,
    write_record,
)
from pipeline.lab.tracking.track_recording import compute_error, make_record, track_frames
from pipeline.lab.tracking.tracker import GIVE_UP_AFTER, KeyFrame, TrackedFrame, Tracker
from tests.pipeline.lab.tracking.presses import press, untouched

# of perfect membranes: a fifth of a pixel's half
POSITION_MM = 0.02
ROTATION_DEG = 0.1


def track(presses):
    return track_frames(range(len(presses)), lambda i: presses[i][0])


def error(result, presses):
    return compute_error(result, lambda i: presses[i][1])


@pytest.mark.parametrize("shape", ["star", "letters"])
def test_a_slide_and_a_turn_are_followed(shape):
    steps = [
        (0.0, 0.0, 0.0),
        (0.5, 0.0, 0.0),
        (1.0, 0.2, 0.0),
        (1.5, 0.4, 0.0),
        (1.5, 0.4, 4.0),
        (1.5, 0.4, 9.0),
    ]
    presses = [press(shape, *step) for step in steps]
    result = track(presses)
    assert [frame.state for frame in result.frames] == ["tracked"] * len(steps)
    found = error(result, presses)
    assert found.path_mm > 1.5
    assert found.turned_deg == pytest.approx(9.0, abs=1e-3)
    assert found.drift_mm < POSITION_MM
    assert found.drift_deg < ROTATION_DEG


@settings(max_examples=8)
@given(x=st.floats(-0.4, 0.4), y=st.floats(-0.4, 0.4), angle=st.floats(-4, 4))
def test_the_motion_back_is_the_inverse(x, y, angle):
    one = make_surface(press("star")[0])
    two = make_surface(press("star", round(x, 2), round(y, 2), round(angle, 1))[0])
    there = register_surfaces(one, two, np.eye(4))
    back = register_surfaces(two, one, np.eye(4))
    both = back.current_from_key @ there.current_from_key
    assert np.linalg.norm(rigid.apply(both, there.centre_mm) - there.centre_mm) < POSITION_MM
    assert rigid.rotation_angle_deg(both) < ROTATION_DEG


def test_a_turn_that_a_cone_does_not_show_is_named_and_not_measured():
    result = track([press("cone"), press("cone", angle_deg=10.0), press("cone", angle_deg=20.0)])
    last = result.frames[-1]
    assert last.state == "tracked"
    assert any("rotates about z" in direction for direction in last.weak_directions)
    assert rigid.rotation_angle_deg(last.sensor_from_start) < 1.0


def test_another_object_is_lost_and_starts_a_part_of_its_own():
    presses = [
        press("star"),
        press("star", 0.2),
        *[press("cross", 0.3, 0.5, 20.0)] * (GIVE_UP_AFTER + 2),
    ]
    result = track(presses)
    states = [frame.state for frame in result.frames]
    assert states[:2] == ["tracked", "tracked"]
    assert states[2 : 2 + GIVE_UP_AFTER] == ["lost"] * GIVE_UP_AFTER
    assert [frame.part for frame in result.frames[-2:]] == [1, 1]
    assert result.n_lost == GIVE_UP_AFTER
    assert all(frame.sensor_from_start is None for frame in result.frames if frame.state == "lost")


def test_a_lost_object_is_found_again_where_it_was():
    presses = [
        press("star"),
        press("star", 0.2),
        press("cross", 0.3, 0.5, 20.0),
        press("star", 0.3),
    ]
    result = track(presses)
    assert [frame.state for frame in result.frames] == ["tracked", "tracked", "lost", "tracked"]
    assert result.n_parts == 1
    assert error(result, presses).drift_mm < POSITION_MM


def test_without_contact_there_is_nothing_to_follow():
    result = track([(untouched(), None), press("star"), (untouched(), None), press("star", 1.0)])
    assert [frame.state for frame in result.frames] == [
        "no contact",
        "tracked",
        "no contact",
        "tracked",
    ]
    assert result.n_parts == 2
    assert track([(untouched(), None)]).patch is None


def test_a_frame_without_any_depth_is_no_contact():
    membrane = press("star")[0]
    nothing = np.full_like(membrane.depth_mm, np.nan)
    result = track(
        [press("star"), (replace(membrane, depth_mm=nothing, indentation_mm=nothing), None)]
    )
    assert [frame.state for frame in result.frames] == ["tracked", "no contact"]


def test_missing_depth_is_left_out():
    presses = [press("star"), press("star", 0.5, 0.2, 3.0)]
    holed = presses[1][0].depth_mm.copy()
    holed[::7, ::5] = np.nan
    holed[100:140, 150:200] = np.nan
    found = error(track([presses[0], (replace(presses[1][0], depth_mm=holed), None)]), presses)
    assert found.drift_mm < 2 * POSITION_MM


def test_the_mean_of_one_place_is_that_place():
    surface = make_surface(press("star")[0])
    mean = average_surfaces(surface, [surface] * 3, [np.eye(4)] * 3)
    inside = mean.moved > 0
    assert np.abs(mean.depth_mm - surface.depth_mm)[inside].max() < 1e-3
    assert np.count_nonzero(mean.contact ^ surface.contact) < 0.02 * np.count_nonzero(
        surface.contact
    )
    assert mean.n_frames == 3


def test_a_mean_is_less_noisy_than_its_frames():
    import cv2

    rng = np.random.default_rng(5)
    presses = [press("star", 0.1 * step, 0.0) for step in range(9)]
    surfaces = []
    for membrane, _ in presses:
        noise = np.asarray(
            cv2.GaussianBlur(rng.normal(0.0, 1.0, membrane.depth_mm.shape), (0, 0), 4.0), np.float32
        )
        surfaces.append(
            make_surface(replace(membrane, depth_mm=membrane.depth_mm + 0.02 * noise / noise.std()))
        )
    poses = [pose @ rigid.invert(presses[0][1]) for _, pose in presses]
    mean = average_surfaces(surfaces[0], surfaces, poses)
    errors_mm = [
        (surface.depth_mm - presses[0][0].depth_mm)[presses[0][0].contact]
        for surface in (mean, surfaces[0])
    ]
    assert np.abs(errors_mm[0]).mean() < 0.5 * np.abs(errors_mm[1]).mean()


def test_a_noisy_sensor_is_tracked_against_the_mean_of_what_follows_a_key_frame():
    tracker = Tracker()
    stated = DepthErrorModel(rms_mm=0.18, correlation_mm=1.6)
    presses = [press("star", 0.3 * step, 0.0, 2.0 * step, "soft_bubble") for step in range(6)]
    for index, (membrane, _) in enumerate(presses):
        tracker.add_frame(index, make_surface(replace(membrane, error=stated)))
    before = [frame.sensor_from_start for frame in tracker.frames]
    tracker.average_key()
    assert [key.surface.n_frames for key in tracker.keys] == [6]
    assert np.array_equal(tracker.frames[0].sensor_from_start, before[0])
    assert not np.array_equal(tracker.frames[3].sensor_from_start, before[3])
    for frame, (_, pose) in zip(tracker.frames, presses, strict=True):
        off = frame.sensor_from_start @ rigid.invert(pose @ rigid.invert(presses[0][1]))
        assert rigid.rotation_angle_deg(off) < 1.0
    gel = Tracker()
    for index in range(6):
        gel.add_frame(index, make_surface(press("star", 0.1 * index)[0]))
    gel.average_key()
    assert [key.surface.n_frames for key in gel.keys] == [1], "a gel's noise is not worth the time"


def test_a_closed_loop_mends_the_pose_of_a_key_frame():
    steps = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)]
    presses = [press("star", *step) for step in steps]
    true = [pose @ rigid.invert(presses[0][1]) for _, pose in presses]
    drifted = [true[0], true[1], rigid.translation(0.15, -0.1, 0.0) @ true[2]]
    keys = [
        KeyFrame(
            index=i,
            part=0,
            surface=make_surface(presses[i][0]),
            sensor_from_start=drifted[i],
            covariance=np.zeros((6, 6)),
            parent=i - 1,
        )
        for i in range(3)
    ]
    mended, n_loops = patch_map.close_loops(keys)
    assert n_loops == 1
    assert np.abs(mended[2].sensor_from_start[:3, 3] - true[2][:3, 3]).max() < POSITION_MM


def test_the_patch_map_lies_on_the_object(tmp_path):
    presses = [press("star", *step) for step in ((0.0, 0.0), (0.5, 0.0), (1.0, 0.4, 5.0))]
    (tmp_path / "patch.ply").write_bytes(format_patch(track(presses).patch))
    patch = load_mesh(tmp_path / "patch.ply", unit="mm")
    assert distance_to_star_mm(patch, presses[0][1]) < 0.05
    assert len(patch.triangles) > 1000


def distance_to_star_mm(patch, pose):
    """Mean distance of a patch to the star at a pose."""
    import open3d as o3d

    from pipeline.physics.simulation import shapes

    mesh = shapes.make_shape("star").mesh
    scene = o3d.t.geometry.RaycastingScene()
    corners = rigid.apply(pose, mesh.vertices_mm).astype(np.float32)
    scene.add_triangles(o3d.core.Tensor(corners), o3d.core.Tensor(mesh.triangles.astype(np.uint32)))
    return float(
        scene.compute_distance(o3d.core.Tensor(patch.vertices_mm.astype(np.float32))).numpy().mean()
    )


@pytest.mark.parametrize("side_px", [0, 1, 3])
def test_a_contact_too_small_to_fuse_has_no_surface(side_px):
    assert patch_map.fuse_views([flat_view(slice(50, 50 + side_px))]) is None


def flat_view(contact_cols, depth_mm=None):
    """A view of a flat membrane that is in contact in a square of these columns."""
    membrane = press("star")[0]
    contact = np.zeros(membrane.contact.shape, np.bool_)
    contact[contact_cols, contact_cols] = True
    level_mm = float(np.nanmedian(membrane.depth_mm)) if depth_mm is None else depth_mm
    return patch_map.ContactView(
        sensor_from_start=np.eye(4),
        camera=membrane.camera,
        depth_mm=np.full(contact.shape, level_mm, np.float32),
        contact=contact,
    )


def patch_width_mm(views):
    return float(np.ptp(patch_map.fuse_views(views).vertices_mm[:, 0]))


def test_a_contact_that_most_views_do_not_confirm_is_no_surface():
    small = flat_view(slice(80, 120))
    wide = flat_view(slice(40, 160))
    narrow_mm = patch_width_mm([small])
    assert patch_width_mm([wide]) > 2.5 * narrow_mm
    assert patch_width_mm([small, wide, small]) == pytest.approx(narrow_mm, rel=0.1)
    # Two of five views are enough, one is not.
    assert patch_width_mm([wide, small, wide, small, small]) == pytest.approx(
        patch_width_mm([wide]), rel=0.1
    )
    assert patch_width_mm([wide, small, small, small]) == pytest.approx(narrow_mm, rel=0.1)
    # A membrane that is elsewhere says nothing of the place.
    away = flat_view(slice(0, 0), depth_mm=float(small.depth_mm[0, 0]) + 5.0)
    assert patch_width_mm([small, away, away]) == pytest.approx(narrow_mm, rel=0.1)


def test_measured_depth_mends_what_the_stage_smoothed():
    import cv2

    exact, pose = press("star", sensor="soft_bubble")
    smooth = np.asarray(cv2.GaussianBlur(exact.depth_mm, (0, 0), 5.0), np.float32)
    rng = np.random.default_rng(3)
    noisy = [
        exact.depth_mm + rng.normal(0.0, 0.4, smooth.shape).astype(np.float32) for _ in range(16)
    ]
    noisy[0][::9] += 20.0  # flying pixels
    noisy[1][::7] = np.nan
    frame = TrackedFrame(index=0, state="tracked", part=0, sensor_from_start=np.eye(4))

    def error_mm(measured):
        views = [
            patch_map.make_view(frame, replace(exact, depth_mm=smooth, measured_depth_mm=image))
            for image in measured
        ]
        return distance_to_star_mm(patch_map.fuse_views(views), pose)

    assert error_mm(noisy) < 0.5 * error_mm([None])


def test_a_track_is_the_same_after_it_was_written_and_read(tmp_path):
    presses = [(untouched(), None), press("star"), press("star", 0.5)]
    result = track(presses)
    record = make_record(result, "depth", error(result, presses))
    assert [row.state for row in record.rows] == ["no contact", "tracked", "tracked"]
    assert record.rows[2].x_mm == pytest.approx(0.5, abs=POSITION_MM)
    assert record.rows[2].key_frame == 1
    write_record(tmp_path / "track", record)
    assert is_track_folder(tmp_path / "track")
    read = read_record(tmp_path / "track")
    assert format_table(read.rows) == format_table(record.rows)
    assert (read.stage, read.key_frames, read.n_loops, read.error) == (
        "depth",
        record.key_frames,
        0,
        record.error,
    )
    # none without an area
    assert len(read.patch.triangles) == pytest.approx(len(record.patch.triangles), rel=0.01)
    assert np.allclose(
        read.rows[2].sensor_from_start, result.frames[2].sensor_from_start, atol=1e-4
    )


@pytest.mark.parametrize(
    ("file", "text", "named"),
    [
        ("track.csv", "frame,state,part\n0,flying,0\n", "flying"),
        ("track.csv", "frame,state,part\nx,lost,0\n", "int"),
        ("track.csv", "frame,state,part\n0,lost\n", "part"),
        ("track.json", "[]", "summary"),
        ("track.json", '{"stage": "depth", "key_frames": [-1]}', "key_frames"),
    ],
)
def test_a_damaged_track_is_one_sentence(tmp_path, file, text, named):
    (tmp_path / "track.csv").write_text("frame,state,part\n0,lost,0\n")
    (tmp_path / "track.json").write_text('{"stage": "depth"}')
    assert read_record(tmp_path).count("lost") == 1
    (tmp_path / file).write_text(text)
    with pytest.raises(FileProblem, match=named):
        read_record(tmp_path)


def test_the_stated_error_adds_up_along_the_chain_of_key_frames(monkeypatch):
    """Each frame is registered with the same covariance, and each becomes the key frame of the
    next.
    """
    surface = make_surface(press("star")[0])
    monkeypatch.setattr(tracker, "NEW_KEY_OVERLAP", 2.0)
    monkeypatch.setattr(Tracker, "_rank_keys", lambda self, _: [len(self.keys) - 1])
    fit = register_surfaces(surface, surface, np.eye(4))
    assert fit is not None
    one = np.diag([1e-6, 1e-6, 1e-6, 4e-4, 9e-4, 36e-4])
    monkeypatch.setattr(tracker, "register_surfaces", lambda *_: replace(fit, covariance=one))
    followed = Tracker()
    frames = []
    for index in range(4):
        frames.append(followed.add_frame(index, surface))
    for k, frame in enumerate(frames):
        np.testing.assert_allclose(frame.covariance, k * one, atol=1e-15)
        assert frame.std_mm == pytest.approx(0.07 * k**0.5)
        assert frame.std_deg == pytest.approx(np.degrees((3e-6 * k) ** 0.5))
        # after the first of the part
        np.testing.assert_array_equal(followed.keys[k + 1].covariance, frame.covariance)


def test_the_more_frames_a_mean_is_of_the_smaller_is_the_stated_error():
    surface = make_surface(press("star")[0])
    one, four = (
        register_surfaces(replace(surface, n_frames=n), surface, np.eye(4)) for n in (1, 4)
    )
    assert one is not None
    assert four is not None
    np.testing.assert_allclose(four.covariance, 1.25 / 2.0 * one.covariance)


@pytest.mark.parametrize(("weak", "step_mm"), [((), 0.06), (("moves along x",), 0.0)])
def test_motion_along_a_direction_that_is_not_measured_is_not_extrapolated(
    monkeypatch, weak, step_mm
):
    surface = make_surface(press("star")[0])
    fit = register_surfaces(surface, surface, np.eye(4))
    assert fit is not None
    moved = replace(fit, current_from_key=rigid.translation(0.2, 0.0, 0.0), weak_directions=weak)
    monkeypatch.setattr(tracker, "register_surfaces", lambda *_: moved)
    followed = Tracker()
    for index in range(2):
        followed.add_frame(index, surface)
    np.testing.assert_allclose(followed._velocity, rigid.translation(step_mm, 0.0, 0.0), atol=1e-12)
    followed.add_frame(2, None)
    farther = replace(fit, current_from_key=rigid.translation(0.9, 0.0, 0.0))
    monkeypatch.setattr(tracker, "register_surfaces", lambda *_: farther)
    followed.add_frame(3, surface)  # a step over a lost frame is no velocity
    np.testing.assert_array_equal(followed._velocity, np.eye(4))


def test_only_the_first_part_is_fused(monkeypatch):
    views: list[int] = []
    monkeypatch.setattr(track_module, "fuse_views", lambda found: views.append(len(found)))
    presses = [press("star"), (untouched(), None), press("star", x_mm=1.0), press("star", x_mm=2.0)]
    result = track(presses)
    assert (result.n_parts, views) == (2, [1])


def test_no_point_is_where_the_filter_mixes_in_missing_depth():
    depth = press("star")[0]
    rows, cols = np.nonzero(depth.contact)
    hole = (int(np.median(rows)), int(np.median(cols)))
    gaps = depth.depth_mm.copy()
    gaps[hole[0] - 2 : hole[0] + 3, hole[1] - 2 : hole[1] + 3] = np.nan
    surface = make_surface(replace(depth, depth_mm=gaps))
    away_px = np.abs(surface.pixels - (hole[1], hole[0])).max(axis=1)
    assert away_px.min() > 2 + 2.5
    assert away_px.min() < 2 + 2.5 + 2.0  # and no farther than needed


def test_an_edge_of_the_pose_graph_is_about_the_origin_of_the_frame():
    surface = make_surface(press("star")[0])
    fit = register_surfaces(surface, surface, np.eye(4))
    assert fit is not None
    centre = np.array([2.0, -3.0, 11.0])
    one = np.diag([1e-4, 2e-4, 3e-4, 4e-2, 5e-2, 6e-2])
    by_motion = np.eye(6)
    # t + c x w
    by_motion[3:, :3] = np.stack([np.cross(centre, axis) for axis in np.eye(3)], axis=1)
    expected = by_motion @ (one + 1e-6 * np.eye(6)) @ by_motion.T
    found = patch_map._to_information(replace(fit, covariance=one, centre_mm=centre))
    np.testing.assert_allclose(np.linalg.inv(found), expected, rtol=1e-6, atol=1e-12)


def test_frames_follow_the_key_frame_that_they_were_registered_to():
    surface = make_surface(press("star")[0])
    before = [
        KeyFrame(
            index=k,
            part=0,
            surface=surface,
            sensor_from_start=rigid.translation(float(k), 0, 0),
            covariance=np.eye(6),
        )
        for k in range(2)
    ]
    after = [
        before[0],
        replace(before[1], sensor_from_start=rigid.from_parts((0.5, 2.0, 0.0), (0.0, 0.0, 30.0))),
    ]
    frames = [
        TrackedFrame(
            index=k,
            state="tracked",
            part=0,
            key=key,
            sensor_from_start=rigid.translation(1.5, 0, 0),
        )
        for k, key in enumerate((0, 1))
    ]
    lost = TrackedFrame(index=2, state="lost", part=0)
    moved = patch_map.move_to_keys([*frames, lost], before, after)
    np.testing.assert_allclose(moved[0].sensor_from_start, frames[0].sensor_from_start)
    np.testing.assert_allclose(
        moved[1].sensor_from_start, rigid.translation(0.5, 0, 0) @ after[1].sensor_from_start
    )
    assert moved[2] is lost
