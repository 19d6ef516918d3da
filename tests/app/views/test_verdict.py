"""What the verdict says of a frame."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

from app.document.evaluator import EvaluatedFrame
from app.frames.verdict import describe_cause, judge_frame
from app.session.state import Session
from pipeline.core.errors import UNCERTAIN_CONTACT, StageWarning
from pipeline.core.graph import StageResult
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import make_depth_map
from pipeline.sensors.spec import load_sensor
from pipeline.translation.error_attribution import (
    DEFAULT_METRIC,
    OUTSIDE_VIEW,
    ErrorAttribution,
    ErrorShare,
)


def judge(*notes):
    spec = load_sensor("gelslim")
    level = np.zeros(spec.camera.shape, np.float32)
    depth = make_depth_map(spec.rest_depth_mm, level, level > 0, spec.camera, notes)
    found = StageResult(
        name="depth", method=None, output=depth, state="computed", ms=1.0, notes=notes, digest=""
    )
    return judge_frame(
        EvaluatedFrame(
            index=3,
            settings=Session(),
            frame=TactileFrame(
                sensor="gelslim", image=np.zeros((*level.shape, 3), np.uint8), reference=None
            ),
            results=MappingProxyType({"depth": found}),
            metrics={},
            summary=None,
        ),
        (),
        None,
    )


def test_a_contact_that_may_be_there_is_not_called_none():
    assert judge()[1] == "Frame 3 has no contact."
    state, sentence, cause = judge(UNCERTAIN_CONTACT)
    assert state == "warning"
    assert "no contact" not in sentence
    assert UNCERTAIN_CONTACT in cause


def attribute(share_mm, total_mm, *, title="depth", stage="depth"):
    part = ErrorShare(stage=stage, title=title, share=share_mm, remaining=total_mm - share_mm)
    return ErrorAttribution(
        frame=3,
        metric=DEFAULT_METRIC,
        unit="mm",
        total=total_mm,
        shares=(part,),
        remainder=total_mm - share_mm,
    )


def answer(stage, *notes, fallback=""):
    return StageResult(
        name=stage,
        method=None,
        output=None,
        state="computed",
        ms=1.0,
        notes=notes,
        digest="",
        fallback=fallback,
    )


def test_shares_that_cancel_are_said_to():
    words = describe_cause(
        attribute(0.22, 0.19, title=OUTSIDE_VIEW, stage="target_depth"), MappingProxyType({})
    )
    assert words == "Had the source seen the whole object: 0.22 mm less; other errors cancel it."
    words = describe_cause(attribute(0.15, 0.2), MappingProxyType({}))
    assert words == "75% of it: the measured depth of the source."


def test_why_the_object_was_refused_comes_before_the_shares():
    refused = "T2D2 diffusion: the mesh does not fit"
    results = {"touch": answer("touch", fallback=refused)}
    words = describe_cause(attribute(0.18, 0.19), results)
    assert words.startswith(f"{refused}. 95% of it: ")


def test_a_warning_of_the_stage_says_why():
    warning = StageWarning("sensor not calibrated: wrong by half; press a ball")
    words = describe_cause(attribute(0.18, 0.19), {"depth": answer("depth", warning)})
    assert words.endswith("the measured depth of the source; sensor not calibrated: wrong by half.")
