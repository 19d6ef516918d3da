"""The paper's tables on recorded pairs: a folder in the published layout, held out as the
training held out.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.cli.evaluate import parse_weights
from pipeline.cli.main import EXIT_USER_ERROR, build_app, run_app
from pipeline.core.errors import SettingProblem
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh, sample_surface
from pipeline.lab.evaluation import paper_figures
from pipeline.lab.evaluation.held_out import Candidate, find_trained_hold_out, select_recorded
from pipeline.lab.evaluation.paper_tables import EvaluationRequest
from pipeline.lab.evaluation.table_rows import build_rows
from pipeline.lab.evaluation.touch_metrics import TouchMetrics, bootstrap_metrics, pool_metrics
from pipeline.lab.evaluation.touch_scoring import PAPER_GRASP, GraspFinger, ScoredTouch
from pipeline.lab.training.recorded_pairs import PairFolder, open_pairs
from pipeline.physics.simulation import shapes
from pipeline.stages.networks.weights import Weights, load_weights, save_weights
from pipeline.stages.networks.weights_registry import WEIGHTS_FOLDER
from tests.pipeline.io.touch2touch_files import write_grasps

SAMPLE = Path(__file__).parents[4] / "sample_data" / "recordings" / "first_touch.h5"
SHIPPED = WEIGHTS_FOLDER / "vqvae_gelslim_to_soft_bubble.safetensors"


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    root = tmp_path_factory.mktemp("touch2touch") / "data"
    for k, tool in enumerate(("hex", "peg")):
        write_grasps(SAMPLE, root / "train", tool, first=10 * k)
    return root


@pytest.fixture
def trained(tmp_path) -> Path:
    """Weights whose card says that one grasp of `peg` was held out."""
    shipped = load_weights(SHIPPED)
    split = {"train": [["hex", 0], ["hex", 1]], "test": [["peg", 11]]}
    (tmp_path / "held_out.json").write_text(json.dumps(split))
    recipe = {
        "task": "vqvae",
        "data": {"pairs": "data", "hold_out": str(tmp_path / "held_out.json")},
    }
    path = tmp_path / "mine.safetensors"
    save_weights(
        path,
        Weights(
            name="mine",
            kind=shipped.kind,
            config=shipped.config,
            tensors=shipped.tensors,
            onnx=shipped.onnx,
            card={**shipped.card, "recipe": json.dumps(recipe)},
        ),
    )
    return path


def test_the_tables_hold_the_pairs_that_the_training_held_out(data, trained, tmp_path, capsys):
    out = tmp_path / "table.json"
    code = run_app(
        build_app(),
        [
            "evaluate",
            "--recordings",
            str(data),
            "--split",
            "unseen_tools",
            "--weights",
            f"vqvae={trained}",
            "--only",
            "vqvae",
            "--method",
            "depth=physics",
            "--poses",
            "none",
            "--json",
            str(out),
        ],
    )
    said = capsys.readouterr()
    assert code == 0, said.err
    table = json.loads(out.read_text())
    assert "vqvae" not in {row["candidate"] for row in table["rows"] if row["target"] == "gelslim"}
    assert "do not translate from a bubble to a gel" in table["notes"][-1]
    rows = {row["candidate"]: row for row in table["rows"] if row["target"] == "soft_bubble"}
    assert set(rows) == {"no_contact", "mean", "physics", "vqvae"}
    assert {row["n_touches"] for row in rows.values()} == {2}, (
        "the fingers of the grasp that was held out"
    )
    assert "1 validate as unseen tools (peg)" in " ".join(said.out.split())
    error = {name: row["metrics"]["error_mm"]["all"] for name, row in rows.items()}
    assert error["physics"] < error["no_contact"]
    assert all(np.isfinite(value) for value in error.values())


def test_figures_show_input_depth_touch_and_truth(data, tmp_path, monkeypatch):
    physics = Candidate(name="physics", title="physics", paper_model="T2D2")
    monkeypatch.setattr(paper_figures, "_select_models", lambda *_: {"T2D2": physics})
    rows = []
    draw = paper_figures._draw
    monkeypatch.setattr(
        paper_figures, "_draw", lambda of, *more: (rows.append(of), draw(of, *more))
    )
    request = EvaluationRequest(
        split="unseen_tools",
        directions=(("gelslim", "soft_bubble"),),
        methods={"depth": "physics"},
        pairs=PairFolder(path=str(data), hold_out="peg"),
    )
    paths = paper_figures.draw_paper_figures(request, tmp_path)
    assert [path.name for path in paths] == [
        "figure_4_unseen_tools.png",
        "figure_5_unseen_tools.png",
    ]
    assert all(path.stat().st_size > 10_000 for path in paths)
    assert {row.object_name for row in rows[0]} == {"peg"}
    images = rows[0][0].images
    assert set(images) == {"input", "target depth", "T2D2", "recorded touch"}
    assert images["input"].shape == (320, 427, 3)
    assert {images[name].shape for name in ("target depth", "T2D2", "recorded touch")} == {
        (140, 175, 3)
    }


def test_selections_are_of_one_tool_and_finger_and_name_their_grasps(data):
    pairs = open_pairs(PairFolder(path=str(data), hold_out="peg"), "gelslim", "soft_bubble")
    right, left = sorted(
        select_recorded(pairs, "unseen_tools"), key=lambda one: one.source_stream, reverse=True
    )
    assert (right.target_stream, left.target_stream) == ("soft_bubble right", "soft_bubble left")
    assert right.frames == left.frames
    assert all(name.startswith("peg") for name in right.frame_names)
    assert {one.object_name for one in select_recorded(pairs, "training")} == {"hex"}


def test_the_fingers_of_a_grasp_are_registered_together_by_the_papers_protocol():
    mesh = shapes.make_shape("three_lines").mesh
    # the pattern lies in the grasp's plane
    upright = rigid.from_parts((0.0, 0.0, 0.0), (0.0, 90.0, 0.0))
    laid = Mesh(vertices_mm=rigid.apply(upright, mesh.vertices_mm), triangles=mesh.triangles)
    pose = rigid.from_parts((0.0, 1.0, 0.0), (5.0, 0.0, 0.0))
    points = rigid.apply(pose, sample_surface(laid, 2000, 1)[0])
    empty = TouchMetrics(values={}, n_pixels={}, peak_value=1.0)
    scored = [
        ScoredTouch(
            candidate="physics",
            touch_name="hex 1",
            metrics=empty,
            ms=1.0,
            pose_errors={},
            features=None,
            finger=GraspFinger(points_mm=points[finger::2], grasp_from_object=pose, mesh=laid),
        )
        for finger in (0, 1)
    ]
    physics = Candidate(name="physics", title="physics")
    (row,) = build_rows("unseen_tools", "gelslim", "soft_bubble", [physics], scored)
    errors = row.pose_errors[PAPER_GRASP]
    assert errors.n_poses == 1
    assert errors.rotation_deg[0] < 0.5
    assert errors.translation_mm[0] < 0.2


def test_weights_that_held_out_different_pairs_are_refused(trained, tmp_path):
    assert find_trained_hold_out({"vqvae": trained, "t2t": SHIPPED}).endswith("held_out.json")
    other = load_weights(trained)
    recipe = json.dumps({"data": {"pairs": "data", "hold_out": "hex"}})
    save_weights(
        tmp_path / "other.safetensors",
        Weights(
            name="other",
            kind=other.kind,
            config=other.config,
            tensors=other.tensors,
            onnx=other.onnx,
            card={**other.card, "recipe": recipe},
        ),
    )
    with pytest.raises(SettingProblem, match="held out different pairs"):
        find_trained_hold_out({"vqvae": trained, "t2t": tmp_path / "other.safetensors"})


def test_mistakes_are_one_sentence(data, trained, capsys):
    for tokens, words in (
        (("--hold-out", "screw"), "no tool 'screw' to hold out"),
        (("--weights", "magic=x"), "weights are given by method=FILE"),
        (("--weights", f"t2t={trained}", "--only", "t2t"), "were trained for vqvae"),
        (("--direction", "digit:gelslim"), "holds no pairs"),
    ):
        code = run_app(
            build_app(), ["evaluate", "--recordings", str(data), "--split", "unseen_tools", *tokens]
        )
        assert code == EXIT_USER_ERROR
        assert words in " ".join(capsys.readouterr().err.split())
    assert parse_weights(["depth=a", "t2t=b"]) == {"depth": Path("a"), "t2t": Path("b")}


def test_the_interval_of_a_mean_covers_it_and_counts_grasps_and_not_fingers():
    rng = np.random.default_rng(0)
    values = np.repeat(rng.normal(5.0, 1.0, 20), 2)  # both fingers of a grasp are equal
    touches = [
        TouchMetrics(
            values={("error_mm", "all"): v, ("squared", "all"): v},
            n_pixels={"all": 10},
            peak_value=255.0,
        )
        for v in values
    ]
    grasps = [f"hex {k // 2}" for k in range(40)]
    low, high = bootstrap_metrics(touches, grasps)["error_mm"]["all"]
    pooled = pool_metrics(touches)
    assert low < pooled["error_mm"]["all"] < high
    expected = 2 * 1.96 * values[::2].std() / np.sqrt(20)
    assert high - low == pytest.approx(expected, rel=0.15)
    fewer = bootstrap_metrics(touches, [str(k) for k in range(40)])["error_mm"]["all"]
    assert fewer[1] - fewer[0] < 0.8 * (high - low)
    psnr = bootstrap_metrics(touches, grasps)["psnr_db"]["all"]
    assert psnr[0] < pooled["psnr_db"]["all"] < psnr[1]
    assert bootstrap_metrics(touches[:8], grasps[:8]) == {}
