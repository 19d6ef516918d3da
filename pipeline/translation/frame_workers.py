"""Worker processes, one a core, that run frames of one translation through the stages.

Threads do not do it: the interpreter's lock lets two of them do the work of one. The workers are
started once and kept; each opens the translation with its first frame. Frames and results lie in
shared memory, a block a worker, so that what is under way is bounded.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import BrokenExecutor, Future
from contextlib import suppress
from dataclasses import field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from pipeline.core.errors import FileProblem, NotConverged, TouchError
from pipeline.core.frozen import frozen
from pipeline.core.graph import StageResult
from pipeline.core.processes import WorkerPool
from pipeline.core.shared_memory import Parcel, SharedBlock
from pipeline.core.values.frames import Recording, Stream, TactileFrame
from pipeline.io.mounts import mount
from pipeline.physics.simulation.datasets import SimulationPlan, simulate_moment
from pipeline.translation.catalogue import default_params
from pipeline.translation.following import FROM_REST, Start, get_start
from pipeline.translation.translate import Request, Translation, open_translation

if TYPE_CHECKING:
    from pipeline.core.geometry.meshes import Mesh
    from pipeline.core.geometry.symmetry import Symmetry
    from pipeline.sensors.alignment import Alignment

Results = Mapping[str, StageResult]
_BLOCK_BYTES = 32 << 20  # of a frame's results; those of a gel to a bubble take 4 MB
_NICE = 5
_TOUCHED = 8  # the middle of a simulated press, slide, twist and release
CACHE_BYTES = 32 << 20  # of a graph whose frames do not return: what follows from the last ones


Shared = tuple[str, Parcel]  # a value in a block, which a worker takes once


@frozen
class Opening:
    """What a worker opens once for all that it is asked."""

    token: str  # of this opening, by which alone it is known
    request: Request = field(compare=False)
    params: Mapping[str, object] = field(compare=False)
    alignment: Alignment = field(compare=False)
    # that makes the recording, which a worker cannot open; "" = it is a file
    live_sensor: str = field(compare=False)
    # that the request does not name; None = the one that it opens
    mesh: Mesh | None = field(compare=False)
    symmetry: Symmetry | None = field(compare=False)


def describe_opening(translation: Translation) -> Opening:
    """Return how a worker opens a translation again, which `open_once` does."""
    request = translation.request
    recording = translation.recording
    is_live = recording.refresh is not None
    is_named = request.mesh is not None or translation.mesh is recording.object_mesh
    return Opening(
        token=uuid4().hex,
        request=request,
        params=dict(translation.params),
        alignment=translation.alignment,
        live_sensor=translation.stream.sensor if is_live else "",
        mesh=None if is_named and not is_live else translation.mesh,
        symmetry=translation.symmetry,
    )


@lru_cache(maxsize=1)
def open_once(opening: Opening) -> Translation:
    """Open a translation in a worker, which keeps it open until it is asked for another one."""
    path = opening.request.recording
    if opening.live_sensor:
        mount(path, lambda: _make_recording(path, opening))
    opened = open_translation(opening.request, cache_bytes=CACHE_BYTES)
    opened = replace(opened, alignment=opening.alignment, params=opening.params)
    if opening.mesh is None:
        return opened
    return replace(opened, mesh=opening.mesh, symmetry=opening.symmetry)


class FrameWorkers:
    """The workers of one translation; `close()` ends them."""

    def __init__(self, translation: Translation, n_workers: int = 0) -> None:
        """Start nothing yet; 0 = one worker a core."""
        self.n_workers = n_workers or os.cpu_count() or 1
        # whether a draft differs from what the methods compute
        self.has_draft = _make_draft_params(translation) != _make_full_params(translation)
        self._methods = {method.stage: method for method in translation.methods}
        # a reader, a recorder and a window come first
        self._pool = WorkerPool(self.n_workers, nice=_NICE)
        self._free = [SharedBlock(_BLOCK_BYTES) for _ in range(self.n_workers)]
        self._blocks = list(self._free)
        self._opened = self.share(describe_opening(translation))

    def share(self, value: object) -> Shared:
        """Hand over a value that many frames are computed with, until `close`."""
        block = SharedBlock(_BLOCK_BYTES)
        self._blocks.append(block)
        return block.name, block.put(value)

    def warm_up(self) -> None:
        """Have every worker start, and load and compile what a touched frame needs, before it has
        room: a frame that waits for that would be seconds old.
        """
        blocks = list(self._free)
        self._free.clear()
        for block in blocks:
            task = self._pool.submit(_compute_simulated_touch, self._opened)
            task.add_done_callback(partial(self._release, block))

    def _release(self, block: SharedBlock, _task: Future[None]) -> None:
        self._free.append(block)

    @property
    def has_room(self) -> bool:
        """Whether a worker is idle."""
        return bool(self._free)

    def submit(
        self,
        frame: TactileFrame,
        stages: Sequence[str] | None = None,
        *,
        start: Start = FROM_REST,
        context: Shared | None = None,
        draft: bool = False,
    ) -> Future[Results]:
        """Have an idle worker compute stages of a frame, as `Translation.evaluate` does.

        `context` are the shared context images. `draft`: methods that have cheaper parameters for
        dragging use them. Raises NotConverged where a worker has died.
        """
        block = self._free.pop()
        answer: Future[Results] = Future()
        parcel = block.put((frame, start))
        try:
            task = self._pool.submit(
                _evaluate, self._opened, block.name, parcel, stages, context, draft
            )
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
        for block in self._blocks:
            block.close()


def _evaluate(
    opened: Shared,
    block_name: str,
    parcel: Parcel,
    stages: Sequence[str] | None,
    context: Shared | None,
    draft: bool,
) -> Parcel:
    """Compute stages of the frame in a block, and leave the results there."""
    translation = open_once(_take_once(*opened))
    block = _attach(block_name)
    frame, start = block.take(parcel)
    if context is not None:
        frame = replace(frame, context_frames=_take_once(*context))
    if draft:
        translation = replace(translation, params=_make_draft_params(translation))
    results = translation.evaluate(frame, stages, start=start)
    return block.put([replace(one, method=None, nodes=()) for one in results.values()])


def _compute_simulated_touch(opened: Shared) -> None:
    """Compute two frames of a press in a row; a sensor that cannot be simulated is opened only."""
    translation = open_once(_take_once(*opened))
    with suppress(TouchError):
        plan = SimulationPlan(
            sensors=(translation.stream.sensor,),
            object_source="sphere",
            n_poses=2 * _TOUCHED,
            seed=0,
            sequence="all",
        )
        start = FROM_REST
        for index in (_TOUCHED, _TOUCHED + 1):
            frame, _ = simulate_moment(plan, index)[0]
            start = get_start(translation.evaluate(frame, start=start))


@lru_cache
def _attach(name: str) -> SharedBlock:
    return SharedBlock(name=name)


@lru_cache(maxsize=4)
def _take_once(name: str, parcel: Parcel) -> Any:
    return _attach(name).take(parcel)


def _make_recording(path: Path, opening: Opening) -> Recording:
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


def _make_full_params(translation: Translation) -> dict[str, object]:
    """The parameters, with the defaults where none are given."""
    params = default_params(translation.methods)
    for method in translation.methods:
        own = translation.params.get(method.stage)
        params[method.stage] = own if isinstance(own, method.params) else params[method.stage]
    return params


def _make_draft_params(translation: Translation) -> dict[str, object]:
    """The parameters with those for dragging where a method has them."""
    params = _make_full_params(translation)
    for method in translation.methods:
        if method.draft is not None:
            params[method.stage] = method.draft(params[method.stage])
    return params
