"""Smooth a track: an object moves more evenly than single frames are measured.

Kalman filter and Rauch-Tung-Striebel smoother (1965) of each of the six coordinates. A coordinate x changes by its
velocity v, which is correlated over time (an Ornstein-Uhlenbeck process); z is what a frame measures, with error 1:

    x' = x + v,    v' = phi v + w,    var(w) = (1 - phi^2) s^2,    z = x + n,    var(n) = 1

How long velocities last (phi) and how large they are (s) is what makes the track itself likeliest, per coordinate: a
coordinate that rests is averaged over all frames, an uneven one stays as measured. The first frame is measured like the
others, so the motion since then is smoothed at both ends.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.base.arrays import Doubles, freeze
from pipeline.geometry import rigid
from pipeline.tracking.tracker import TrackedFrame

MIN_FRAMES = 10  # fewer do not show how evenly an object moves
_PERSISTENCE = (0.0, 0.5, 0.8, 0.95, 0.99)  # phi
_VELOCITIES = (1e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 10.0)  # s, in measurement errors a frame

_State = tuple[Doubles, Doubles, Doubles, Doubles, Doubles]  # x, v, and the variances of x, of x with v, of v


def smooth_frames(frames: Sequence[TrackedFrame]) -> tuple[TrackedFrame, ...]:
    """The frames with smoothed poses, each part by itself; states and covariances stay those of single frames."""
    smoothed = list(frames)
    for part in {frame.part for frame in frames}:
        places = [i for i, frame in enumerate(frames) if frame.part == part and frame.sensor_from_start is not None]
        if len(places) < MIN_FRAMES:
            continue
        poses = _smooth_poses([frames[i] for i in places], np.array(places) - places[0])
        for i, pose in zip(places, poses, strict=True):
            smoothed[i] = replace(frames[i], sensor_from_start=freeze(pose))
    return tuple(smoothed)


def _smooth_poses(frames: Sequence[TrackedFrame], steps: np.ndarray) -> list[Doubles]:
    """The poses `sensor_from_start` of one part, whose frames are number `steps` since its first."""
    poses = [frame.sensor_from_start for frame in frames if frame.sensor_from_start is not None]
    centres = [frame.centre_mm for frame in frames if frame.centre_mm is not None]
    pairs = list(zip(poses, centres, strict=True))[1:]  # a part's first frame has no fit and so no centroid
    centre = np.mean([rigid.apply(rigid.invert(pose), here) for pose, here in pairs], axis=0)
    turns = np.unwrap(np.array([rigid.rotation_vector_rad(pose) for pose in poses]), axis=0)
    measured = np.full((int(steps[-1]) + 1, 6), np.nan)
    measured[steps] = np.column_stack([turns, np.array([rigid.apply(pose, centre) for pose in poses])])
    moved: list[Doubles] = []
    for row in smooth_coordinates(measured)[steps]:
        pose = rigid.rotation(row[:3])
        pose[:3, 3] = row[3:] - pose[:3, :3] @ centre
        moved.append(pose)
    start = rigid.invert(moved[0])
    return [pose @ start for pose in moved]


def smooth_coordinates(measured: Doubles) -> Doubles:
    """Coordinates (n, d) of n frames, smoothed one by one; a row of NaN is a frame without a measurement."""
    phi, s = (grid.reshape(-1, 1) for grid in np.meshgrid(_PERSISTENCE, _VELOCITIES, indexing="ij"))
    best = _filter(measured, phi, s)[1].argmax(axis=0)
    phi, s = phi[best, 0], s[best, 0]
    states = _filter(measured, phi, s)[0]
    x, v = states[-1][:2]
    smoothed = np.empty_like(measured)
    smoothed[-1] = x
    for k in range(len(states) - 2, -1, -1):
        state = states[k]
        x_next, v_next, xx, xv, vv = _predict(state, phi, s)
        along_x, along_v = x - x_next, v - v_next
        # [P F^T] [P']^-1 (smoothed - predicted), of 2 x 2 matrices
        det = xx * vv - xv**2
        on_x, on_v = (vv * along_x - xv * along_v) / det, (xx * along_v - xv * along_x) / det
        x = state[0] + (state[2] + state[3]) * on_x + phi * state[3] * on_v
        v = state[1] + (state[3] + state[4]) * on_x + phi * state[4] * on_v
        smoothed[k] = x
    return smoothed


def _predict(state: _State, phi: Doubles, s: Doubles) -> _State:
    x, v, xx, xv, vv = state
    return x + v, phi * v, xx + 2.0 * xv + vv, phi * (xv + vv), phi**2 * vv + (1.0 - phi**2) * s**2


def _filter(measured: Doubles, phi: Doubles, s: Doubles) -> tuple[list[_State], Doubles]:
    """The filtered states of every frame, and the log-likelihood of each coordinate at its best measurement error."""
    shape = np.broadcast_shapes(phi.shape, measured[0].shape)
    x, one, zero = np.broadcast_to(measured[0], shape), np.ones(shape), np.zeros(shape)
    state: _State = (x, zero, one, zero, np.broadcast_to(s**2, shape))
    states, squares, logs, n = [state], zero, zero, 0
    for row in measured[1:]:
        x, v, xx, xv, vv = state = _predict(state, phi, s)
        if np.isfinite(row).all():
            off, spread = row - x, xx + 1.0
            squares, logs, n = squares + off**2 / spread, logs + np.log(spread), n + 1
            state = (x + xx / spread * off, v + xv / spread * off, xx / spread, xv / spread, vv - xv**2 / spread)
        states.append(state)
    return states, -0.5 * (n * np.log(squares / n + 1e-18) + logs)
