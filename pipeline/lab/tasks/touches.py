"""Touches of a task: what every sensor of a finger records at one moment, and its translation,
without a file between.

A finger is a place for a sensor: the source records there, and for truth the target records the
same moment. The moment is a recording of one frame in memory, so that translation, ground truth and
error attribution work as on files.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from pipeline.core.arrays import Doubles, Image
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.graph import Graph, StageResult
from pipeline.core.memo import Cache
from pipeline.core.progress import SILENT, Progress, SubProgress
from pipeline.core.values.frames import Pairing, Recording, Stream, TactileFrame, Truth
from pipeline.core.values.results import DepthMap, GeneratedTouch
from pipeline.lab.tasks.task import StageShare
from pipeline.physics.sensor_images import render_sensor_image
from pipeline.physics.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.physics.simulation.press import move_bubble_closer, simulate_press
from pipeline.physics.simulation.variation import vary_sensor
from pipeline.sensors.alignment import resolve_alignment
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.networks.weights import SUFFIX, NoWeights
from pipeline.stages.networks.weights_registry import WEIGHTS_FOLDER
from pipeline.translation.catalogue import BUILT_IN
from pipeline.translation.error_attribution import list_substitutions
from pipeline.translation.translate import Request, Translation, load_nothing

# the target itself; no touch; the source itself, without a translation
TRUE = "true"
NONE = "none"
OWN = "own"
_CACHE_BYTES = 64 << 20  # all stages of a moment, with and without truth in their place


@frozen
class SensorPlace:
    """One sensor instance at a finger, and the seed of its noise."""

    nominal: SensorSpec  # as the pipeline knows it
    instance: SensorSpec  # as it is
    seed: int

    def record(
        self, mesh: Mesh, finger_from_object: Doubles, *, index: int, time_s: float
    ) -> tuple[TactileFrame, Truth | None]:
        """The frame of the object at this pose in the finger's alignment frame.

        Truth None: not converged.
        """
        press = simulate_press(mesh, finger_from_object, self.instance, seed=self.seed + index)
        frame = TactileFrame(
            sensor=self.nominal.name,
            image=press.image,
            reference=self.render_reference(),
            index=index,
            time_s=time_s,
        )
        return frame, press.truth if press.converged else None

    def render_reference(self) -> np.ndarray:
        """The reference image of the instance."""
        flat = np.zeros(self.nominal.camera.shape, np.float32)
        return cast(
            "np.ndarray",
            render_sensor_image(self.instance, flat, self.instance.rest_depth_mm, self.seed - 1),
        )


def load_placed_sensor(name: str) -> SensorSpec:
    """The nominal sensor; a bubble as near to the object as in the simulated data sets."""
    spec = load_sensor(name)
    return spec if spec.bubble is None else move_bubble_closer(spec, BUBBLE_DEEPER_MM)


def place_sensor(name: str, rng: np.random.Generator, vary: float) -> SensorPlace:
    """An instance of a sensor drawn by `rng`; `vary` as in `vary_sensor`."""
    instance_seed, noise_seed = (int(seed) for seed in rng.integers(1 << 31, size=2))
    nominal = load_placed_sensor(name)
    return SensorPlace(
        nominal=nominal, instance=vary_sensor(nominal, instance_seed, vary), seed=1 + noise_seed
    )


def check_touch(name: str, source: str, target: str) -> None:
    """Raise SettingProblem unless `name` is "true", "none", "own" or a touch method for this
    direction.
    """
    if name in (TRUE, NONE, OWN):
        return
    select = BUILT_IN.method("touch", name).weights
    file = find_weights(name, source, target)
    found = select and select(load_sensor(source), load_placed_sensor(target), file)
    if isinstance(found, NoWeights):
        raise SettingProblem(f"--touch {name} cannot translate {source} to {target}: {found.why}")


def find_weights(touch: str, source: str, target: str) -> Path | None:
    """The shipped file of the VQ-VAE, which answers only with weights of one's choice.

    None = the method's own.
    """
    return WEIGHTS_FOLDER / f"vqvae_{source}_to_{target}{SUFFIX}" if touch == "vqvae" else None


def make_touch_request(touch: str, recording: Path, source: str, target: str) -> Request:
    """How a touch method translates.

    By the default route for "true" and others that read no translation.
    """
    request = Request(recording=recording, source=source, target=target)
    if touch not in {method.name for method in BUILT_IN.stage("touch").methods}:
        return request
    methods = {"touch": touch, **({"touch_depth": "from_image"} if touch == "vqvae" else {})}
    weights = find_weights(touch, source, target)
    return replace(
        request,
        route="t2t" if "frame" in BUILT_IN.method("touch", touch).reads else "t2d2",
        methods=tuple(methods.items()),
        weights=() if weights is None else (("touch", weights),),
    )


class Moment:
    """One moment of one finger: the frames at hand, and every translation of them, each computed
    once.
    """

    def __init__(
        self,
        mesh: Mesh,
        frames: Sequence[tuple[TactileFrame, Truth | None]],
        source: SensorSpec,
        target: SensorSpec,
        *,
        context_images: tuple[Image, ...] = (),
        draft: bool = False,
    ) -> None:
        """`frames` holds one of the source, and for truth one of the target, of the same index.

        `context_images` are other touches of the source's instance, which determine its
        illumination. `draft`: the source's depth is computed as while a slider is dragged, in half
        the time.
        """
        streams = tuple(_make_stream(*pair) for pair in frames)
        self._recording = Recording(
            path=Path("moment"), format="moment", streams=streams, object_mesh=mesh
        )
        self._source = source
        self._target = target
        self._mesh = mesh
        self._context_images = context_images
        self._draft = draft
        self._graph = Graph((), cache=Cache(_CACHE_BYTES))

    def open_translation(self, touch: str) -> Translation:
        """The translation of the source's frame by a touch method.

        Of the target's own frame for "true".
        """
        source = self._target if touch == TRUE else self._source
        return Translation(
            request=make_touch_request(touch, self._recording.path, source.name, self._target.name),
            recording=self._recording,
            stream=self._recording.stream(source.name),
            source=source,
            target=self._target,
            alignment=resolve_alignment(source, self._target),
            calibration=None,
            mesh=self._mesh,
            load_context_images=load_nothing
            if touch == TRUE
            else lambda _reference: self._context_images,
            graph=self._graph,
        )

    def evaluate(
        self,
        touch: str,
        stage: str,
        given: Mapping[str, object] | None = None,
        progress: Progress = SILENT,
    ) -> tuple[Translation, dict[str, StageResult]]:
        """The translation by `touch` and its results up to `stage`, with values `given` in place
        of stages.
        """
        translation = self.open_translation(touch)
        params = {
            method.stage: method.draft(method.params())
            for method in translation.methods
            if self._draft and method.stage == "depth" and method.draft is not None
        }
        return translation, replace(translation, params=params).evaluate(
            0, [stage], progress, given=given or {}
        )

    def measure_depth(
        self, touch: str, given: Mapping[str, object] | None = None, progress: Progress = SILENT
    ) -> DepthMap:
        """Depth of the touch that the controller gets: the target's or the source's own frame
        for "true" and "own".
        """
        stage = "depth" if touch in (TRUE, OWN) else "touch_depth"
        output = self.evaluate(touch, stage, given, progress)[1][stage].output
        assert isinstance(output, DepthMap)
        return output

    def generate_touch(
        self, touch: str, given: Mapping[str, object] | None = None
    ) -> GeneratedTouch:
        """The generated touch of the source's frame."""
        output = self.evaluate(touch, "touch", given)[1]["touch"].output
        assert isinstance(output, GeneratedTouch)
        return output


def _make_stream(frame: TactileFrame, truth: Truth | None) -> Stream:
    first = replace(frame, index=0)
    return Stream(
        name=frame.sensor,
        sensor=frame.sensor,
        n_frames=1,
        frame=lambda _index: first,
        truth=lambda _index: truth,
        has_truth=truth is not None,
    )


def make_pairing(name: str, source: SensorSpec, target: SensorSpec) -> Pairing:
    """The alignment of two sensors of one finger, by the names of their streams."""
    return Pairing(
        source=f"{source.name}_{name}",
        target=f"{target.name}_{name}",
        target_from_source=resolve_alignment(source, target).target_from_source,
    )


POSE_TITLE = "pose estimation"  # what remains with the true touch: the controller's own


@frozen
class CorrectedEstimate:
    """The controller's estimate with the truth in one more stage."""

    stage: str
    title: str
    estimate: Any


def correct_estimates(
    moments: Sequence[Moment],
    touch: str,
    estimate: Callable[[Sequence[dict[str, object]], Progress], Any],
    truth: Any,
    *,
    progress: Progress = SILENT,
) -> tuple[CorrectedEstimate, ...]:
    """Estimates with the truth in one more stage each, in running order.

    The last is `truth` itself.

    `estimate` reads values in place of stages, one mapping per finger.
    """
    corrected: list[CorrectedEstimate] = []
    if touch != NONE:
        given: list[dict[str, object]] = [{} for _ in moments]
        by_stage = list(zip(*(list_true_stages(moment, touch) for moment in moments), strict=True))
        for done, steps in enumerate(by_stage):
            part = SubProgress(
                progress,
                done / len(by_stage),
                1.0 / len(by_stage),
                f"truth in place of {steps[0][1]}",
            )
            part.step(0.0, "")
            for one, (stage, _, value) in zip(given, steps, strict=True):
                one[stage] = value
            corrected.append(
                CorrectedEstimate(
                    stage=steps[0][0], title=steps[0][1], estimate=estimate(given, part)
                )
            )
    return (*corrected, CorrectedEstimate(stage="pose", title=POSE_TITLE, estimate=truth))


def share_error(
    error_mm: float,
    corrected: Sequence[CorrectedEstimate],
    judge: Callable[[Any], tuple[float, bool]],
) -> tuple[StageShare, ...]:
    """The shares of `error_mm`, which add up to it.

    `judge` returns error and success of an estimate.
    """
    judged = [judge(one.estimate) for one in corrected]
    errors_mm = [error_mm, *(error for error, _ in judged)]
    return tuple(
        StageShare(
            stage=one.stage,
            title=one.title,
            share_mm=before - now,
            remaining_mm=now,
            succeeds=succeeds,
        )
        for one, before, (now, succeeds) in zip(corrected, errors_mm[:-1], judged, strict=True)
    )


def list_true_stages(
    moment: Moment, touch: str, last: str = "touch_depth"
) -> list[tuple[str, str, object]]:
    """(stage, title, truth) of one finger for the stages that the controller's touch comes from,
    up to `last`.
    """
    last = "depth" if touch in (TRUE, OWN) else last
    translation, results = moment.evaluate(touch, last)
    before = translation.stages[: translation.stages.index(last) + 1]
    truths = translation.read_true_outputs(0)
    return list(
        list_substitutions(
            translation, {name: truths[name] for name in before if name in truths}, results
        )
    )
