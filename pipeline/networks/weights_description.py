"""What a foreign weights file does not say of itself: a TOML of the same name next to it."""

from collections.abc import Mapping
from pathlib import Path

from pipeline.base.errors import FileProblem
from pipeline.base.files import read_toml
from pipeline.base.params import Value

_WHAT = "the description of the weights"


def get_description_path(weights: Path) -> Path:
    """The file of the description, such as `latest.toml` for `latest.pth`."""
    return weights.with_suffix(".toml")


def read_description(weights: Path, known: Mapping[str, type]) -> dict[str, Value]:
    """The values next to a weights file, by the names and types `known`; empty where there is no description.

    Raises FileProblem for an unknown name or a value of another type.
    """
    path = get_description_path(weights)
    if not path.is_file():
        return {}
    values = read_toml(path, _WHAT)
    for name, value in values.items():
        if name not in known:
            raise FileProblem(f"{_WHAT} has {name!r}; known are {', '.join(known)}", path, field=name)
        if known[name] is float and type(value) is int:
            values[name] = float(value)
        elif type(value) is not known[name]:
            raise FileProblem(f"{name} in {_WHAT} must be a {known[name].__name__}, got {value!r}", path, field=name)
    return values
