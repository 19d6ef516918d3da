"""The sample recordings: small, whole, and each holds what its name promises."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.io import hdf5
from pipeline.io.inspection.recording_report import inspect_recording

FOLDER = Path(__file__).resolve().parents[3] / "sample_data" / "recordings"
NAMES = sorted(path.stem for path in FOLDER.glob("*.h5"))
LIMIT_BYTES = 20e6  # what all samples may take together
SATURATED_SHARE = 0.1  # of a picture's values, when it counts as overexposed


@pytest.fixture
def opened():
    recordings = []

    def go(name):
        recordings.append(hdf5.read(FOLDER / f"{name}.h5"))
        return recordings[-1]

    yield go
    for recording in recordings:
        recording.close()


def test_all_samples_together_stay_small():
    assert sum(path.stat().st_size for path in FOLDER.glob("*.h5")) < LIMIT_BYTES


@pytest.mark.parametrize("name", NAMES)
def test_a_sample_passes_every_check_and_knows_its_truth(name):
    report = inspect_recording(FOLDER / f"{name}.h5")
    assert [check.name for check in report.checks if check.state == "fail"] == []
    assert report.has_mesh
    assert all(len(stream.truth) == 3 for stream in report.streams)


@pytest.mark.parametrize("name", ["grasps_lines_120", "grasps_curve", "grasps_cross"])
def test_every_grasp_has_contact_on_both_sensors(opened, name):
    recording = opened(name)
    assert {s.sensor for s in recording.streams} == {"gelslim", "soft_bubble"}
    assert all(s.truth(k).contact.any() for s in recording.streams for k in range(s.n_frames))


def test_nothing_touches_in_the_sample_without_contact(opened):
    for stream in opened("no_contact").streams:
        for k in range(stream.n_frames):
            assert not stream.truth(k).contact.any()
            assert not stream.truth(k).indentation_mm.any()


def test_the_hard_cases_are_present(opened):
    recording = opened("trouble")
    gel = recording.stream("gelslim")
    bubble = recording.stream("soft_bubble")
    contact = [gel.truth(k).contact for k in range(gel.n_frames)]
    saturated = [float((gel.frame(k).image == 255).mean()) for k in range(gel.n_frames)]
    assert not contact[0].any()
    assert 0 < gel.truth(1).indentation_mm.max() < 0.06  # slack
    assert contact[1].any()
    rows, cols = np.nonzero(bubble.truth(2).contact)
    # the middle is bridged
    assert not bubble.truth(2).contact[round(rows.mean()), round(cols.mean())]
    assert saturated[3] > SATURATED_SHARE > max(s for k, s in enumerate(saturated) if k != 3)
    assert contact[4][:, -1].any()
    assert not contact[5][:, -1].any()
    assert np.array_equal(contact[5], contact[6])  # a sixth of a turn of a hexagon
    assert not np.array_equal(gel.frame(5).image, gel.frame(6).image)
