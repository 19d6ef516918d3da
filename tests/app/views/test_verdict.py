"""What the verdict says of a frame."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

from app.document.evaluator import EvaluatedFrame
from app.frames.verdict import judge_frame
from app.session.state import Session
from pipeline.core.errors import UNCERTAIN_CONTACT
from pipeline.core.graph import StageResult
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import make_depth_map
from pipeline.sensors.spec import load_sensor


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
