"""The checks of a recording: each gives pass, fail or unknown, and one sentence naming file and field."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, Image
from pipeline.base.errors import CalibrationError
from pipeline.geometry import rigid
from pipeline.physics.reference_colours import compare_colours
from pipeline.sensors.spec import SensorSpec
from pipeline.values.frames import Recording, TactileFrame, Truth

CheckState = Literal["pass", "fail", "unknown"]

_DEPTH_MM = (5.0, 1000.0)  # a depth camera looks at a membrane some centimetres away; metres would read 0.08
_MOVED_MM = 1.0  # beyond the noise of a bubble's depth
_PRESSED_IN = 0.5  # share of the moved pixels that must have come nearer
_NAN_LIMIT = 0.5  # share of pixels without a reading beyond which a depth frame is of no use
_WHITE, _BURNT_OUT = 254, 0.5  # grey level at which nothing is told apart, and the share of a picture that may be so
_ALIKE = 0.2  # likeness of colours below which nothing is said of them
_EDGE_SHARE = 0.01  # contact pixels at the very edge whose indentation is rounded to 0
_BULGE, _MOST_BULGING = 0.25, 0.25  # of the depth, of the contact: a gel bulges into what an object has hollow
_APART_MM = 2.0  # between what is touched and the box of what touches: more than any layer bridges
_FAR_MM = 500.0  # an object that is felt lies within this distance of the sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One question put to a recording."""

    name: str
    state: CheckState
    text: str  # one sentence, naming file and field when something is wrong


class StreamChecker:
    """Gathers what the checks of one stream need, frame by frame, without keeping the frames."""

    def __init__(self, stream: str, path: str, spec: SensorSpec | None) -> None:
        """A tally for `stream` of the recording at `path`, whose sensor is `spec` if known."""
        self._stream, self._path, self._spec = stream, path, spec
        self._bad: defaultdict[str, list[str]] = defaultdict(list)  # check -> what is wrong
        self._without_reference: list[int] = []
        self._odd_sizes: list[int] = []
        self._depths_mm: list[float] = []
        self._gaps: list[int] = []
        self._n_frames, self._n_gaps, self._n_pixels, self._n_nearer, self._n_moved = 0, 0, 0, 0, 0
        self._reference: TactileFrame | None = None
        self._n_truth, self._n_poses = 0, 0

    def add_problem(self, text: str) -> None:
        """A frame that cannot be read, in the reader's words."""
        self._bad["frames"].append(text)

    def add_frame(self, frame: TactileFrame) -> None:
        """Count one frame."""
        self._n_frames += 1
        if frame.reference is None:
            self._without_reference.append(frame.index)
        elif self._reference is None:
            self._reference = frame
        want = frame.camera.shape if frame.camera is not None else (self._spec.camera.shape if self._spec else None)
        if want is not None and frame.image.shape[:2] != want:
            self._odd_sizes.append(frame.index)
        kind = np.dtype(np.float32 if frame.is_depth else np.uint8)
        if frame.image.dtype != kind:
            self._bad["types"].append(f"frame {frame.index} holds {frame.image.dtype}, it must be {kind}")
        blank = _blank(frame.image)
        if blank:
            self._bad["pictures"].append(f"frame {frame.index} {blank}")
        if frame.is_depth:
            self._depth(frame)

    def _depth(self, frame: TactileFrame) -> None:
        seen = np.isfinite(frame.image)
        self._n_pixels += seen.size
        self._n_gaps += int(seen.size - seen.sum())
        if seen.mean() < 1.0 - _NAN_LIMIT:
            self._gaps.append(frame.index)
        if seen.any():
            self._depths_mm.append(float(np.median(frame.image[seen])))
        if frame.reference is not None and frame.reference.shape == frame.image.shape:
            pressed = np.nan_to_num(frame.reference - frame.image)  # no reading has not moved
            self._n_nearer += int((pressed > _MOVED_MM).sum())
            self._n_moved += int((np.abs(pressed) > _MOVED_MM).sum())

    def add_truth(self, index: int, truth: Truth) -> None:
        """Check what is said to be true of frame `index`."""
        if truth.sensor_from_object is not None:
            self._n_poses += 1
            self._pose(index, truth.sensor_from_object)
        if truth.indentation_mm is None:
            return
        self._n_truth += 1
        pressed, limit = truth.indentation_mm, self._spec.limits.indentation_max_mm if self._spec else math.inf
        if not np.isfinite(pressed).any():
            self._bad["truth"].append(f"indentation_mm of frame {index} has no value")
            return
        deepest = float(np.nanmax(pressed))
        if deepest > 2 * limit:
            self._bad["truth"].append(
                f"indentation_mm of frame {index} reaches {deepest:.3g} mm, the limit is {limit:g} mm"
            )
        if truth.contact is None:
            return
        bulging = (pressed < 0) & (pressed > -_BULGE * deepest)
        odd, bulges = truth.contact & ~(pressed > 0) & ~bulging, truth.contact & bulging
        n_touched = int(truth.contact.sum())
        if odd.sum() > _EDGE_SHARE * n_touched or bulges.sum() > _MOST_BULGING * n_touched:
            self._bad["truth"].append(f"contact of frame {index} holds pixels whose indentation_mm is not positive")

    def _pose(self, index: int, sensor_from_object: Doubles) -> None:
        try:
            pose = rigid.validate_rigid(sensor_from_object, f"sensor_from_object of frame {index}")
        except CalibrationError as error:
            self._bad["poses"].append(str(error))
            return
        far = float(np.linalg.norm(pose[:3, 3]))
        if far > _FAR_MM:
            self._bad["poses"].append(f"sensor_from_object of frame {index} puts the object {far:.3g} mm away")

    def add_contact_offset(self, index: int, far_mm: float) -> None:
        """Note how far from its contact the object of frame `index` is said to lie."""
        if far_mm > _APART_MM:
            self._bad["poses"].append(
                f"sensor_from_object of frame {index} puts the object {far_mm:.3g} mm beside its own contact; "
                "is it in metres, or of another sensor?"
            )

    def summarize_checks(self, times_s: Sequence[float]) -> list[Check]:
        """The answers, once all frames have been counted."""
        found = [
            self._check("frames", self._bad["frames"] or self._none(), "every frame can be read"),
            self._sizes(),
            self._references(),
        ]
        found.append(self._check("types", self._bad["types"], "every reading is of its type"))
        found.append(self._check("pictures", self._bad["pictures"], "none is blank, burnt out or without a value"))
        if self._depths_mm or self._gaps:
            found += [self._depth_unit(), self._depth_sign(), self._readings()]
        elif self._n_frames:
            found.append(self._colours())
        found.append(self._times(times_s))
        if self._n_truth:
            found.append(
                self._check("truth", self._bad["truth"], "contact lies within the indentation, depths within limits")
            )
        if self._n_poses:
            found.append(self._check("poses", self._bad["poses"], "every rotation has determinant +1 and mm fit"))
        return found

    def _check(self, name: str, bad: Sequence[str], good: str) -> Check:
        if not bad:
            return self._said(name, "pass", good)
        more = f" (and {len(bad) - 1} more)" if len(bad) > 1 else ""
        return self._said(name, "fail", f"{bad[0]}{more}")

    def _said(self, name: str, state: CheckState, text: str) -> Check:
        if state == "fail" and self._path not in text:
            text = f"{text}: '{self._path}'"
        return Check(name=f"{self._stream} {name}", state=state, text=text)

    def _none(self) -> list[str]:
        return [] if self._n_frames else ["there is no frame"]

    def _sizes(self) -> Check:
        if self._spec is None:
            return self._said("image size", "unknown", "the sensor is not known, so its image size is not either")
        shape = self._spec.camera.shape
        bad = [f"frame {i} does not have the size of {self._spec.name}, {shape[1]} x {shape[0]} px"
               for i in self._odd_sizes]  # fmt: skip
        return self._check("image size", bad, "as the sensor's camera")

    def _references(self) -> Check:
        if len(self._without_reference) == self._n_frames:
            return self._said("reference", "unknown", "no untouched reading; name one with --reference")
        bad = [f"frame {i} has no reference, others do" for i in self._without_reference]
        return self._check("reference", bad, "every frame has an untouched reading")

    def _depth_unit(self) -> Check:
        odd = [d for d in self._depths_mm if not _DEPTH_MM[0] <= d <= _DEPTH_MM[1]]
        bad = [f"frames has a median depth of {d:.3g} mm; is it in another unit?" for d in odd]
        return self._check("depth unit", bad, f"median depth {np.median(self._depths_mm or [np.nan]):.1f} mm fits mm")

    def _depth_sign(self) -> Check:
        if not self._n_moved:
            return self._said(
                "depth sign", "unknown", f"nothing moves by more than {_MOVED_MM:g} mm from the reference"
            )
        share = self._n_nearer / self._n_moved
        text = f"{share:.0%} of what moves comes nearer to the camera"
        if share < _PRESSED_IN:
            return self._said(
                "depth sign",
                "fail",
                f"frames: only {text}; a touch should; is the depth's sign flipped, or was the reference touched?",
            )
        return self._said("depth sign", "pass", text)

    def _readings(self) -> Check:
        bad = [f"frame {i} has no reading in more than half of its pixels" for i in self._gaps]
        share = self._n_gaps / max(1, self._n_pixels)
        return self._check("readings", bad, f"{share:.1%} of the pixels have no reading (NaN)")

    def _times(self, times_s: Sequence[float]) -> Check:
        known = np.asarray([t for t in times_s if math.isfinite(t)])
        if len(known) < 2:
            return self._said("times", "unknown", "no times are recorded")
        back = np.nonzero(np.diff(known) <= 0)[0]
        return self._check("times", [f"timestamps do not rise after frame {i}" for i in back], "timestamps rise")

    def _colours(self) -> Check:
        """Whether the untouched picture looks like the sensor's, or more so once it is changed."""
        frame, spec = self._reference, self._spec
        if frame is None or frame.reference is None or spec is None or spec.optics is None:
            return self._said("colours", "unknown", "needs an untouched picture and a sensor with described lights")
        if frame.reference.shape != (*spec.camera.shape, 3) or frame.reference.dtype != np.uint8:
            return self._said("colours", "unknown", "the picture does not have the sensor's size")
        found = compare_colours(cast("Image", frame.reference), spec)
        lie = f"its colours lie as those of an untouched {spec.name} by {found.similarity:.2f}"
        text = f"{lie} (1 = the same, 0 = unrelated)"
        if found.problem:
            so = "" if math.isnan(found.corrected_similarity) else f", so changed by {found.corrected_similarity:.2f}"
            return self._said("colours", "fail", f"the reference: {found.problem}; {text}{so}")
        return self._said("colours", "pass" if found.similarity > _ALIKE else "unknown", text)


def check_pairings(recording: Recording) -> list[Check]:
    """Whether every known transform between two streams is rigid and names streams that exist."""
    names, found = {s.name for s in recording.streams}, list[Check]()
    for pair in recording.pairings:
        name = f"{pair.source} to {pair.target}"
        missing, bad = {pair.source, pair.target} - names, ""
        try:
            rigid.validate_rigid(pair.target_from_source, f"target_from_source of {name}")
        except CalibrationError as error:
            bad = str(error)
        if missing and not bad:
            bad = f"target_from_source names {', '.join(sorted(missing))}, which is no stream"
        text = f"{bad}: '{recording.path}'" if bad else "rotation has determinant +1"
        found.append(Check(name=name, state="fail" if bad else "pass", text=text))
    return found


def _blank(image: NDArray[np.number]) -> str:
    """What makes a reading show nothing, "" where it shows something."""
    known = image[np.isfinite(image)]
    if not known.size:
        return "has no value at all"
    if known.size == image.size and known.min() == known.max():
        return f"is {known.flat[0]:g} everywhere"
    if image.ndim == 3:
        white = float((image.min(axis=2) >= _WHITE).mean())
        if white > _BURNT_OUT:
            return f"is burnt out: {white:.0%} of it is white"
    return ""
