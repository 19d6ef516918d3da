"""What is put in comes out: orientation, flip, scale, shift and tilt of simulated pairs, within the predicted standard deviation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from pipeline.base.errors import SettingProblem
from pipeline.imprints.agreement import compute_correlation, compute_mean_imprint
from pipeline.imprints.continuation import detect_boundary_ridges
from pipeline.imprints.fitting import fit_pairs, score_fit
from pipeline.imprints.transfer import ImprintPair, TransferModel, transfer_imprint
from tests.pipeline.imprints.scenes import SIDE_PX, pairs

TRUE = TransferModel(is_mirrored=True, rotation_rad=math.radians(40.0), log_scale=math.log(0.36), right=0.06, down=-0.05,
                tilt_right=0.3, tilt_down=-0.2)  # fmt: skip
SPREADS = 4.0  # standard deviations; and never nearer asked than
LEAST = {"rotation_rad": math.radians(1.0), "log_scale": 0.02, "right": 0.005, "down": 0.005, "tilt_right": 0.03,
         "tilt_down": 0.03}  # fmt: skip


def test_a_known_carrying_is_found_within_the_spread_told():
    found = fit_pairs(pairs(TRUE, 6))
    assert found.transfer.is_mirrored
    for name, least in LEAST.items():
        off = getattr(found.transfer, name) - getattr(TRUE, name)
        off = math.remainder(off, 2 * math.pi) if name == "rotation_rad" else off
        assert abs(off) <= max(least, SPREADS * found.std[name]), name
    others = pairs(TRUE, 10)[6:]
    assert np.mean([score_fit(p, found.transfer, found.mean_imprint) for p in others]) > 0.9
    assert found.initial_guesses[0][0].startswith("mirrored")


def test_what_the_touches_do_not_tell_is_named():
    level = replace(TRUE, tilt_right=0.0, tilt_down=0.0)
    dots = []
    for pair in pairs(level, 4):
        y, x = np.indices(pair.contact.shape) - (SIDE_PX - 1) / 2
        spot = np.clip(6.0 - np.hypot(x, y), 0.0, 1.0).astype(np.float32)  # round: alike from every side
        empty = ImprintPair(
            name="dot", contact=spot, source_size=(1.0, 1.0), imprint=pair.imprint, target_size=(1.0, 1.0)
        )
        real = transfer_imprint(empty, level)
        dots.append(replace(empty, imprint=real + 0.2 * np.random.default_rng(3).normal(size=real.shape).astype("f4")))
    assert "rotation_rad" in fit_pairs(dots).undetermined


def test_metric_pairs_keep_their_scale():
    true = TransferModel(rotation_rad=math.radians(180.0), right=2.0, down=-1.0)
    found = fit_pairs(pairs(true, 3, metric=True))
    assert found.transfer.log_scale == 0.0
    assert abs(math.remainder(found.transfer.rotation_rad - math.pi, 2 * math.pi)) < math.radians(2.0)
    assert (found.transfer.right, found.transfer.down) == pytest.approx((2.0, -1.0), abs=0.5)


def test_too_few_pairs_are_refused():
    with pytest.raises(SettingProblem, match=r"at least two touches.*got 1"):
        fit_pairs(pairs(TRUE, 1))


def test_what_is_common_to_all_imprints_counts_for_nothing():
    rng = np.random.default_rng(0)
    common = rng.normal(size=(16, 16))
    own = rng.normal(size=(5, 16, 16))
    assert abs(compute_correlation(common, own[0] + 3 * common, common)) < 1e-9
    assert compute_correlation(own[0] - 2 * common, own[0] + 3 * common, common) == pytest.approx(1.0)
    mean = compute_mean_imprint([common + 0.1 * o for o in own])
    assert compute_correlation(mean, common) > 0.99


def test_a_stroke_goes_on_where_it_pointed():
    picture = np.zeros((SIDE_PX, SIDE_PX), np.float32)
    y, x = np.indices(picture.shape)
    angle = math.radians(25.0)
    along, across = ((x - 32) * math.cos(angle) + (y - 32) * math.sin(angle),
                     (x - 32) * math.sin(angle) - (y - 32) * math.cos(angle))  # fmt: skip
    picture[(np.abs(across) < 3) & (along > -5)] = 1.0
    rays = detect_boundary_ridges(picture)
    assert len(rays.x_px) == 1
    assert math.degrees(math.atan2(rays.down[0], rays.right[0])) == pytest.approx(25.0, abs=2.0)
