"""Track a recording: one stage's depth maps in, motions and a patch map out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.base.progress import SILENT, Progress
from pipeline.geometry import rigid
from pipeline.geometry.meshes import Mesh
from pipeline.tracking.membrane_surface import make_surface
from pipeline.tracking.motion_smoothing import smooth_frames
from pipeline.tracking.patch_map import ContactView, close_loops, fuse_views, make_view, move_to_keys
from pipeline.tracking.track_record import MOTION, TrackError, TrackRecord, TrackRow
from pipeline.tracking.tracker import KeyFrame, TrackedFrame, Tracker
from pipeline.values.results import DepthMap

_VIEW_EVERY_MM, _VIEW_EVERY_DEG = 0.3, 2.0  # motion between the views of a patch map


@dataclass(frozen=True, slots=True, kw_only=True)
class Track:
    """The motion of an object over the frames of a recording."""

    frames: tuple[TrackedFrame, ...]
    keys: tuple[KeyFrame, ...]
    n_loops: int  # closed
    patch: Mesh | None  # in the sensor frame of the first part's first frame; None where no contact could be fused

    @property
    def n_lost(self) -> int:
        """Frames in which the object was lost."""
        return sum(frame.state == "lost" for frame in self.frames)

    @property
    def n_parts(self) -> int:
        """Parts that do not know of each other."""
        return len({key.part for key in self.keys})


def track_frames(
    indices: Sequence[int],
    read_depth: Callable[[int], DepthMap],
    progress: Progress = SILENT,
    on_frame: Callable[[TrackedFrame, Sequence[KeyFrame]], None] | None = None,
) -> Track:
    """Follow the object through the frames `indices`; `read_depth` gives the membrane of a frame.

    `on_frame` receives every frame, with the key frames so far, before loops are closed and the motion is smoothed.
    """
    tracker, frames, views = Tracker(), list[TrackedFrame](), list[ContactView]()
    seen_at: Doubles | None = None
    for done, index in enumerate(indices):
        progress.step(done / len(indices), f"frame {index}")
        surface = make_surface(read_depth(index))
        frame = tracker.add_frame(index, surface)
        frames.append(frame)
        if on_frame is not None:
            on_frame(frame, tracker.keys)
        if frame.sensor_from_start is not None and frame.part == 0 and _is_elsewhere(frame.sensor_from_start, seen_at):
            view = make_view(frame, surface, tracker.keys)
            views += [] if view is None else [view]
            seen_at = frame.sensor_from_start
    keys, n_loops = close_loops(tracker.keys)
    return Track(
        frames=smooth_frames(move_to_keys(frames, tracker.keys, keys)), keys=keys, n_loops=n_loops,
        patch=fuse_views(views, keys),
    )  # fmt: skip


def _is_elsewhere(pose: Doubles, before: Doubles | None) -> bool:
    if before is None:
        return True
    motion = pose @ rigid.invert(before)
    shift_mm = float(np.linalg.norm(pose[:3, 3] - before[:3, 3]))
    return shift_mm > _VIEW_EVERY_MM or rigid.rotation_angle_deg(motion) > _VIEW_EVERY_DEG


def compute_error(track: Track, read_pose: Callable[[int], Doubles | None]) -> TrackError | None:
    """The error of a track's first part where `read_pose` knows `sensor_from_object` (4, 4); None where it does not."""
    frames = [frame for frame in track.frames if frame.part == 0 and frame.sensor_from_start is not None]
    poses = [read_pose(frame.index) for frame in frames]
    first = poses[0] if poses else None
    if first is None:
        return None
    shifts, turns, path_mm, turned_deg, before = [0.0], [0.0], 0.0, 0.0, first
    for frame, pose in zip(frames[1:], poses[1:], strict=True):
        if pose is None or frame.centre_mm is None or frame.sensor_from_start is None:
            continue
        true = pose @ rigid.invert(first)
        here = rigid.apply(rigid.invert(true), frame.centre_mm)
        shifts.append(float(np.linalg.norm(rigid.apply(frame.sensor_from_start, here) - frame.centre_mm)))
        turns.append(rigid.rotation_angle_deg(frame.sensor_from_start @ rigid.invert(true)))
        step = pose @ rigid.invert(before)
        path_mm += float(np.linalg.norm(rigid.apply(step, frame.centre_mm) - frame.centre_mm))
        turned_deg += rigid.rotation_angle_deg(step)
        before = pose
    return TrackError(
        path_mm=path_mm, turned_deg=turned_deg, drift_mm=max(shifts), drift_deg=max(turns), n_frames=len(shifts)
    )


def make_record(track: Track, stage: str, error: TrackError | None) -> TrackRecord:
    """Return a track as rows."""
    rows = tuple(make_row(frame, track.keys) for frame in track.frames)
    keys = tuple(key.index for key in track.keys)
    return TrackRecord(stage=stage, rows=rows, key_frames=keys, n_loops=track.n_loops, error=error, patch=track.patch)


def make_row(frame: TrackedFrame, keys: Sequence[KeyFrame]) -> TrackRow:
    """Return one frame as a row."""
    pose = frame.sensor_from_start
    if pose is None:
        return TrackRow(frame=frame.index, state=frame.state, part=frame.part)
    motion = (*pose[:3, 3].tolist(), *np.rad2deg(rigid.rotation_vector_rad(pose)).tolist())
    return TrackRow(
        frame=frame.index, state=frame.state, part=frame.part, key_frame=keys[frame.key].index, std_mm=frame.std_mm,
        std_deg=frame.std_deg, overlap=frame.overlap, agreement=frame.agreement,
        not_measured="; ".join(frame.weak_directions), **dict(zip(MOTION, motion, strict=True)),
    )  # fmt: skip
