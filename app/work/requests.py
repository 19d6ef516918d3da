"""From a session to the pipeline's request, and to the depth parameters."""

from collections.abc import Mapping, Sequence, Set
from contextlib import closing
from dataclasses import replace

from app.session.state import REQUEST_FIELDS, Session
from pipeline.base.errors import FileProblem
from pipeline.base.params import list_settings
from pipeline.base.progress import Progress, reading_reported_to
from pipeline.engine.graph import Method
from pipeline.networks.guidance import NO_CONDITION_DROPOUT
from pipeline.networks.weights import NoWeights, Weights
from pipeline.recordings import open_recording
from pipeline.sensors.alignment_files import read_alignment
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.photometric import DepthParams
from pipeline.stages.depth.stage import PHYSICS
from pipeline.translation.catalogue import Catalogue
from pipeline.translation.translate import Request, Translation, open_translation


def make_request(session: Session) -> Request:
    """Build the request that opens a session with a recording."""
    fields = {name: getattr(session, name) for name in REQUEST_FIELDS}
    methods, weights = tuple(sorted(session.methods.items())), tuple(sorted(session.weights.items()))
    return Request(**fields, methods=methods, weights=weights)


def make_request_if_open(session: Session) -> Request | None:
    """Build the request of a session; None without a recording."""
    return None if session.recording is None else make_request(session)


def find_undo_target(
    sessions: Sequence[Session], at: int, opened: Set[Request | None], failing: Set[Request | None]
) -> int | None:
    """Return the undo index to go back to from `at`, which could not be opened; None if there is none.

    It is the nearest index whose request is open. If a change after an undo has removed that one from the stack, it
    is the nearest earlier index that is not known to fail.
    """
    earlier = range(at - 1, -1, -1)
    for index in (*earlier, *range(at + 1, len(sessions))):
        if make_request_if_open(sessions[index]) in opened:
            return index
    return next((i for i in earlier if (req := make_request_if_open(sessions[i])) and req not in failing), None)


def get_depth_params(session: Session, methods: Sequence[Method]) -> DepthParams:
    """Return the parameters of a session's depth by one of these methods, used for both sensors of a comparison."""
    depth = next((method for method in methods if issubclass(method.params, DepthParams)), PHYSICS)
    params = session.get_params(depth)
    assert isinstance(params, DepthParams)
    return params


def open_request(request: Request, catalogue: Catalogue) -> Translation:
    """Open a translation, to a default target if none is named; raises TouchError."""
    if not request.target:
        request = replace(request, target=_choose_target(request))
    translation = open_translation(request, catalogue)
    if translation.n_frames == 0:
        translation.close()
        raise FileProblem("the recording holds no frame; choose another", request.recording)
    return translation


def apply_session(session: Session, opened: Translation) -> Translation:
    """Return an open translation with the offsets and parameters of a session."""
    return replace(
        opened,
        alignment=session.offsets.apply_to(opened.alignment),
        params=session.collect_params(opened.methods),
    )


def _choose_target(request: Request) -> str:
    """Return the target of the alignment file, else another sensor of the recording, else one of another kind."""
    with closing(
        open_recording(
            request.recording,
            sensor=request.source,
            stream=request.stream,
            reference=request.reference,
            reference_frames=request.reference_frames,
            depth_unit=request.depth_unit,
        )
    ) as recording:
        stated = load_sensor(request.source).name if request.source else ""
        source = request.source or recording.stream(request.stream or stated).sensor
        others = [s.sensor for s in recording.streams if s.sensor not in ("", source)]
    file = None if request.alignment is None else read_alignment(request.alignment)
    if file is not None and file.source == source:
        return file.target
    kind = load_sensor(source).kind if source else ""  # of a sensor that nobody knows, which does not open
    if others:
        return next((name for name in others if load_sensor(name).kind != kind), others[0])
    return "soft_bubble" if kind == "gel" else "gelslim"


def explain_unavailable(opened: Translation, progress: Progress) -> Mapping[str, Mapping[str, str]]:
    """Method key -> parameter -> why it cannot act; reads the weights."""
    with reading_reported_to(progress):
        weights = opened.weights
    return {m.key: _explain(m, weights[m.weights_name]) for m in opened.methods if m.weights is not None}


def _explain(method: Method, weights: object) -> Mapping[str, str]:
    if isinstance(weights, NoWeights):
        settings = list_settings(method.params()).items()
        return {name: f"no network for this pair: {weights.why}" for name, (_, setting) in settings if setting.pinned}
    has_dropout = not isinstance(weights, Weights) or weights.trained_with_condition_dropout
    return {} if has_dropout else {"guidance": NO_CONDITION_DROPOUT}
