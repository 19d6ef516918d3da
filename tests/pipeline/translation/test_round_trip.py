"""Round trip to the target and back, and the distance of a touch from training touches."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.geometry import rigid
from pipeline.stages.metrics.stage_metrics import (
    METRICS,
    ROUND_TRIP,
    TRAINING_DISTANCE,
    describe_metric,
)
from pipeline.translation.round_trip import (
    compute_training_distance,
    describe_touch,
    load_training_features,
    measure_round_trip,
    measure_training_distance,
    reverse_translation,
)
from pipeline.translation.translate import Request, open_translation

SAMPLE_RECORDING = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"
TOUCHED = 5
UNTOUCHED = 0
STAGES = ("depth", "target_depth", "touch", "touch_depth")


@pytest.fixture(scope="module")
def translation():
    # no networks: this is about the geometry
    methods = (("depth", "physics"), ("touch", "physics"))
    opened = open_translation(
        Request(recording=SAMPLE_RECORDING, source="gelslim", target="soft_bubble", methods=methods)
    )
    yield opened
    opened.close()


def test_a_round_trip_returns_the_depth_and_is_far_off_where_it_does_not(translation):
    results = translation.evaluate(TOUCHED, STAGES)
    error_mm = measure_round_trip(results, translation)[ROUND_TRIP]
    depth = results["depth"].output
    mean_mm = float(depth.indentation_mm[depth.contact].mean())
    assert 0 < error_mm < 0.5 * mean_mm
    deeper = replace(depth, indentation_mm=np.asarray(2.0 * depth.indentation_mm, np.float32))
    forged = {**results, "depth": replace(results["depth"], output=deeper)}
    assert measure_round_trip(forged, translation)[ROUND_TRIP] > 2.0 * error_mm
    untouched = translation.evaluate(UNTOUCHED, STAGES)
    assert measure_round_trip(untouched, translation) == {}
    assert measure_training_distance(untouched, translation) == {}


def test_the_way_back_undoes_the_alignment(translation):
    depth = translation[TOUCHED].depth
    back = reverse_translation(translation, depth)
    np.testing.assert_allclose(
        back.alignment.target_from_source,
        rigid.invert(translation.alignment.target_from_source),
        atol=1e-9,
    )
    assert (back.source.name, back.target.name) == (
        translation.target.name,
        translation.source.name,
    )
    assert back.target.camera == depth.camera


def test_a_touch_unlike_training_is_farther_than_one_of_the_sample(translation):
    results = translation.evaluate(TOUCHED, ["target_depth"])
    seen = measure_training_distance(results, translation)[TRAINING_DISTANCE]
    view = results["target_depth"].output
    everywhere = np.ones_like(view.contact)
    strange = replace(
        view, contact=everywhere, indentation_mm=np.full(view.contact.shape, 40.0, np.float32)
    )
    assert 0 < seen < 2.0 < compute_training_distance(strange, translation.target)
    assert load_training_features("no_such_sensor") is None


@pytest.mark.parametrize("sensor", ["gelslim", "soft_bubble"])
def test_95_percent_of_training_touches_are_nearer_than_1(sensor):
    scaled, mean, scale, usual = load_training_features(sensor)
    gaps = np.linalg.norm(scaled[:, None] - scaled[None], axis=2)
    np.fill_diagonal(gaps, np.inf)
    assert len(scaled) > 200
    assert np.mean(gaps.min(axis=1) <= usual) == pytest.approx(0.95, abs=0.01)
    assert np.isfinite(mean).all()
    assert (scale > 0).all()


def test_a_touch_is_described_in_millimetres_whatever_the_pixels():
    """A disc of 5 mm radius and 1 mm depth, off centre, on two grids."""
    described = []
    for pixel_mm in (0.1, 0.2):
        n = round(40 / pixel_mm)
        y, x = pixel_mm * (np.mgrid[:n, :n] - 0.5 * (n - 1))
        inside = np.hypot(x - 3.0, y) < 5.0
        described.append(
            describe_touch(inside, np.where(inside, 1.0, 0.0).astype(np.float32), pixel_mm)
        )
    np.testing.assert_allclose(*described, atol=0.02)
    assert described[0][0] == pytest.approx(math.log(25 * math.pi), abs=0.01)
    assert described[0][5] == pytest.approx(3.0, abs=0.05)
    assert described[0][6] == pytest.approx(1.0, abs=0.02)
    assert describe_touch(np.zeros((4, 4), bool), np.zeros((4, 4), np.float32), 0.1) is None


def test_metrics_of_a_frame_are_named_without_a_stage():
    assert describe_metric(ROUND_TRIP) == "round-trip error, mm"
    assert describe_metric(TRAINING_DISTANCE) == "distance from training"
    assert METRICS["training_distance"].better == "lower"
