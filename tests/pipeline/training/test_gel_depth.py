"""Examples of gels that physics has read, and what a correction of them is judged by."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.networks.gel_depth import GelDepthPrediction
from pipeline.stages.depth.gel_network_input import CONTACT_CHANNEL, POSITION_CHANNEL, SURFACE_CHANNEL
from pipeline.training import gel_depth, gel_presses, gel_samples
from pipeline.training.gel_depth import GelDepthTask, make_example, mirror_example
from pipeline.training.gel_loss import compute_scale_free_loss
from pipeline.training.recipe import load_recipe

TASK = GelDepthTask(n_presses=3, n_images=12)


def sample(seed, task=TASK):
    return task.sample(np.random.default_rng(seed))


@pytest.fixture(scope="module")
def examples():
    return [make_example(gel_samples.simulate_gel_sample(3, index, 3)) for index in range(14)]


def test_an_example_depends_on_its_seed_alone(examples):
    again = make_example(gel_samples.simulate_gel_sample(3, 2, 3))
    assert {name: values.shape for name, values in again.items()} == {
        "fields": (16, 120, 160), "indentation": (120, 160), "contact": (120, 160), "depth": ()
    }  # fmt: skip
    assert all(np.array_equal(values, examples[2][name]) for name, values in again.items())
    assert not np.array_equal(examples[2]["fields"], examples[3]["fields"])


def test_contact_is_pushed_in_and_examples_are_finite(examples):
    touched = [one for one in examples if one["contact"].any()]
    assert len(touched) > 8
    for one in examples:
        assert np.isfinite(one["fields"]).all()
        assert set(np.unique(one["contact"])) <= {0, 1}
    for one in touched:
        inside, outside = one["contact"] > 0, one["contact"] == 0
        assert one["indentation"][inside].mean() > one["indentation"][outside].mean()


def test_physics_finds_a_contact_in_every_picture_and_is_often_about_right(examples):
    assert all(one["fields"][CONTACT_CHANNEL].any() for one in examples)
    touched = [one for one in examples if one["contact"].any()]
    alike = [np.corrcoef(one["fields"][SURFACE_CHANNEL].ravel(), one["indentation"].ravel())[0, 1] for one in touched]
    assert np.median(alike) > 0.9


def test_a_folder_keeps_pictures_and_gives_the_same_ones(tmp_path):
    kept = gel_samples.simulate_gel_sample(3, 2, 3, str(tmp_path))
    (file,) = tmp_path.iterdir()
    before = file.stat().st_mtime_ns
    again, unkept = gel_samples.simulate_gel_sample(3, 2, 3, str(tmp_path)), gel_samples.simulate_gel_sample(3, 2, 3)
    assert file.stat().st_mtime_ns == before
    for name in ("touched", "physical_px", "indentation_px"):
        np.testing.assert_allclose(getattr(again, name), getattr(unkept, name), rtol=1e-3, atol=1e-3)
    assert np.array_equal(again.contact, kept.contact)


def test_examples_are_drawn_from_as_many_pictures_as_are_wanted(monkeypatch):
    asked = []
    monkeypatch.setattr(
        gel_samples, "reading", lambda *which: asked.append(which) or gel_samples.simulate_unseen_tool(0)
    )
    for seed in range(60):
        assert sample(seed)["fields"].shape == (16, 80, 112)
    assert {index for _, index, _, _ in asked} == set(range(12))


def test_what_is_held_out_is_the_same_each_time_and_no_example_of_training():
    for split in ("unseen_grasps", "unseen_tools"):
        one, again = TASK.make_validation_example(split, 3), TASK.make_validation_example(split, 3)
        assert all(np.array_equal(one[name], again[name]) for name in one)
        assert one["fields"].shape == (16, 120, 160)


def test_a_mirror_turns_slopes_and_leaves_the_place(examples):
    one = next(e for e in examples if e["contact"].any())
    seen = set()
    for seed in range(12):
        turned = mirror_example(np.random.default_rng(seed), {k: v.copy() for k, v in one.items()})
        np.testing.assert_allclose(turned["fields"][POSITION_CHANNEL:], one["fields"][POSITION_CHANNEL:], atol=1e-6)
        for flips in ((), (-1,), (-2,), (-2, -1)):
            if np.array_equal(turned["indentation"], np.flip(one["indentation"], flips)):
                seen.add(flips)
                for axis, field in ((-1, 6), (-2, 7), (-1, 8), (-2, 9)):
                    sign = -1 if axis in flips else 1
                    assert np.array_equal(turned["fields"][field], sign * np.flip(one["fields"][field], flips))
    assert len(seen) == 4


def test_a_press_seen_nearer_is_larger_and_deeper_by_as_much():
    surface, touched = gel_presses._simulate_press(1, 0, mesh=False)
    areas, depths = [], []
    for zoom in (1.0, 1.4):
        view = np.array([[1 / zoom, 0, 103.5 - 79.5 / zoom], [0, 1 / zoom, 103.5 - 59.5 / zoom]], np.float32)
        areas.append(float((gel_presses._resample_to_sensor(touched, view, (120, 160)) > 0.5).sum()))
        depths.append(
            float(np.abs(np.gradient(zoom * gel_presses._resample_to_sensor(surface, view, (120, 160)))[0]).max())
        )
    if areas[0] and touched[30:-30, 30:-30].sum() == touched.sum():
        assert areas[1] / areas[0] == pytest.approx(1.96, rel=0.15)
    assert depths[1] == pytest.approx(depths[0], rel=0.2)  # slopes stay what they are


def test_meshes_press_too_and_pictures_are_of_both_kinds(monkeypatch):
    surface, touched = gel_presses._simulate_press(1, 0, mesh=True)
    assert surface.shape == touched.shape == (208, 208)
    assert surface[touched > 0].mean() > 5 * surface[touched == 0].mean()
    asked = []
    drawn = gel_presses.sample_gel_press
    monkeypatch.setattr(gel_presses, "drawn", lambda *a, mesh: asked.append(mesh) or drawn(*a, mesh=mesh))
    gel_samples.simulate_gel_sample(3, 4, 3)
    even = set(asked)
    asked.clear()
    gel_samples.simulate_gel_sample(3, 5, 3)
    assert even == {False}
    assert set(asked) == {True}


def reading(surface, contact, spread=0.1):
    nothing = torch.zeros_like(surface)
    return GelDepthPrediction(surface=surface, correction=nothing, contact_logit=contact, contact_logit_correction=nothing,
                   log_error_scale=nothing + float(np.log(spread)))  # fmt: skip


def test_the_truth_is_judged_better_than_anything_near_it(examples):
    batch = [torch.from_numpy(np.stack([e[name] for e in examples])) for name in ("indentation", "contact")]
    logit = 12.0 * (2.0 * batch[1].float() - 1.0)
    best, parts = compute_scale_free_loss(reading(batch[0], logit), *batch)
    assert float(parts["surface"]) == pytest.approx(0, abs=1e-6)
    assert float(parts["slopes"]) == pytest.approx(0, abs=1e-6)
    assert float(parts["overlap"]) < 0.01
    for worse in (reading(batch[0] + 0.1, logit), reading(batch[0] ** 2, logit), reading(batch[0], 0.5 * logit)):
        assert float(compute_scale_free_loss(worse, *batch)[0]) > float(best)
    scaled, _ = compute_scale_free_loss(reading(1.3 * batch[0], logit), *batch)
    assert float(scaled) == pytest.approx(float(best), abs=0.05)  # the spread alone sees it


def test_a_part_that_is_learned_from_lies_at_the_contact_most_of_the_time():
    one = gel_samples.simulate_unseen_tool(0)
    shares = [sample_of(one, seed)["contact"].sum() / one.contact.sum() for seed in range(6)]
    assert min(shares) > 0.5  # the touch is larger than a part


def sample_of(taught, seed):
    return make_example(taught, gel_depth._part(np.random.default_rng(seed), taught))


def test_a_spread_that_is_right_is_judged_better_than_one_twice_or_half_as_wide():
    truth = torch.zeros(1, 60, 80)
    noise = torch.distributions.Laplace(0.0, 0.5).sample(truth.shape)
    everywhere = torch.ones_like(truth, dtype=torch.uint8)
    flat = torch.full_like(truth, 100.0)
    told = {
        s: float(compute_scale_free_loss(reading(flat, truth, s), flat + noise, everywhere)[1]["spread"])
        for s in (0.25, 0.5, 1.0)
    }
    assert told[0.5] == min(told.values())


def test_figures_of_the_truth_are_perfect(examples):
    class Knows(torch.nn.Module):
        def forward(self, fields):
            one = next(e for e in examples if np.array_equal(e["fields"], fields[0].numpy()))
            contact = torch.from_numpy(np.array(one["contact"], np.float32))[None]
            return reading(torch.from_numpy(one["indentation"])[None], contact - 0.5)

    figures = TASK.evaluate(Knows(), examples)
    assert figures["contact IoU"] == 1
    assert figures["error of shape, um"] == pytest.approx(0, abs=1e-4)
    assert figures.get("false contacts", 0) == 0
    assert figures["physics contact IoU"] < 1
    assert figures["physics error in contact, um"] > 0


def test_the_recipe_that_comes_along_is_one():
    recipe = load_recipe("gel", "depth")
    assert isinstance(recipe.settings, GelDepthTask)
    assert recipe.network["kind"] == "gel_reading"
