"""Recorded pairs of two sensors as training examples: folders of a data set, with validation pairs
held out.

Both fingers of a grasp are pairs of their own and have one role. Two splits validate: other grasps
of the same tools, and other tools. Both are disjoint, and neither holds a grasp that is trained on.
Pairs are read when they are drawn.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.core.arrays import Mask, freeze
from pipeline.core.errors import FileProblem, SettingProblem, escape_text
from pipeline.core.frozen import frozen
from pipeline.core.memo import Memo
from pipeline.core.values.frames import Grasp, Recording, Stream, TactileFrame, Truth
from pipeline.core.values.pairing import NO_PARTNER, pair_frames
from pipeline.io import open_recording
from pipeline.io.grasp_files import is_grasp_folder, is_training_split, read_split_file
from pipeline.io.inspection.synchrony import compare_streams
from pipeline.lab.training.task import Split, Task
from pipeline.physics.simulation import shapes
from pipeline.sensors import alignment as alignments
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec, load_sensor

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.lab.training.task import Example

Role = Literal["training", "unseen_grasps", "unseen_tools", "left_out"]
BY_TOOL = "tool"
# held out: of 12 tools 3, as the lab's code does; of grasps a fifth, as well
_TOOL_SHARE = 0.25
_GRASP_SHARE = 0.2
_MAX_NAMES = 12  # in a message
HOLD_OUT_HELP = (
    "`tool` for a quarter of the tools, names of tools separated by commas, `lab` or `paper` for "
    "published lists of "
    "tools, or a split.json; without it the splits of the folder, else `tool`"
)


@frozen
class ToolSplit:
    """A published split by tools."""

    training: tuple[str, ...]
    unseen: tuple[str, ...]


def list_tool_splits() -> Mapping[str, ToolSplit]:
    """Published splits by name.

    `lab`: the tools that train_single.py of the lab's depth_anything_v2 lists. `paper`: the twelve
    training objects of the simulated catalogue, which stand for the paper's, and its six unseen
    ones.
    """
    lab = (
        "01_2_lines_angle_1",
        "02_2_lines_angle_2",
        "03_2_lines_angle_3",
        "04_3_lines_angle_1",
        "06_5_lines_angle_1",
        "31_rod",
        "32",
        "33",
        "37",
    )
    return {
        "lab": ToolSplit(
            training=tuple(f"pattern_{name}" for name in lab),
            unseen=("pattern_05_3_lines_angle_2", "pattern_35", "pattern_36"),
        ),
        "paper": ToolSplit(
            training=tuple(shapes.list_shapes("training")),
            unseen=tuple(shapes.list_shapes("unseen")),
        ),
    }


def assign_roles(
    grasps: Sequence[Grasp], hold_out: str = "", share: float = 1.0
) -> tuple[tuple[Role, ...], tuple[str, ...]]:
    """The role of every grasp, and what was decided; `hold_out` is as `HOLD_OUT_HELP` says. The
    same grasps give the same roles.

    Of the grasps to train on, `share` is used, at least one and more for a larger share; the others
    are left out.

    Raises SettingProblem for an unknown tool or where nothing is left to train on, FileProblem for
    a split file.
    """
    has_own_splits = any(not is_training_split(grasp.split) for grasp in grasps)
    if hold_out.endswith(".json"):
        split_of = read_split_file(Path(hold_out))
        roles = _roles_by_split(grasps, [split_of.get((g.tool, g.number)) for g in grasps])
    elif not hold_out and has_own_splits:
        roles = _roles_by_split(grasps, [grasp.split for grasp in grasps])
    else:
        tools = {grasp.tool for grasp in grasps}
        roles = _roles_by_tool(grasps, _select_tools(tools, hold_out or BY_TOOL))
    trained = np.flatnonzero([role == "training" for role in roles])
    if not trained.size:
        raise SettingProblem(
            f"no grasp is left to train on with --hold-out {hold_out or BY_TOOL}; hold out fewer "
            "tools"
        )
    n_used = max(1, round(share * len(trained)))
    for k in np.random.default_rng(0).permutation(trained)[n_used:]:
        roles[k] = "left_out"
    notes = [_describe_roles(grasps, roles)]
    if share < 1.0:
        notes.append(f"of {len(trained)} grasps to train on a share of {share:g} is used")
    return tuple(roles), tuple(notes)


def _roles_by_split(grasps: Sequence[Grasp], splits: Sequence[str | None]) -> list[Role]:
    """Roles by a data set's splits; grasps of split None, which a file does not list, are left
    out.
    """
    trained = {
        grasp.tool
        for grasp, split in zip(grasps, splits, strict=True)
        if split is not None and is_training_split(split)
    }

    def find_role(grasp: Grasp, split: str | None) -> Role:
        if split is None:
            return "left_out"
        if is_training_split(split):
            return "training"
        return "unseen_grasps" if grasp.tool in trained else "unseen_tools"

    return [find_role(grasp, split) for grasp, split in zip(grasps, splits, strict=True)]


def _select_tools(tools: set[str], hold_out: str) -> ToolSplit:
    """The tools to train on and to hold out."""
    names = sorted(tools)
    published = list_tool_splits().get(hold_out)
    if published is not None:
        return published
    if hold_out == BY_TOOL:
        n = max(1, round(_TOOL_SHARE * len(names))) if len(names) > 1 else 0
        unseen = {names[k] for k in np.random.default_rng(0).permutation(len(names))[:n]}
    else:
        unseen = {name.strip() for name in hold_out.split(",")}
        unknown = sorted(unseen - tools)
        if unknown:
            raise SettingProblem(f"no tool {unknown[0]!r} to hold out; there are {_shorten(names)}")
    return ToolSplit(training=tuple(tools - unseen), unseen=tuple(sorted(unseen)))


def _roles_by_tool(grasps: Sequence[Grasp], tools: ToolSplit) -> list[Role]:
    """Unseen tools by name, and a fifth of the grasps of every other tool."""
    roles: list[Role] = ["unseen_tools" if g.tool in tools.unseen else "left_out" for g in grasps]
    for tool in tools.training:
        own = [k for k, grasp in enumerate(grasps) if grasp.tool == tool]
        n_held_out = math.ceil(_GRASP_SHARE * len(own)) if len(own) > 1 else 0
        for place, k in enumerate(np.random.default_rng(0).permutation(len(own))):
            roles[own[k]] = "unseen_grasps" if place < n_held_out else "training"
    return roles


def _describe_roles(grasps: Sequence[Grasp], roles: Sequence[Role]) -> str:
    counts = Counter(roles)
    unseen = {g.tool for g, role in zip(grasps, roles, strict=True) if role == "unseen_tools"}
    text = (
        f"{counts['training']} grasps are trained on, {counts['unseen_grasps']} validate as unseen "
        f"grasps, {counts['unseen_tools']} validate as unseen tools"
    )
    if unseen:
        text += f" ({_shorten(sorted(unseen))})"
    if counts["left_out"]:
        text += f", {counts['left_out']} belong to no list and are left out"
    return text


def _shorten(names: Sequence[str]) -> str:
    return escape_text(", ".join(names[:_MAX_NAMES])) + (", ..." if names[_MAX_NAMES:] else "")


_MAX_UNTOUCHED = 1000  # pairs in a row that a task cannot use
_MAX_LISTED = 5  # in a note
_SUFFIXES = (".h5", ".hdf5", ".pt")
# of files of gelslim_depth
_SPLIT_NAME = re.compile(r"^(?P<tool>.+)_(?P<split>train|val|validation|test)$")
_SEED = 29  # of validation examples


class NoPairs(SettingProblem):
    """A recording does not hold both sensors."""


@frozen
class PairFolder:
    """Recorded pairs that a recipe trains on."""

    path: str = ""  # file or folder; "" = none
    hold_out: str = ""  # as `hold_out.HOLD_OUT_HELP` says
    share: float = 1.0  # of the grasps to train on that is used


@frozen
class RecordedPair:
    """The frames of one touch by both sensors."""

    source: SensorSpec
    target: SensorSpec
    source_frame: TactileFrame
    target_frame: TactileFrame
    target_truth: Truth | None
    alignment: Alignment


@frozen
class PairPlace:
    """Where a pair is: streams of one recording, and the frame."""

    recording: Recording
    source_stream: Stream
    target_stream: Stream
    index: int  # of the source's frame
    target_index: int
    grasp: Grasp


@frozen
class PairSet:
    """All pairs of two sensors in a file or folder."""

    source: SensorSpec
    target: SensorSpec
    places: Mapping[Role, tuple[PairPlace, ...]]
    notes: tuple[str, ...]

    def load(self, place: PairPlace) -> RecordedPair:
        """Read the frames of a pair; raises FileProblem."""
        recording = place.recording
        one = place.source_stream
        other = place.target_stream
        transform = recording.target_from_source(one.name, other.name)
        return RecordedPair(
            source=self.source,
            target=self.target,
            source_frame=one.frame(place.index),
            target_frame=other.frame(place.target_index),
            target_truth=other.truth(place.target_index),
            alignment=alignments.resolve_alignment(self.source, self.target, transform),
        )


@lru_cache(maxsize=4)
def open_pairs(folder: PairFolder, source_name: str, target_name: str) -> PairSet:
    """The pairs of a recording, a data set's folder, or a folder of recordings, by role.

    A sensor with itself gives its touches with their truth.

    Raises NoPairs where a sensor has no stream, FileProblem where nothing is paired.
    """
    source = load_sensor(source_name)
    target = load_sensor(target_name)
    path = Path(folder.path)
    files = _list_recordings(path)
    notes: dict[str, None] = {}
    found: list[tuple[PairPlace, ...]] = []  # of each moment, one per finger
    for file in files:
        recording = open_recording(file)
        streams = _match_streams(recording, source_name, target_name)
        if not streams:
            raise NoPairs(f"{str(file)!r} holds no pairs of {source.title} and {target.title}")
        wrong: list[str] = []
        for moment in _list_moments(recording, streams, file):
            if recording.find_pair_problem(moment[0].index):
                wrong.append(moment[0].grasp.name)
            else:
                found.append(moment)
        notes |= dict.fromkeys(_describe_recording(recording, streams, wrong))
    if not found:
        raise FileProblem("both sensors are recorded at no moment", path)
    grasps = [moment[0].grasp for moment in found]
    roles, decided = assign_roles(grasps, folder.hold_out, folder.share)
    places: dict[Role, list[PairPlace]] = {}
    for moment, role in zip(found, roles, strict=True):
        places.setdefault(role, []).extend(moment)
    return PairSet(
        source=source,
        target=target,
        notes=(*decided, *notes),
        places={role: _shuffle(of_role) for role, of_role in places.items()},
    )


def _shuffle(places: Sequence[PairPlace]) -> tuple[PairPlace, ...]:
    """Mix the tools, so that the first pairs are of all of them."""
    return tuple(places[k] for k in np.random.default_rng(0).permutation(len(places)))


def _list_recordings(path: Path) -> list[Path]:
    """The recordings of a folder that is not one recording itself, else the path."""
    if not path.is_dir() or is_grasp_folder(path):
        return [path]
    return sorted(file for file in path.rglob("*") if file.suffix in _SUFFIXES) or [path]


def _name_grasps(file: Path, n: int) -> tuple[Grasp, ...]:
    """Grasps of a recording of one tool, which its name tells, perhaps with the split:
    `<tool>_train.pt`.
    """
    match = _SPLIT_NAME.match(file.stem)
    tool, split = (match["tool"], match["split"]) if match else (file.stem, "")
    return tuple(Grasp(tool=tool, split=split, number=k) for k in range(n))


def _match_streams(recording: Recording, source: str, target: str) -> list[tuple[Stream, Stream]]:
    """Streams of both sensors in their order: right finger with right finger."""
    ones, others = ([s for s in recording.streams if s.sensor == name] for name in (source, target))
    return list(zip(ones, others, strict=False))


def _list_moments(
    recording: Recording, streams: Sequence[tuple[Stream, Stream]], file: Path
) -> list[tuple[PairPlace, ...]]:
    """The places of every frame of the source that any finger has a partner for."""
    n = max(one.n_frames for one, _ in streams)
    grasps = recording.grasps or _name_grasps(file, n)
    moments = [list[PairPlace]() for _ in range(n)]
    for one, other in streams:
        for index, partner in enumerate(pair_frames(one, other).partners.tolist()):
            if partner != NO_PARTNER:
                moments[index].append(
                    PairPlace(
                        recording=recording,
                        source_stream=one,
                        target_stream=other,
                        index=index,
                        target_index=partner,
                        grasp=grasps[index],
                    )
                )
    return [tuple(moment) for moment in moments if moment]


def _describe_recording(
    recording: Recording, streams: Sequence[tuple[Stream, Stream]], wrong: Sequence[str]
) -> list[str]:
    one, other = streams[0]
    notes = list(recording.notes)
    if wrong:
        more = ", ..." if len(wrong) > _MAX_LISTED else ""
        notes.append(
            f"{len(wrong)} wrong pairs are left out: {', '.join(wrong[:_MAX_LISTED])}{more}; see "
            "inspect"
        )
    notes += [note for pair in streams if (note := pair_frames(*pair).note)]
    if one.sensor != other.sensor and recording.target_from_source(one.name, other.name) is None:
        notes.append("the recording has no target_from_source: the sensors' descriptions are used")
    for stream in (one, other):
        if stream.n_frames and stream.frame(0).reference is None:
            notes.append(f"{stream.name} has no reference image: the nominal one is used")
    synchrony = compare_streams(one, other) if one.sensor != other.sensor else None
    if synchrony is not None and synchrony.warning is not None:
        notes.append(str(synchrony.warning))
    return notes


@frozen
class PairTask(Task):
    """A task on recorded pairs; loss and metrics are the task's."""

    task: Any  # a Task that trains on pairs
    folder: PairFolder

    def sample(self, rng: np.random.Generator) -> Example:
        """An example of a pair that is trained on."""
        places = self._pairs.places["training"]
        order = (places[int(rng.integers(len(places)))] for _ in range(_MAX_UNTOUCHED))
        return self._make_example(order, rng, is_validation=False)

    def make_validation_example(self, split: Split, index: int) -> Example:
        """An example of a held-out pair."""
        places = self._pairs.places[split]
        order = (places[(index + k) % len(places)] for k in range(len(places)))
        return self._make_example(order, np.random.default_rng([_SEED, index]), is_validation=True)

    def count_validation_examples(self, split: Split) -> int:
        """Number of held-out pairs of a split."""
        return len(self._pairs.places.get(split, ()))

    def collect_notes(self) -> tuple[str, ...]:
        """What was held out, assumed or left out."""
        return self._pairs.notes

    def compute_loss(
        self, network: nn.Module, batch: Mapping[str, Tensor]
    ) -> tuple[Tensor, dict[str, Any]]:
        """The task's."""
        return self.task.compute_loss(network, batch)

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """The task's."""
        return self.task.evaluate(network, held_out)

    @property
    def _pairs(self) -> PairSet:
        return open_pairs(self.folder, *self.task.pair_sensors)

    def _make_example(
        self, order: Iterable[PairPlace], rng: np.random.Generator, *, is_validation: bool
    ) -> Example:
        for place in order:
            (prepared,) = _prepared.get_or_make(
                (self.task, place.recording.path, place.source_stream.name, place.index),
                lambda p=place: (self.task.prepare_pair(self._pairs.load(p)),),
            )
            if prepared is not None:
                return self.task.make_pair_example(prepared, rng, is_validation=is_validation)
        raise FileProblem(
            "no pair that was tried is touched on both sides and has what is trained on",
            self.folder.path,
        )


def derive_contact(truth: Truth, sensor: SensorSpec) -> Mask:
    """The contact of a truth; where none is stored, the indentation beyond the sensor's smallest.

    Public sets store the overlap of object and gel, which is 0 outside the contact.
    """
    if truth.contact is not None:
        return truth.contact
    assert truth.indentation_mm is not None
    return freeze(np.nan_to_num(truth.indentation_mm) > sensor.limits.contact_min_mm)


_prepared: Memo[tuple[Any, ...], tuple[Any]] = Memo(most_bytes=1 << 30)


def use_pairs(task: Task, folder: PairFolder) -> Task:
    """`task` on recorded pairs; `task` itself without a folder. Raises SettingProblem for a task
    that cannot.
    """
    if not folder.path:
        return task
    if not hasattr(task, "prepare_pair"):
        raise SettingProblem(
            f"the task {type(task).__name__} does not train on pairs; train t2t, latent, vqvae or "
            "depth_anything"
        )
    return PairTask(task=task, folder=folder)
