"""Ground truth in place of one stage after the other: the shares add up, and each stage gets its
own.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from app.session.sample import SAMPLE_RECORDING
from pipeline.core.arrays import freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.graph import StageResult
from pipeline.translation.error_attribution import OUTSIDE_VIEW, attribute_error
from pipeline.translation.translate import Request, open_translation

TOUCHED = 5


@pytest.fixture(scope="module")
def to_bubble():
    """The sample's GelSlim translated to its bubble."""
    with open_translation(
        Request(recording=SAMPLE_RECORDING, source="gelslim", target="soft_bubble", route="t2d2")
    ) as translation:
        yield translation


def test_shares_and_remainder_add_up_to_the_error(to_bubble):
    for metric in ("touch_depth.contact_mae_mm", "pose.mssd_mm"):
        found = attribute_error(to_bubble, TOUCHED, metric)
        assert found.total == pytest.approx(
            sum(part.share for part in found.shares) + found.remainder
        )
        assert found.shares[-1].remaining == found.remainder


def test_ground_truth_in_every_stage_leaves_no_error(to_bubble):
    found = attribute_error(to_bubble, TOUCHED)
    assert found.remainder == 0.0
    assert found.total > 0.1


def test_contact_outside_the_sources_view_is_named(to_bubble):
    """A bubble touches much more of the object than the gel: depth and rendering contribute
    little to the error.
    """
    found = attribute_error(to_bubble, TOUCHED)
    share = {part.title: part.share for part in found.shares}
    assert share[OUTSIDE_VIEW] > 0.8 * found.total
    assert OUTSIDE_VIEW in found.summary


def test_the_error_of_a_wrong_stage_is_attributed_to_it(to_bubble):
    """Depth that is 1 mm too deep raises the share of depth alone."""
    clean = {
        part.title: part.share
        for part in attribute_error(to_bubble, TOUCHED, "touch_depth.mae_mm").shares
    }
    depth = next(method for method in to_bubble.methods if method.stage == "depth")

    def deeper(*reads):
        made = depth.run(*reads)
        more = np.where(made.contact, made.indentation_mm + 1.0, made.indentation_mm).astype(
            np.float32
        )
        return replace(
            made, indentation_mm=freeze(more), depth_mm=freeze(made.depth_mm - 1.0 * made.contact)
        )

    wrong = to_bubble.with_(
        stage="depth", method=replace(depth, name="deeper", run=deeper, nodes=())
    )
    found = attribute_error(wrong, TOUCHED, "touch_depth.mae_mm")
    shares = {part.title: part.share for part in found.shares}
    assert shares["depth"] > clean["depth"] + 0.002
    others = [title for title in shares if title != "depth"]
    assert all(shares[title] == pytest.approx(clean[title], abs=1e-9) for title in others)


def test_a_frame_without_contact_has_no_attribution(to_bubble):
    assert attribute_error(to_bubble, 0) is None


@pytest.mark.parametrize(
    ("metric", "fact"),
    [
        ("touch_depth.nonsense", "nonsense"),
        ("nowhere.mae_mm", "nowhere"),
        ("touch_depth.contact_iou", "contact_iou"),
    ],
)
def test_a_metric_that_cannot_be_attributed_is_refused(to_bubble, metric, fact):
    with pytest.raises(SettingProblem, match=fact):
        attribute_error(to_bubble, TOUCHED, metric)


def test_every_stage_but_the_cloud_has_ground_truth(to_bubble):
    translation = to_bubble
    truths = translation.read_true_outputs(TOUCHED)
    assert set(truths) == set(translation.stages) - {"cloud"}
    results = {
        name: StageResult(
            name=name, method=None, output=value, state="given", ms=0.0, notes=(), digest=""
        )
        for name, value in truths.items()
    }
    metrics = translation.compute_metrics(results, TOUCHED)
    for name in (
        "depth.mae_mm",
        "touch_depth.mae_mm",
        "touch.depth_mae_mm",
        "pose.translation_mm",
        "pose.mssd_mm",
    ):
        assert metrics[name] == pytest.approx(0.0, abs=1e-9), name


def test_the_command_prints_the_worst_frame_first_and_writes_every_share(capsys, tmp_path):
    from pipeline.cli.main import build_app, run_app

    out = tmp_path / "attribution.json"
    assert (
        run_app(
            build_app(),
            [
                "attribute",
                str(SAMPLE_RECORDING),
                "--target",
                "gelslim",
                "--sensor",
                "digit",
                "--frame",
                "5",
                "--json",
                str(out),
            ],
        )
        == 0
    )
    printed = capsys.readouterr().out
    assert "frame 5 is the worst" in printed
    (one,) = json.loads(out.read_text())
    assert one["total"] == pytest.approx(
        sum(part["share"] for part in one["shares"]) + one["remainder"]
    )


def test_the_command_names_the_sensor_without_ground_truth(capsys):
    from pipeline.cli.main import build_app, run_app

    assert (
        run_app(
            build_app(),
            ["attribute", str(SAMPLE_RECORDING), "--target", "gelsight_mini", "--frame", "5"],
        )
        == 2
    )
    assert "gelsight_mini" in capsys.readouterr().err
