from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.errors import SettingProblem, ShapeError
from pipeline.core.values.frames import TactileFrame
from pipeline.io import open_recording
from pipeline.io.hdf5_writer import RecordingWriter
from pipeline.lab.evaluation.variant_comparison import find_same_moment
from pipeline.sensors.spec import load_sensor
from pipeline.translation.alignment.touches import load_paired_touches
from pipeline.translation.translate import Request, estimate_camera_shift_mm, open_translation

BUBBLE = load_sensor("soft_bubble")
SAMPLE = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"


def still(reference, camera=BUBBLE.camera):
    return TactileFrame(sensor="soft_bubble", image=reference, reference=reference, camera=camera)


@pytest.mark.parametrize("shift_mm", [1.5, -2.25])
def test_another_units_camera_is_told_by_the_middle_of_its_untouched_membrane(shift_mm):
    """Only the middle fifth counts: the rim is where units differ in shape, and where readings
    are lost.
    """
    reference = (BUBBLE.rest_depth_mm - shift_mm).astype(np.float32)
    rows, cols = reference.shape
    middle = np.zeros(reference.shape, bool)
    middle[rows * 2 // 5 : rows * 3 // 5 + 1, cols * 2 // 5 : cols * 3 // 5 + 1] = True
    reference[~middle] = np.nan
    assert estimate_camera_shift_mm(still(reference), BUBBLE) == pytest.approx(shift_mm, abs=1e-4)
    assert estimate_camera_shift_mm(
        still(np.where(middle, reference, 3.0).astype(np.float32)), BUBBLE
    ) == pytest.approx(shift_mm, abs=1e-4)


def test_where_nothing_tells_there_is_no_shift():
    reference = BUBBLE.rest_depth_mm.astype(np.float32)
    assert estimate_camera_shift_mm(still(np.full_like(reference, np.nan)), BUBBLE) == 0.0
    assert estimate_camera_shift_mm(still(reference, camera=None), BUBBLE) == 0.0
    assert estimate_camera_shift_mm(replace(still(reference), reference=None), BUBBLE) == 0.0


def write_lost(path, lost):
    """The first frames of the sample, of which the bubble lost some."""
    with (
        closing(open_recording(SAMPLE)) as sample,
        RecordingWriter(path, depth_step_mm=0.05) as writer,
    ):
        for name in ("gelslim", "soft_bubble"):
            stream = sample.stream(name)
            for index in range(8):
                if name == "gelslim" or index not in lost:
                    writer.append(name, stream.frame(index), stream.truth(index))
    return path


def test_truth_and_the_targets_own_touch_are_those_at_the_sources_time(tmp_path):
    path = write_lost(tmp_path / "lost.h5", {2, 5})
    with closing(
        open_translation(Request(recording=path, source="gelslim", target="soft_bubble"))
    ) as it:
        assert it.select_paired(range(8)) == [0, 1, 3, 4, 6, 7]
        assert it.read_target_observation(2) is None
        frame, truth = it.read_target_observation(6)
        assert frame.time_s == it.stream.frame(6).time_s
        with closing(open_recording(SAMPLE)) as sample:
            np.testing.assert_allclose(
                truth.indentation_mm,
                sample.stream("soft_bubble").truth(6).indentation_mm,
                atol=1e-6,
            )
        assert any("2 of gelslim have no partner" in note for note in it.notes)
        own = it.with_target_as_source()
        assert own.stream.frame(6).time_s == it.stream.frame(6).time_s
        assert own.with_target_as_source().stream.frame(6).index == 6
        touches = load_paired_touches(it, range(8), exact=True)
        assert {touch.index for touch in touches} <= {0, 1, 3, 4, 6, 7}
        with closing(
            open_translation(Request(recording=path, stream="soft_bubble", target="gelslim"))
        ) as other:
            assert find_same_moment(it, other, 7) == 5
            assert find_same_moment(other, it, 5) == 7
            with pytest.raises(SettingProblem, match="at the time of frame 2"):
                find_same_moment(it, other, 2)


def test_a_depth_off_by_a_unit_shifts_no_alignment():
    for factor in (10.0, 0.1, 1000.0):
        with pytest.raises(ShapeError, match="unit"):
            estimate_camera_shift_mm(
                still((BUBBLE.rest_depth_mm * factor).astype(np.float32)), BUBBLE
            )
    nearer = still((BUBBLE.rest_depth_mm / 1.5).astype(np.float32))
    assert estimate_camera_shift_mm(nearer, BUBBLE) == pytest.approx(26.6, abs=0.1)


def test_what_the_target_recorded_is_read_in_the_light_of_its_own_touches():
    with closing(
        open_translation(Request(recording=SAMPLE, source="gelslim", target="soft_bubble"))
    ) as it:
        own = it.with_target_as_source()
        assert own.source.name == "soft_bubble"
        assert own.load_context_images(own.stream.frame(0).reference) == ()
        again = own.with_target_as_source()
        assert again.stream.name == it.stream.name
        assert [
            picture.shape for picture in again.load_context_images(it.stream.frame(0).reference)
        ] == [picture.shape for picture in it.load_context_images(it.stream.frame(0).reference)]
        assert it.load_context_images(it.stream.frame(0).reference)
        # another sensor instance
        assert it.load_context_images(own.stream.frame(0).reference) == ()
