"""One translation as a user requests it: a recording, two sensors, and what goes with them,
opened and checked once.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, cast

import numpy as np

from pipeline.calibration.calibration_file import load_if_present
from pipeline.calibration.calibration_table import Calibration
from pipeline.calibration.force_scale import ForceScale, load_force_scale
from pipeline.core.arrays import Floats, Image
from pipeline.core.digests import compute_cached_digest
from pipeline.core.errors import (
    CalibrationError,
    SettingProblem,
    ShapeError,
    StageWarning,
    UnknownSensor,
)
from pipeline.core.frame_lists import check_frame_index
from pipeline.core.frozen import frozen
from pipeline.core.geometry.meshes import Mesh, load_mesh
from pipeline.core.graph import Graph, Method, StageResult
from pipeline.core.memo import DEFAULT_MAX_BYTES, Cache
from pipeline.core.params import Value
from pipeline.core.progress import SILENT, Progress, reading_reported_to
from pipeline.core.values.frames import Recording, Stream, TactileFrame, Truth
from pipeline.core.values.pairing import follow, pair_frames
from pipeline.io import open_recording
from pipeline.io.depth_arrays import DepthUnit
from pipeline.sensors import alignment as alignments
from pipeline.sensors.alignment import Alignment, Offsets, load_alignment, shift_alignment_along_z
from pipeline.sensors.spec import SensorSpec, describe_unit_problem, load_sensor
from pipeline.stages.networks.devices import AUTO, check_device, choose_placement
from pipeline.stages.networks.network_factory import ONNX_KINDS
from pipeline.stages.networks.weights import NoWeights, Weights
from pipeline.stages.stage import TRUTH, GroundTruth, SensorRole, Stage, get_input_name
from pipeline.translation.catalogue import (
    BUILT_IN,
    Catalogue,
    Route,
    replace_parameter,
    with_settings,
)
from pipeline.translation.following import FROM_REST, Start
from pipeline.translation.frame_selection import select_context_frames
from pipeline.translation.translated_frame import TranslatedFrame
from pipeline.views.display_params import DisplayParams
from pipeline.views.view import PreviewContext

if TYPE_CHECKING:
    from typing import Self

    from pipeline.core.geometry.symmetry import Symmetry


@frozen
class Request:
    """What to translate into what; the empty string and None mean the recording's own."""

    recording: Path
    target: str
    source: str = ""
    stream: str = ""
    route: str = ""
    methods: tuple[tuple[str, str], ...] = ()  # (stage, method) in place of the route's own
    reference: Path | None = None
    # of the recording to make the reference of: "median", "untouched" or a number
    reference_frames: str = ""
    calibration: Path | None = None
    mesh: Path | None = None
    mesh_unit: str = "auto"
    depth_unit: DepthUnit = "auto"
    alignment: Path | None = None  # TOML with T_S->A and T_A->T
    # (stage, file); stage "" = the first whose method takes weights
    weights: tuple[tuple[str, Path], ...] = ()
    # raise, where False lets the method fall back and say so
    refuses_unusable_weights: bool = False
    offsets: Offsets = field(default_factory=Offsets)  # offsets from that alignment
    device: str = AUTO  # that networks run on: auto, cpu, cuda, cuda:1 or mps


DEFAULT_DISPLAY = DisplayParams()
ContextLoader = Callable[[Image | Floats | None], tuple[Image, ...]]


def load_nothing(_reference: Image | Floats | None) -> tuple[Image, ...]:
    """Return no context images."""
    return ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Translation:
    """An opened recording, its target, and the methods between: a sequence of frames that are
    translated when asked.

    `len()` is the number of frames, `[i]` the `TranslatedFrame` with that number (negative: from
    the end), and a loop goes through all. Use it in a `with` statement, or `close()` it. Results
    are cached by content: what `with_` returns computes only what differs.
    """

    request: Request
    recording: Recording
    stream: Stream
    source: SensorSpec
    target: SensorSpec
    alignment: Alignment
    calibration: Calibration | None
    mesh: Mesh | None
    notes: tuple[str, ...] = field(default=())
    symmetry: Symmetry | None = None  # of `mesh`; None = not known
    force_scale: ForceScale | None = None  # of the source; None = not weighed
    catalogue: Catalogue = BUILT_IN
    # of the source's sensor instance, by a frame's reference
    load_context_images: ContextLoader = load_nothing
    # stage -> parameters; missing = defaults
    params: Mapping[str, object] = field(default_factory=dict[str, object])
    # its cache holds the results; its methods are not read
    graph: Graph = field(default_factory=lambda: Graph(()))

    def __repr__(self) -> str:
        names = f"{self.source.name} -> {self.target.name}"
        return f"<{self.n_frames} frames of {names}: {self.recording.path.name!r}>"

    def __len__(self) -> int:
        return self.n_frames

    def __bool__(self) -> bool:  # an empty recording is one too
        return True

    def __getitem__(self, index: int) -> TranslatedFrame:
        try:
            number = operator.index(index)
        except TypeError:
            raise SettingProblem(
                f"a frame is chosen by its number, got {index!r}; several by a loop over "
                "range(first, end)"
            ) from None
        from_end = -self.n_frames <= number < 0
        return TranslatedFrame(
            self, self.check_index(number + self.n_frames if from_end else number)
        )

    def __iter__(self) -> Iterator[TranslatedFrame]:
        return (TranslatedFrame(self, index) for index in range(self.n_frames))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def with_(
        self, *, stage: str = "touch", method: str | Method = "", **settings: Value
    ) -> Translation:
        """Return the translation with another method of a stage, or other parameters of it.

        It shares the cache and the open recording: close only one of the two.

        Args:
            stage: Stage that `method` and `settings` are about: `depth`, `cloud`, `target_depth`,
                `touch`, `touch_depth` or `pose`.
            method: Name of one of its methods (`list_methods`), or a `Method` of your own, which
                says its stage.
            settings: Parameters of the stage's method, such as `steps=8` or `guidance=2.0`.

        Raises:
            SettingProblem: There is no such stage, method or parameter, or a value is out of its
                range.
        """
        changed = self
        if isinstance(method, Method):
            stage = method.stage
        elif not isinstance(cast("object", method), str):
            raise SettingProblem(
                f"a method is a name or a Method, got {method!r}; give "
                "ts.Method(stage=..., name=..., title=..., run=..., params=..., reads=...)"
            )
        if method:
            changed = changed._with_method(stage, method)
        if settings:
            method_ = changed.get_method(stage)
            params = changed.params.get(stage)
            params = params if isinstance(params, method_.params) else method_.params()
            for name, value in settings.items():
                params = replace_parameter(params, stage, name, value)
            changed = replace(changed, params={**changed.params, stage: params})
        return changed

    def with_alignment(self, alignment: Alignment) -> Translation:
        """Return the translation by another alignment of the two sensors, such as a refined one."""
        return replace(self, alignment=alignment)

    def with_calibration(self, calibration: Calibration) -> Translation:
        """Return the translation by another calibration table of the source."""
        return replace(self, calibration=calibration, load_context_images=load_nothing)

    def _with_method(self, stage: str, method: str | Method) -> Translation:
        catalogue = self.catalogue
        name = method if isinstance(method, str) else method.name
        if isinstance(method, Method):
            catalogue = catalogue.add_method(method)
        catalogue.method(stage, name)  # raises SettingProblem
        methods = {**dict(self.request.methods), stage: name}
        request = replace(self.request, methods=tuple(methods.items()))
        unused = (
            *_about_methods(request, self.methods),
            *_about_kinds(request, self.source, self.target, catalogue),
        )
        notes = tuple(dict.fromkeys((*self.notes, *unused)))
        # A function at hand may have been changed under the same name, so it shares no results.
        graph = self.graph if isinstance(method, str) else Graph(())
        return replace(self, request=request, catalogue=catalogue, notes=notes, graph=graph)

    def get_method(self, stage: str) -> Method:
        """Return the method that computes a stage.

        Raises SettingProblem where the route has no such stage.
        """
        return Graph(self.methods).select_methods([stage])[-1]

    def list_methods(self, stage: str = "touch") -> tuple[str, ...]:
        """Return the names of a stage's methods that can answer for these two sensors.

        They are for the kind of the stage's sensor, have weights where they are networks, and
        a mesh where they need one. Raises SettingProblem for an unknown stage.
        """
        kind = self.get_sensor(stage).kind
        return tuple(
            m.name
            for m in self.catalogue.stage(stage).methods
            if m.fits(kind)
            and self._has_weights(m)
            and (self.mesh is not None or "mesh" not in m.reads)
        )

    def _has_weights(self, method: Method) -> bool:
        file = dict(self.request.weights).get(method.stage)
        found = None if method.weights is None else method.weights(self.source, self.target, file)
        return not isinstance(found, NoWeights)

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return self.stream.n_frames

    @property
    def methods(self) -> tuple[Method, ...]:
        """The methods of the route, one per stage, in running order."""
        return self.catalogue.methods(
            self.route.name, dict(self.request.methods), self.sensor_kinds
        )

    @property
    def route(self) -> Route:
        """The route of the request, or the default for this object."""
        return self.catalogue.route(self.request.route, has_mesh=self.mesh is not None)

    @property
    def sensor_kinds(self) -> dict[SensorRole, str]:
        """The kinds of the two sensors."""
        return {"source": self.source.kind, "target": self.target.kind}

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages of the route, in order."""
        return tuple(method.stage for method in self.methods)

    @property
    def truth_label(self) -> str:
        """Title of the truths in place of computed stages, such as "with true depth".

        "" without.
        """
        pinned = [
            self.catalogue.stage(m.stage).title.lower() for m in self.methods if m.name == TRUTH
        ]
        return f"with true {' and '.join(pinned)}" if pinned else ""

    def get_role(self, column: str) -> SensorRole:
        """Return whose frame a column is in: "source" or the name of a stage."""
        return "source" if column == "source" else self.catalogue.stage(column).sensor_role

    def get_sensor(self, column: str) -> SensorSpec:
        """Return the sensor whose frame a column is in."""
        return self.source if self.get_role(column) == "source" else self.target

    def make_preview_context(
        self, results: Mapping[str, StageResult], display: DisplayParams = DEFAULT_DISPLAY
    ) -> PreviewContext:
        """Return what previews are drawn from, with these results of the stages computed so far."""
        outputs = {name: result.output for name, result in results.items()}
        return PreviewContext(
            outputs=outputs, source=self.source, target=self.target, mesh=self.mesh, display=display
        )

    def reload_frames(self) -> Translation:
        """Return the translation with the frames that a growing recording has gained."""
        if self.recording.refresh is None:
            return self
        recording = self.recording.refresh()
        return replace(self, recording=recording, stream=recording.stream(self.stream.name))

    def with_target_as_source(self) -> Translation:
        """Return the translation that reads the target's own recording as a source, frame by
        frame of this one.
        """
        own = self.target_stream
        assert own is not None
        load_context_images = _context_image_loader(
            self.calibration, self.recording, own, self.target
        )
        return replace(
            self,
            stream=own,
            source=self.target,
            target=self.source,
            load_context_images=load_context_images,
            force_scale=None,
        )

    def evaluate(
        self,
        frame: int | TactileFrame,
        stages: Iterable[str] | None = None,
        progress: Progress = SILENT,
        *,
        given: Mapping[str, object] = MappingProxyType({}),
        start: Start = FROM_REST,
        on_stage: Callable[[StageResult], None] | None = None,
    ) -> dict[str, StageResult]:
        """Return the results of some stages and of those that they depend on, in running order.

        Args:
            frame: Number of a frame, or a frame at hand.
            stages: Names of the stages; None = all of the route.
            progress: Shows how far it is, and may cancel.
            given: Values in place of stages or inputs: the truth of a stage there attributes the
                error.
            start: Pose and membrane of the frame before, where a sequence is followed.
            on_stage: Receives each result as soon as it is there.

        Raises:
            TouchError: A frame is damaged, a name unknown, or a stage cannot be computed.
        """
        inputs = {**self.read_inputs(frame, start, progress), **given}
        names = self.stages if stages is None else stages
        return self.graph.with_methods(self.methods).evaluate(
            names, inputs, self.params, progress, on_stage
        )

    def read_inputs(
        self,
        frame: int | TactileFrame,
        start: Start = FROM_REST,
        progress: Progress = SILENT,
    ) -> Mapping[str, object]:
        """Return the graph's inputs for a frame by number or at hand.

        Raises FileProblem if it is damaged.

        `start` is of the frame before, where a sequence is followed. `progress` shows how weights
        are read.
        """
        if not isinstance(frame, TactileFrame):
            frame = self.stream.frame(self.check_index(frame))
        with reading_reported_to(progress):
            weights = self.weights
        return {
            "frame": replace(
                frame,
                context_frames=frame.context_frames or self.load_context_images(frame.reference),
            ),
            "source": self.source,
            "target": self.target,
            "calibration": self.calibration,
            "alignment": shift_alignment_along_z(
                self.alignment,
                source_shift_mm=estimate_camera_shift_mm(frame, self.source),
                target_shift_mm=0.0,
            ),
            "mesh": self.mesh,
            "previous": start.pose,
            "previous_membrane": start.membrane,
            **weights,
            **self._read_truth_inputs(frame.index),
        }

    def _read_truth_inputs(self, index: int) -> dict[str, object]:
        """Return the inputs of the stages that take the truth of frame `index`.

        None where it is not known.
        """
        pinned = [method.stage for method in self.methods if method.name == TRUTH]
        truths = self.read_true_outputs(index, tuple(pinned)) if pinned else {}
        return {get_input_name(stage): truths.get(stage) for stage in pinned}

    def knows_truth(self, stage: Stage) -> bool:
        """Whether the recording holds the truth of any frame that a stage's true value is made
        from.
        """
        if stage.sensor_role == "source":
            return self.stream.has_truth
        return self.target_stream is not None and self.target_stream.has_truth

    @property
    def target_stream(self) -> Stream | None:
        """The target's own stream by this translation's frame numbers; None if it took no part."""
        other = self.recording.find_partner(self.stream.name, self.target.name)
        return (
            None if other is None or other.name == self.stream.name else follow(self.stream, other)
        )

    def select_paired(self, indices: Iterable[int]) -> list[int]:
        """Return those of some frames at whose time the target recorded one as well."""
        other = self.recording.find_partner(self.stream.name, self.target.name)
        paired = set() if other is None else set(pair_frames(self.stream, other).indices.tolist())
        return [index for index in indices if index in paired]

    def check_given_weights(self) -> None:
        """Check that the methods can use the files that the request names.

        Raises SettingProblem with the reason.
        """
        for method, file in self._select_weights_files():
            read = self.weights[method.weights_name]
            if file is not None and isinstance(read, NoWeights):
                raise SettingProblem(f"{method.stage}: {read.why}")

    @property
    def weights(self) -> dict[str, object]:
        """`Method.weights_name` -> its `Weights` (the request's file, or else the shipped ones)
        or `NoWeights`.
        """
        return {
            method.weights_name: self._place(method.weights(self.source, self.target, file))
            for method, file in self._select_weights_files()
            if method.weights is not None
        }

    def _place(self, weights: object) -> object:
        """Return weights for the requested device; the reason why there are none as it is."""
        if not isinstance(weights, Weights):
            return weights
        by_opencv = weights.kind in ONNX_KINDS
        return weights.place(
            choose_placement(self.request.device, weights.n_parameters, by_opencv=by_opencv)
        )

    def _select_weights_files(self) -> list[tuple[Method, Path | None]]:
        """Return each method that reads weights with its file of the request.

        None: the shipped weights.
        """
        methods = Graph(self.methods).list_methods(self.source.kind)
        given = dict(self.request.weights)
        first = next((m for m in self.methods if m.weights is not None), None)
        learned = [m for m in methods if m.weights is not None]
        return [(m, given.get(m.stage, given.get("") if m is first else None)) for m in learned]

    def read_source_truth(self, index: int) -> Truth | None:
        """Return the truth of frame `index` on the source's side."""
        return self.stream.truth(index)

    def read_target_observation(self, index: int) -> tuple[TactileFrame, Truth | None] | None:
        """Return what the target sensor recorded of the same touch.

        None if it recorded none at that time.
        """
        other = self.target_stream
        if other is None or not self.select_paired([index]):
            return None
        return other.frame(index), other.truth(index)

    def read_ground_truth(self, index: int) -> GroundTruth:
        """Return all ground truth of frame `index`."""
        other = self.read_target_observation(index)
        return GroundTruth(
            source_truth=self.read_source_truth(index),
            mesh=self.mesh,
            symmetry=self.symmetry,
            target_observation=None if other is None else other[0],
            target_truth=None if other is None else other[1],
        )

    def read_true_outputs(self, index: int, shown: tuple[str, ...] = ()) -> dict[str, object]:
        """Return stage -> true value on frame `index`; stages without known truth are absent.

        Of the `shown` stages and those that their previews read, where given.
        """
        facts = self.read_ground_truth(index)
        stages = [self.catalogue.stage(name) for name in self.stages]
        views = [self.catalogue.views[name] for name in self.stages if name in shown]
        needed = {*shown, *(other for view in views for other in view.preview_stages)}
        stages = [stage for stage in stages if not shown or stage.name in needed]
        values = {
            s.name: s.make_ground_truth(
                facts, self.source if s.sensor_role == "source" else self.target
            )
            for s in stages
        }
        return {name: value for name, value in values.items() if value is not None}

    def compute_metrics(self, results: Mapping[str, StageResult], index: int) -> dict[str, float]:
        """Return all metrics against the truth of frame `index`, as stage.metric.

        See `METRICS` for units.
        """
        return self.compute_metrics_against(results, self.read_ground_truth(index))

    def compute_metrics_against(
        self, results: Mapping[str, StageResult], facts: GroundTruth
    ) -> dict[str, float]:
        """Return all metrics against the given ground truth."""
        return {
            f"{name}.{figure}": value
            for name, result in results.items()
            for figure, value in self.catalogue.stage(name)
            .compute_metrics(result.output, facts)
            .items()
        }

    def close(self) -> None:
        """Close the recording's file."""
        self.recording.close()

    def check_index(self, index: int) -> int:
        """Return `index` if there is such a frame; raises SettingProblem otherwise."""
        return check_frame_index(index, self.n_frames)


def open_translation(
    request: Request,
    catalogue: Catalogue = BUILT_IN,
    *,
    recording: Recording | None = None,
    mesh: Mesh | None = None,
    settings: Sequence[str] = (),
    cache_bytes: int = DEFAULT_MAX_BYTES,
) -> Translation:
    """Open and check all that `request` names; raises TouchError with what is wrong and where.

    `recording` and `mesh` are those at hand, in place of the files. `settings` are
    `stage.parameter=value`. `cache_bytes` bounds the results that are held.
    """
    # report a wrong name before anything is read
    check_device(request.device)
    methods = catalogue.methods(request.route, dict(request.methods))
    target = load_sensor(request.target)
    recording = recording or open_recording(
        request.recording,
        sensor=request.source,
        stream=request.stream,
        reference=request.reference,
        reference_frames=request.reference_frames,
        depth_unit=request.depth_unit,
    )
    if mesh is not None:
        recording = replace(recording, object_mesh=mesh, symmetry=None)
    try:
        opened = _open_with(recording, request, target, methods, catalogue)
        params = with_settings(opened.methods, settings)
    except Exception:
        recording.close()
        raise
    return replace(opened, params=params, graph=Graph((), cache=Cache(cache_bytes)))


def _open_with(
    recording: Recording,
    request: Request,
    target: SensorSpec,
    methods: tuple[Method, ...],
    catalogue: Catalogue,
) -> Translation:
    """Open and check what `request` names beside its recording."""
    said = load_sensor(request.source) if request.source else None
    stream = recording.stream(request.stream or (said.name if said else ""))
    if not stream.sensor:
        unknown = UnknownSensor(
            "the recording does not say which sensor made it; choose one (--sensor): "
            f"'{request.recording}'"
        )
        unknown.alternatives = recording.alternatives
        raise unknown
    source = said or load_sensor(stream.sensor)
    mesh = recording.object_mesh
    if request.mesh is not None:
        mesh = load_mesh(request.mesh, unit=request.mesh_unit)
    calibration = None if request.calibration is None else load_if_present(request.calibration)
    translation = Translation(
        request=request,
        recording=recording,
        stream=stream,
        source=source,
        target=target,
        alignment=request.offsets.apply_to(_alignment(request, recording, stream, source, target)),
        calibration=calibration,
        mesh=mesh,
        notes=(
            *recording.notes,
            *_about_source(request, recording, stream, target),
            *_about_pairs(recording, stream, target),
            *_about_symmetry(recording, stream, mesh),
            *_about_weights(request, methods, catalogue),
            *_about_methods(request, methods),
            *_about_kinds(request, source, target, catalogue),
        ),
        symmetry=recording.symmetry if mesh is recording.object_mesh else None,
        force_scale=_load_force_scale(request.calibration, source),
        catalogue=catalogue,
        load_context_images=_context_image_loader(calibration, recording, stream, source),
    )
    if request.weights and request.refuses_unusable_weights:
        translation.check_given_weights()
    return translation


def _context_image_loader(
    calibration: Calibration | None, recording: Recording, stream: Stream, source: SensorSpec
) -> ContextLoader:
    """Return a loader of the context images that determine the illumination, chosen when a frame is
    first read.

    They are of the frame's own reference, and so of its sensor instance. A calibration table
    contains the illumination. A growing recording has no fixed context.
    """
    if source.optics is None or calibration is not None or recording.refresh is not None:
        return load_nothing
    select = cache(lambda: select_context_frames(stream))

    @cache
    def load(reference_digest: str) -> tuple[Image, ...]:
        same = [one for one in select() if compute_cached_digest(one.reference) == reference_digest]
        return tuple(cast("Image", one.image) for one in same)

    return lambda reference: load(compute_cached_digest(reference))


def _load_force_scale(path: Path | None, source: SensorSpec) -> ForceScale | None:
    """Return the force scale of a calibration file.

    Raises CalibrationError for one of another sensor.
    """
    scale = None if path is None else load_force_scale(path)
    if scale is not None and scale.sensor != source.name:
        raise CalibrationError(
            f"the weighings are of {scale.sensor}, not of {source.name}: '{path}'"
        )
    return scale


def _about_source(
    request: Request, recording: Recording, stream: Stream, target: SensorSpec
) -> tuple[str, ...]:
    """Return a note where nobody chose the stream: one of several of a sensor, or the target's
    own sensor.
    """
    alike = [other.name for other in recording.streams if other.sensor == stream.sensor]
    if not request.stream and len(alike) > 1:
        return (
            f"{len(alike)} streams are of {stream.sensor} ({', '.join(alike)}); {stream.name} is "
            "read (--stream)",
        )
    others = [other.name for other in recording.streams if other.sensor not in ("", target.name)]
    if request.stream or request.source or stream.sensor != target.name or not others:
        return ()
    return (
        f"source and target are both {target.name}; choose the source {' or '.join(others)} "
        "(--stream)",
    )


def _about_pairs(recording: Recording, stream: Stream, target: SensorSpec) -> tuple[str, ...]:
    """Return a note where frames of the source or the target's own stream have no partner."""
    other = recording.find_partner(stream.name, target.name)
    note = "" if other is None else pair_frames(stream, other).note
    return (note,) if note else ()


def _about_symmetry(recording: Recording, stream: Stream, mesh: Mesh | None) -> tuple[str, ...]:
    """Return a note on pose errors where the object's symmetry is unknown."""
    if (
        mesh is None
        or not stream.has_truth
        or (mesh is recording.object_mesh and recording.symmetry is not None)
    ):
        return ()
    return ("the object's symmetry is not known; pose errors count every turn as one",)


def _about_weights(
    request: Request, methods: tuple[Method, ...], catalogue: Catalogue
) -> tuple[str, ...]:
    """Return a warning about weights that no method reads."""
    learned = {method.stage for method in methods if method.weights is not None}
    unread = [
        (stage, file)
        for stage, file in request.weights
        if (stage not in learned if stage else not learned)
    ]
    return tuple(
        f"the weights {file.name!r} count for nothing: "
        f"{f'the method of {stage} reads none' if stage else 'no method reads any'}; "
        f"{_suggest_methods(stage, catalogue)}"
        for stage, file in unread
    )


def _about_methods(request: Request, methods: tuple[Method, ...]) -> tuple[str, ...]:
    """Return a note on methods chosen for stages that the route leaves out."""
    stages = {method.stage for method in methods}
    return tuple(
        f"the method {name!r} of {stage} is not used: the route {request.route!r} has no such stage"
        for stage, name in request.methods
        if stage not in stages
    )


def _about_kinds(
    request: Request, source: SensorSpec, target: SensorSpec, catalogue: Catalogue
) -> tuple[str, ...]:
    """Return a warning about each chosen method that is for another kind of sensor, and names
    the one that answers.
    """
    notes: list[str] = []
    kinds: dict[SensorRole, str] = {"source": source.kind, "target": target.kind}
    answering = {m.stage: m for m in catalogue.methods(request.route, dict(request.methods), kinds)}
    for stage, name in request.methods:
        chosen = catalogue.method(stage, name)
        answer = answering.get(stage)
        if answer is not None and answer.name != chosen.name:
            sensor = source if catalogue.stage(stage).sensor_role == "source" else target
            notes.append(
                StageWarning(
                    f"{stage}: {chosen.title!r} is for sensors of kind "
                    f"{' or '.join(chosen.kinds)}, and {sensor.title} "
                    f"is a {sensor.kind}; {answer.title!r} answers instead ({stage}={answer.name})"
                )
            )
    return tuple(notes)


def _suggest_methods(stage: str, catalogue: Catalogue) -> str:
    """Return which methods of a stage, or of all for "", read weights."""
    methods = [
        m
        for entry in catalogue.stages
        if stage in ("", entry.name)
        for m in entry.methods
        if m.weights
    ]
    names = ", ".join(f"{method.stage}={method.name}" for method in methods)
    return f"choose one that does with --method: {names}" if names else "none of its methods does"


def _alignment(
    request: Request, recording: Recording, stream: Stream, source: SensorSpec, target: SensorSpec
) -> Alignment:
    """Return the alignment of the file; else of the recording; else of the sensor descriptions."""
    if request.alignment is not None:
        return load_alignment(request.alignment, source=source.name, target=target.name).alignment
    other = recording.find_partner(stream.name, target.name)
    known = None if other is None else recording.target_from_source(stream.name, other.name)
    return alignments.resolve_alignment(source, target, known)


def estimate_camera_shift_mm(frame: TactileFrame, spec: SensorSpec) -> float:
    """Return how much smaller z is in this frame's own camera than in the description's.

    0 if that is unknown.

    The camera of a depth recording may be nearer or farther than described; the alignment is about
    the membrane, so the two rest membranes are brought together along the optical axis. Raises
    ShapeError where they differ by a unit.
    """
    if not frame.is_depth or frame.reference is None or frame.camera is None:
        return 0.0
    rest = frame.reference
    rows, cols = rest.shape
    centre = rest[rows * 2 // 5 : rows * 3 // 5 + 1, cols * 2 // 5 : cols * 3 // 5 + 1]
    seen = centre[np.isfinite(centre) & (centre > 0)]
    if not seen.size:
        return 0.0
    r, c = spec.rest_depth_mm.shape
    described = spec.rest_depth_mm[r * 2 // 5 : r * 3 // 5 + 1, c * 2 // 5 : c * 3 // 5 + 1]
    problem = describe_unit_problem(float(np.median(seen)), spec)
    if problem:
        raise ShapeError(f"the reference of frame {frame.index} {problem}: '{frame.origin}'")
    return float(np.median(described) - np.median(seen))
