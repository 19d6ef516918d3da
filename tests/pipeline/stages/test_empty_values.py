"""Legal values without content (nothing, one point, no depth anywhere) through every public
function of the stages.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.errors import TouchError
from pipeline.core.graph import Fallback, Skipped
from pipeline.core.params import NoParams
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import Cloud, DepthMap, TargetDepth
from pipeline.lab.tracking import patch_map, surface_registration, track_recording
from pipeline.lab.tracking.tracker import Tracker
from pipeline.stages.cloud import back_projection
from pipeline.stages.depth import bubble_depth, contact_force
from pipeline.stages.depth.depth_params import DepthParams
from pipeline.stages.pose import signed_distances
from pipeline.stages.pose.registration import scene
from pipeline.stages.target_depth import surface_projection
from pipeline.stages.touch import physical_render
from pipeline.stages.touch_depth import stage as touch_depth
from tests.stability.checks import sound
from tests.stability.scenes import aligned, cloud, depth_map, mesh, projection, small, view

KINDS = ("nothing", "one pixel", "no depth")
SENSORS = ("gelslim", "soft_bubble")
PLACES = st.tuples(st.floats(0.0, 0.999), st.floats(0.0, 0.999))
SURFACE = {"jump_mm": 1.0, "grazing_deg": 80.0}


def make_depth(name: str, kind: str, place: tuple[float, float]) -> DepthMap:
    """A depth map of this kind: untouched, one pixel in contact, or no value anywhere."""
    sensor = small(name)
    rows, cols = sensor.camera.shape
    pushed = np.zeros((rows, cols))
    if kind == "one pixel":
        pushed[int(place[0] * rows), int(place[1] * cols)] = 0.3
    made = depth_map(sensor, pushed)
    if kind != "no depth":
        return made
    gaps = np.full((rows, cols), np.nan, np.float32)
    return replace(made, depth_mm=gaps, indentation_mm=gaps)


def make_cloud(name: str, kind: str, place: tuple[float, float]) -> Cloud:
    """A cloud without a point, with one, or with one that is nowhere near the camera."""
    x, y = (10.0 * at - 5.0 for at in place)
    z = float(small(name).rest_depth_mm.min()) - 0.3
    return cloud({"nothing": [], "one pixel": [[x, y, z]], "no depth": [[x, y, -z]]}[kind])


def make_target_depth(name: str, kind: str, place: tuple[float, float]) -> TargetDepth:
    made = view(small(name), np.zeros(small(name).camera.shape))
    depth = make_depth(name, kind, place)
    if kind == "one pixel":
        touched = depth.contact
        return replace(
            made,
            contact=touched,
            indentation_mm=np.where(touched, depth.indentation_mm, 0).astype(np.float32),
            depth_mm=np.where(touched, depth.depth_mm, np.nan).astype(np.float32),
            source_index=np.where(touched, 0, -1).astype(np.int32),
        )
    return replace(made, in_view=np.zeros_like(made.in_view)) if kind == "no depth" else made


def make_frame(name: str, kind: str, place: tuple[float, float]) -> TactileFrame:
    sensor = small(name)
    depth = make_depth(name, kind, place)
    if sensor.kind == "gel":
        still = np.full((*sensor.camera.shape, 3), 90, np.uint8)
        image = still.copy()
        image[depth.contact] = 200
        return TactileFrame(
            sensor=name,
            image=np.zeros_like(image) if kind == "no depth" else image,
            reference=still,
        )
    return TactileFrame(
        sensor=name, image=depth.depth_mm, reference=sensor.rest_depth_mm.astype(np.float32)
    )


def project(name: str, mode: str) -> Callable[..., Any]:
    return lambda kind, place: surface_projection.project_cloud(
        make_cloud(name, kind, place), small(name), projection(mode)
    )


def rasterise(name: str, kind: str, place: Any) -> Any:
    made = make_cloud(name, kind, place)
    camera = small(name).camera
    membrane = small(name).membrane
    pixel, _ = surface_projection.assign_pixels(made, camera)
    splat = surface_projection.splat_cloud(made, camera, membrane, pixel)
    surface = surface_projection.rasterise_surface(made, camera, membrane, **SURFACE)
    assert (
        splat.n_drawn_px == surface.n_drawn_px == (kind == "one pixel" and bool((pixel >= 0).any()))
    )
    assert np.isfinite(surface.depth_mm).sum() == surface.n_drawn_px
    return surface_projection.project_checked_cloud(made, small(name), projection("surface"))


def touch_of(name: str, kind: str, place: Any) -> Any:
    return physical_render.render_touch(
        make_target_depth(name, kind, place), small(name), physical_render.PhysicalRenderParams()
    )


def membrane_of(name: str, kind: str, place: Any) -> Any:
    return touch_depth.use_membrane(touch_of(name, kind, place), small(name), NoParams())


def bubble(kind: str, place: Any) -> Any:
    frame = make_frame("soft_bubble", kind, place)
    sensor = small("soft_bubble")
    bubble_depth.compute_largest_change(frame.image, frame.reference)
    bubble_depth.skip_without_contact(frame, sensor, DepthParams())
    return bubble_depth.estimate_depth(frame, sensor, smoothing_px=1.0, least_mm=0.3)


def force(name: str, kind: str, place: Any) -> Any:
    depth = make_depth(name, kind, place)
    known = contact_force.estimate_force(
        depth, small(name), make_frame(name, kind, place), NoParams()
    )
    assert np.isfinite(known.normal_n)
    assert kind == "one pixel" or known.normal_n == 0.0


def tracked(name: str, kind: str, place: Any) -> Any:
    depth = make_depth(name, kind, place)
    surface = surface_registration.make_surface(depth)
    assert not surface.is_touched
    assert (
        surface_registration.register_surfaces(surface, surface, np.eye(4)) is None
        or kind == "one pixel"
    )
    assert surface_registration.measure_overlap(surface, np.eye(4)) in (0.0, 1.0)
    assert [Tracker().add_frame(0, surface).state, Tracker().add_frame(0, None).state] == [
        "no contact",
        "lost",
    ]
    result = track_recording.track_frames((0, 1), lambda _: depth)
    assert track_recording.compute_error(result, lambda _: np.eye(4)) is None
    record = track_recording.make_record(result, "depth", None)
    assert (record.patch, record.n_parts, record.count("no contact")) == (None, 0, 2)


def tracked_at_the_rim(name: str, _kind: str, place: Any) -> Any:
    """A contact of which every pixel is mixed with what is beyond the image's border."""
    sensor = small(name)
    pushed = np.zeros(sensor.camera.shape)
    along = int(place[0] * (sensor.camera.cols - 26))
    pushed[:3, along : along + 26] = 0.5
    surface = surface_registration.make_surface(depth_map(sensor, pushed))
    assert surface_registration.register_surfaces(surface, surface, np.eye(4)) is None
    assert surface_registration.measure_overlap(surface, np.eye(4)) == 0.0


def nothing_tracked(_kind: str, _place: Any) -> Any:
    result = track_recording.track_frames((), lambda _: None)
    assert (result.frames, result.keys, result.patch) == ((), (), None)
    assert track_recording.smooth_frames(()) == ()
    assert patch_map.fuse_views(()) is None
    assert patch_map.close_loops(()) == ((), 0)
    assert track_recording.smooth_coordinates(np.zeros((1, 6))).shape == (1, 6)
    assert track_recording.smooth_coordinates(np.zeros((0, 6))).shape == (0, 6)


def poses(name: str, kind: str, place: Any) -> list[Any]:
    touched = make_depth(name, kind, place)
    thing = mesh("ball")
    found = [
        signed_distances.estimate_pose(touched, thing, signed_distances.PoseParams(n_starts=6)),
        signed_distances.estimate_pose_planar(
            touched, thing, signed_distances.PoseParams(n_starts=6)
        ),
        signed_distances.estimate_pose_icp(touched, thing, signed_distances.PoseParams(n_starts=6)),
    ]
    seen = scene.extract_scene(touched, 100, 0)
    assert len(seen.points_mm) <= 1
    return found


FUNCTIONS: dict[str, Callable[[str, Any], Any]] = {
    "bubble depth": bubble,
    "tracking of no frame": nothing_tracked,
    **{
        f"{what}, {name}": make
        for name in SENSORS
        for what, make in {
            "back projection": lambda kind, place, name=name: back_projection.back_project_depth(
                make_depth(name, kind, place),
                aligned(small(name), small("digit")),
                back_projection.BackProjectionParams(stride=1),
            ),
            "projected as surface": project(name, "surface"),
            "projected as points": project(name, "paper"),
            "rasterised": lambda kind, place, name=name: rasterise(name, kind, place),
            "touch": lambda kind, place, name=name: touch_of(name, kind, place),
            "touch depth": lambda kind, place, name=name: membrane_of(name, kind, place),
            "force": lambda kind, place, name=name: force(name, kind, place),
            "tracking": lambda kind, place, name=name: tracked(name, kind, place),
            "tracking at the rim": lambda kind, place, name=name: tracked_at_the_rim(
                name, kind, place
            ),
            "pose": lambda kind, place, name=name: poses(name, kind, place),
        }.items()
    },
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_value_without_content_gives_a_sound_one_or_a_sentence(name):
    @settings(max_examples=6)
    @given(st.sampled_from(KINDS), PLACES)
    def try_all(kind, place):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            try:
                results = FUNCTIONS[name](kind, place)
            except TouchError:
                return
        for result in results if isinstance(results, list) else [results]:
            answer = (
                result.output
                if isinstance(result, Skipped)
                else result.result
                if isinstance(result, Fallback)
                else result
            )
            if answer is not None:
                sound(answer)

    try_all()
