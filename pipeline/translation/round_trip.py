"""What ranks frames without ground truth, of real recordings and of live sensors: round trip,
distance from training.

Round trip: the generated touch is translated back to the source, and compared with the depth it was
made from. The error is small where both directions keep the shape of the contact; it cannot see
what the way back undoes, as of the alignment.

Distance from training: a touch is described by a few numbers of the contact that the network is
given, and compared with the nearest training touch, each number in units of its standard deviation
over training. Divided by the distance that 95 % of the training touches are within of their own
nearest neighbour, it says beyond 1 that a touch is unlike what the network has learned from.
"""

import math
from dataclasses import replace

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.core.files import read_arrays
from pipeline.core.geometry import rigid
from pipeline.core.graph import StageResults
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, GeneratedTouch, TargetDepth
from pipeline.physics.sensor_images import render_reference
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.metrics.stage_metrics import ROUND_TRIP, TRAINING_DISTANCE, compute_mae_mm
from pipeline.stages.networks.weights_registry import WEIGHTS_FOLDER
from pipeline.translation.translate import Translation, load_nothing

_BACK = "touch_depth"  # stage whose value on the way back is compared


def measure_training_distance(results: StageResults, translation: Translation) -> dict[str, float]:
    """Return the distance of a touch from training as a metric of its frame.

    {} where it is unknown.
    """
    observed = results["target_depth"].output if "target_depth" in results else None
    if not isinstance(observed, TargetDepth):
        return {}
    distance = compute_training_distance(observed, translation.target)
    return {TRAINING_DISTANCE: distance} if np.isfinite(distance) else {}


def measure_round_trip(
    results: StageResults, translation: Translation, progress: Progress = SILENT
) -> dict[str, float]:
    """Return the round-trip error of a frame's results as a metric.

    {} without contact or on a route without depth.

    Compared are the pixels in contact that the target could see. The way back takes the methods and
    parameters of the way there, without the files that were given for one direction. Raises
    TouchError as the stages do.
    """
    depth, touch = (
        results[name].output if name in results else None for name in ("depth", "touch")
    )
    if (
        not isinstance(depth, DepthMap)
        or not isinstance(touch, GeneratedTouch)
        or _BACK not in translation.stages
    ):
        return {}
    if not depth.contact.any():
        return {}
    back = reverse_translation(translation, depth)
    reference = render_reference(back.source) if touch.reference is None else touch.reference
    frame = TactileFrame(
        sensor=back.source.name,
        image=touch.image,
        reference=reference,
        camera=touch.camera,
        origin="generated touch",
    )
    returned = back.evaluate(frame, [_BACK, "target_depth"], progress)
    membrane = returned[_BACK].output
    view = returned["target_depth"].output
    if membrane.indentation_mm.shape != depth.indentation_mm.shape:
        return {}
    error_mm = compute_mae_mm(
        membrane.indentation_mm, depth.indentation_mm, depth.contact & view.in_view
    )
    return {ROUND_TRIP: error_mm} if np.isfinite(error_mm) else {}


def reverse_translation(translation: Translation, depth: DepthMap) -> Translation:
    """Return the translation from the target back to the source, onto the pixels of the source's
    `depth`.
    """
    alignment = Alignment(
        alignment_from_source=freeze(rigid.invert(translation.alignment.target_from_alignment)),
        target_from_alignment=freeze(rigid.invert(translation.alignment.alignment_from_source)),
    )
    return replace(
        translation,
        source=translation.target,
        target=translation.source.with_camera(depth.camera),
        alignment=alignment,
        calibration=None,
        mesh=None,
        symmetry=None,
        load_context_images=load_nothing,
        request=replace(translation.request, calibration=None, mesh=None, weights=()),
    )


_USUAL_SHARE = 0.95  # of the training touches, that are nearer than 1
_WHAT = "the described training touches"
_KEY = "features"
_SMALL_MM = 0.02  # added to lengths before the logarithm: depths below it are noise


def describe_touch(contact: Mask, indentation_mm: Floats, pixel_mm: float) -> Doubles | None:
    """Describe a contact (rows, cols) with pixels of this size in seven numbers.

    None without contact.

    They are the logarithms of area (mm²), largest and mean indentation, and of the extent along
    both principal axes (mm, standard deviation), the distance of its centre from the image centre
    (mm), and the share of its ellipse that it fills.
    """
    if not contact.any():
        return None
    rows, cols = np.nonzero(contact)
    points_mm = pixel_mm * np.stack([cols, rows], axis=1).astype(np.float64)
    centre_mm = points_mm.mean(axis=0)
    spread = np.cov(points_mm, rowvar=False, bias=True) + np.eye(2) * pixel_mm**2 / 12.0
    minor_mm, major_mm = np.sqrt(np.linalg.eigvalsh(spread))
    area_mm2 = len(rows) * pixel_mm**2
    deep_mm = indentation_mm[contact].astype(np.float64)
    middle_mm = 0.5 * pixel_mm * (np.array(contact.shape[::-1]) - 1.0)
    return np.array(
        [
            math.log(area_mm2),
            math.log(_SMALL_MM + max(0.0, float(deep_mm.max()))),
            math.log(_SMALL_MM + max(0.0, float(deep_mm.mean()))),
            math.log(major_mm),
            math.log(minor_mm),
            float(np.hypot(*(centre_mm - middle_mm))),
            area_mm2 / (4.0 * math.pi * major_mm * minor_mm),
        ]
    )


def compute_training_distance(observed: TargetDepth, target: SensorSpec) -> float:
    """Return how far a touch is from the nearest training touch of a target sensor.

    NaN without contact or training.

    1 = as far as the 5 % of the training touches that are farthest from their nearest neighbour.
    """
    table = load_training_features(target.name)
    pixel_mm = target.pixel_mm * target.camera.fx_px / observed.camera.fx_px
    features = (
        None
        if table is None
        else describe_touch(observed.contact, observed.indentation_mm, pixel_mm)
    )
    if table is None or features is None:
        return math.nan
    scaled, mean, scale, usual = table
    return float(np.linalg.norm(scaled - (features - mean) / scale, axis=1).min() / usual)


@derive_once
def load_training_features(target: str) -> tuple[Doubles, Doubles, Doubles, float] | None:
    """Describe the training touches of a sensor; None where it has none.

    Returns their features (n, k) in standard deviations, the mean (k,) and the standard deviation
    (k,), and the usual distance to the nearest.
    """
    path = WEIGHTS_FOLDER / f"training_touches_{target}.npz"
    if not path.is_file():
        return None
    features = np.asarray(read_arrays(path, _WHAT)[_KEY], np.float64)
    mean = features.mean(axis=0)
    scale = features.std(axis=0)
    scaled = freeze((features - mean) / scale)
    gaps = np.linalg.norm(scaled[:, None] - scaled[None], axis=2)
    np.fill_diagonal(gaps, np.inf)
    return scaled, freeze(mean), freeze(scale), float(np.quantile(gaps.min(axis=1), _USUAL_SHARE))
