"""Track the membrane of one stage through a recording, for the command line and the window
alike.
"""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.results import DepthMap
from pipeline.lab.tracking.patch_map import (
    ContactView,
    close_loops,
    fuse_views,
    make_view,
    move_to_keys,
)
from pipeline.lab.tracking.surface_registration import make_surface
from pipeline.lab.tracking.track_record import (
    MOTION,
    TRACKED_STAGES,
    TrackError,
    TrackRecord,
    TrackRow,
)
from pipeline.lab.tracking.tracker import KeyFrame, TrackedFrame, Tracker
from pipeline.translation.translate import Translation

# motion between the views of a patch map
_VIEW_EVERY_MM = 0.15
_VIEW_EVERY_DEG = 1.0


@frozen
class Track:
    """The motion of an object over the frames of a recording."""

    frames: tuple[TrackedFrame, ...]
    keys: tuple[KeyFrame, ...]
    n_loops: int  # closed
    # in the sensor frame of the first part's first frame; None where no contact could be fused
    patch: Mesh | None

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
    read_depth: Callable[[int], DepthMap | None],
    progress: Progress = SILENT,
    on_frame: Callable[[TrackedFrame, Sequence[KeyFrame]], None] | None = None,
) -> Track:
    """Follow the object through the frames `indices`.

    `read_depth` gives the membrane of a frame, None = lost.

    `on_frame` receives every frame, with the key frames so far, before loops are closed and the
    motion is smoothed.
    """
    tracker = Tracker()
    views = dict[int, ContactView]()
    seen_at: Doubles | None = None
    for done, index in enumerate(indices):
        progress.step(done / len(indices), f"frame {index}")
        depth = read_depth(index)
        frame = tracker.add_frame(index, None if depth is None else make_surface(depth))
        if on_frame is not None:
            on_frame(frame, tracker.keys)
        pose = frame.sensor_from_start
        if (
            depth is not None
            and pose is not None
            and frame.part == 0
            and _is_elsewhere(pose, seen_at)
        ):
            view = make_view(frame, depth)
            views |= {} if view is None else {done: view}
            seen_at = pose
    tracker.average_key()
    keys, n_loops = close_loops(tracker.keys)
    smoothed = smooth_frames(move_to_keys(tracker.frames, tracker.keys, keys))
    placed = [
        replace(view, sensor_from_start=pose)
        for done, view in views.items()
        if (pose := smoothed[done].sensor_from_start) is not None
    ]
    return Track(frames=smoothed, keys=keys, n_loops=n_loops, patch=fuse_views(placed))


def _is_elsewhere(pose: Doubles, before: Doubles | None) -> bool:
    if before is None:
        return True
    motion = pose @ rigid.invert(before)
    shift_mm = float(np.linalg.norm(pose[:3, 3] - before[:3, 3]))
    return shift_mm > _VIEW_EVERY_MM or rigid.rotation_angle_deg(motion) > _VIEW_EVERY_DEG


def compute_error(track: Track, read_pose: Callable[[int], Doubles | None]) -> TrackError | None:
    """The error of a track's first part where `read_pose` knows `sensor_from_object` (4, 4).

    None where it does not.
    """
    frames = [
        frame for frame in track.frames if frame.part == 0 and frame.sensor_from_start is not None
    ]
    poses = [read_pose(frame.index) for frame in frames]
    first = poses[0] if poses else None
    if first is None:
        return None
    shifts = [0.0]
    turns = [0.0]
    path_mm = 0.0
    turned_deg = 0.0
    before = first
    for frame, pose in zip(frames[1:], poses[1:], strict=True):
        if pose is None or frame.centre_mm is None or frame.sensor_from_start is None:
            continue
        true = pose @ rigid.invert(first)
        here = rigid.apply(rigid.invert(true), frame.centre_mm)
        shifts.append(
            float(np.linalg.norm(rigid.apply(frame.sensor_from_start, here) - frame.centre_mm))
        )
        turns.append(rigid.rotation_angle_deg(frame.sensor_from_start @ rigid.invert(true)))
        step = pose @ rigid.invert(before)
        path_mm += float(np.linalg.norm(rigid.apply(step, frame.centre_mm) - frame.centre_mm))
        turned_deg += rigid.rotation_angle_deg(step)
        before = pose
    return TrackError(
        path_mm=path_mm,
        turned_deg=turned_deg,
        drift_mm=max(shifts),
        drift_deg=max(turns),
        n_frames=len(shifts),
    )


def make_record(track: Track, stage: str, error: TrackError | None) -> TrackRecord:
    """Return a track as rows."""
    rows = tuple(make_row(frame, track.keys) for frame in track.frames)
    keys = tuple(key.index for key in track.keys)
    return TrackRecord(
        stage=stage,
        rows=rows,
        key_frames=keys,
        n_loops=track.n_loops,
        error=error,
        patch=track.patch,
    )


def make_row(frame: TrackedFrame, keys: Sequence[KeyFrame]) -> TrackRow:
    """Return one frame as a row."""
    pose = frame.sensor_from_start
    if pose is None:
        return TrackRow(frame=frame.index, state=frame.state, part=frame.part)
    motion = (*pose[:3, 3].tolist(), *np.rad2deg(rigid.rotation_vector_rad(pose)).tolist())
    return TrackRow(
        frame=frame.index,
        state=frame.state,
        part=frame.part,
        key_frame=keys[frame.key].index,
        std_mm=frame.std_mm,
        std_deg=frame.std_deg,
        overlap=frame.overlap,
        agreement=frame.agreement,
        not_measured="; ".join(frame.weak_directions),
        **dict(zip(MOTION, motion, strict=True)),
    )


MIN_FRAMES = 10  # fewer do not show how evenly an object moves
_PERSISTENCE = (0.0, 0.5, 0.8, 0.95, 0.99)  # phi
# s, in measurement errors a frame
_VELOCITIES = (1e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 10.0)

# x, v, and the variances of x, of x with v, of v
_State = tuple[Doubles, Doubles, Doubles, Doubles, Doubles]


def smooth_frames(frames: Sequence[TrackedFrame]) -> tuple[TrackedFrame, ...]:
    """The frames with smoothed poses, each part by itself.

    States and covariances stay those of single frames.

    An object moves more evenly than single frames are measured. Kalman filter and
    Rauch-Tung-Striebel smoother (1965) of each of the six coordinates. A coordinate x changes by
    its velocity v, which is correlated over time (an Ornstein-Uhlenbeck process); z is what a frame
    measures, with error 1:

        x' = x + v,    v' = phi v + w,    var(w) = (1 - phi^2) s^2,    z = x + n,    var(n) = 1

    How long velocities last (phi) and how large they are (s) is what makes the track itself
    likeliest, per coordinate: a coordinate that rests is averaged over all frames, an uneven one
    stays as measured. The first frame is measured like the others, so the motion since then is
    smoothed at both ends.
    """
    smoothed = list(frames)
    for part in {frame.part for frame in frames}:
        places = [
            i
            for i, frame in enumerate(frames)
            if frame.part == part and frame.sensor_from_start is not None
        ]
        if len(places) < MIN_FRAMES:
            continue
        poses = _smooth_poses([frames[i] for i in places], np.array(places) - places[0])
        for i, pose in zip(places, poses, strict=True):
            smoothed[i] = replace(frames[i], sensor_from_start=freeze(pose))
    return tuple(smoothed)


def _smooth_poses(frames: Sequence[TrackedFrame], steps: np.ndarray) -> list[Doubles]:
    """The poses `sensor_from_start` of one part, whose frames are number `steps` since its
    first.
    """
    poses = [frame.sensor_from_start for frame in frames if frame.sensor_from_start is not None]
    centres = [frame.centre_mm for frame in frames if frame.centre_mm is not None]
    # a part's first frame has no fit and so no centroid
    pairs = list(zip(poses, centres, strict=True))[1:]
    centre = np.mean([rigid.apply(rigid.invert(pose), here) for pose, here in pairs], axis=0)
    turns = np.unwrap(np.array([rigid.rotation_vector_rad(pose) for pose in poses]), axis=0)
    measured = np.full((int(steps[-1]) + 1, 6), np.nan)
    measured[steps] = np.column_stack(
        [turns, np.array([rigid.apply(pose, centre) for pose in poses])]
    )
    moved: list[Doubles] = []
    for row in smooth_coordinates(measured)[steps]:
        pose = rigid.rotation(row[:3])
        pose[:3, 3] = row[3:] - pose[:3, :3] @ centre
        moved.append(pose)
    start = rigid.invert(moved[0])
    return [pose @ start for pose in moved]


def smooth_coordinates(measured: Doubles) -> Doubles:
    """Coordinates (n, d) of n frames, smoothed one by one.

    A row of NaN is a frame without a measurement.
    """
    if not len(measured):
        return measured
    phi, s = (grid.reshape(-1, 1) for grid in np.meshgrid(_PERSISTENCE, _VELOCITIES, indexing="ij"))
    best = _filter(measured, phi, s)[1].argmax(axis=0)
    phi = phi[best, 0]
    s = s[best, 0]
    states = _filter(measured, phi, s)[0]
    x, v = states[-1][:2]
    smoothed = np.empty_like(measured)
    smoothed[-1] = x
    for k in range(len(states) - 2, -1, -1):
        state = states[k]
        x_next, v_next, xx, xv, vv = _predict(state, phi, s)
        along_x = x - x_next
        along_v = v - v_next
        # [P F^T] [P']^-1 (smoothed - predicted), of 2 x 2 matrices
        det = xx * vv - xv**2
        on_x = (vv * along_x - xv * along_v) / det
        on_v = (xx * along_v - xv * along_x) / det
        x = state[0] + (state[2] + state[3]) * on_x + phi * state[3] * on_v
        v = state[1] + (state[3] + state[4]) * on_x + phi * state[4] * on_v
        smoothed[k] = x
    return smoothed


def _predict(state: _State, phi: Doubles, s: Doubles) -> _State:
    x, v, xx, xv, vv = state
    return x + v, phi * v, xx + 2.0 * xv + vv, phi * (xv + vv), phi**2 * vv + (1.0 - phi**2) * s**2


def _filter(measured: Doubles, phi: Doubles, s: Doubles) -> tuple[list[_State], Doubles]:
    """The filtered states of every frame, and the log-likelihood of each coordinate at its best
    measurement error.
    """
    shape = np.broadcast_shapes(phi.shape, measured[0].shape)
    x = np.broadcast_to(measured[0], shape)
    one = np.ones(shape)
    zero = np.zeros(shape)
    state: _State = (x, zero, one, zero, np.broadcast_to(s**2, shape))
    states = [state]
    squares = zero
    logs = zero
    n = 0
    for row in measured[1:]:
        x, v, xx, xv, vv = state = _predict(state, phi, s)
        if np.isfinite(row).all():
            off = row - x
            spread = xx + 1.0
            squares = squares + off**2 / spread
            logs = logs + np.log(spread)
            n = n + 1
            state = (
                x + xx / spread * off,
                v + xv / spread * off,
                xx / spread,
                xv / spread,
                vv - xv**2 / spread,
            )
        states.append(state)
    return states, -0.5 * (n * np.log(squares / n + 1e-18) + logs)


def track_recording(
    translation: Translation,
    stage: str,
    indices: Sequence[int],
    progress: Progress = SILENT,
    on_row: Callable[[TrackRow], None] | None = None,
) -> TrackRecord:
    """Follow the object through the frames `indices` by the depth of a stage.

    `on_row` receives every frame at once.

    Rows of the result may differ from those that `on_row` received: closed loops move them. Frames
    that cannot be read count as lost; raises FileProblem where none can.
    """
    if stage not in TRACKED_STAGES:
        raise SettingProblem(
            f"the membrane of {stage!r} is not tracked; choose one of {', '.join(TRACKED_STAGES)}"
        )
    problems = dict[int, FileProblem]()

    def read_depth(index: int) -> DepthMap | None:
        try:
            frame = translation.stream.frame(index)
        except FileProblem as error:
            problems[index] = error
            return None
        return translation.evaluate(frame, [stage])[stage].output

    track = track_frames(
        indices,
        read_depth,
        progress,
        None if on_row is None else lambda frame, keys: on_row(make_row(frame, keys)),
    )
    if problems and len(problems) == len(indices):
        raise problems[indices[0]]
    record = make_record(
        track, stage, compute_error(track, lambda index: _read_pose(translation, stage, index))
    )
    return replace(
        record, problems=tuple(f"frame {index}: {problem}" for index, problem in problems.items())
    )


def _read_pose(translation: Translation, stage: str, index: int) -> Doubles | None:
    """The true pose `sensor_from_object` (4, 4) in the frame of the followed sensor.

    None where unknown or damaged.
    """
    truth = None
    with contextlib.suppress(FileProblem):
        if stage == "touch_depth":
            other = translation.read_target_observation(index)
            truth = None if other is None else other[1]
        else:
            truth = translation.read_source_truth(index)
    return None if truth is None else truth.sensor_from_object
