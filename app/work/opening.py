"""What a session asks of the pipeline: the request that it opens, and how depth is worked out."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

from app.session.state import ASKED, Session
from pipeline.base.errors import FileProblem
from pipeline.recordings import open_recording
from pipeline.stages.depth.slot import PHYSICS
from pipeline.stages.depth.stage import DepthParams
from pipeline.translation.catalogue import Catalogue
from pipeline.translation.translate import Request, Translation, open_translation


def request_of(session: Session) -> Request:
    """What a session, which has a recording, asks the pipeline to open."""
    asked = {name: getattr(session, name) for name in ASKED}
    methods, weights = tuple(sorted(session.methods.items())), tuple(sorted(session.weights.items()))
    return Request(**asked, methods=methods, weights=weights)


def depth_params(session: Session) -> DepthParams:
    """How a session has its depth worked out, on both sides of a comparison."""
    params = session.params_of(PHYSICS)
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
