"""What a session asks of the pipeline: the request that it opens, and how depth is worked out."""

from __future__ import annotations

from collections.abc import Sequence, Set
from contextlib import closing
from dataclasses import replace

from app.session.state import REQUEST_FIELDS, Session
from pipeline.base.errors import FileProblem
from pipeline.recordings import open_recording
from pipeline.stages.depth.photometric import DepthParams
from pipeline.stages.depth.stage import NETWORK, PHYSICS
from pipeline.translation.catalogue import Catalogue
from pipeline.translation.translate import Request, Translation, open_translation


def make_request(session: Session) -> Request:
    """What a session, which has a recording, asks the pipeline to open."""
    asked = {name: getattr(session, name) for name in REQUEST_FIELDS}
    methods, weights = tuple(sorted(session.methods.items())), tuple(sorted(session.weights.items()))
    return Request(**asked, methods=methods, weights=weights)


def make_request_if_open(session: Session) -> Request | None:
    """As `request_of`; None where nothing is to be opened."""
    return None if session.recording is None else make_request(session)


def find_undo_target(
    sessions: Sequence[Session], at: int, opened: Set[Request | None], failing: Set[Request | None]
) -> int | None:
    """Where on the undo stack to go back to from its place `at`, which could not be opened; None = nowhere.

    To the nearest that is open. Who went backwards and chose anew has cut that off the stack: then to the nearest
    before that is not known to fail as well.
    """
    before = range(at - 1, -1, -1)
    for place in (*before, *range(at + 1, len(sessions))):
        if make_request_if_open(sessions[place]) in opened:
            return place
    return next((i for i in before if (asked := make_request_if_open(sessions[i])) and asked not in failing), None)


def get_depth_params(session: Session) -> DepthParams:
    """How a session has its depth worked out, on both sides of a comparison."""
    params = session.get_params(PHYSICS if session.methods.get(PHYSICS.stage) == PHYSICS.name else NETWORK)
    assert isinstance(params, DepthParams)
    return params


def open_request(request: Request, catalogue: Catalogue) -> Translation:
    """The translation, to another sensor of the recording where no target is named; raises TouchError."""
    if not request.target:
        request = replace(request, target=_best_target(request))
    translation = open_translation(request, catalogue)
    if translation.n_frames == 0:
        translation.close()
        raise FileProblem("the recording holds no frame; choose another", request.recording)
    return translation


def _best_target(request: Request) -> str:
    """The other sensor of the same recording, else one that differs from the source."""
    with closing(
        open_recording(
            request.recording, sensor=request.source, reference=request.reference, depth_unit=request.depth_unit
        )
    ) as recording:
        source = recording.stream(request.stream or request.source).sensor
        others = [s.sensor for s in recording.streams if s.sensor not in ("", source)]
    if others:
        return others[0]
    return "soft_bubble" if source.startswith("gelslim") else "gelslim"
