"""Entry points of other packages: whatever they are or raise, only they are left out."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import sys
from pathlib import Path
from types import ModuleType

import pytest

from app.shell.panels import Panel
from pipeline.cli.main import build_app, run_app
from pipeline.core import entry_points
from pipeline.io import formats
from pipeline.lab.tasks import insertion, task
from pipeline.sensors import descriptions, kinds
from pipeline.sensors.spec import list_sensor_names
from pipeline.stages.depth.stage import STAGE
from pipeline.translation import catalogue

ROOT = Path(__file__).parents[3]
METHOD = dataclasses.replace(STAGE.methods[0], name="lab")
GOOD = {
    "tactoscope.formats": dataclasses.replace(formats.FORMATS[0], key="lab"),
    "tactoscope.sensor_kinds": dataclasses.replace(kinds.GEL, key="lab"),
    "tactoscope.tasks": dataclasses.replace(insertion.TASK, name="lab"),
    "tactoscope.methods": METHOD,
    "tactoscope.panels": Panel(title="lab", build=lambda _: None),  # type: ignore[arg-type, return-value]
}
READ = {
    "tactoscope.formats": lambda: entry_points.load_entry_points(
        "tactoscope.formats", formats.RecordingFormat
    ),
    "tactoscope.sensor_kinds": lambda: entry_points.load_entry_points(
        "tactoscope.sensor_kinds", kinds.SensorKind
    ),
    "tactoscope.tasks": lambda: entry_points.load_entry_points(
        "tactoscope.tasks", task.ManipulationTask
    ),
    "tactoscope.methods": lambda: entry_points.load_entry_points(
        "tactoscope.methods", catalogue.Method, catalogue._check_params
    ),
    "tactoscope.panels": lambda: entry_points.load_entry_points("tactoscope.panels", Panel),
    "tactoscope.sensors": descriptions.find_descriptions,
}
WRONG = (None, 5, "text", b"\0", 1.5, [], {}, object(), object)


class Unprintable(Exception):
    """An error whose text raises."""

    def __str__(self) -> str:
        raise SystemExit(3)


@pytest.fixture
def install(monkeypatch):
    """Entry points of another package, by group and value."""

    def add(**values: object) -> None:
        module = ModuleType("lab_module")
        vars(module).update(values)
        monkeypatch.setitem(sys.modules, "lab_module", module)
        entry_points.load_entry_points.cache_clear()

    others = importlib.metadata.entry_points

    def point(group: str, name: str) -> None:
        entries = [
            importlib.metadata.EntryPoint(name="lab", value=f"lab_module:{name}", group=group)
        ]
        monkeypatch.setattr(
            importlib.metadata,
            "entry_points",
            lambda **asked: entries if asked.get("group") == group else others(**asked),
        )

    yield lambda group, value: (add(value=value), point(group, "value"))
    entry_points.load_entry_points.cache_clear()


@pytest.mark.parametrize("group", GOOD)
def test_a_value_of_the_declared_types_is_added_and_any_other_left_out(group, install, caplog):
    install(group, GOOD[group])
    assert READ[group]() == (GOOD[group],)
    spoilt = [*WRONG]
    for field in dataclasses.fields(GOOD[group]):
        right = getattr(GOOD[group], field.name)
        bad = object() if isinstance(right, dict) else {1: 2}
        spoilt += [
            dataclasses.replace(GOOD[group], **{field.name: one})
            for one in (object(), [], bad, -1j)
        ]
    for value in spoilt:
        caplog.clear()
        install(group, value)
        assert READ[group]() == ()
        assert "left out" in caplog.text


@pytest.mark.parametrize("value", [*WRONG, "/no/such/place", "a\0b"])
def test_a_place_of_sensors_that_is_no_path_is_left_out(value, install):
    names = list_sensor_names()
    install("tactoscope.sensors", value)
    assert list_sensor_names() == names


@pytest.mark.parametrize(
    "error", [SystemExit(5), Unprintable(), ImportError("\x1b[2J"), RecursionError()]
)
@pytest.mark.parametrize("group", READ)
def test_a_module_that_raises_is_left_out(group, error, install, monkeypatch, caplog):
    def fail(_: object) -> None:
        raise error

    install(group, None)
    before = entry_points.load_entry_points.__wrapped__
    monkeypatch.setattr(importlib.metadata.EntryPoint, "load", fail)
    assert before(group, object) == ()
    assert "left out" in caplog.text
    assert "\x1b" not in caplog.text


@pytest.mark.parametrize("group", READ)
def test_commands_run_whatever_is_installed(group, install, capsys):
    install(group, 5)
    assert run_app(build_app(), ["--help"]) == 0
    assert (
        run_app(
            build_app(), ["inspect", str(ROOT / "sample_data" / "recordings" / "no_contact.h5")]
        )
        == 0
    )
    capsys.readouterr()


def test_a_list_of_packages_that_cannot_be_read_adds_nothing(monkeypatch, caplog):
    def fail(**_: object) -> None:
        raise ValueError("damaged metadata")

    monkeypatch.setattr(importlib.metadata, "entry_points", fail)
    assert entry_points.load_entry_points.__wrapped__("tactoscope.formats", object) == ()
    assert "damaged metadata" in caplog.text


def leave(_: object) -> bool:
    """A function of a format that ends the process."""
    raise SystemExit(4)


def test_a_format_whose_test_fails_refuses_no_other_format(install, tmp_path, caplog):
    mine = dataclasses.replace(
        formats.FORMATS[0],
        key="lab",
        matches=f"{__name__}:leave",
        folder=f"{__name__}:leave",
        suffixes=(".h5", ".png"),
    )
    install("tactoscope.formats", mine)
    path = ROOT / "sample_data" / "recordings" / "no_contact.h5"
    assert run_app(build_app(), ["inspect", str(path)]) == 0
    assert "'lab'" in caplog.text
