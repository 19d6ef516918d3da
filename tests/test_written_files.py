"""What one of the program's writers writes, its reader opens, equal: every writer that has a
reader.
"""

from __future__ import annotations

import math
import re
import string
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from app.session.layout import ComparisonSettings, Layout
from app.session.state import Session, load_session, save_session
from pipeline.calibration import calibration_file, slope_model
from pipeline.calibration.calibration_table import BallFit, Calibration, ExpectedError
from pipeline.calibration.force_scale import fit_force_scale, load_force_scale, save_force_scale
from pipeline.calibration.slope_model import SlopeModel
from pipeline.core import disk_store
from pipeline.core.files import read_arrays, read_json, write_arrays, write_json
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.geometry.symmetry import Symmetry
from pipeline.core.values.frames import Pairing, TactileFrame, Truth
from pipeline.io import hdf5
from pipeline.io.hdf5_writer import RecordingWriter
from pipeline.io.image_files import read_rgb
from pipeline.io.live.recorder import LiveRecordingWriter
from pipeline.io.reference_estimate import write_reference
from pipeline.lab.evaluation.comparison_tiles import TABLE_FILE, write_tiles
from pipeline.lab.tasks.rollout_file import read_rollout, summarise, write_rollout
from pipeline.lab.tasks.task import Decision, Rollout, Tick, TrialPlan
from pipeline.lab.tracking.track_record import (
    TrackError,
    TrackRecord,
    TrackRow,
    read_record,
    write_record,
)
from pipeline.lab.training.run_folder import TrainingState, load_state, save_state
from pipeline.lab.training.simulated_touches import SampleCache
from pipeline.sensors.alignment import (
    Alignment,
    AlignmentFile,
    Offsets,
    load_alignment,
    save_alignment,
)
from pipeline.stages.networks.weights import Weights, load_weights, save_weights
from pipeline.translation.cross_section import SectionLine
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import Tile

WORDS = st.text(alphabet=string.ascii_letters + string.digits + " _-äßµ→'\"\\|,;\n\t", max_size=12)
NAMES = st.text(alphabet=string.ascii_letters + string.digits + "_-äµ", min_size=1, max_size=8)
NUMBERS = st.floats(-1e6, 1e6, allow_subnormal=False)
POSITIVE = st.floats(1e-6, 1e6)
POSES = st.builds(
    rigid.from_parts,
    st.tuples(*[st.floats(-500.0, 500.0)] * 3),
    st.tuples(*[st.floats(-179.0, 179.0)] * 3),
)
SEEDS = st.integers(0, 2**32 - 1)


def arrays(
    kind: Any, shape: tuple[int, ...], elements: st.SearchStrategy[Any] | None = None
) -> st.SearchStrategy[Any]:
    return npst.arrays(kind, shape, elements=elements)


def optional(values: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.none() | values


def same(first: object, second: object, tolerance: float = 0.0) -> None:
    """Compare arrays with NaN equal to itself, and anything else by `==`."""
    if first is None or second is None:
        assert first is second
    elif isinstance(first, np.ndarray) or isinstance(second, np.ndarray):
        one = np.asarray(first)
        two = np.asarray(second)
        assert one.shape == two.shape
        if one.dtype.kind in "fiu" and one.size:
            np.testing.assert_allclose(
                one.astype(float), two.astype(float), rtol=0.0, atol=tolerance, equal_nan=True
            )
        else:
            assert np.array_equal(one, two)
    else:
        assert first == second


# Recordings


@st.composite
def recordings(
    draw: Any,
) -> tuple[dict[str, Any], dict[str, list[tuple[TactileFrame, Truth | None]]]]:
    """Arguments of a writer, and one or two streams of frames with their truth."""
    streams = {}
    for name in draw(st.lists(NAMES, min_size=1, max_size=2, unique=True)):
        rows = draw(st.integers(1, 5))
        cols = draw(st.integers(2, 6))
        depth = draw(st.booleans())
        noise = np.random.default_rng(draw(SEEDS))
        camera = draw(
            optional(
                st.just(Camera(rows=rows, cols=cols, fx_px=3.0, fy_px=3.5, cx_px=1.0, cy_px=2.0))
            )
        )

        def image(noise=noise, depth=depth, rows=rows, cols=cols):
            if not depth:
                return noise.integers(0, 256, (rows, cols, 3), dtype=np.uint8)
            values = noise.uniform(50.0, 80.0, (rows, cols)).astype(np.float32)
            values[noise.random((rows, cols)) < 0.2] = np.nan
            return values

        reference = draw(optional(st.builds(image)))
        frames = []
        for index in range(draw(st.integers(1, 3))):
            truth = Truth(
                indentation_mm=draw(
                    optional(arrays(np.float32, (rows, cols), st.floats(-3.0, 3.0, width=32)))
                ),
                contact=draw(optional(arrays(np.bool_, (rows, cols)))),
                sensor_from_object=draw(optional(POSES)),
                force_n=draw(optional(arrays(np.float64, (3,), NUMBERS))),
            )
            time_s = draw(st.just(math.nan) | st.floats(0.0, 1e9))
            frame = TactileFrame(
                sensor=draw(st.just(name)),
                image=image(),
                reference=reference,
                index=index,
                time_s=time_s,
                camera=camera,
            )
            frames.append((frame, draw(optional(st.just(truth)))))
        streams[name] = frames
    names = list(streams)
    mesh = Mesh(
        vertices_mm=np.array([[0.0, 0, 0], [9, 0, 0], [0, 9, 0.5]]),
        triangles=np.array([[0, 1, 2]], np.int32),
        name=draw(NAMES),
    )
    symmetry = Symmetry(
        rotations=np.eye(3)[None], axis=draw(optional(st.just(np.array([0.0, 0.0, 1.0]))))
    )
    pairing = Pairing(source=names[0], target=names[-1], target_from_source=draw(POSES))
    given_mesh = draw(st.booleans())
    options = {
        "object_mesh": mesh if given_mesh else None,
        "symmetry": draw(optional(st.just(symmetry))) if given_mesh else None,
        "pairings": (pairing,) if len(names) == 2 else (),
        "coding": draw(st.sampled_from(("plain", "row differences"))),
        "notes": tuple(
            draw(
                st.lists(WORDS.filter(lambda text: text.strip() and text.isprintable()), max_size=2)
            )
        ),
        "depth_step_mm": draw(st.sampled_from((0.0, 0.01))),
    }
    return options, streams


def check_recording(written: Any, folder: Path) -> None:
    options, streams = written
    path = folder / "a.h5"
    with RecordingWriter(path, **options) as writer:
        for name, frames in streams.items():
            for frame, truth in frames:
                writer.append(name, frame, truth)
    with closing(hdf5.read(path)) as recording:
        assert [stream.name for stream in recording.streams] == list(streams)
        assert set(options["notes"]) <= set(recording.notes)
        for pair in options["pairings"]:
            same(
                recording.target_from_source(pair.source, pair.target),
                pair.target_from_source,
                1e-9,
            )
        mesh = options["object_mesh"]
        symmetry = options["symmetry"]
        same(mesh and mesh.vertices_mm, recording.object_mesh and recording.object_mesh.vertices_mm)
        same(symmetry and symmetry.rotations, recording.symmetry and recording.symmetry.rotations)
        same(symmetry and symmetry.axis, recording.symmetry and recording.symmetry.axis)
        for name, frames in streams.items():
            compare_stream(recording.stream(name), frames, options["depth_step_mm"])


def compare_stream(stream: Any, frames: Any, step_mm: float) -> None:
    assert stream.n_frames == len(frames)
    for index, (frame, truth) in enumerate(frames):
        back = stream.frame(index)
        known = stream.truth(index) or Truth()
        step = 0.51 * step_mm if frame.is_depth else 0.0
        same(back.image, frame.image, step)
        same(back.reference, frame.reference, step)
        same(np.array(back.time_s), np.array(frame.time_s))
        same(frame.camera and frame.camera.matrix, back.camera and back.camera.matrix)
        given = truth or Truth()
        same(known.indentation_mm, given.indentation_mm, 6e-4)
        same(known.contact, given.contact)
        same(known.sensor_from_object, given.sensor_from_object, 1e-9)
        same(known.force_n, given.force_n)


def check_live_recording(written: Any, folder: Path) -> None:
    options, streams = written
    name, frames = next(iter(streams.items()))
    path = folder / "live.h5"
    path.unlink(missing_ok=True)
    with LiveRecordingWriter(path, notes=options["notes"], coding=options["coding"]) as writer:
        for frame, _ in frames:
            writer.append(name, frame)
    with closing(hdf5.read(path)) as recording:
        compare_stream(recording.stream(name), [(frame, None) for frame, _ in frames], 0.0)


# Calibrations


@st.composite
def calibrations(draw: Any) -> Calibration:
    colour = draw(st.integers(1, 2))
    position = draw(st.integers(0, 2))
    n_terms = len(slope_model.list_exponents(colour))
    finite = st.floats(-1e3, 1e3, width=32)
    model = SlopeModel(
        colour_degree=colour,
        position_degree=position,
        slope_max=draw(POSITIVE),
        coefficients=draw(arrays(np.float32, (position + 1, position + 1, n_terms, 2), finite)),
    )
    used = BallFit(
        index=0,
        x_px=draw(NUMBERS),
        y_px=draw(NUMBERS),
        radius_px=draw(POSITIVE),
        residual=draw(POSITIVE),
        used=True,
    )
    unused = BallFit(
        index=1, x_px=math.nan, y_px=math.nan, radius_px=math.nan, residual=math.nan, used=False
    )
    shares = st.floats(0.0, 1.0)
    error = st.builds(
        ExpectedError,
        diameter_share=shares,
        diameter_p90=shares,
        depth_share=shares,
        depth_p90=shares,
        n_held_out=st.integers(0, 99),
    )
    return Calibration(
        sensor=draw(NAMES),
        rows=draw(st.integers(1, 900)),
        cols=draw(st.integers(1, 900)),
        pixel_mm=draw(POSITIVE),
        model=model,
        origin=draw(WORDS),
        presses=tuple(draw(st.lists(st.sampled_from((used, unused))))),
        uses_built_in=draw(st.booleans()),
        expected_error=draw(optional(error)),
        diameter_ratio=draw(optional(POSITIVE)),
        reference_thumbnail=draw(optional(arrays(np.uint8, (2, 3, 3)))),
        coverage_map=draw(optional(arrays(np.bool_, (2, 3)))),
        depth_scale_map=draw(optional(arrays(np.float32, (2, 3), st.floats(0.125, 9.0, width=32)))),
    )


def check_calibration(calibration: Calibration, folder: Path) -> None:
    back = calibration_file.load(calibration_file.save(calibration, folder / "c.npz"))
    for name in ("reference_thumbnail", "coverage_map", "depth_scale_map"):
        same(getattr(back, name), getattr(calibration, name))
    same(back.model.coefficients, calibration.model.coefficients)
    same(
        np.array([[f.x_px, f.y_px, f.residual] for f in back.presses]),
        np.array([[f.x_px, f.y_px, f.residual] for f in calibration.presses]),
    )
    blank = {
        "reference_thumbnail": None,
        "coverage_map": None,
        "depth_scale_map": None,
        "presses": (),
    }
    assert replace(back, model=calibration.model, **blank) == replace(calibration, **blank)
    assert replace(back.model, coefficients=calibration.model.coefficients) == calibration.model
    assert [fit.used for fit in back.presses] == [fit.used for fit in calibration.presses]


def check_force_scale(written: Any, folder: Path) -> None:
    calibration, sensor, pairs = written
    known = (
        None if calibration is None else calibration_file.save(calibration, folder / "known.npz")
    )
    scale = fit_force_scale(sensor, *zip(*pairs, strict=True))
    save_force_scale(scale, folder / "f.npz", known)
    back = load_force_scale(folder / "f.npz")
    assert back is not None
    assert (back.sensor, back.factor, back.exponent) == (scale.sensor, scale.factor, scale.exponent)
    same(back.weighings_n, scale.weighings_n)
    table = calibration_file.load_if_present(folder / "f.npz")
    assert (table and table.sensor) == (calibration and calibration.sensor)


FORCE_SCALES = st.tuples(
    optional(calibrations()),
    NAMES,
    st.lists(st.tuples(st.floats(0.01, 100.0), st.floats(0.01, 100.0)), min_size=2, max_size=5),
)


# Alignments, sessions


def check_alignment(written: Any, folder: Path) -> None:
    first, second, source, target, origin = written
    alignment = Alignment(alignment_from_source=first, target_from_alignment=second)
    content = AlignmentFile(alignment=alignment, source=source, target=target, origin=origin)
    save_alignment(folder / "a.toml", content)
    back = load_alignment(folder / "a.toml", source=source, target=target)
    same(back.alignment.target_from_source, alignment.target_from_source, 1e-6)


TRIPLES = st.tuples(*[st.floats(-300.0, 300.0)] * 3)
LAYOUTS = st.builds(
    Layout,
    name=st.sampled_from(("look", "compare", "align")),
    panes=st.lists(
        st.tuples(NAMES, st.sampled_from(("2D", "3D", "both"))), min_size=1, max_size=3
    ).map(tuple),
)


@st.composite
def sessions(draw: Any, folder: str = "files", variant: bool = True) -> Session:
    paths = optional(NAMES.map(lambda name: Path(folder) / name))
    return Session(
        recording=draw(paths),
        source=draw(WORDS),
        target=draw(WORDS),
        stream=draw(WORDS),
        frame=draw(st.integers(0, 10**6)),
        reference=draw(paths),
        calibration=draw(paths),
        mesh=draw(paths),
        alignment=draw(paths),
        offsets=draw(
            st.builds(Offsets, translation_mm=TRIPLES, rotation_deg=TRIPLES, pivot_mm=TRIPLES)
        ),
        layout=draw(LAYOUTS),
        cameras_linked=draw(st.booleans()),
        methods=draw(st.sampled_from(({}, {"target_depth": "paper"}))),
        weights={} if (file := draw(paths)) is None else {"touch": file},
        params=draw(st.sampled_from(({}, {"display": DisplayParams()}))),
        notes=draw(st.dictionaries(st.integers(0, 99), WORDS, max_size=3)),
        comparison=ComparisonSettings(stage=draw(NAMES)),
        cameras=draw(st.dictionaries(NAMES, st.tuples(*[NUMBERS] * 10), max_size=2)),
        section=draw(
            optional(
                st.builds(
                    SectionLine,
                    begin_mm=st.tuples(*[st.floats(-90.0, 90.0)] * 2),
                    end_mm=st.tuples(*[st.floats(-90.0, 90.0)] * 2),
                )
            )
        ),
        tick=draw(st.integers(0, 99)),
        variant=draw(optional(sessions(folder, False))) if variant else None,
    )


def check_session(session: Session, folder: Path) -> None:
    def place(one: Session) -> Session:
        """The session with its files within the folder of this run."""
        files = {
            name: folder / getattr(one, name)
            for name in ("recording", "reference", "calibration", "mesh", "alignment")
            if getattr(one, name) is not None
        }
        variant = (
            None if one.variant is None else place(replace(one.variant, cameras={}, section=None))
        )
        return replace(
            one,
            **files,
            weights={key: folder / file for key, file in one.weights.items()},
            variant=variant,
        )

    written = place(session)
    path = folder / "a.touch.json"
    save_session(written, path)
    back = load_session(path)
    assert back == written
    assert (dict(back.cameras), back.section, back.tick) == (
        dict(written.cameras),
        written.section,
        written.tick,
    )


# Tracks and rollouts


@st.composite
def tracks(draw: Any) -> TrackRecord:
    motion = {
        name: st.floats(-99.0, 99.0).map(lambda v: round(v, 5) + 0.0)
        for name in (
            "x_mm",
            "y_mm",
            "z_mm",
            "rx_deg",
            "ry_deg",
            "rz_deg",
            "std_mm",
            "std_deg",
            "overlap",
            "agreement",
        )
    }
    weak = st.sampled_from(("", "x", "x; y; about z", "along 3, and 4"))
    followed = st.builds(
        TrackRow,
        frame=st.integers(0, 999),
        state=st.just("tracked"),
        part=st.integers(0, 9),
        key_frame=optional(st.integers(0, 99)),
        not_measured=weak,
        **motion,
    )
    lost = st.builds(
        TrackRow,
        frame=st.integers(0, 999),
        state=st.sampled_from(("lost", "no contact")),
        part=st.integers(0, 9),
    )
    error = st.builds(
        TrackError,
        path_mm=POSITIVE,
        turned_deg=POSITIVE,
        drift_mm=POSITIVE,
        drift_deg=POSITIVE,
        n_frames=st.integers(0, 99),
    )
    corners = np.array([[0.0, 0, 0], [7, 0, 0], [0, 5, 1], [0, 0, 9]])
    patch = Mesh(
        vertices_mm=corners * draw(st.floats(0.5, 5.0)),
        triangles=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
    )
    return TrackRecord(
        stage=draw(st.sampled_from(("depth", "touch_depth"))),
        rows=tuple(draw(st.lists(followed | lost, max_size=4))),
        key_frames=tuple(draw(st.lists(st.integers(0, 99), max_size=3))),
        n_loops=draw(st.integers(0, 9)),
        error=draw(optional(error)),
        patch=draw(optional(st.just(patch))),
        problems=tuple(draw(st.lists(WORDS, max_size=2))),
    )


def check_track(record: TrackRecord, folder: Path) -> None:
    write_record(folder, record)
    back = read_record(folder)
    names = list(TrackRow.__dataclass_fields__)
    for one, two in zip(back.rows, record.rows, strict=True):
        assert [repr(getattr(one, name)) for name in names] == [
            repr(getattr(two, name)) for name in names
        ]
    assert (back.patch is None) is (record.patch is None)
    if back.patch is not None and record.patch is not None:
        np.testing.assert_allclose(
            np.sort(back.patch.vertices_mm, 0), np.sort(record.patch.vertices_mm, 0), atol=1e-5
        )
    assert replace(back, rows=(), patch=None) == replace(record, rows=(), patch=None)


@st.composite
def rollouts(draw: Any) -> tuple[Rollout, TrialPlan]:
    body = draw(NAMES.filter(lambda name: name not in ("object", "hand")))
    ticks = tuple(
        Tick(
            time_s=0.1 * k,
            world_from_object=draw(POSES),
            world_from_hand=draw(POSES),
            commanded=draw(POSES),
            force_n=draw(arrays(np.float64, (3,), NUMBERS)),
            world_from_bodies={body: draw(POSES)},
        )
        for k in range(draw(st.integers(1, 3)))
    )
    decision = st.builds(
        Decision,
        tick=st.integers(0, len(ticks) - 1),
        error_mm=st.floats(0.0, 99.0),
        estimate=st.dictionaries(NAMES, NUMBERS, max_size=2),
    )
    image = np.random.default_rng(draw(SEEDS)).integers(0, 256, (3, 4, 3), dtype=np.uint8)
    frames = tuple(
        ("gelslim", TactileFrame(sensor="gelslim", image=image, reference=image, index=k), None)
        for k in range(draw(st.integers(1, 2)))
    )
    rollout = Rollout(
        case=draw(NAMES),
        trial=draw(st.integers(0, 99)),
        touch=draw(NAMES),
        tolerance_mm=draw(st.floats(0.1, 9.0)),
        succeeds=draw(st.booleans()),
        cause=draw(NAMES),
        measures=draw(st.dictionaries(NAMES, NUMBERS, max_size=2)),
        decisions=tuple(draw(st.lists(decision, max_size=2))),
        ticks=ticks,
        frames=frames,
    )
    plan = TrialPlan(
        task="insertion",
        case=rollout.case,
        index=0,
        touches=("t2t", "none"),
        tolerances_mm=(0.5,),
        seed=draw(SEEDS),
        vary=draw(st.floats(0.0, 1.0)),
    )
    return rollout, plan


def check_rollout(written: Any, folder: Path) -> None:
    rollout, plan = written
    write_rollout(rollout, folder / "r.h5", "key", plan)
    back = read_rollout(folder / "r.h5")
    assert back.plan == replace(
        plan, touches=(rollout.touch,), tolerances_mm=(rollout.tolerance_mm,)
    )
    stated = summarise(rollout)
    assert {
        name: getattr(back.summary, name)
        for name in ("case", "trial", "touch", "tolerance_mm", "cause", "measures")
    } == {
        name: stated[name]
        for name in ("case", "trial", "touch", "tolerance_mm", "cause", "measures")
    }
    same(back.world_from_object, np.array([tick.world_from_object for tick in rollout.ticks]))
    same(back.commanded, np.array([tick.commanded for tick in rollout.ticks]))
    same(back.force_n, np.array([tick.force_n for tick in rollout.ticks]))
    (name, table), *_ = back.world_from_bodies.items()
    same(table, np.array([tick.world_from_bodies[name] for tick in rollout.ticks]))


# Weights, trainings, caches


@st.composite
def networks(draw: Any) -> Weights:
    finite = st.floats(-1e4, 1e4, width=32)
    plain = st.booleans() | st.integers(-9999, 9999) | NUMBERS | WORDS
    return Weights(
        name="w",
        kind=draw(NAMES),
        config=draw(st.dictionaries(NAMES, plain, max_size=3)),
        tensors={
            name: draw(arrays(np.float32, (2, 3), finite))
            for name in draw(st.lists(NAMES, min_size=1, max_size=3, unique=True))
        },
        card=draw(st.dictionaries(NAMES, WORDS, max_size=3)),
    )


def check_weights(weights: Weights, folder: Path) -> None:
    save_weights(folder / "w.safetensors", weights)
    back = load_weights(folder / "w.safetensors")
    assert back.content_digest == weights.content_digest
    assert dict(back.card) == dict(weights.card)


@st.composite
def trainings(draw: Any) -> TrainingState:
    import torch

    tensors = {
        draw(NAMES): torch.tensor(draw(st.lists(st.floats(-9.0, 9.0, width=32), max_size=4)))
    }
    return TrainingState(
        recipe=draw(WORDS),
        step=draw(st.integers(0, 10**6)),
        network_tensors=tensors,
        trained_s=draw(POSITIVE),
        curve=[{"step": 1.0, "loss": draw(POSITIVE)}],
        metrics=[{"name": draw(NAMES), "value": draw(POSITIVE)}],
    )


def check_training(state: TrainingState, folder: Path) -> None:
    save_state(folder, state)
    back = load_state(folder)
    for one, two in zip(back.network_tensors.values(), state.network_tensors.values(), strict=True):
        assert one.equal(two)
    state.network_tensors = back.network_tensors
    assert back == state


@dataclass(frozen=True, slots=True, kw_only=True)
class Made:
    """A value that both caches hold."""

    table: Any
    name: str


@st.composite
def made_values(draw: Any) -> Made:
    return Made(
        table=draw(arrays(np.float32, (2, 3), st.floats(-99.0, 99.0, width=16))), name=draw(NAMES)
    )


def check_disk_store(value: Made, folder: Path) -> None:
    stored = disk_store.load_or_make(
        Made, (value.table, value.name), (__name__,), lambda: value, folder
    )
    again = disk_store.load_or_make(
        Made, (value.table, value.name), (__name__,), lambda: pytest.fail("not read"), folder
    )
    same(again.table, stored.table)
    assert again.name == value.name


def check_sample_cache(value: Made, folder: Path) -> None:
    cache = SampleCache(Made)
    (folder / "one.npz").unlink(missing_ok=True)
    cache.get("one", str(folder), lambda: value)
    cache.clear()
    again = cache.get("one", str(folder), lambda: pytest.fail("not read"))
    same(again.table, value.table)
    assert again.name == value.name


# Reports, tables, arrays, images

REPORTS = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**53), 2**53)
    | st.floats(allow_nan=False, allow_infinity=False)
    | WORDS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner, max_size=3),
)


def check_report(value: Any, folder: Path) -> None:
    write_json(folder / "r.json", value)
    assert read_json(folder / "r.json", "the report") == value


def check_arrays(stored: Any, folder: Path) -> None:
    write_arrays(folder / "a.npz", stored)
    back = read_arrays(folder / "a.npz", "the arrays")
    assert back.keys() == stored.keys()
    for name, array in stored.items():
        assert back[name].dtype == array.dtype
        same(back[name], array)


ARRAYS = st.dictionaries(
    st.tuples(NAMES, NAMES).map(".".join),
    npst.arrays(
        st.sampled_from((np.float32, np.float64, np.int32, np.uint8, np.bool_)),
        npst.array_shapes(max_dims=3, min_side=0),
    ),
    max_size=3,
)


def check_tiles(titles: Any, folder: Path) -> None:
    tiles = [Tile(title=title, metrics=metrics) for title, metrics in titles]
    write_tiles(folder / "tiles", tiles)
    back = read_json(folder / "tiles" / TABLE_FILE, "the comparison")["tiles"]
    assert [(tile["title"], tile["metrics"]) for tile in back] == [
        (tile.title, dict(tile.metrics)) for tile in tiles
    ]


def check_reference(image: Any, folder: Path) -> None:
    import cv2

    frames = folder / "frames"
    frames.mkdir(exist_ok=True)
    for index in range(3):
        cv2.imwrite(str(frames / f"{index}.png"), image[:, :, ::-1])
    written, _ = write_reference(frames, folder / "reference.png")
    same(written, image)
    same(read_rgb(folder / "reference.png"), image)


class Case(NamedTuple):
    values: st.SearchStrategy[Any]
    check: Callable[[Any, Path], None]


CASES = {
    "recording": Case(recordings(), check_recording),
    "live recording": Case(recordings(), check_live_recording),
    "calibration": Case(calibrations(), check_calibration),
    "force scale": Case(FORCE_SCALES, check_force_scale),
    "alignment": Case(st.tuples(POSES, POSES, NAMES, NAMES, WORDS), check_alignment),
    "session": Case(sessions(), check_session),
    "track": Case(tracks(), check_track),
    "rollout": Case(rollouts(), check_rollout),
    "weights": Case(networks(), check_weights),
    "training": Case(trainings(), check_training),
    "cache on disk": Case(made_values(), check_disk_store),
    "training sample": Case(made_values(), check_sample_cache),
    "report": Case(REPORTS, check_report),
    "arrays": Case(ARRAYS, check_arrays),
    "comparison": Case(
        st.lists(st.tuples(WORDS, st.dictionaries(NAMES, NUMBERS, max_size=2)), max_size=3),
        check_tiles,
    ),
    "reference": Case(arrays(np.uint8, (4, 5, 3)), check_reference),
}


# Module that writes files -> the case above, or why it has none.
WRITERS = {
    "app/session/state.py": "session",
    "app/window/screenshots.py": "no reader: an image for people",
    "pipeline/core/figures.py": "no reader: an image for people",
    "pipeline/calibration/calibration_file.py": "calibration",
    "pipeline/calibration/force_scale.py": "force scale",
    "pipeline/cli/attribute.py": "report",
    "pipeline/cli/evaluate.py": "report",
    "pipeline/cli/task.py": "report",
    "pipeline/core/disk_store.py": "cache on disk",
    "pipeline/lab/evaluation/comparison_tiles.py": "comparison",
    "pipeline/io/live/recorder.py": "live recording",
    "pipeline/stages/networks/weights.py": "weights",
    "pipeline/io/hdf5_writer.py": "recording",
    "pipeline/io/reference_estimate.py": "reference",
    "pipeline/translation/reports/export.py": "arrays",
    "pipeline/translation/reports/report.py": "report",
    "pipeline/translation/reports/repro_bundle.py": "report",
    "pipeline/translation/reports/video.py": "no reader: its frames are counted before it is moved",
    "pipeline/sensors/alignment.py": "alignment",
    "pipeline/lab/tasks/rerun.py": "report",
    "pipeline/lab/tracking/track_record.py": "track",
    "pipeline/lab/training/simulated_touches.py": "training sample",
    "pipeline/lab/training/run_folder.py": "training",
}


def test_no_writer_is_left_out():
    root = Path(__file__).parents[1]
    helper = re.compile(
        r"\b(open_atomic|open_growing_file|write_(text|json|arrays|together|folder))\("
    )
    found = {
        path.relative_to(root).as_posix()
        for package in ("pipeline", "app", "widgets")
        for path in (root / package).rglob("*.py")
        if helper.search(path.read_text("utf-8"))
    } - {"pipeline/core/files.py"}
    assert found == WRITERS.keys()
    assert all(case in CASES or case.startswith("no reader: ") for case in WRITERS.values())


def check_many(name: str, folder: Path, n: int) -> None:
    case = CASES[name]
    every = settings(max_examples=n, suppress_health_check=list(HealthCheck))
    every(given(case.values)(lambda value: case.check(value, folder)))()


@pytest.mark.parametrize("name", CASES)
def test_what_a_writer_writes_its_reader_opens(name, tmp_path):
    check_many(name, tmp_path, 8)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", CASES)
def test_what_a_writer_writes_its_reader_opens_500_times(name, tmp_path):
    check_many(name, tmp_path, 500)
