"""A recipe: all that decides what a training gives, as a TOML that can be read, changed and kept with the weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.base.files import read_toml
from pipeline.base.params import Value, list_settings, replace_value, setting
from pipeline.training.recorded_touches import RecordingSource
from pipeline.training.task import TASKS, Task, import_task_class

Precision = Literal["float32", "bf16"]
OptimiserKind = Literal["adamw", "adam"]
Schedule = Literal["cosine", "poly", "constant"]
RECIPES_FOLDER = Path(__file__).parent / "recipes"
P = TypeVar("P")


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingSettings:
    """The top of a recipe: how much is learned from."""

    seed: int = setting(0, "Seed", low=0, high=2**31)
    batch: int = setting(16, "Examples a step", low=1, high=4096, help="for each of several devices")
    steps: int = setting(10_000, "Steps", low=1, high=10**9, help="--minutes stands in place of it")
    n_cached_examples: int = setting(
        0, "Examples kept on the device", low=0, high=10**7,
        help="made once and each shown often, for a device that learns faster than they are made; 0 = each shown once",
    )  # fmt: skip
    initial_weights: str = setting("", "File of weights to begin with", help="empty = random ones")
    precision: Precision = setting("float32", "Precision", choices=Precision, help="of the network, not of its loss")


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimiser:
    """[optimiser]: how a loss becomes a change."""

    kind: OptimiserKind = setting("adamw", "Method", choices=OptimiserKind)
    learning_rate: float = setting(1e-3, "Learning rate", low=0.0, high=10.0)
    schedule: Schedule = setting("cosine", "Schedule", choices=Schedule, help="poly is (1 - t)^0.9")
    warm_up_steps: int = setting(100, "Warm-up", unit="steps", low=0, high=10**6)
    final_share: float = setting(0.01, "Final share of the learning rate", low=0.0, high=1.0)
    weight_decay: float = setting(0.01, "Weight decay", low=0.0, high=10.0)
    beta2: float = setting(0.99, "Memory of the squared gradient", low=0.0, high=0.99999)
    max_gradient_norm: float = setting(1.0, "Longest gradient", low=1e-6, high=1e9)
    ema_decay: float = setting(0.999, "Memory of the averaged weights", low=0.0, high=0.99999)


@dataclass(frozen=True, slots=True, kw_only=True)
class Validation:
    """[validation]: how often, and on how many held-out examples of each split."""

    n_evaluations: int = setting(10, "Times", low=1, high=10_000)
    n_examples: int = setting(48, "Examples", low=1, high=100_000)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Data:
    """[data]."""

    recorded_share: float = setting(0.2, "Share of own touches", low=0.0, high=1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """A whole recipe."""

    name: str
    task: str  # of `TASKS`
    settings: Task
    network: Mapping[str, Value]  # kind and the arguments of its class
    training: TrainingSettings = field(default_factory=TrainingSettings)
    optimiser: Optimiser = field(default_factory=Optimiser)
    rate_factors: Mapping[str, float] = field(default_factory=dict)  # beginning of a parameter's name -> times the rate
    validation: Validation = field(default_factory=Validation)
    recordings: tuple[RecordingSource, ...] = ()  # of the user, mixed in for a share
    recorded_share: float = 0.0

    @property
    def plain_values(self) -> dict[str, Any]:
        """All of it in plain values, for files and cards; equal ones give equal runs."""
        parts = {"training": self.training, "optimiser": self.optimiser, "settings": self.settings}
        plain = {name: {key: value for key, (value, _) in list_settings(part).items()} for name, part in parts.items()}
        if not self.training.n_cached_examples:
            del plain["training"]["n_cached_examples"]  # runs begun before there was such a thing go on
        own = [{key: value for key, (value, _) in list_settings(one).items()} for one in self.recordings]
        told = {"task": self.task, "network": dict(self.network), "rate_factors": dict(self.rate_factors), **plain}
        return told | ({"data": {"recorded_share": self.recorded_share, "recordings": own}} if own else {})


def list_shipped_recipes(what: str = "") -> tuple[str, ...]:
    """The names of the recipes that come along, of those that train `what` where that is given."""
    names = sorted(path.stem for path in RECIPES_FOLDER.glob("*.toml"))
    return tuple(n for n in names if not what or TASKS[read_toml(_path(n), "the recipe")["task"]].subcommand == what)


def load_recipe(name: str, what: str = "") -> Recipe:
    """The recipe of that name, or in that file.

    Raises SettingProblem for a name that does not exist and FileProblem for what is wrong inside, a recipe that trains
    something else than `what` included.
    """
    path = Path(name) if name.endswith(".toml") else _path(name)
    if not name.endswith(".toml") and not path.is_file():
        raise SettingProblem(
            f"no recipe {name!r}; there are {', '.join(list_shipped_recipes(what))}, or give a .toml file"
        )
    data = read_toml(path, "the recipe")
    try:
        made = _recipe(path.stem, data, path.parent)
        if what and TASKS[made.task].subcommand != what:
            raise SettingProblem(f"it trains {TASKS[made.task].subcommand}, not {what}")
    except SettingProblem as error:
        raise FileProblem(f"the recipe cannot be used: {error}", path) from error
    return made


def _path(name: str) -> Path:
    return RECIPES_FOLDER / f"{name}.toml"


def _recipe(name: str, data: Mapping[str, Any], folder: Path) -> Recipe:
    tables = {key: dict(_table(data, key)) for key in ("network", "optimiser", "validation", "settings", "data")}
    top = {key: value for key, value in data.items() if key not in (*tables, "task", "name")}
    task = data.get("task")
    if not isinstance(task, str):
        raise SettingProblem(f"it must name its task, one of {', '.join(TASKS)}")
    if not isinstance(tables["network"].get("kind"), str):
        raise SettingProblem("[network] must name its kind")
    factors = tables["optimiser"].pop("rate_factors", {})
    numbers = isinstance(factors, dict) and all(
        isinstance(value, (int, float)) and value >= 0 for value in cast("dict[str, Any]", factors).values()
    )
    if not numbers:
        raise SettingProblem("[optimiser.rate_factors] must map beginnings of parameters' names to factors")
    return Recipe(
        name=name, task=task, settings=_filled(import_task_class(task)(), tables["settings"], "[settings] "),
        network=_plain(tables["network"]), training=_filled(TrainingSettings(), top, ""),
        optimiser=_filled(Optimiser(), tables["optimiser"], "[optimiser] "),
        rate_factors={key: float(value) for key, value in factors.items()},
        validation=_filled(Validation(), tables["validation"], "[validation] "),
        recordings=_recordings(tables["data"], folder), recorded_share=_filled(_Data(), tables["data"], "[data] ").recorded_share,
    )  # fmt: skip


def _recordings(table: dict[str, Any], folder: Path) -> tuple[RecordingSource, ...]:
    """The [[data.recordings]], whose paths are told from the recipe's folder; what else is in [data] stays."""
    listed = table.pop("recordings", [])
    if not isinstance(listed, list) or not all(isinstance(one, dict) for one in cast("list[Any]", listed)):
        raise SettingProblem("recordings must be tables, [[data.recordings]]")
    made: list[RecordingSource] = []
    for one in cast("list[dict[str, Any]]", listed):
        own = _filled(RecordingSource(), one, "[[data.recordings]] ")
        if not own.path:
            raise SettingProblem("every one of [[data.recordings]] must name its path")
        beside = {"path": own.path, "reference": own.reference}
        made.append(replace(own, **{key: str(folder / name) for key, name in beside.items() if name}))
    return tuple(made)


def _table(data: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    table = data.get(key, {})
    if not isinstance(table, dict):
        raise SettingProblem(f"{key} must be a table, [{key}]")
    return cast("dict[str, Any]", table)


def _plain(table: Mapping[str, Any]) -> Mapping[str, Value]:
    for key, value in table.items():
        if not isinstance(value, (bool, int, float, str)):
            raise SettingProblem(f"[network] {key} must be a plain value, got {value!r}")
    return table


def _filled(part: P, table: Mapping[str, Any], where: str) -> P:
    """`part` with the values of a table, each checked."""
    for key, value in table.items():
        try:
            plain = isinstance(value, (bool, int, float, str))
            part = replace_value(part, key, value if plain else str(value))
        except SettingProblem as error:
            raise SettingProblem(f"{where}{error}") from error
    return part


def override_training(recipe: Recipe, **pace: int | str) -> Recipe:
    """The same with another seed, other steps or another beginning."""
    made = recipe.training
    for name, value in pace.items():
        made = replace_value(made, name, value)
    return replace(recipe, training=made)
