"""Recipes: everything that decides the result of a training, as a TOML file that is kept with
the weights.
"""

from collections.abc import Mapping
from dataclasses import field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec
from msgspec import Meta

from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.files import read_toml
from pipeline.core.frozen import frozen
from pipeline.core.params import Value, list_settings, replace_value, setting
from pipeline.core.typed_data import InvalidField, Name, check
from pipeline.lab.training.recorded_pairs import HOLD_OUT_HELP, PairFolder
from pipeline.lab.training.task import TASKS, Task, import_task_class
from pipeline.stages.networks import weights_registry
from pipeline.stages.networks.published_weights import READERS
from pipeline.stages.networks.weights import NoWeights, Weights, load_weights

Precision = Literal["float32", "bf16"]
OptimiserKind = Literal["adamw", "adam"]
Schedule = Literal["cosine", "poly", "constant"]
RECIPES_FOLDER = Path(__file__).parent / "recipes"
# networks that can say that recorded pairs trained them
_MARKED_KINDS = ("residual_denoiser", "latent")
_Factor = Annotated[float, Meta(ge=0.0, le=1e9)]
P = TypeVar("P")


@frozen
class TrainingSettings:
    """Top level of a recipe."""

    seed: int = setting(0, "Seed", low=0, high=2**31)
    batch: int = setting(16, "Batch size", low=1, high=4096)
    steps: int = setting(10_000, "Steps", low=1, high=10**9, help="--minutes replaces them")
    n_cached_examples: int = setting(
        0,
        "Cached examples",
        low=0,
        high=10**7,
        help="held on a GPU that trains faster than examples are made; 0 = every example is new",
    )
    initial_weights: str = setting("", "Initial weights", help="a file; empty = random weights")
    precision: Precision = setting(
        "float32", "Precision", choices=Precision, help="of the network; the loss is float32"
    )


@frozen
class Optimiser:
    """[optimiser]."""

    kind: OptimiserKind = setting("adamw", "Optimiser", choices=OptimiserKind)
    learning_rate: float = setting(1e-3, "Learning rate", low=0.0, high=10.0)
    schedule: Schedule = setting("cosine", "Schedule", choices=Schedule, help="poly is (1 - t)^0.9")
    warm_up_steps: int = setting(100, "Warm-up", unit="steps", low=0, high=10**6)
    final_share: float = setting(
        0.01, "Final share", low=0.0, high=1.0, help="of the learning rate"
    )
    weight_decay: float = setting(0.01, "Weight decay", low=0.0, high=10.0)
    beta2: float = setting(0.99, "Beta 2", low=0.0, high=0.99999)
    max_gradient_norm: float = setting(1.0, "Max gradient norm", low=1e-6, high=1e9)
    ema_decay: float = setting(0.999, "EMA decay", low=0.0, high=0.99999)


@frozen
class Validation:
    """[validation]."""

    n_evaluations: int = setting(10, "Evaluations", low=1, high=10_000)
    n_examples: int = setting(48, "Examples", low=1, high=100_000, help="of each split")


@frozen
class _Data:
    """[data]."""

    pairs: str = setting(
        "", "Pairs", help="file or folder of recorded pairs, which replace simulated ones"
    )
    hold_out: str = setting("", "Held out", help=HOLD_OUT_HELP)
    share: float = setting(
        1.0, "Share", low=0.001, high=1.0, help="of the grasps to train on that is used"
    )


class _RecipeTables(msgspec.Struct, kw_only=True, frozen=True):
    """The tables of a recipe's file; its other values are `TrainingSettings`."""

    task: Name
    network: dict[str, Any] = {}
    optimiser: dict[str, Any] = {}
    validation: dict[str, Any] = {}
    settings: dict[str, Any] = {}
    data: dict[str, Any] = {}


@frozen
class Recipe:
    """A complete recipe."""

    name: str
    task: str  # of `TASKS`
    settings: Task
    network: Mapping[str, Value]  # kind and the arguments of its class
    training: TrainingSettings = field(default_factory=TrainingSettings)
    optimiser: Optimiser = field(default_factory=Optimiser)
    rate_factors: Mapping[str, float] = field(
        default_factory=dict
    )  # prefix of parameter names -> factor of the learning rate
    validation: Validation = field(default_factory=Validation)
    pairs: PairFolder = field(default_factory=PairFolder)

    @property
    def plain_values(self) -> dict[str, Any]:
        """The recipe in plain values, for files and cards; equal values give equal runs."""
        parts = {"training": self.training, "optimiser": self.optimiser, "settings": self.settings}
        plain: dict[str, Any] = {name: _list_values(part) for name, part in parts.items()}
        plain |= {
            "task": self.task,
            "network": dict(self.network),
            "rate_factors": dict(self.rate_factors),
        }
        if self.pairs.path:
            part = {} if self.pairs.share == 1.0 else {"share": self.pairs.share}
            plain["data"] = {"pairs": self.pairs.path, "hold_out": self.pairs.hold_out, **part}
        return plain


def _list_values(part: object) -> dict[str, Value]:
    return {key: value for key, (value, _) in list_settings(part).items()}


def list_shipped_recipes(what: str = "") -> tuple[str, ...]:
    """Names of the shipped recipes, or of those of one subcommand of `train`."""
    names = sorted(path.stem for path in RECIPES_FOLDER.glob("*.toml"))
    return tuple(
        n
        for n in names
        if not what or TASKS[read_toml(_get_path(n), "the recipe")["task"]].subcommand == what
    )


def load_recipe(name: str, what: str = "", initial_weights: str = "") -> Recipe:
    """A shipped recipe by name, or the recipe in a file.

    With `initial_weights` it starts from those.

    Raises SettingProblem for an unknown name, FileProblem for an invalid recipe or one of another
    subcommand.
    """
    path = Path(name) if name.endswith(".toml") else _get_path(name)
    if not name.endswith(".toml") and not path.is_file():
        raise SettingProblem(
            f"no recipe {name!r}; there are {', '.join(list_shipped_recipes(what))}, or give a "
            ".toml file"
        )
    data = read_toml(path, "the recipe")
    if initial_weights:
        data = {**data, "initial_weights": initial_weights}
    try:
        recipe = _make_recipe(path.stem, data, path.parent)
        if what and TASKS[recipe.task].subcommand != what:
            raise SettingProblem(f"it trains {TASKS[recipe.task].subcommand}, not {what}")
    except (SettingProblem, InvalidField) as error:
        raise FileProblem(f"the recipe cannot be used: {error}", path) from error
    return recipe


def _get_path(name: str) -> Path:
    return RECIPES_FOLDER / f"{name}.toml"


def _make_recipe(name: str, data: Mapping[str, Any], folder: Path) -> Recipe:
    tables = check(data, _RecipeTables)
    top = {
        key: value
        for key, value in data.items()
        if key not in (*_RecipeTables.__struct_fields__, "name")
    }
    settings = import_task_class(tables.task)()
    network = _check_plain(tables.network)
    if not network:
        network = _read_network(str(data.get("initial_weights", "")))
        settings = _fill(
            settings,
            {key: network[key] for key in list_settings(settings) if key in network},
            "[network] ",
        )
    if not isinstance(network.get("kind"), str):
        raise SettingProblem(
            "[network] must name its kind, or be left out for that of initial_weights"
        )
    factors = check(
        tables.optimiser.pop("rate_factors", {}), dict[str, _Factor], "optimiser.rate_factors"
    )
    values = _fill(_Data(), tables.data, "[data] ")
    recipe = Recipe(
        name=name,
        task=tables.task,
        settings=_fill(settings, tables.settings, "[settings] "),
        network=network,
        training=_fill(TrainingSettings(), top, ""),
        optimiser=_fill(Optimiser(), tables.optimiser, "[optimiser] "),
        rate_factors=factors,
        validation=_fill(Validation(), tables.validation, "[validation] "),
    )
    if not values.pairs:
        return recipe
    return override_pairs(recipe, str(folder / values.pairs), values.hold_out, values.share)


def _read_network(initial_weights: str) -> Mapping[str, Value]:
    """The network of the weights that a recipe starts from; {} without such weights."""
    if not initial_weights:
        return {}
    weights = load_initial_weights(initial_weights)
    return {"kind": weights.kind, **weights.config}


def load_initial_weights(name: str, kind: str = "") -> Weights:
    """Weights of a file, or shipped ones by name (without a suffix).

    Raises FileProblem and SettingProblem.
    """
    if Path(name).suffix:
        if not Path(name).exists():
            raise FileProblem(
                "the recipe starts from weights that are not there; train them first, or give "
                "--from",
                Path(name),
            )
        return READERS.get(kind, load_weights)(Path(name))
    weights = weights_registry.load_shipped(name)
    if isinstance(weights, NoWeights):
        raise SettingProblem(weights.why)
    return weights


def _check_plain(table: Mapping[str, Any]) -> Mapping[str, Value]:
    for key, value in table.items():
        if not isinstance(value, (bool, int, float, str)):
            raise SettingProblem(f"[network] {key} must be a plain value, got {value!r}")
    return table


def _fill(part: P, table: Mapping[str, Any], where: str) -> P:
    """`part` with the checked values of a table."""
    for key, value in table.items():
        try:
            is_plain = isinstance(value, (bool, int, float, str))
            part = replace_value(part, key, value if is_plain else str(value))
        except SettingProblem as error:
            raise SettingProblem(f"{where}{error}") from error
    return part


def override_pairs(recipe: Recipe, path: str, hold_out: str, share: float = 1.0) -> Recipe:
    """The recipe trained on recorded pairs, or on a share of those to train on.

    Raises SettingProblem.
    """
    share = replace_value(_Data(), "share", share).share
    # as trained on recorded pairs
    is_marked = bool(path) and recipe.network["kind"] in _MARKED_KINDS
    network = {**recipe.network, "trained_on_recordings": 1.0} if is_marked else recipe.network
    return replace(
        recipe, pairs=PairFolder(path=path, hold_out=hold_out, share=share), network=network
    )


def override_training(recipe: Recipe, **values: int | str) -> Recipe:
    """The recipe with other values at its top level."""
    training = recipe.training
    for name, value in values.items():
        training = replace_value(training, name, value)
    return replace(recipe, training=training)
