"""The touches of a recorded rollout: its fingers, and the translation that gives what its controller read."""

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

from pipeline.recordings import hdf5
from pipeline.tasks.catalogue import load_task
from pipeline.tasks.task import RecordedRollout
from pipeline.tasks.touches import choose_route
from pipeline.translation.translate import Request
from pipeline.values.frames import Recording


def list_places(path: Path) -> Mapping[str, str]:
    """Stream of the source -> title, for every finger or plate of a rollout that records two sensors."""
    with closing(hdf5.read(path)) as recording:
        return _list_places(recording)


def _list_places(recording: Recording) -> Mapping[str, str]:
    sensors = {stream.name: stream.sensor for stream in recording.streams}
    return {
        pair.source: pair.source.removeprefix(f"{sensors.get(pair.source, '')}_").replace("_", " ")
        for pair in recording.pairings
        if pair.source in sensors
    }


def make_touch_request(rollout: RecordedRollout, stream: str = "") -> Request:
    """The translation of a rollout's frames by the method that its controller read; "" = the first finger."""
    task = load_task(rollout.plan.task)
    chosen = choose_route(rollout.summary.touch, task.source, task.target)
    return Request(
        recording=rollout.path, source=task.source, target=task.target, stream=stream, route=chosen.route,
        methods=chosen.methods, weights=chosen.weights,
    )  # fmt: skip
