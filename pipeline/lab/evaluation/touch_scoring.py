"""Scores of one recording in one direction, as a pure function that any process can run."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from pipeline.core.arrays import Doubles, Floats, freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.graph import Graph, StageResult
from pipeline.core.memo import Cache
from pipeline.core.params import list_settings
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame, Truth
from pipeline.core.values.results import DepthMap, GeneratedTouch, ObjectPose, TargetDepth
from pipeline.io import open_recording
from pipeline.lab.evaluation.held_out import (
    BASELINES,
    MEAN_TOUCH,
    NO_CONTACT,
    OWN,
    RECORDED,
    Candidate,
    PressRecordings,
    compute_mean_change,
)
from pipeline.lab.evaluation.touch_metrics import (
    RecordedTouch,
    TouchMetrics,
    build_recorded_touch,
    compute_generated_change,
    compute_touch_metrics,
)
from pipeline.lab.evaluation.variants import choose_methods
from pipeline.lab.training.recorded_pairs import derive_contact
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.networks import weights_registry
from pipeline.stages.networks.weights import NoWeights, Weights
from pipeline.stages.touch.frame_chain import make_touch_from_change
from pipeline.stages.touch.physical_render import make_reference_touch
from pipeline.translation.catalogue import default_params, with_setting
from pipeline.translation.translate import Request, Translation, open_translation

PAPER_GRASP = "paper_grasp"  # pose by both fingers of a grasp, see `registration.planar`
_CACHE_BYTES = 64 * 1024 * 1024  # one frame's stages by every candidate


@frozen
class ScoringJob:
    """All candidates on all touches of one recording in one direction."""

    recordings: PressRecordings
    source: str
    target: str
    candidates: tuple[Candidate, ...]
    training_recordings: tuple[PressRecordings, ...] = ()  # for the mean touch
    # touch method or stage -> file in place of shipped ones
    weights: Mapping[str, Path] = field(default_factory=dict)
    methods: Mapping[str, str] = field(default_factory=dict)  # stage -> method, without touch
    settings: tuple[str, ...] = ()  # stage.parameter=value
    pose_methods: tuple[str, ...] = ()  # pose methods that judge the touches


@frozen
class ScoredTouch:
    """Metrics of one touch by one candidate."""

    candidate: str
    touch_name: str  # recording and frame
    metrics: TouchMetrics
    ms: float  # of all stages up to the touch; 0 for baselines
    # method -> (mm, deg) in the target's image plane; absent = no pose
    pose_errors: Mapping[str, tuple[float, float]]
    features: Floats | None  # of the encoder; None = no encoder for this sensor
    notes: tuple[str, ...] = ()
    finger: GraspFinger | None = None  # for poses of both fingers together; None = not known


@frozen
class GraspFinger:
    """One finger's contact in the frame of the grasp, with the truth."""

    points_mm: Doubles  # (n, 3)
    grasp_from_object: Doubles  # (4, 4)
    mesh: Mesh


def score_recording(job: ScoringJob, progress: Progress = SILENT) -> list[ScoredTouch]:
    """Every touch of the job by every candidate, in the order of the recording."""
    with open_presses(job.recordings, job.source, job.target, job.methods) as translation:
        return list(_score_touches(job, translation, progress))


@contextmanager
def open_presses(
    of: PressRecordings, source: str, target: str, methods: Mapping[str, str]
) -> Generator[Translation, None, None]:
    """Translate presses of a source that also know what the target recorded of them."""
    translation = open_translation(
        Request(
            recording=of.source,
            target=target,
            source=source,
            stream=of.source_stream,
            mesh=of.mesh,
            mesh_unit="m" if of.mesh else "auto",
            methods=tuple(methods.items()),
        )
    )
    with closing(translation), closing(open_recording(of.target)) as other:
        streams = translation.stream, other.stream(of.target_stream or target)
        yield replace(translation, recording=replace(translation.recording, streams=streams))


def _score_touches(
    job: ScoringJob, translation: Translation, progress: Progress
) -> Iterator[ScoredTouch]:
    mean = (
        compute_mean_change(job.training_recordings, job.target)
        if job.training_recordings
        else None
    )
    indices = job.recordings.frames or translation.select_paired(range(translation.n_frames))
    for k, index in enumerate(indices):
        progress.step(k / len(indices), f"{job.recordings.object_name} {k + 1} of {len(indices)}")
        other = translation.read_target_observation(index)
        assert other is not None
        names = job.recordings.frame_names
        name = names[k] if names else f"{job.recordings.object_name} {index}"
        scorer = _TouchScorer(job, translation, index, name, other, mean)
        for candidate in job.candidates:
            yield scorer.score_candidate(candidate)


class _TouchScorer:
    """Scores candidates on one recorded touch, with a cache of what they have in common."""

    def __init__(
        self,
        job: ScoringJob,
        translation: Translation,
        index: int,
        name: str,
        observed: tuple[TactileFrame, Truth | None],
        mean: Floats | None,
    ) -> None:
        self._job = job
        self._index = index
        self._name = name
        self._mean = mean
        # of this touch alone
        self._translation = replace(translation, graph=Graph((), cache=Cache(_CACHE_BYTES)))
        self._true = self._read_recorded_touch(*observed)
        self._truth = observed[1]
        self._ms: dict[str, float] = {}
        target_depth = self._evaluate("physics", {}, "target_depth")["target_depth"].output
        assert isinstance(target_depth, TargetDepth)
        self._known = target_depth.in_view

    def score_candidate(self, candidate: Candidate) -> ScoredTouch:
        results, given = self._run(candidate.name)
        touch = given["touch"]
        touch_depth = given["touch_depth"]
        assert isinstance(touch, GeneratedTouch)
        assert isinstance(touch_depth, DepthMap)
        change = compute_generated_change(touch, self._translation.target)
        # the source itself has no touch to compare, and the recorded one is the truth
        metrics = TouchMetrics(values={}, n_pixels={}, peak_value=self._true.peak_value)
        if candidate.name not in (OWN, RECORDED):
            mean = None if candidate.name in BASELINES else self._mean
            metrics = compute_touch_metrics(change, touch_depth, self._true, self._known, mean)
        is_own = candidate.name == OWN
        judges_grasps = PAPER_GRASP in self._job.pose_methods and not is_own
        return ScoredTouch(
            candidate=candidate.name,
            touch_name=self._name,
            metrics=metrics,
            ms=sum(self._ms[r.method.key] for r in results.values() if r.method is not None),
            pose_errors=self._compute_pose_errors(candidate, given),
            features=None
            if is_own
            else encode_change(self._translation.target, change, self._job.weights),
            notes=tuple(dict.fromkeys(r.fallback for r in results.values() if r.fallback)),
            finger=self._find_finger(touch_depth) if judges_grasps else None,
        )

    def _run(self, name: str) -> tuple[dict[str, StageResult], dict[str, object]]:
        """Results by a touch method, and the touch of any candidate with its depth."""
        target = self._translation.target
        given: dict[str, object] = {"touch": make_reference_touch(target)}
        results: dict[str, StageResult] = {}
        if name == OWN:  # the source's own depth, registered in its frame
            results = self._evaluate("physics", {}, "depth")
            return results, {**given, "touch_depth": results["depth"].output}
        if name == RECORDED:
            touch = make_touch_from_change(target, self._true.change)
            return results, {"touch": touch, "touch_depth": self._estimate_target_depth()}
        if name == MEAN_TOUCH and self._mean is not None:
            given["touch"] = make_touch_from_change(target, self._mean)
        elif name not in BASELINES:
            results = self._evaluate(name, {}, "touch")
            given["touch"] = results["touch"].output
        # its own membrane if it has one, else read from its image as from a frame of the target
        touch = given["touch"]
        assert isinstance(touch, GeneratedTouch)
        how = "from_image" if touch.membrane is None else "membrane"
        chosen = choose_methods(self._translation, {**self._job.methods, "touch_depth": how}, {})
        read = chosen.evaluate(self._index, ["touch_depth"], given=given)
        return results, {**given, "touch_depth": read["touch_depth"].output}

    def _find_finger(self, touch_depth: DepthMap | None) -> GraspFinger | None:
        """The contact of a touch in the grasp frame.

        None where the frame, the tool or its pose is not known.
        """
        truth = self._truth
        mesh = self._translation.mesh
        if touch_depth is None or truth is None or mesh is None:
            return None
        if truth.grasp_from_sensor is None or truth.sensor_from_object is None:
            return None
        points = touch_depth.camera.back_project(touch_depth.depth_mm)[touch_depth.contact]
        points = points[np.isfinite(points).all(axis=1)]
        return GraspFinger(
            points_mm=rigid.apply(truth.grasp_from_sensor, points),
            mesh=mesh,
            grasp_from_object=truth.grasp_from_sensor @ truth.sensor_from_object,
        )

    def _evaluate(
        self,
        touch: str,
        given: Mapping[str, object],
        stage: str,
        pose: str = "",
        *,
        is_own: bool = False,
    ) -> dict[str, StageResult]:
        """Results up to a stage with one touch and pose method; of the source's own frame in place
        of a touch.

        Remembers the times of computed stages.
        """
        methods = {**self._job.methods, **({"pose": pose} if pose else {})}
        like = choose_candidate(self._translation, touch, methods, self._job.weights)
        if is_own:
            source = like.source
            frame = like.stream.frame(self._index)
            assert frame.reference is not None  # its depth is known
            change = source.sensor_kind.compute_relative_change(frame.image, frame.reference)
            given = {**given, "touch": make_touch_from_change(source, change)}
            like = replace(like, target=source)
        params = default_params(like.methods)
        for assignment in self._job.settings:
            if _has_setting(assignment, params):
                params = with_setting(params, assignment)
        results = replace(like, params=params).evaluate(self._index, [stage], given=given)
        for result in results.values():
            if result.method is not None and result.state in ("computed", "skipped"):
                self._ms.setdefault(result.method.key, result.ms)
        return results

    def _estimate_target_depth(self) -> DepthMap:
        """Depth of the target's own frame."""
        read = choose_methods(self._translation.with_target_as_source(), self._job.methods, {})
        output = read.evaluate(self._index, ["depth"])["depth"].output
        assert isinstance(output, DepthMap)
        return output

    def _read_recorded_touch(self, frame: TactileFrame, truth: Truth | None) -> RecordedTouch:
        """The recorded touch with its truth, or with the depth of its own frame where no truth
        is recorded.
        """
        target = self._translation.target
        if truth is not None and truth.indentation_mm is not None:
            contact = derive_contact(truth, target)
            return build_recorded_touch(frame, target, truth.indentation_mm, contact)
        depth = self._estimate_target_depth()
        shape = frame.image.shape[:2]
        if shape != depth.contact.shape:
            raise SettingProblem(
                f"frame {frame.index} of {frame.sensor} has {shape} pixels, but "
                f"{depth.contact.shape} are described"
            )
        indentation_mm = np.nan_to_num(depth.indentation_mm)
        return build_recorded_touch(frame, target, indentation_mm, depth.contact)

    def _compute_pose_errors(
        self, candidate: Candidate, given: Mapping[str, object]
    ) -> dict[str, tuple[float, float]]:
        """Method -> (mm, deg) in the target's image plane; methods without a pose are absent."""
        pose_errors: dict[str, tuple[float, float]] = {}
        truth = self._translation.read_ground_truth(self._index)
        stage = self._translation.catalogue.stage("pose")
        is_own = candidate.name == OWN
        for name in self._job.pose_methods:
            if candidate.name == NO_CONTACT or name == PAPER_GRASP:
                continue
            found = self._evaluate("physics", given, "pose", name, is_own=is_own)["pose"]
            if is_own and found.fallback:  # no network knows this source
                continue
            pose = found.output
            assert isinstance(pose, ObjectPose)
            if is_own and pose.sensor_from_object is not None:
                target_from_source = self._translation.alignment.target_from_source
                pose = replace(
                    pose,
                    sensor_from_object=target_from_source @ pose.sensor_from_object,
                    scene_mm=rigid.apply(target_from_source, pose.scene_mm),
                )
            errors = stage.compute_metrics(pose, truth)
            if "se2_mm" in errors and "se2_deg" in errors:
                pose_errors[name] = errors["se2_mm"], errors["se2_deg"]
        return pose_errors


def choose_candidate(
    translation: Translation,
    touch: str,
    methods: Mapping[str, str],
    weights: Mapping[str, Path],
) -> Translation:
    """The translation by one touch method; `weights` are of touch methods or of stages."""
    chosen = {**methods, "touch": touch}
    files = {stage: file for stage, file in weights.items() if stage in {"depth", *chosen}}
    if touch in weights:
        files["touch"] = weights[touch]
    return choose_methods(translation, chosen, files)


def _has_setting(assignment: str, params: Mapping[str, object]) -> bool:
    """Whether these methods have a setting; touch methods differ in their parameters."""
    stage, _, name = assignment.partition("=")[0].strip().partition(".")
    return stage != "touch" or name in list_settings(params[stage])


_TASK = "touch_pose"


INCEPTION = "inception"  # in place of a touch method of `ScoringJob.weights`


def load_encoder_weights(
    target: SensorSpec, weights: Mapping[str, Path] = MappingProxyType({})
) -> Weights | NoWeights:
    """The Inception network of `weights`, else the encoder of a sensor's touches, or the reason
    that there is none.
    """
    if INCEPTION in weights:
        from pipeline.stages.networks.inception import read_inception

        return weights_registry.load_file(weights[INCEPTION], read_inception)
    own = weights_registry.load_for_task(_TASK, f"encoder_{target.name}", None)
    if isinstance(own, Weights):
        return own
    return weights_registry.load_for_task(_TASK, f"pose_{target.name}", None)


def encode_change(
    target: SensorSpec, change: Floats, weights: Mapping[str, Path] = MappingProxyType({})
) -> Floats | None:
    """Features (n,) of a change (rows, cols, channels) of a sensor; None without encoder."""
    known = load_encoder_weights(target, weights)
    if isinstance(known, NoWeights):
        return None
    import torch

    from pipeline.stages.networks import inception
    from pipeline.stages.networks.network_factory import load_network
    from pipeline.stages.networks.touch_formats import encode_image, normalise, resize_to_square

    with torch.inference_mode():
        if INCEPTION in weights:
            square = encode_image(resize_to_square(change, inception.SIDE), target.kind)
            features = inception.compute_features(known, torch.from_numpy(square[None]))
        else:
            encoder: Any = load_network(known)
            square = normalise(resize_to_square(change), target.kind)
            features = encoder.compute_embedding(torch.from_numpy(np.array(square)[None]))
        return freeze(features[0].numpy().astype(np.float32))
