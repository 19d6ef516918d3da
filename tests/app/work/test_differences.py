"""What two sessions differ in, in words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from app.compare.variant_jobs import describe_differences
from app.session.state import Session
from pipeline.sensors.alignment import Offsets
from pipeline.stages.cloud.stage import STAGE as CLOUD
from pipeline.translation.catalogue import BUILT_IN

ONE = Session(recording=Path("a/one.h5"), target="gelslim", frame=3)


def test_only_what_results_depend_on_is_listed():
    method = CLOUD.methods[0]
    other = replace(
        ONE,
        recording=Path("b/two.h5"),
        frame=4,
        methods={"target_depth": "paper"},
        offsets=Offsets(translation_mm=(1.0, 0.0, 0.0)),
        params={method.key: replace(method.params(), stride=4)},
        cameras_linked=False,
    )
    assert describe_differences(ONE, other, BUILT_IN) == (
        "recording: one.h5 | two.h5",
        "alignment offsets differ",
        "Cloud, every n-th pixel: 1 | 4",
        "Target depth: Surface | Point splat (paper)",
    )


def test_a_method_that_the_mesh_decides_differs_from_a_chosen_one():
    other = replace(ONE, methods={"touch": "t2d2"})
    (text,) = describe_differences(ONE, other, BUILT_IN, has_mesh=True)
    assert text.endswith("Object | T2D2 diffusion")
    assert describe_differences(ONE, other, BUILT_IN) == ()


def test_equal_settings_do_not_differ_and_missing_stages_are_listed():
    assert describe_differences(ONE, replace(ONE, frame=9), BUILT_IN) == ()
    texts = describe_differences(ONE, replace(ONE, route="t2t"), BUILT_IN)
    assert any(t.startswith("Depth: ") and t.endswith("| nothing") for t in texts)
