"""Checks of a recording's streams: each gives pass, fail or unknown, and a sentence that names
file and field.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Image, describe_size
from pipeline.core.errors import CalibrationError
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.values.frames import Recording, TactileFrame, Truth
from pipeline.core.values.pairing import compute_interval_s
from pipeline.physics.reference_colours import compare_colours
from pipeline.sensors.spec import SensorSpec, describe_unit_problem

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


@frozen
class Check:
    """Result of one check of a recording."""

    name: str
    state: CheckState
    text: str  # one sentence; names file and field of a failure


class StreamChecker:
    """Collects the problems of one stream by check, frame by frame."""

    def __init__(self, stream: str, path: str, spec: SensorSpec | None) -> None:
        """Check `stream` of the recording at `path`; `spec` is its sensor, None if not known."""
        self._stream = stream
        self._path = path
        self._spec = spec
        self._problems: defaultdict[str, list[str]] = defaultdict(list)  # check -> sentences
        self._counts = Counter[str]()
        self._depths_mm: list[float] = []
        self._reference: TactileFrame | None = None

    def add_problem(self, text: str, check: str = "frames") -> None:
        """Add a sentence to a check, of a frame that cannot be read unless another is named."""
        self._problems[check].append(text)

    def add_frame(self, frame: TactileFrame) -> None:
        """Add one frame."""
        name = f"frame {frame.index}"
        self._counts["frames"] += 1
        if frame.reference is None:
            self.add_problem(f"{name} has no reference, others do", "reference")
        elif self._reference is None:
            self._reference = frame
        if self._spec is not None:
            shape = (frame.camera or self._spec.camera).shape
            if frame.image.shape[:2] != shape:
                want = f"the size of {self._spec.name}, {describe_size(shape)}"
                self.add_problem(f"{name} does not have {want}", "image size")
        dtype = np.dtype(np.float32 if frame.is_depth else np.uint8)
        if frame.image.dtype != dtype:
            self.add_problem(f"{name} holds {frame.image.dtype}, it must be {dtype}", "types")
        problem = _find_image_problem(frame.image)
        if problem:
            self.add_problem(f"{name} {problem}", "images")
        if frame.is_depth:
            self._add_depth(frame, name)

    def _add_depth(self, frame: TactileFrame, name: str) -> None:
        known = np.isfinite(frame.image)
        self._counts.update(pixels=known.size, gaps=int((~known).sum()))
        if known.mean() < 1.0 - _MAX_GAP_SHARE:
            self.add_problem(f"{name} has no value in more than half of its pixels", "gaps")
        if known.any():
            self._depths_mm.append(float(np.median(frame.image[known])))
        if frame.reference is not None and frame.reference.shape == frame.image.shape:
            # pixels without a value have not moved
            indentation = np.nan_to_num(frame.reference - frame.image)
            self._counts.update(
                nearer=int((indentation > _MIN_MOTION_MM).sum()),
                moved=int((np.abs(indentation) > _MIN_MOTION_MM).sum()),
            )

    def add_truth(self, index: int, truth: Truth) -> None:
        """Add the truth of frame `index`."""
        if truth.sensor_from_object is not None:
            self._counts["poses"] += 1
            self._add_pose(index, truth.sensor_from_object)
        indentation = truth.indentation_mm
        if indentation is None:
            return
        self._counts["truth"] += 1
        if not np.isfinite(indentation).any():
            self.add_problem(f"indentation_mm of frame {index} has no value", "truth")
            return
        limit = self._spec.limits.indentation_max_mm if self._spec else math.inf
        deepest = float(np.nanmax(indentation))
        if deepest > 2 * limit:
            self.add_problem(
                f"indentation_mm of frame {index} reaches {deepest:.3g} mm, the limit is "
                f"{limit:g} mm",
                "truth",
            )
        if truth.contact is None:
            return
        is_bulge = (indentation < 0) & (indentation > -_MAX_BULGE * deepest)
        is_wrong = ~(indentation > 0) & ~is_bulge
        n_contact = int(truth.contact.sum())
        if (
            int((truth.contact & is_wrong).sum()) > _MAX_EDGE_SHARE * n_contact
            or int((truth.contact & is_bulge).sum()) > _MAX_BULGE_SHARE * n_contact
        ):
            self.add_problem(
                f"contact of frame {index} holds pixels whose indentation_mm is not positive",
                "truth",
            )

    def _add_pose(self, index: int, sensor_from_object: Doubles) -> None:
        name = f"sensor_from_object of frame {index}"
        try:
            pose = rigid.validate_rigid(sensor_from_object, name)
        except CalibrationError as error:
            self.add_problem(str(error), "poses")
            return
        distance_mm = float(np.linalg.norm(pose[:3, 3]))
        if distance_mm > _MAX_OBJECT_MM:
            self.add_problem(f"{name} puts the object {distance_mm:.3g} mm away", "poses")

    def add_contact_offset(self, index: int, offset_mm: float) -> None:
        """Add the distance of the object from its contact in frame `index`."""
        if offset_mm > _MAX_OFFSET_MM:
            self.add_problem(
                f"sensor_from_object of frame {index} puts the object {offset_mm:.3g} mm from its "
                "contact; check whether it is in metres or of another sensor",
                "poses",
            )

    def summarize_checks(self, times_s: Sequence[float]) -> list[Check]:
        """The checks, after all frames have been added."""
        n = self._counts
        if not n["frames"]:
            self.add_problem("there is no frame")
        without = ""
        if len(self._problems["reference"]) == n["frames"]:
            without = "no reference; name one with --reference, or make one with --reference-frames"
        unknown = "" if self._spec else "the sensor is not known"
        checks = [
            self._check("frames", "every frame can be read"),
            self._check("image size", "as the sensor's camera", unknown),
            self._check("reference", "every frame has a reference", without),
            self._check("types", "every frame has the right type"),
            self._check("images", "no image is uniform, saturated or without a value"),
        ]
        if self._depths_mm or self._problems["gaps"]:
            share = n["gaps"] / max(1, n["pixels"])
            checks += [
                self._check_depth_unit(),
                self._check_depth_sign(),
                self._check("gaps", f"{share:.1%} of the pixels have no value (NaN)"),
            ]
        elif n["frames"]:
            checks.append(self._check_colours())
        checks.append(self._check_times(times_s))
        if n["truth"]:
            good = "contact lies within the indentation, indentation within limits"
            checks.append(self._check("truth", good))
        if n["poses"]:
            good = "every rotation has determinant +1 and distances fit mm"
            checks.append(self._check("poses", good))
        return checks

    def _check(self, name: str, success: str, unknown: str = "") -> Check:
        """The check of the problems under a name; `unknown` says why it cannot be made."""
        problems = self._problems[name]
        if unknown or not problems:
            return self._make_check(name, "unknown" if unknown else "pass", unknown or success)
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        return self._make_check(name, "fail", f"{problems[0]}{more}")

    def _make_check(self, name: str, state: CheckState, text: str) -> Check:
        if state == "fail" and self._path not in text:
            text = f"{text}: '{self._path}'"
        return Check(name=f"{self._stream} {name}", state=state, text=text)

    def _check_depth_unit(self) -> Check:
        median_mm = float(np.median(self._depths_mm or [np.nan]))
        fits = f"median depth {median_mm:.1f} mm fits"
        success = f"{fits} mm"
        if self._spec is not None:
            rest_mm = float(np.median(self._spec.rest_depth_mm))
            success = f"{fits} the {rest_mm:.1f} mm at which {self._spec.name} rests"
            medians_mm = {"frames": median_mm}
            reference = None if self._reference is None else self._reference.reference
            if reference is not None and np.isfinite(reference).any():
                medians_mm["the reference"] = float(np.nanmedian(reference))
            for what, depth_mm in medians_mm.items():
                problem = describe_unit_problem(depth_mm, self._spec)
                if problem:
                    self.add_problem(f"{what} {problem}", "depth unit")
        if not self._problems["depth unit"]:
            self._problems["depth unit"] = [
                f"frames has a median depth of {depth_mm:.3g} mm; check the unit"
                for depth_mm in self._depths_mm
                if not _DEPTH_MM[0] <= depth_mm <= _DEPTH_MM[1]
            ]
        return self._check("depth unit", success)

    def _check_depth_sign(self) -> Check:
        n_moved = self._counts["moved"]
        unknown = ""
        if not n_moved:
            unknown = f"no pixel moves by more than {_MIN_MOTION_MM:g} mm from the reference"
        share = self._counts["nearer"] / max(1, n_moved)
        text = f"{share:.0%} of the moving pixels come nearer to the camera"
        if share < _MIN_NEARER_SHARE:
            self.add_problem(
                f"frames: only {text}, as by a flipped sign or a touch in the reference; check "
                "both",
                "depth sign",
            )
        return self._check("depth sign", text, unknown)

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
                f"are in {units[0]}: then divide them by {n:,.0f}",
            )
        for i in np.flatnonzero(np.diff(known) <= 0):
            self.add_problem(f"timestamps do not rise after frame {i}", "times")
        return self._check("times", "timestamps rise")

    def _check_colours(self) -> Check:
        """Compare the colours of the reference with those of the description, also mirrored or
        channel-swapped.
        """
        spec = self._spec
        reference = None if self._reference is None else self._reference.reference
        if reference is None or spec is None or spec.optics is None:
            return self._make_check(
                "colours", "unknown", "needs a reference image and a sensor with described LEDs"
            )
        if reference.shape != (*spec.camera.shape, 3) or reference.dtype != np.uint8:
            return self._make_check(
                "colours", "unknown", "the reference does not have the sensor's size"
            )
        comparison = compare_colours(cast("Image", reference), spec)
        text = (
            f"colours match a {spec.name} reference by {comparison.similarity:.2f} (1 = "
            "equal, 0 = unrelated)"
        )
        if comparison.problem:
            corrected = comparison.corrected_similarity
            so = "" if math.isnan(corrected) else f", {corrected:.2f} after this correction"
            self.add_problem(f"the reference: {comparison.problem}; {text}{so}", "colours")
        elif comparison.similarity <= _MIN_SIMILARITY:
            return self._make_check("colours", "unknown", text)
        return self._check("colours", text)


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
