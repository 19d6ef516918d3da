"""What only the truth tells against a result, and which frame is looked at first."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from app.session.sample import SAMPLE_RECORDING
from pipeline.core.arrays import freeze
from pipeline.core.digests import compute_cached_digest
from pipeline.core.errors import StageWarning, select_warnings
from pipeline.core.geometry.camera import Camera
from pipeline.core.graph import StageResult
from pipeline.core.values.frames import TactileFrame, Truth
from pipeline.core.values.results import TargetDepth
from pipeline.io import open_recording
from pipeline.stages.stage import GroundTruth
from pipeline.translation.frame_selection import find_contact_frame, select_context_frames
from pipeline.translation.translate import Request, open_translation
from pipeline.translation.truth_view import add_truth_warnings

SHAPE = (12, 16)


def _view(known_cols: int) -> StageResult:
    known = np.zeros(SHAPE, bool)
    known[:, :known_cols] = True
    zero = np.zeros(SHAPE, np.float32)
    camera = Camera(rows=SHAPE[0], cols=SHAPE[1], fx_px=10.0, fy_px=10.0, cx_px=8.0, cy_px=6.0)
    view = TargetDepth(
        depth_mm=zero,
        contact=known,
        indentation_mm=zero,
        camera=camera,
        source_index=np.full(SHAPE, -1, np.int32),
        in_view=known,
    )
    return StageResult(
        name="target_depth",
        method=None,
        output=view,
        state="computed",
        ms=0.0,
        notes=("plain",),
        digest="",
    )


@pytest.mark.parametrize(("known_cols", "share"), [(8, "50%"), (16, None), (2, "12%")])
def test_a_touch_of_which_the_source_saw_a_part_is_doubted(known_cols, share):
    facts = GroundTruth(target_truth=Truth(contact=np.ones(SHAPE, bool)))
    report = add_truth_warnings(_view(known_cols), facts)
    assert report.notes[-1] == "plain"
    assert [d.split()[3] for d in report.warnings] == ([] if share is None else [share])
    assert add_truth_warnings(_view(known_cols), GroundTruth()).warnings == ()  # nobody knows


def test_doubts_are_told_apart_from_notes_and_count_for_nothing_where_no_work_was_done():
    notes = ("a", StageWarning("b"), "c", StageWarning("d"))
    assert select_warnings(notes) == ("b", "d")
    result = replace(_view(2), notes=notes)
    assert result.warnings == ("b", "d")
    assert replace(result, state="skipped").warnings == ()


def test_the_first_frame_looked_at_is_a_touched_one():
    stream = open_recording(SAMPLE_RECORDING).stream("gelslim")
    index = find_contact_frame(stream)
    assert stream.truth(index).contact.any()
    assert not stream.truth(0).contact.any()


def test_touches_that_tell_of_the_light_are_strong_and_in_different_places():
    base = open_recording(SAMPLE_RECORDING).stream("gelslim").frame(0)

    def frame(index: int) -> TactileFrame:
        image = base.reference.copy()
        place = ((40, 40), (40, 40), (200, 300), (120, 200), (0, 0))[index]
        image[place[0] : place[0] + 60, place[1] : place[1] + 60] ^= np.uint8(
            (32, 64, 48, 1, 0)[index]
        )
        return replace(base, image=image, index=index)

    stream = replace(open_recording(SAMPLE_RECORDING).stream("gelslim"), n_frames=5, frame=frame)
    chosen = [frame.image for frame in select_context_frames(stream)]
    assert [image.tobytes() for image in chosen[:2]] == [
        frame(1).image.tobytes(),
        frame(2).image.tobytes(),
    ]
    assert frame(4).image.tobytes() not in [image.tobytes() for image in chosen]
    bubble = open_recording(SAMPLE_RECORDING, sensor="soft_bubble").stream("soft_bubble")
    assert select_context_frames(bubble) == ()


def test_every_frame_of_a_recording_brings_the_touches_that_tell_of_its_light():
    request = Request(recording=SAMPLE_RECORDING, source="gelslim", target="soft_bubble")
    with closing(open_translation(request)) as one, closing(open_translation(request)) as other:
        first, last = (one.read_inputs(index)["frame"] for index in (0, one.n_frames - 1))
        assert len(first.context_frames) > 1
        assert first.context_frames is last.context_frames
        assert compute_cached_digest(
            other.read_inputs(one.n_frames - 1)["frame"]
        ) == compute_cached_digest(last)  # nothing hangs on what was read first


def test_frames_without_an_untouched_reading_begin_at_the_first():
    stream = open_recording(SAMPLE_RECORDING).stream("gelslim")

    def bare(index: int) -> TactileFrame:
        return replace(stream.frame(index), reference=None)

    assert find_contact_frame(replace(stream, frame=bare)) == 0
    dark = freeze(np.zeros_like(stream.frame(0).image))
    assert (
        find_contact_frame(
            replace(stream, frame=lambda _: replace(stream.frame(0), image=dark, reference=dark))
        )
        == 0
    )
