"""No contact in, no touch out: whatever the method, nothing is sampled of a frame that does not
touch the target.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.errors import AlignmentWarning, UncertainContact
from pipeline.core.geometry import rigid
from pipeline.core.graph import Graph
from pipeline.core.progress import SILENT
from pipeline.core.values.frames import TactileFrame
from pipeline.physics import optics
from pipeline.sensors import alignment
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.photometric import DepthParams
from pipeline.stages.networks.weights import NoWeights, save_weights
from pipeline.stages.touch import latent_diffusion, physical_render, t2d2, t2t, vqvae
from pipeline.stages.touch.frame_chain import guard_contact
from pipeline.stages.touch.moved_touch import get_trained_alignment
from pipeline.translation.catalogue import BUILT_IN
from tests.pipeline.stages.target_views import estimate_views
from tests.pipeline.stages.test_latent_diffusion_touch import make_depth_weights
from tests.pipeline.stages.test_light_changes import add_spot

pytestmark = pytest.mark.usefixtures("shared_results")
GEL = load_sensor("gelslim")
BUBBLE = load_sensor("soft_bubble")
METHODS = tuple(method.name for method in BUILT_IN.stage("touch").methods)
SAMPLERS = (
    (t2d2, "sample_residual"),
    (t2t, "sample_residual"),
    (latent_diffusion, "sample_image"),
    (vqvae, "_run_network"),
)


def evaluate(
    name, frame, *, target=BUBBLE, target_too_far_mm=0.0, between=None, graph=None, file=None
):
    """All results up to the depth of the touch by a method with its shipped weights."""
    methods = BUILT_IN.methods("t2d2", {"touch": name}, {"source": GEL.kind, "target": target.kind})
    moved = between or alignment.correct_alignment(
        alignment.resolve_alignment(GEL, target), rigid.translation(0.0, 0.0, target_too_far_mm)
    )
    inputs = {
        "frame": frame,
        "source": GEL,
        "target": target,
        "calibration": None,
        "mesh": None,
        "previous": None,
        "previous_membrane": None,
        "alignment": moved,
        **{
            m.weights_name: m.weights(GEL, target, file if m.stage == "touch" else None)
            for m in methods
            if m.weights is not None
        },
    }
    if graph is not None:
        return graph.with_methods(methods).evaluate(["touch"], inputs, {})
    return Graph(methods).evaluate(["touch", "touch_depth", "pose"], inputs, {})


@pytest.fixture(scope="module")
def still():
    return optics.render_reference(GEL)


@pytest.fixture(scope="module")
def lit_frame(still):
    """The reference image with a wide spot of light, which a large touch might make as well."""
    image = add_spot(still, grey=40.0, place=(0.5, 0.4), width=0.2)
    return TactileFrame(sensor="gelslim", image=image, reference=still)


@pytest.fixture(scope="module")
def touched_frame(still):
    y, x = np.mgrid[: GEL.camera.rows, : GEL.camera.cols] * GEL.pixel_mm
    dent = np.maximum(0.6 - ((x - 9.0) ** 2 + (y - 7.0) ** 2) / 12.0, 0.0).astype(np.float32)
    return TactileFrame(sensor="gelslim", image=optics.render(GEL, dent, seed=1), reference=still)


@pytest.fixture
def sampled(monkeypatch):
    """The samplers that were asked."""
    asked = []
    for module, name in SAMPLERS:
        sample = getattr(module, name)
        monkeypatch.setattr(
            module,
            name,
            lambda *given, _sample=sample, _name=name, **more: (
                asked.append(_name),
                _sample(*given, **more),
            )[1],
        )
    return asked


@pytest.mark.parametrize("name", METHODS)
def test_a_change_taken_for_light_makes_no_touch(name, lit_frame, sampled):
    results = evaluate(name, lit_frame)
    touch = results["touch"]
    assert not sampled
    assert touch.state == "skipped"
    assert np.array_equal(touch.output.image, physical_render.make_reference_touch(BUBBLE).image)
    assert not results["touch_depth"].output.contact.any()


def test_nothing_made_of_an_uncertain_frame_is_called_exact_or_untouched(lit_frame):
    for name in METHODS:
        results = evaluate(name, lit_frame, target=GEL)
        for stage, result in results.items():
            assert any(isinstance(note, UncertainContact) for note in result.notes), (
                name,
                stage,
                result.notes,
            )
            for note in result.notes:
                assert "exact" not in note, (name, stage)
                assert not note.startswith("no contact"), (name, stage)


def test_a_frame_without_change_is_exact_on_a_gel(still):
    frame = TactileFrame(sensor="gelslim", image=still, reference=still)
    for name in METHODS:
        assert evaluate(name, frame, target=GEL)["touch"].notes[0].endswith("is exact")


@pytest.mark.parametrize("name", METHODS)
def test_a_target_out_of_reach_is_not_touched_and_the_alignment_is_named(
    name, touched_frame, sampled
):
    assert evaluate(name, touched_frame)["touch_depth"].output.contact.any()
    sampled.clear()
    results = evaluate(name, touched_frame, target_too_far_mm=9.0)
    touch = results["touch"]
    assert not sampled
    assert not results["touch_depth"].output.contact.any()
    assert "correct the alignment" in " ".join(touch.notes)
    assert not any("check the source" in note or "no contact:" in note for note in touch.notes)
    warnings = [warning for result in results.values() for warning in result.warnings]
    assert any(isinstance(warning, AlignmentWarning) for warning in warnings), (
        "offers to centre the touch"
    )


def draw_alignments_out_of_reach(n):
    """Alignments by which no point that the gel can feel lies inside the bubble's surface."""
    rng = np.random.default_rng(5)
    deepest = GEL.rest_depth_mm.astype(np.float64) - GEL.limits.indentation_max_mm
    points = GEL.camera.back_project(deepest)[::8, ::8].reshape(-1, 3)
    described = alignment.resolve_alignment(GEL, BUBBLE)
    drawn = []
    while len(drawn) < n:
        motion = rigid.rotation(np.deg2rad([6.0, 6.0, 25.0]) * rng.uniform(-1.0, 1.0, 3))
        motion[:3, 3] = *rng.uniform(-40.0, 40.0, 2), rng.uniform(-9.0, 12.0)
        moved = alignment.correct_alignment(described, motion)
        x_mm, y_mm, z_mm = rigid.apply(moved.target_from_source, points).T
        camera = BUBBLE.camera
        col, row = camera.fx_px * x_mm / z_mm + camera.cx_px, camera.fy_px * y_mm / z_mm
        row = row + camera.cy_px
        inside = (row >= 0) & (row < camera.rows - 1) & (col >= 0) & (col < camera.cols - 1)
        rest_mm = BUBBLE.rest_depth_mm[
            np.rint(row[inside]).astype(int), np.rint(col[inside]).astype(int)
        ]
        if (z_mm[inside] > rest_mm + 0.2).all():
            drawn.append(moved)
    return drawn


def test_nothing_is_invented_where_nothing_can_reach(touched_frame, sampled):
    """200 touches and more: every method, with its shipped weights and with those of recorded
    pairs.
    """
    reference = physical_render.make_reference_touch(BUBBLE)
    n_invented, n = 0, 0
    graph = Graph(())
    for moved in draw_alignments_out_of_reach(29):
        for name in METHODS:
            touch = evaluate(name, touched_frame, between=moved, graph=graph)["touch"]
            n += 1
            n_invented += not np.array_equal(touch.output.image, reference.image)
            assert touch.state == "skipped", name
            assert touch.notes[0].endswith("correct the alignment")
    assert n >= 200
    assert n_invented == 0
    assert not sampled


def test_latent_touches_are_pressed_at_the_given_alignment(touched_frame, tmp_path, monkeypatch):
    """A network knows grasps of one depth, which the described alignment is not."""
    trained = get_trained_alignment(GEL)
    deep = evaluate("physics", touched_frame, between=trained)["touch"].output
    assert deep.membrane.indentation_mm.max() > 10.0
    known = replace(deep, membrane=None)
    monkeypatch.setattr(latent_diffusion, "_sample_touch", lambda *_: known)
    file = tmp_path / "latent.safetensors"
    save_weights(file, make_depth_weights(condition="image"))
    found = evaluate("latent", touched_frame, file=file)["touch"]
    assert found.answered_by.startswith("T2T latent")
    membrane = found.output.membrane
    assert membrane.contact.any()
    assert 2.0 < membrane.indentation_mm.max() < 6.0, "4 mm inside the gel's surface, as described"


def test_weights_of_recorded_pairs_are_asked_only_of_touches_that_reach(touched_frame, lit_frame):
    """Whoever trained them: by the alignment a touch that misses the target is none."""
    from tests.pipeline.stages.test_touch_from_source import weights_of

    weights = replace(
        weights_of("vqvae", "vqvae", inputs=3, outputs=1, width=4, codes=8),
        config={"trained_on_recordings": 1.0},
    )
    far = alignment.correct_alignment(
        alignment.resolve_alignment(GEL, BUBBLE), rigid.translation(0.0, 0.0, 30.0)
    )
    guard = guard_contact(lambda *_: "asked")

    def run(frame, between):
        view, depth = estimate_views(frame, GEL, between, BUBBLE)
        return guard(frame, depth, GEL, None, between, BUBBLE, view, weights, None, SILENT)

    near = alignment.resolve_alignment(GEL, BUBBLE)
    assert run(touched_frame, near) == "asked"
    assert run(touched_frame, far).reason.endswith("correct the alignment")
    assert run(lit_frame, near) != "asked"


@pytest.mark.parametrize("name", ["t2t", "latent", "vqvae"])
def test_methods_and_parameters_of_depth_reach_touches_from_images(name, touched_frame):
    """A touch that the user's depth does not see is none, whichever method would generate it."""

    def evaluate_with(params, graph=None, **others):
        kinds = {"source": GEL.kind, "target": BUBBLE.kind}
        methods = BUILT_IN.methods("t2d2", {"touch": name, **others}, kinds)
        graph = Graph(methods) if graph is None else graph.with_methods(methods)
        inputs = {
            "frame": touched_frame,
            "source": GEL,
            "target": BUBBLE,
            "calibration": None,
            "alignment": alignment.resolve_alignment(GEL, BUBBLE),
            "touch_weights": NoWeights(why="none"),
            "previous_membrane": None,
            "depth_weights": NoWeights(why="none"),
            "true_depth": replace(depth, contact=np.zeros_like(depth.contact)),
        }
        return graph, graph.evaluate(["touch"], inputs, params)

    depth = estimate_views(touched_frame, GEL, alignment.resolve_alignment(GEL, BUBBLE), BUBBLE)[1]
    graph, results = evaluate_with({})
    assert results["touch"].output.membrane.contact.any()
    deeper = 0.9 * float(depth.indentation_mm.max()) / GEL.limits.contact_min_mm
    _, limited = evaluate_with({"depth": DepthParams(contact_limit=min(deeper, 10.0))}, graph)
    assert (
        limited["touch"].output.membrane.contact.sum()
        < results["touch"].output.membrane.contact.sum()
    )
    _, untouched = evaluate_with({}, graph, depth="truth")
    assert untouched["touch"].state == "skipped"
    _, splat = evaluate_with({}, graph, target_depth="paper")
    assert splat["touch"].digest != results["touch"].digest


def test_the_default_methods_are_those_of_the_default_route():
    t2t = BUILT_IN.methods("t2t")
    for kind in ("gel", "bubble"):
        known = {
            m.stage: m for m in BUILT_IN.methods("t2d2", kinds={"source": kind, "target": kind})
        }
        chosen = [m for m in Graph(t2t).list_methods(kind) if m not in t2t]
        assert [m.stage for m in chosen] == ["depth", "cloud", "target_depth"]
        assert all(known[m.stage] is m for m in chosen)
