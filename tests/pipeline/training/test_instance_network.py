"""A network taught on one unit's presses of a ball: how it is judged, when it is kept, and how it is used."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.base.errors import CalibrationError, FileProblem, SettingProblem
from pipeline.calibration.calibration_file import load
from pipeline.calibration.calibration_table import BallFit, make_built_in
from pipeline.cli import calibrate_network
from pipeline.cli.calibrate import BallCalibrationRequest, run_ball_calibration
from pipeline.networks.network_factory import load_predictor
from pipeline.networks.weights import Weights
from pipeline.physics import optics
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth import network as by_network
from pipeline.stages.depth.gel_network import NetworkParams
from pipeline.stages.depth.photometric import DepthParams, estimate_depth_with_notes
from pipeline.training import instance_network
from pipeline.training.gel_samples import GelTrainingSample
from pipeline.training.instance_network import CALIBRATION_TABLE, SHIPPED_NETWORK, TRAINED_NETWORK, BallErrors
from pipeline.values.frames import TactileFrame
from tests.pipeline.calibration.test_balls import hertz

MINI = load_sensor("gelsight_mini")
BALL_MM, DEEP_MM = 6.31, 0.6
READ: dict[int, GelTrainingSample] = {}
PLACES = ((90, 70), (230, 80), (110, 170), (220, 165), (160, 120), (60, 120))


def picture(place, seed):
    x, y = place
    pressed = hertz(MINI.camera.shape, MINI.pixel_mm, x, y, BALL_MM, DEEP_MM)
    return optics.render(MINI, pressed, seed=seed)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("presses")
    for k, place in enumerate(PLACES):
        cv2.imwrite(str(made / f"{k}.png"), picture(place, k)[..., ::-1])
    cv2.imwrite(str(made / "still.png"), optics.render_reference(MINI)[..., ::-1])
    return made


@pytest.fixture
def asked(folder, tmp_path):
    return BallCalibrationRequest(
        presses=folder, sensor="gelsight_mini", diameter_mm=BALL_MM, reference=folder / "still.png",
        out=tmp_path / "unit.npz", pixel_mm=None, pattern="[0-9].png", seed=0, network=tmp_path / "unit.safetensors",
        even_if_worse=False,
    )  # fmt: skip


@pytest.fixture
def quick(monkeypatch):
    """A lesson of one step, beside look-ups of the described light."""
    plain = make_built_in(MINI)
    fits = tuple(
        BallFit(index=k, x_px=x, y_px=y, radius_px=np.sqrt(BALL_MM / 2 * DEEP_MM) / MINI.pixel_mm, residual=0.1, used=True)
        for k, (x, y) in enumerate(PLACES)
    )  # fmt: skip
    found = replace(plain, presses=fits, uses_built_in=True)
    monkeypatch.setattr("pipeline.cli.calibrate.calibrated", lambda *_a, **_k: found)
    monkeypatch.setattr(instance_network, "calibrated", lambda *_a, **_k: found)
    taught = instance_network._make_training_sample

    def once(presses, look_up, fit):  # every lesson of this file has the same presses
        if fit.index not in READ:
            READ[fit.index] = taught(presses, look_up, fit)
        return READ[fit.index]

    monkeypatch.setattr(instance_network, "_taught", once)
    monkeypatch.setattr(instance_network, "STEPS", 1)
    monkeypatch.setattr(instance_network, "_BATCH", 2)
    monkeypatch.setattr(instance_network, "_TOOLS", 1)
    monkeypatch.setattr(instance_network, "_SHARE", 1.0)


@pytest.mark.usefixtures("quick")
def test_a_network_that_does_not_win_is_not_kept(asked, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(instance_network, "judged", lambda *_: judged((0.03, 0.03, 0.03)))
    run_ball_calibration(asked)
    said = capsys.readouterr().out
    assert "the look-up is best, the taught network is not: no weights are written; use the look-up" in said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["unit.npz"]


@pytest.mark.usefixtures("quick")
def test_a_network_that_wins_is_kept_and_corrects_the_look_up_of_its_unit(asked, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(
        instance_network, "wins", lambda off: set(off) == {CALIBRATION_TABLE, SHIPPED_NETWORK, TRAINED_NETWORK}
    )
    run_ball_calibration(asked)
    assert "the taught network is best" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["unit.md", "unit.npz", "unit.safetensors"]
    assert "4 presses of a ball of 6.31 mm, 2 held out" in asked.network.with_suffix(".md").read_text()
    _used(asked)


def judged(taught):
    """What is measured of three presses, the taught network's being `taught` mm off the ball."""
    zero = np.zeros(3)
    return {
        name: BallErrors(shape_rms_mm=np.array(values), diameter_error=zero, contact_error=zero)
        for name, values in (
            (CALIBRATION_TABLE, (0.02, 0.02, 0.02)),
            (SHIPPED_NETWORK, (0.05, 0.02, 0.02)),
            (TRAINED_NETWORK, taught),
        )
    }


def _used(asked):
    """The weights correct what the unit's look-up reads, and nothing else."""
    weights = by_network.select_weights(MINI, MINI, asked.network)
    assert isinstance(weights, Weights)
    frame = TactileFrame(sensor=MINI.name, image=picture((160, 120), 9), reference=optics.render_reference(MINI))
    look_up, params = load(asked.out), NetworkParams()
    corrected = by_network.estimate_depth(frame, MINI, look_up, load_predictor(weights), params)
    plain = estimate_depth_with_notes(frame, MINI, look_up, DepthParams())
    assert not np.array_equal(corrected.indentation_mm, plain.indentation_mm)
    alone = by_network.estimate_depth(frame, MINI, None, load_predictor(weights), params)
    assert np.array_equal(
        alone.indentation_mm, estimate_depth_with_notes(frame, MINI, None, DepthParams()).indentation_mm
    )
    assert any("give it as --calibration" in note for note in alone.notes)


@pytest.mark.usefixtures("quick")
def test_a_lesson_that_was_interrupted_goes_on(asked, monkeypatch, tmp_path):
    def interrupted(_run):
        raise KeyboardInterrupt

    whole, began = calibrate_network.run_with_progress_bar, []
    monkeypatch.setattr(instance_network, "judged", lambda *_: judged((0.03, 0.03, 0.03)))
    monkeypatch.setattr(calibrate_network, "followed", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_ball_calibration(asked)
    assert (tmp_path / "unit.run").is_dir()
    monkeypatch.setattr(calibrate_network, "followed", lambda run: began.append(run.resume) or whole(run))
    run_ball_calibration(replace(asked, even_if_worse=True))
    assert began == [True]
    assert not (tmp_path / "unit.run").exists()
    assert asked.network.is_file()


@pytest.mark.usefixtures("quick")
def test_a_folder_of_other_things_is_left_alone(asked, tmp_path):
    other = tmp_path / "unit.run" / "notes.txt"
    other.parent.mkdir()
    other.write_text("mine")
    with pytest.raises(FileProblem, match="a folder that other things are kept in"):
        run_ball_calibration(asked)
    assert other.read_text() == "mine"


@pytest.mark.usefixtures("quick")
def test_too_few_presses_are_refused_in_one_sentence(folder):
    whole = instance_network.calibrate_sensor()
    some = replace(whole, presses=whole.presses[:5])
    images = [picture(place, k) for k, place in enumerate(PLACES)]
    with pytest.raises(CalibrationError, match="found in 5 presses, and a network is taught on 6 at least"):
        instance_network.split_presses(images, optics.render_reference(MINI), MINI, BALL_MM, some, 0)


def test_what_is_wrong_with_the_options_is_said_before_anything_is_read(asked, tmp_path):
    for other, said in (
        ({"network": tmp_path / "unit.npz"}, "kept in a .safetensors file"),
        ({"network": None, "even_if_worse": True}, "name their file with --network"),
    ):
        with pytest.raises(SettingProblem, match=said):
            run_ball_calibration(replace(asked, presses=tmp_path / "nowhere", **other))


def test_a_ball_is_off_by_nothing_and_a_flatter_one_by_as_much():
    radius_px, wide = 28.0, MINI.pixel_mm
    fit = BallFit(index=0, x_px=150.0, y_px=110.0, radius_px=radius_px, residual=0.0, used=True)
    y, x = np.mgrid[: MINI.camera.rows, : MINI.camera.cols]
    away = np.hypot(x - 150.0, y - 110.0)
    ball = np.sqrt(np.maximum((BALL_MM / 2) ** 2 - (wide * away) ** 2, 0.0)) - BALL_MM / 2 + 0.7
    plain = estimate_depth_with_notes(TactileFrame(sensor=MINI.name, image=optics.render_reference(MINI), reference=optics.render_reference(MINI)), MINI, None, DepthParams())  # fmt: skip
    seen = replace(plain, indentation_mm=ball.astype(np.float32), contact=away < radius_px)
    ball_mm, diameter, contact = instance_network.measure_ball_error(seen, fit, BALL_MM / 2, wide)
    assert ball_mm == pytest.approx(0.0, abs=1e-6)
    assert diameter == pytest.approx(0.0, abs=1e-5)
    assert contact == 0.0
    flat = replace(seen, indentation_mm=(0.5 * ball).astype(np.float32), contact=away < radius_px / 2)
    ball_mm, diameter, contact = instance_network.measure_ball_error(flat, fit, BALL_MM / 2, wide)
    inside = ball[away < 0.85 * radius_px]
    assert ball_mm == pytest.approx(0.5 * inside.std(), rel=1e-3)
    assert diameter == pytest.approx(1.0, rel=1e-4)
    assert contact == pytest.approx(0.75, abs=0.01)


@pytest.mark.parametrize(
    ("taught", "won"),
    [
        ((0.01, 0.01, 0.01), True),
        ((0.001, 0.03, 0.03), False),
        ((0.01, 0.01, 0.09), False),
        ((0.03, 0.03, 0.03), False),
    ],
)
def test_a_network_wins_in_the_mean_and_in_most_presses(taught, won):
    assert instance_network.is_trained_best(judged(taught)) is won
