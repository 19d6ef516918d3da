"""Every shipped touch method beats the mean of other touches in contact, or warns that the touch
may be wrong.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pipeline.core.errors import OutsideViewWarning, UnseenObjectWarning
from pipeline.core.values.results import GeneratedTouch, TargetDepth
from pipeline.io import open_recording
from pipeline.lab.evaluation.variants import list_method_variants
from pipeline.sensors.spec import load_sensor
from pipeline.stages.metrics.stage_metrics import compute_mae_mm
from pipeline.stages.touch import physical_render
from pipeline.stages.touch.latent_diffusion import LatentParams
from pipeline.translation.translate import Request, open_translation

# a bubble is pressed 13 mm deep; in the sample 4 mm
GRASPS = ("grasps_cross", "grasps_curve", "grasps_lines_120")
SAMPLE = ("first_touch", 8)
TOUCHES = [
    (*SAMPLE, "gelslim", "soft_bubble"),
    (*SAMPLE, "soft_bubble", "gelslim"),
    (*SAMPLE, "digit", "soft_bubble"),
    (*SAMPLE, "digit", "gelslim"),
    ("grasps_cross", 2, "gelslim", "soft_bubble"),
    ("grasps_curve", 1, "gelslim", "soft_bubble"),
    ("grasps_lines_120", 2, "gelslim", "soft_bubble"),
    ("grasps_lines_120", 2, "soft_bubble", "gelslim"),
]
FEW_STEPS = LatentParams(steps=8, guidance=1.0)


@cache
def compute_mean_touch(recording, target):
    """Mean indentation of the grasps in the other recordings."""
    touches = []
    for name in set(GRASPS) - {recording}:
        with closing(open_recording(f"sample_data/recordings/{name}.h5")) as opened:
            stream = opened.stream(target)
            touches += [stream.truth(index).indentation_mm for index in range(stream.n_frames)]
    return np.mean(touches, axis=0)


def generate(variant, frame):
    """A touch with the depth of it, and why another method answered."""
    params = {
        stage: FEW_STEPS if isinstance(p, LatentParams) else p
        for stage, p in variant.stage_params.items()
    }
    results = replace(variant.translation, params=params).evaluate(frame, ["touch", "touch_depth"])
    return results["touch"].output, results["touch_depth"].output


@pytest.mark.parametrize(("recording", "frame", "source", "target"), TOUCHES)
def test_better_than_the_mean_touch_or_warned(recording, frame, source, target):
    request = Request(
        recording=f"sample_data/recordings/{recording}.h5", source=source, target=target
    )
    with closing(open_translation(request)) as translation:
        truth = translation.read_ground_truth(frame).target_truth
        mean_mm = compute_mae_mm(
            compute_mean_touch(recording, target), truth.indentation_mm, truth.contact
        )
        untouched_mm = compute_mae_mm(
            np.zeros_like(truth.indentation_mm), truth.indentation_mm, truth.contact
        )
        variants, _ = list_method_variants(translation, {}, "touch")
        assert len(variants) >= 2
        for variant in variants:
            touch, depth = generate(variant, frame)
            error_mm = compute_mae_mm(depth.indentation_mm, truth.indentation_mm, truth.contact)
            is_warned = any(isinstance(note, UnseenObjectWarning) for note in touch.notes)
            assert is_warned or error_mm < min(mean_mm, untouched_mm), (
                variant.label,
                error_mm,
                touch.notes,
            )


def generate_by(method, frame=1):
    request = Request(
        recording="sample_data/recordings/grasps_curve.h5",
        source="gelslim",
        target="soft_bubble",
        methods=(("touch", method),),
    )
    with closing(open_translation(request)) as translation:
        touch = translation[frame].touch
    assert isinstance(touch, GeneratedTouch)
    return touch


def test_only_physics_leaves_out_what_lies_outside_the_view():
    def warns(method):
        return any(isinstance(note, OutsideViewWarning) for note in generate_by(method).notes)

    assert warns("physics")
    assert not warns("t2d2")
    assert not warns("t2t")


@pytest.mark.parametrize(
    ("radius_mm", "deep_mm", "warns"), [(1.6, 4.2, True), (1.7, 6.2, True), (2.6, 4.7, False)]
)
def test_a_ball_deeper_than_the_source_saw_of_it_is_warned_of(radius_mm, deep_mm, warns):
    """Contacts of a ball of 5 mm on a gel: of the bubble's contact the gel knows 36, 26 and 85
    %.
    """
    bubble = load_sensor("soft_bubble")
    row, col = np.mgrid[: bubble.camera.rows, : bubble.camera.cols]
    contact = (
        np.hypot(row - bubble.camera.cy_px, col - bubble.camera.cx_px) * bubble.pixel_mm
        <= radius_mm
    )
    indentation = np.where(contact, deep_mm, 0.0).astype(np.float32)
    view = TargetDepth(
        depth_mm=bubble.rest_depth_mm - indentation,
        contact=contact,
        indentation_mm=indentation,
        camera=bubble.camera,
        source_index=np.zeros(contact.shape, np.int32),
        in_view=np.ones(contact.shape, np.bool_),
    )
    assert bool(physical_render.warn_of_unseen_object(view, bubble)) == warns


def test_no_contact_on_the_source_is_exact_for_a_gel_only():
    gel, bubble = (
        physical_render.make_reference_touch(load_sensor(name)).notes[0]
        for name in ("gelslim", "soft_bubble")
    )
    assert gel.endswith("is exact")
    assert "exact" not in bubble
    assert "may touch already" in bubble
