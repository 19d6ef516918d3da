"""The built wheel, installed away from the source: what it can do there, and what it says where
others have its names.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SAMPLE = ROOT / "sample_data" / "recordings" / "first_touch.h5"
SOURCES = ("app", "widgets", "pipeline", "tactoscope.py", "pyproject.toml", "README.md", "LICENSE")


def pip(*words):
    done = subprocess.run(
        [sys.executable, "-m", "pip", "-q", *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel, made from a copy so that nothing is left in the source."""
    copy = tmp_path_factory.mktemp("source")
    for name in SOURCES:
        whole = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        whole(
            ROOT / name, copy / name, **({"ignore": _no_caches} if whole is shutil.copytree else {})
        )
    pip(
        "wheel",
        "--no-deps",
        "--no-build-isolation",
        "--no-index",
        "--wheel-dir",
        copy / "made",
        copy,
    )
    return next((copy / "made").glob("*.whl"))


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """A folder that holds the wheel's content and nothing else."""
    folder = tmp_path_factory.mktemp("installed")
    pip("install", "--no-deps", "--no-index", "--target", folder, wheel)
    return folder


@pytest.fixture
def typed(installed, tmp_path):
    """Run `tactoscope` of the wheel from an empty folder; returns exit code, stdout and stderr."""

    def go(*words, before=()):
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([*map(str, before), str(installed)]),
        }
        command = [sys.executable, installed / "bin" / "tactoscope", *map(str, words)]
        done = subprocess.run(
            command,
            env=environment,
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=550,
            check=False,
        )
        return done.returncode, done.stdout, done.stderr

    return go


def _no_caches(_folder, names):
    return [name for name in names if name == "__pycache__"]


def test_the_wheel_holds_every_module_and_description_and_is_not_for_upload(wheel):
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
        about = next(archive.read(name).decode() for name in held if name.endswith("METADATA"))
    wanted = {
        str(path.relative_to(ROOT))
        for package in ("app", "widgets", "pipeline")
        for path in (ROOT / package).rglob("*")
        if path.suffix in (".py", ".toml")
    }
    assert wanted | {"tactoscope.py"} <= held
    assert {name.partition("/")[0] for name in held if ".dist-info" not in name} == {
        "app",
        "widgets",
        "pipeline",
        "tactoscope.py",
    }
    weights = {path.name for path in (ROOT / "sample_data" / "weights").iterdir()}
    assert {f"pipeline/stages/networks/shipped/{name}" for name in weights} <= held
    assert "README.md" in weights
    assert "Classifier: Private :: Do Not Upload" in about
    assert all(f"Python :: 3.{minor}" in about for minor in (11, 12, 13))


def test_it_helps_from_any_folder(typed):
    code, out, _ = typed("--help")
    assert code == 0
    assert "translate" in out


@pytest.mark.slow  # its kernels are compiled anew
@pytest.mark.timeout(600)
def test_it_translates_a_sample_from_any_folder(typed, tmp_path):
    asked = (
        "translate",
        SAMPLE,
        "--target",
        "soft_bubble",
        "--sensor",
        "gelslim",
        "--frame",
        "0",
        "--out",
        "out",
    )
    code, _, err = typed(*asked)
    assert code == 0, err
    assert (tmp_path / "out" / "frame_0000" / "stages.npz").is_file()


def test_it_says_where_bench_and_samples_are(typed):
    code, _, err = typed("bench", "--list")
    assert code == 2
    assert "benchmarks" in err
    _, out, _ = typed("doctor")
    assert "ok       no sample recordings and no bench" in out


@pytest.mark.parametrize("name", ["app", "widgets", "pipeline"])
@pytest.mark.parametrize("kind", ["package", "module"])
def test_another_package_of_the_same_name_is_named_in_one_sentence(name, kind, typed, tmp_path):
    other = tmp_path / "other"
    (other / name).mkdir(parents=True)
    ((other / name / "__init__.py") if kind == "package" else (other / f"{name}.py")).write_text(
        "raise SystemExit(0)"
    )
    code, out, err = typed("--help", before=[other])
    assert (code, out) == (2, "")
    assert err.startswith(f"tactoscope: another package named {name!r} shadows this project's; ")
    assert str(other / name) in err
    assert len(err.splitlines()) == 1
