"""Follow a touched object through a recording without its mesh.

Each frame is registered to the key frame that overlaps it most, from the motion that the frames
before predict. A frame that overlaps its key frame too little becomes a key frame itself. A return
to an earlier place is measured against the key frame of that place, so that drift does not add up.
A frame that agrees with no key frame is lost, and says so; it is looked for again in the frames
after it.

A noisy key frame's error is in the motion of all frames from it. So the first frames that follow it
are averaged with it, as soon as they are enough or another key frame begins; they are registered
once more, to their mean, and so is what comes after them.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.lab.tracking.surface_registration import (
    MembraneSurface,
    SurfaceFit,
    average_surfaces,
    measure_overlap,
    register_surfaces,
)
from pipeline.lab.tracking.track_record import TrackState

NEW_KEY_OVERLAP = 0.7  # less overlap with its key frame makes a frame a key frame
MIN_OVERLAP = 0.35  # less is no evidence of the same place
# share of points whose residuals are as small as expected; unrelated touches reach a third
MIN_AGREEMENT = 0.5
GIVE_UP_AFTER = 10  # lost frames, after which the next touch starts a part of its own
# weight of the newest step in the velocity: a bubble's steps are smaller than their errors
_SMOOTHING = 0.3
_PREDICTED_OVERLAP = 0.5  # key frames that overlap less are not tried
# frames of a mean
_LEAST_AVERAGED = 4
_MOST_AVERAGED = 32
# stated error from which means pay: gels, whose error is below, drift as far with them
_NOISY_MM = 0.1


@frozen
class TrackedFrame:
    """Where the object is in one frame, relative to where it was in the first frame of its part."""

    index: int
    state: TrackState
    # parts of a track do not know of each other: the contact ended, or the object was lost
    part: int
    key: int = -1  # key frame that it was registered to
    # (4, 4) mm: takes the object's points of the first frame to this one
    sensor_from_start: Doubles | None = None
    covariance: Doubles | None = None  # (6, 6) of (rotation rad, translation mm) about `centre_mm`
    centre_mm: Doubles | None = None  # (3,) of the moved part of the membrane
    weak_directions: tuple[str, ...] = ()  # predicted, not measured
    overlap: float = 0.0
    agreement: float = 0.0

    @property
    def std_mm(self) -> float:
        """Predicted standard deviation of the translation, of all three axes together.

        NaN where not tracked.
        """
        return self._compute_std(np.s_[3:])

    @property
    def std_deg(self) -> float:
        """Predicted standard deviation of the rotation, of all three axes together.

        NaN where not tracked.
        """
        return math.degrees(self._compute_std(np.s_[:3]))

    def _compute_std(self, axes: slice) -> float:
        if self.covariance is None:
            return math.nan
        return math.sqrt(float(np.trace(self.covariance[axes, axes])))


@frozen
class KeyFrame:
    """A frame that others are registered to."""

    index: int
    part: int
    surface: MembraneSurface
    sensor_from_start: Doubles
    covariance: Doubles
    parent: int = -1  # key frame that it was registered to; -1 = the first of its part


def is_accepted(fit: SurfaceFit) -> bool:
    """Whether two membranes agree well enough to be of one place of the object."""
    return fit.overlap >= MIN_OVERLAP and fit.agreement >= MIN_AGREEMENT


@dataclass(slots=True)
class Tracker:
    """Registers frame after frame.

    `keys` are the key frames so far, `frames` all frames, mended since they came.
    """

    keys: list[KeyFrame] = field(default_factory=list)
    frames: list[TrackedFrame] = field(default_factory=list)
    # places in `frames`: newest key frame, what follows
    _following: list[tuple[int, MembraneSurface]] | None = None
    _part: int = -1
    _last: Doubles | None = None  # sensor_from_start of the last tracked frame of this part
    _velocity: Doubles = field(default_factory=lambda: np.eye(4))
    _n_lost: int = 0

    def add_frame(self, index: int, surface: MembraneSurface | None) -> TrackedFrame:
        """Register the next frame; one without a surface could not be read, and counts as lost."""
        frame = self._lose(index) if surface is None else self._place(index, surface)
        self.frames.append(frame)
        if surface is None or frame.sensor_from_start is None:
            return frame
        if self._following is not None and frame.key == len(self.keys) - 1:
            self._following.append((len(self.frames) - 1, surface))
            if len(self._following) == _MOST_AVERAGED:
                self.average_key()
        if frame.overlap < NEW_KEY_OVERLAP:
            self._start_key(surface, frame.key)
        self._last = self.frames[-1].sensor_from_start
        return self.frames[-1]

    def _place(self, index: int, surface: MembraneSurface) -> TrackedFrame:
        if not surface.is_touched:
            self._last = None
            self._n_lost = 0
            return TrackedFrame(index=index, state="no contact", part=max(self._part, 0))
        if self._last is None:
            return self._start_part(index, surface)
        found = self._register(surface)
        if found is None:
            lost = self._lose(index)
            return self._start_part(index, surface) if self._n_lost > GIVE_UP_AFTER else lost
        return self._accept(index, *found)

    def _lose(self, index: int) -> TrackedFrame:
        self._n_lost += 1
        self._velocity = np.eye(4)
        return TrackedFrame(index=index, state="lost", part=max(self._part, 0))

    def _start_part(self, index: int, surface: MembraneSurface) -> TrackedFrame:
        self.average_key()
        self._part = self._part + 1
        self._n_lost = 0
        self._following = [] if surface.error.rms_mm > _NOISY_MM else None
        self._last = np.eye(4)
        self._velocity = np.eye(4)
        key = KeyFrame(
            index=index,
            part=self._part,
            surface=surface,
            sensor_from_start=freeze(np.eye(4)),
            covariance=freeze(np.zeros((6, 6))),
        )
        self.keys.append(key)
        centre = surface.levels[-1].depth_mm
        return TrackedFrame(
            index=index,
            state="tracked",
            part=self._part,
            key=len(self.keys) - 1,
            overlap=1.0,
            agreement=1.0,
            sensor_from_start=key.sensor_from_start,
            covariance=key.covariance,
            centre_mm=freeze(np.array([0.0, 0.0, float(np.median(centre))])),
        )

    def _register(self, surface: MembraneSurface) -> tuple[int, SurfaceFit] | None:
        """The key frame that agrees with a surface, and the motion from it, near the predicted
        or the last pose.
        """
        assert self._last is not None
        for guess in (rigid.orthonormalise(self._velocity @ self._last), self._last):
            for number in self._rank_keys(guess):
                key = self.keys[number]
                start = guess @ rigid.invert(key.sensor_from_start)
                fit = register_surfaces(key.surface, surface, start)
                if fit is not None and is_accepted(fit):
                    return number, fit
        return None

    def _rank_keys(self, sensor_from_start: Doubles) -> list[int]:
        """The one or two key frames of this part that a pose overlaps most, best first."""
        own = [number for number, key in enumerate(self.keys) if key.part == self._part]
        overlap = {
            number: measure_overlap(
                self.keys[number].surface,
                sensor_from_start @ rigid.invert(self.keys[number].sensor_from_start),
            )
            for number in own
        }
        best = sorted(own, key=lambda number: -overlap[number])[:2]
        return [number for number in best if overlap[number] >= _PREDICTED_OVERLAP] or best[:1]

    def _accept(self, index: int, number: int, fit: SurfaceFit) -> TrackedFrame:
        assert self._last is not None
        key = self.keys[number]
        now = freeze(rigid.orthonormalise(fit.current_from_key @ key.sensor_from_start))
        # Nothing measures a motion along a weak direction: extrapolated, noise would become a
        # drift.
        is_known = not (self._n_lost or fit.weak_directions)
        step = now @ rigid.invert(self._last)
        self._velocity = (
            rigid.orthonormalise(self._velocity + _SMOOTHING * (step - self._velocity))
            if is_known
            else np.eye(4)
        )
        self._last = now
        self._n_lost = 0
        return TrackedFrame(
            index=index,
            state="tracked",
            part=self._part,
            key=number,
            sensor_from_start=now,
            covariance=freeze(key.covariance + fit.covariance),
            centre_mm=fit.centre_mm,
            weak_directions=fit.weak_directions,
            overlap=fit.overlap,
            agreement=fit.agreement,
        )

    def _start_key(self, surface: MembraneSurface, parent: int) -> None:
        """Make the last frame a key frame."""
        self.average_key()
        last = self.frames[-1]
        assert last.sensor_from_start is not None
        assert last.covariance is not None
        self.keys.append(
            KeyFrame(
                index=last.index,
                part=self._part,
                surface=surface,
                sensor_from_start=last.sensor_from_start,
                covariance=last.covariance,
                parent=parent,
            )
        )
        self._following = (
            [(len(self.frames) - 1, surface)] if surface.error.rms_mm > _NOISY_MM else None
        )

    def average_key(self) -> None:
        """Average the newest key frame and those that follow it, and register them to their mean.

        once.
        """
        following = self._following or []
        self._following = None
        if len(following) < _LEAST_AVERAGED:
            return
        key = self.keys[-1]
        surfaces = [surface for _, surface in following]
        key_from_start = rigid.invert(key.sensor_from_start)
        poses = [self.frames[place].sensor_from_start for place, _ in following]
        from_key = [pose @ key_from_start for pose in poses if pose is not None]
        mean = average_surfaces(key.surface, surfaces, from_key)
        fits = [
            register_surfaces(mean, surface, start, 1)
            for surface, start in zip(surfaces, from_key, strict=True)
        ]
        own = fits[0]
        if own is None or not is_accepted(own):
            return
        # The key frame's own pose stays: the mean's is where that frame finds it.
        start = rigid.orthonormalise(rigid.invert(own.current_from_key) @ key.sensor_from_start)
        covariance = key.covariance + own.covariance
        self.keys[-1] = replace(
            key, surface=mean, sensor_from_start=freeze(start), covariance=freeze(covariance)
        )
        for (place, _), fit in zip(following[1:], fits[1:], strict=True):
            if fit is not None and is_accepted(fit):
                self.frames[place] = replace(
                    self.frames[place],
                    sensor_from_start=freeze(rigid.orthonormalise(fit.current_from_key @ start)),
                    covariance=freeze(covariance + fit.covariance),
                    centre_mm=fit.centre_mm,
                )
