"""Checks of a recording's streams: each gives pass, fail or unknown, and a sentence that names
file and field.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Image
from pipeline.core.errors import CalibrationError
from pipeline.core.geometry import rigid
from pipeline.core.values.frames import Recording, TactileFrame, Truth
from pipeline.core.values.pairing import compute_interval_s
from pipeline.physics.reference_colours import compare_colours
from pipeline.sensors.depth_unit import describe_unit_problem
from pipeline.sensors.spec import SensorSpec

CheckState = Literal["pass", "fail", "unknown"]

# range of a median depth: the camera is some centimetres from the membrane
_DEPTH_MM = (5.0, 1000.0)
# interval, longer than of any film; rates of cameras
_LONGEST_S = 10.0
_CAMERA_HZ = (1.0, 1000.0)
_MAX_JITTER = 0.2  # of the intervals of a camera, relative; a robot's presses vary more
_TIME_UNITS = {"ms": 1e3, "µs": 1e6, "ns": 1e9}  # units of a second
_MIN_MOTION_MM = 1.0  # change of depth beyond the noise of a bubble
_MIN_NEARER_SHARE = 0.5  # of the moved pixels that must come nearer
_MAX_GAP_SHARE = 0.5  # of the pixels of a usable depth frame
# grey level of a saturated pixel; allowed share of them
_WHITE = 254
_MAX_WHITE_SHARE = 0.5
_MIN_SIMILARITY = 0.2  # of colours; below it the check is unknown
_MAX_EDGE_SHARE = 0.01  # of the contact pixels, at its edge, whose indentation is rounded to 0
# of the depth, of the contact: a gel bulges into hollows of an object
_MAX_BULGE = 0.25
_MAX_BULGE_SHARE = 0.25
_MAX_OFFSET_MM = 2.0  # between contact and bounding box of the object
_MAX_OBJECT_MM = 500.0  # distance of a touching object from the sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """Result of one check of a recording."""

    name: str
    state: CheckState
    text: str  # one sentence; names file and field of a failure


class StreamChecker:
    """Collects the figures for the checks of one stream, frame by frame."""

    def __init__(self, stream: str, path: str, spec: SensorSpec | None) -> None:
        """Check `stream` of the recording at `path`; `spec` is its sensor, None if not known."""
        self._stream = stream
        self._path = path
        self._spec = spec
        self._problems: defaultdict[str, list[str]] = defaultdict(list)  # check -> sentences
        self._without_reference: list[int] = []
        self._wrong_sizes: list[int] = []
        self._depths_mm: list[float] = []
        self._sparse_frames: list[int] = []
        self._n_frames = 0
        self._n_gaps = 0
        self._n_pixels = 0
        self._n_nearer = 0
        self._n_moved = 0
        self._reference: TactileFrame | None = None
        self._n_truth = 0
        self._n_poses = 0

    def add_problem(self, text: str) -> None:
        """Add the error of a frame that cannot be read."""
        self._problems["frames"].append(text)

    def add_frame(self, frame: TactileFrame) -> None:
        """Add one frame."""
        self._n_frames += 1
        if frame.reference is None:
            self._without_reference.append(frame.index)
        elif self._reference is None:
            self._reference = frame
        want = (
            frame.camera.shape
            if frame.camera is not None
            else (self._spec.camera.shape if self._spec else None)
        )
        if want is not None and frame.image.shape[:2] != want:
            self._wrong_sizes.append(frame.index)
        dtype = np.dtype(np.float32 if frame.is_depth else np.uint8)
        if frame.image.dtype != dtype:
            self._problems["types"].append(
                f"frame {frame.index} holds {frame.image.dtype}, it must be {dtype}"
            )
        problem = _find_image_problem(frame.image)
        if problem:
            self._problems["images"].append(f"frame {frame.index} {problem}")
        if frame.is_depth:
            self._add_depth(frame)

    def _add_depth(self, frame: TactileFrame) -> None:
        known = np.isfinite(frame.image)
        self._n_pixels += known.size
        self._n_gaps += int(known.size - known.sum())
        if known.mean() < 1.0 - _MAX_GAP_SHARE:
            self._sparse_frames.append(frame.index)
        if known.any():
            self._depths_mm.append(float(np.median(frame.image[known])))
        if frame.reference is not None and frame.reference.shape == frame.image.shape:
            # pixels without a value have not moved
            indentation = np.nan_to_num(frame.reference - frame.image)
            self._n_nearer += int((indentation > _MIN_MOTION_MM).sum())
            self._n_moved += int((np.abs(indentation) > _MIN_MOTION_MM).sum())

    def add_truth(self, index: int, truth: Truth) -> None:
        """Add the truth of frame `index`."""
        if truth.sensor_from_object is not None:
            self._n_poses += 1
            self._add_pose(index, truth.sensor_from_object)
        if truth.indentation_mm is None:
            return
        self._n_truth += 1
        indentation = truth.indentation_mm
        limit = self._spec.limits.indentation_max_mm if self._spec else math.inf
        if not np.isfinite(indentation).any():
            self._problems["truth"].append(f"indentation_mm of frame {index} has no value")
            return
        deepest = float(np.nanmax(indentation))
        if deepest > 2 * limit:
            self._problems["truth"].append(
                f"indentation_mm of frame {index} reaches {deepest:.3g} mm, the limit is "
                f"{limit:g} mm"
            )
        if truth.contact is None:
            return
        is_bulge = (indentation < 0) & (indentation > -_MAX_BULGE * deepest)
        n_wrong = int((truth.contact & ~(indentation > 0) & ~is_bulge).sum())
        n_bulges = int((truth.contact & is_bulge).sum())
        n_contact = int(truth.contact.sum())
        if n_wrong > _MAX_EDGE_SHARE * n_contact or n_bulges > _MAX_BULGE_SHARE * n_contact:
            self._problems["truth"].append(
                f"contact of frame {index} holds pixels whose indentation_mm is not positive"
            )

    def _add_pose(self, index: int, sensor_from_object: Doubles) -> None:
        try:
            pose = rigid.validate_rigid(sensor_from_object, f"sensor_from_object of frame {index}")
        except CalibrationError as error:
            self._problems["poses"].append(str(error))
            return
        distance_mm = float(np.linalg.norm(pose[:3, 3]))
        if distance_mm > _MAX_OBJECT_MM:
            self._problems["poses"].append(
                f"sensor_from_object of frame {index} puts the object {distance_mm:.3g} mm away"
            )

    def add_contact_offset(self, index: int, offset_mm: float) -> None:
        """Add the distance of the object from its contact in frame `index`."""
        if offset_mm > _MAX_OFFSET_MM:
            self._problems["poses"].append(
                f"sensor_from_object of frame {index} puts the object {offset_mm:.3g} mm from its "
                "contact; "
                "check whether it is in metres or of another sensor"
            )

    def summarize_checks(self, times_s: Sequence[float]) -> list[Check]:
        """The checks, after all frames have been added."""
        no_frames = [] if self._n_frames else ["there is no frame"]
        checks = [
            self._check("frames", self._problems["frames"] or no_frames, "every frame can be read"),
            self._check_sizes(),
            self._check_references(),
        ]
        checks.append(
            self._check("types", self._problems["types"], "every frame has the right type")
        )
        checks.append(
            self._check(
                "images",
                self._problems["images"],
                "no image is uniform, saturated or without a value",
            )
        )
        if self._depths_mm or self._sparse_frames:
            checks += [self._check_depth_unit(), self._check_depth_sign(), self._check_gaps()]
        elif self._n_frames:
            checks.append(self._check_colours())
        checks.append(self._check_times(times_s))
        if self._n_truth:
            checks.append(
                self._check(
                    "truth",
                    self._problems["truth"],
                    "contact lies within the indentation, indentation within limits",
                )
            )
        if self._n_poses:
            checks.append(
                self._check(
                    "poses",
                    self._problems["poses"],
                    "every rotation has determinant +1 and distances fit mm",
                )
            )
        return checks

    def _check(self, name: str, problems: Sequence[str], success: str) -> Check:
        if not problems:
            return self._make_check(name, "pass", success)
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        return self._make_check(name, "fail", f"{problems[0]}{more}")

    def _make_check(self, name: str, state: CheckState, text: str) -> Check:
        if state == "fail" and self._path not in text:
            text = f"{text}: '{self._path}'"
        return Check(name=f"{self._stream} {name}", state=state, text=text)

    def _check_sizes(self) -> Check:
        if self._spec is None:
            return self._make_check("image size", "unknown", "the sensor is not known")
        shape = self._spec.camera.shape
        bad = [
            f"frame {i} does not have the size of {self._spec.name}, {shape[1]} x {shape[0]} px"
            for i in self._wrong_sizes
        ]
        return self._check("image size", bad, "as the sensor's camera")

    def _check_references(self) -> Check:
        if len(self._without_reference) == self._n_frames:
            return self._make_check(
                "reference",
                "unknown",
                "no reference; name one with --reference, or make one with --reference-frames",
            )
        bad = [f"frame {i} has no reference, others do" for i in self._without_reference]
        return self._check("reference", bad, "every frame has a reference")

    def _check_depth_unit(self) -> Check:
        median_mm = float(np.median(self._depths_mm or [np.nan]))
        wrong = [d for d in self._depths_mm if not _DEPTH_MM[0] <= d <= _DEPTH_MM[1]]
        bad = [f"frames has a median depth of {d:.3g} mm; check the unit" for d in wrong]
        if self._spec is None:
            return self._check("depth unit", bad, f"median depth {median_mm:.1f} mm fits mm")
        reference = None if self._reference is None else self._reference.reference
        medians_mm = {"frames": median_mm}
        if reference is not None and np.isfinite(reference).any():
            medians_mm["the reference"] = float(np.nanmedian(reference))
        problems = {
            what: describe_unit_problem(depth_mm, self._spec)
            for what, depth_mm in medians_mm.items()
        }
        bad = [f"{what} {problem}" for what, problem in problems.items() if problem] or bad
        rest_mm = float(np.median(self._spec.rest_depth_mm))
        return self._check(
            "depth unit",
            bad,
            f"median depth {median_mm:.1f} mm fits the {rest_mm:.1f} mm at which "
            f"{self._spec.name} rests",
        )

    def _check_depth_sign(self) -> Check:
        if not self._n_moved:
            return self._make_check(
                "depth sign",
                "unknown",
                f"no pixel moves by more than {_MIN_MOTION_MM:g} mm from the reference",
            )
        share = self._n_nearer / self._n_moved
        text = f"{share:.0%} of the moving pixels come nearer to the camera"
        if share < _MIN_NEARER_SHARE:
            return self._make_check(
                "depth sign",
                "fail",
                f"frames: only {text}, as by a flipped sign or a touch in the reference; check "
                "both",
            )
        return self._make_check("depth sign", "pass", text)

    def _check_gaps(self) -> Check:
        bad = [
            f"frame {i} has no value in more than half of its pixels" for i in self._sparse_frames
        ]
        share = self._n_gaps / max(1, self._n_pixels)
        return self._check("gaps", bad, f"{share:.1%} of the pixels have no value (NaN)")

    def _check_times(self, times_s: Sequence[float]) -> Check:
        known = np.asarray([t for t in times_s if math.isfinite(t)])
        if len(known) < 2:
            return self._make_check("times", "unknown", "no times are recorded")
        interval_s = compute_interval_s(known)
        units = [
            u for u, n in _TIME_UNITS.items() if _CAMERA_HZ[0] <= n / interval_s <= _CAMERA_HZ[1]
        ]
        if interval_s > _LONGEST_S and units:
            n = _TIME_UNITS[units[0]]
            # as a camera is
            is_regular = np.median(np.abs(np.diff(known) - interval_s)) < _MAX_JITTER * interval_s
            return self._make_check(
                "times",
                "fail" if is_regular else "unknown",
                f"timestamps give {1.0 / interval_s:.3g} Hz, and {n / interval_s:.3g} Hz if they "
                f"are in {units[0]}: "
                f"then divide them by {n:,.0f}",
            )
        back = np.nonzero(np.diff(known) <= 0)[0]
        return self._check(
            "times", [f"timestamps do not rise after frame {i}" for i in back], "timestamps rise"
        )

    def _check_colours(self) -> Check:
        """Compare the colours of the reference with those of the description, also mirrored or
        channel-swapped.
        """
        frame = self._reference
        spec = self._spec
        if frame is None or frame.reference is None or spec is None or spec.optics is None:
            return self._make_check(
                "colours", "unknown", "needs a reference image and a sensor with described LEDs"
            )
        if frame.reference.shape != (*spec.camera.shape, 3) or frame.reference.dtype != np.uint8:
            return self._make_check(
                "colours", "unknown", "the reference does not have the sensor's size"
            )
        comparison = compare_colours(cast("Image", frame.reference), spec)
        text = (
            f"colours match a {spec.name} reference by {comparison.similarity:.2f} (1 = "
            "equal, 0 = unrelated)"
        )
        if comparison.problem:
            corrected = comparison.corrected_similarity
            so = "" if math.isnan(corrected) else f", {corrected:.2f} after this correction"
            return self._make_check(
                "colours", "fail", f"the reference: {comparison.problem}; {text}{so}"
            )
        return self._make_check(
            "colours", "pass" if comparison.similarity > _MIN_SIMILARITY else "unknown", text
        )


def check_pairings(recording: Recording) -> list[Check]:
    """Checks that every known transform between two streams is rigid and names existing streams."""
    names = {s.name for s in recording.streams}
    checks = list[Check]()
    for pair in recording.pairings:
        name = f"{pair.source} to {pair.target}"
        missing = {pair.source, pair.target} - names
        problem = ""
        try:
            rigid.validate_rigid(pair.target_from_source, f"target_from_source of {name}")
        except CalibrationError as error:
            problem = str(error)
        if missing and not problem:
            problem = f"target_from_source names {', '.join(sorted(missing))}, which is no stream"
        text = f"{problem}: '{recording.path}'" if problem else "rotation has determinant +1"
        checks.append(Check(name=name, state="fail" if problem else "pass", text=text))
    return checks


def _find_image_problem(image: NDArray[np.number]) -> str:
    """Why an image shows nothing, as a clause; "" where it does."""
    known = image[np.isfinite(image)]
    if not known.size:
        return "has no value at all"
    if known.size == image.size and known.min() == known.max():
        return f"is {known.flat[0]:g} everywhere"
    if image.ndim == 3:
        white = float((image.min(axis=2) >= _WHITE).mean())
        if white > _MAX_WHITE_SHARE:
            return f"is saturated: {white:.0%} of it is white"
    return ""
