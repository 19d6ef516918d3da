"""Simulated data sets: what a frame depends on, and recordings that are interrupted, damaged or
in the way.
"""

from __future__ import annotations

import zlib
from contextlib import closing
from dataclasses import replace

import h5py
import numpy as np
import pytest

from pipeline.core.errors import FileProblem, TouchError
from pipeline.core.geometry import rigid
from pipeline.core.progress import Cancelled
from pipeline.io import hdf5
from pipeline.lab import recorder
from pipeline.physics.simulation import datasets, shapes
from pipeline.physics.simulation.datasets import SimulationPlan

TOOL = shapes.list_shapes("training")[0]
PLAN = SimulationPlan(sensors=("digit", "soft_bubble"), object_source=TOOL, n_poses=3, seed=4)
FRICTION_ROUNDING = 1.001  # float32 tractions, summed
POSE_TOLERANCE_MM = 1e-9  # rounding of a few 4x4 products in float64


class StopsAfter:
    """A progress that cancels after so many moments."""

    def __init__(self, moments):
        self.left = moments

    def step(self, fraction, text):
        self.left -= 1
        if self.left == 0:
            raise Cancelled


def prints(path):
    """A checksum of every array of a recording, frame by frame."""
    recording = hdf5.read(path)
    try:
        return {
            (stream.name, k, what): zlib.crc32(np.ascontiguousarray(array).tobytes())
            for stream in recording.streams
            for k in range(stream.n_frames)
            for what, array in (
                ("image", stream.frame(k).image),
                ("reference", stream.frame(k).reference),
                ("indentation", stream.truth(k).indentation_mm),
                ("contact", stream.truth(k).contact),
                ("pose", stream.truth(k).sensor_from_object),
            )
        }
    finally:
        recording.close()


def images(plan, index):
    return {
        frame.sensor: frame.image.tobytes() for frame, _ in datasets.simulate_moment(plan, index)
    }


def test_the_same_seed_gives_the_same_frames_and_another_seed_others():
    assert images(PLAN, 1) == images(PLAN, 1)
    other = images(replace(PLAN, seed=5), 1)
    assert all(other[name] != image for name, image in images(PLAN, 1).items())


def test_a_frame_does_not_depend_on_the_other_sensors():
    alone = images(replace(PLAN, sensors=("digit",)), 2)
    assert alone["digit"] == images(PLAN, 2)["digit"]


def test_the_transform_of_a_pair_is_exactly_that_of_the_true_poses():
    (_, source), (_, target) = datasets.simulate_moment(PLAN, 0)
    pair = next(
        p
        for p in datasets.compute_pairings(PLAN)
        if (p.source, p.target) == ("digit", "soft_bubble")
    )
    expected = target.sensor_from_object @ rigid.invert(source.sensor_from_object)
    assert np.abs(pair.target_from_source - expected).max() < POSE_TOLERANCE_MM


def test_without_noise_only_the_touch_differs_from_the_reference():
    plan = replace(PLAN, noise=False, sensors=("soft_bubble",), n_poses=1)
    ((frame, truth),) = datasets.simulate_moment(plan, 0)
    assert truth.contact.any()
    # float32 at 80 mm
    assert np.allclose(frame.reference - frame.image, truth.indentation_mm, atol=1e-4)


def test_varied_instances_change_the_reference_and_keep_the_true_poses():
    plan = replace(PLAN, vary=1.0)
    (plain, truth), (varied, varied_truth) = (
        datasets.simulate_moment(p, 0)[0] for p in (PLAN, plan)
    )
    assert not np.array_equal(plain.reference, varied.reference)
    assert np.array_equal(truth.sensor_from_object, varied_truth.sensor_from_object)
    assert datasets.simulate_reference(plan, "digit", 0) is datasets.simulate_reference(
        plan, "digit", datasets.FRAMES_PER_INSTANCE - 1
    )


def test_a_drag_shears_gels_alone_and_the_truth_holds_its_force():
    plan = replace(PLAN, sensors=("digit", "gelslim", "soft_bubble"), n_poses=1, noise=False)
    still, dragged = (datasets.simulate_moment(p, 0) for p in (plan, replace(plan, drag_mm=0.3)))
    for (frame, truth), (dragged_frame, dragged_truth) in zip(still, dragged, strict=True):
        gel = frame.sensor != "soft_bubble"
        along = np.hypot(*dragged_truth.force_n[:2])
        pressed = -dragged_truth.force_n[2]
        assert not truth.force_n[:2].any()
        assert truth.force_n[2] == dragged_truth.force_n[2] < 0
        assert (0.0 < along <= 0.8 * pressed * FRICTION_ROUNDING) == gel
        assert np.array_equal(truth.indentation_mm, dragged_truth.indentation_mm)
        # it alone has markers
        assert np.array_equal(frame.image, dragged_frame.image) == (frame.sensor != "gelslim")
    ways = [t.force_n[:2] / np.hypot(*t.force_n[:2]) for _, t in dragged[:2]]
    assert ways[0] @ ways[1] > 0.99  # both gels have the axes of the alignment frame
    assert "dragged by 0.3 mm" in datasets.describe_plan(replace(plan, drag_mm=0.3))


def test_a_recording_keeps_the_force(tmp_path):
    plan = replace(PLAN, sensors=("gelslim",), n_poses=1, drag_mm=0.3)
    recorder.record_plan(plan, tmp_path / "dragged.h5")
    recording = hdf5.read(tmp_path / "dragged.h5")
    try:
        assert np.array_equal(
            recording.streams[0].truth(0).force_n,
            datasets.simulate_moment(plan, 0)[0][1].force_n,
        )
    finally:
        recording.close()


def test_a_group_stands_for_its_objects_each_once():
    made = datasets.make_plans(("training", TOOL), PLAN)
    assert tuple(p.object_source for p in made) == shapes.list_shapes("training")


@pytest.mark.parametrize(
    ("change", "tools", "named"),
    [
        ({"n_poses": 0}, (TOOL,), "--poses"),
        ({"seed": -1}, (TOOL,), "--seed"),
        ({"vary": 9.0}, (TOOL,), "--vary"),
        ({"drag_mm": 9.0}, (TOOL,), "--drag-mm"),
        ({"sensors": ("digit", "digit")}, (TOOL,), "--sensors"),
        ({"sensors": ("fingertip",)}, (TOOL,), "fingertip"),
        ({}, (), "--tools"),
        ({}, ("spoon",), "spoon"),
        ({}, ("nowhere.stl",), "nowhere.stl"),
    ],
)
def test_invalid_plans_name_the_option(change, tools, named):
    with pytest.raises(TouchError, match=named) as caught:
        datasets.make_plans(tools, replace(PLAN, **change))
    assert "\n" not in str(caught.value)


def test_an_interrupted_recording_continues_to_the_same_arrays(tmp_path):
    whole = tmp_path / "whole.h5"
    parts = tmp_path / "parts.h5"
    assert recorder.record_plan(PLAN, whole).n_moments == 3
    with pytest.raises(Cancelled):
        recorder.record_plan(PLAN, parts, progress=StopsAfter(2))
    assert recorder.count_finished_moments(PLAN, parts) == 2
    assert recorder.record_plan(PLAN, parts).n_moments == 1
    assert recorder.record_plan(PLAN, parts).n_moments == 0
    assert prints(whole) == prints(parts)


def test_two_processes_write_what_one_writes(tmp_path):
    one = tmp_path / "one.h5"
    two = tmp_path / "two.h5"
    plan = replace(PLAN, sensors=("digit",))
    recorder.record_plan(plan, one)
    with recorder.make_worker_pool(2) as pool:
        recorder.record_plan(plan, two, pool=pool)
    assert prints(one) == prints(two)


def test_finished_moments_are_in_place_before_the_rest(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder, "PUBLISH_INTERVAL_S", 0.0)
    path = tmp_path / "a.h5"
    seen = []

    class Looks:
        def step(self, fraction, text):
            seen.append(recorder.count_finished_moments(PLAN, path))

    recorder.record_plan(PLAN, path, progress=Looks())
    assert seen == [0, 1, 2]
    whole = tmp_path / "whole.h5"
    monkeypatch.undo()
    recorder.record_plan(PLAN, whole)
    assert prints(whole) == prints(path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.h5", "whole.h5"]


@pytest.mark.parametrize("damage", ["cut", "flipped", "one sensor short", "truth/known", "object"])
def test_a_damaged_recording_is_repaired_by_the_next_run(tmp_path, damage):
    whole = tmp_path / "whole.h5"
    path = tmp_path / "damaged.h5"
    recorder.record_plan(PLAN, whole)
    data = bytearray(whole.read_bytes())
    with h5py.File(whole, "r") as file:
        chunk = file["streams/digit/frames"].id.get_chunk_info(1)
        table = file["streams/digit/truth/known"].id.get_chunk_info(0)
        mesh = file["object/vertices"].id.get_chunk_info(0)
    if damage == "cut":
        del data[chunk.byte_offset + 10 :]
    elif damage == "flipped":
        data[chunk.byte_offset + 100] ^= 0x10
    elif damage == "truth/known":
        data[table.byte_offset] ^= 0x10
    elif damage == "object":
        data[mesh.byte_offset + mesh.size // 2] ^= 0x10
    path.write_bytes(data)
    if damage == "one sensor short":
        with h5py.File(path, "r+") as file:
            for dataset in file["streams/digit"].values():
                for table in dataset.values() if isinstance(dataset, h5py.Group) else (dataset,):
                    if table.name.split("/")[-1] != "references":
                        table.resize(1, axis=0)
    left = {"truth/known": 0, "object": 3}.get(damage, 1)
    assert recorder.count_finished_moments(PLAN, path) == left
    assert recorder.record_plan(PLAN, path).n_moments == 3 - left
    assert prints(path) == prints(whole)
    with closing(hdf5.read(path)) as mended, closing(hdf5.read(whole)) as wanted:
        assert np.array_equal(mended.object_mesh.vertices_mm, wanted.object_mesh.vertices_mm)
        assert mended.notes == wanted.notes


def test_other_files_in_the_way_are_kept(tmp_path):
    mine = tmp_path / "mine.h5"
    foreign = tmp_path / "notes.h5"
    recorder.record_plan(replace(PLAN, sensors=("digit",), n_poses=1), mine)
    foreign.write_text("lab notes")
    kept = mine.read_bytes()
    for plan, path in ((PLAN, mine), (PLAN, foreign)):
        with pytest.raises(FileProblem, match="kept"):
            recorder.record_plan(plan, path)
    assert mine.read_bytes() == kept
    assert foreign.read_text() == "lab notes"


def test_several_objects_need_a_folder(tmp_path):
    assert (
        recorder.resolve_recording_path(PLAN, tmp_path / "set", 2)
        == tmp_path / "set" / f"{TOOL}.h5"
    )
    with pytest.raises(FileProblem, match="folder"):
        recorder.resolve_recording_path(PLAN, tmp_path / "set.h5", 2)
