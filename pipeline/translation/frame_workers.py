"""Worker processes, one a core, that run frames of one translation through the stages.

Threads do not do it: the interpreter's lock lets two of them do the work of one. The workers are
started once and kept; each opens the translation with its first frame. Frames and results lie in
shared memory, a block a worker, so that what is under way is bounded.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import BrokenExecutor, Future
from contextlib import closing
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.core.errors import FileProblem, NotConverged
from pipeline.core.graph import StageResult
from pipeline.core.processes import WorkerPool
from pipeline.core.shared_memory import Parcel, SharedBlock
from pipeline.core.values.frames import Recording, Stream, TactileFrame
from pipeline.io.mounts import mount
from pipeline.translation.translate import Request, Translation, open_translation

if TYPE_CHECKING:
    from pipeline.core.geometry.meshes import Mesh
    from pipeline.core.geometry.symmetry import Symmetry
    from pipeline.core.values.results import ObjectPose
    from pipeline.sensors.alignment import Alignment

Results = Mapping[str, StageResult]
_BLOCK_BYTES = 32 << 20  # of a frame's results; those of a gel to a bubble take 4 MB
_CACHE_BYTES = 32 << 20  # of a worker's graph: what follows from the last frames


@dataclass(frozen=True, slots=True, kw_only=True)
class _Opening:
    """What a worker opens."""

    request: Request
    alignment: Alignment
    params: Mapping[str, object]
    live_sensor: str  # that makes the recording, which a worker cannot open; "" = it is a file
    mesh: Mesh | None
    symmetry: Symmetry | None


class FrameWorkers:
    """The workers of one translation; `close()` ends them."""

    def __init__(self, translation: Translation, n_workers: int = 0) -> None:
        """Start nothing yet; 0 = one worker a core."""
        self.n_workers = n_workers or os.cpu_count() or 1
        is_live = translation.recording.refresh is not None
        opening = _Opening(
            request=translation.request,
            alignment=translation.alignment,
            params=dict(translation.params),
            live_sensor=translation.stream.sensor if is_live else "",
            mesh=translation.mesh,
            symmetry=translation.symmetry,
        )
        self._methods = {method.stage: method for method in translation.methods}
        self._pool = WorkerPool(self.n_workers)
        self._opening = SharedBlock(_BLOCK_BYTES)
        self._opened = self._opening.name, self._opening.put(opening)
        self._free = [SharedBlock(_BLOCK_BYTES) for _ in range(self.n_workers)]
        self._blocks = tuple(self._free)

    @property
    def has_room(self) -> bool:
        """Whether a worker is idle."""
        return bool(self._free)

    def submit(
        self,
        frame: TactileFrame,
        stages: Sequence[str] | None = None,
        *,
        previous: ObjectPose | None = None,
        draft: bool = False,
    ) -> Future[Results]:
        """Have an idle worker compute stages of a frame, as `Translation.evaluate` does.

        `draft`: methods that have cheaper parameters for dragging use them. Raises NotConverged
        where a worker has died.
        """
        block = self._free.pop()
        answer: Future[Results] = Future()
        parcel = block.put((frame, previous))
        try:
            task = self._pool.submit(_evaluate, self._opened, block.name, parcel, stages, draft)
        except BrokenExecutor as error:
            raise NotConverged(
                "a worker process died, perhaps out of memory; start the translation again"
            ) from error
        task.add_done_callback(partial(self._finish, block, answer))
        return answer

    def _finish(self, block: SharedBlock, answer: Future[Results], task: Future[Parcel]) -> None:
        results: Sequence[StageResult] = ()
        problem: Exception | None = None
        if not task.cancelled():
            try:
                results = block.take(task.result())
            except Exception as error:  # noqa: BLE001 - whoever waits for the answer gets it
                problem = error
        self._free.append(block)
        if problem is not None:
            answer.set_exception(problem)
        elif not task.cancelled():
            answer.set_result(
                {one.name: replace(one, method=self._methods[one.name]) for one in results}
            )

    def close(self) -> None:
        """End the workers, whatever they are doing."""
        self._pool.__exit__(KeyboardInterrupt, None, None)
        for block in (self._opening, *self._blocks):
            block.close()


def _evaluate(
    opened: tuple[str, Parcel],
    block_name: str,
    parcel: Parcel,
    stages: Sequence[str] | None,
    draft: bool,
) -> Parcel:
    """Compute stages of the frame in a block, and leave the results there."""
    translation = _open_once(*opened)
    with closing(SharedBlock(name=block_name)) as block:
        frame, previous = block.take(parcel)
        if draft:
            translation = replace(translation, params=_make_draft_params(translation))
        results = translation.evaluate(frame, stages, previous=previous)
        return block.put([replace(one, method=None, nodes=()) for one in results.values()])


@lru_cache(maxsize=1)
def _open_once(name: str, parcel: Parcel) -> Translation:
    with closing(SharedBlock(name=name)) as block:
        opening: _Opening = block.take(parcel)
    if opening.live_sensor:
        path = opening.request.recording
        mount(path, lambda: _make_recording(path, opening))
    translation = open_translation(opening.request, cache_bytes=_CACHE_BYTES)
    return replace(
        translation,
        alignment=opening.alignment,
        params=opening.params,
        mesh=opening.mesh,
        symmetry=opening.symmetry,
    )


def _make_recording(path: Path, opening: _Opening) -> Recording:
    """A recording that grows elsewhere: its frames are handed over one by one."""

    def refuse(index: int) -> Any:
        raise FileProblem(f"frame {index} was not handed over", path)

    sensor = opening.live_sensor
    stream = Stream(name=sensor, sensor=sensor, n_frames=0, frame=refuse, truth=lambda _: None)
    return Recording(
        path=path,
        format="live sensor",
        streams=(stream,),
        object_mesh=opening.mesh,
        symmetry=opening.symmetry,
        refresh=lambda: _make_recording(path, opening),
    )


def _make_draft_params(translation: Translation) -> dict[str, object]:
    """The parameters with those for dragging where a method has them."""
    params = dict(translation.params)
    for method in translation.methods:
        own = params.get(method.stage)
        own = own if isinstance(own, method.params) else method.params()
        params[method.stage] = own if method.draft is None else method.draft(own)
    return params
