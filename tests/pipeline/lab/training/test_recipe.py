"""Recipes: shipped ones are valid, and errors of others name the key."""

from __future__ import annotations

import pytest

from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.lab.training import recipe, task
from tests.pipeline.lab.training import toy


def test_a_recipe_holds_all_values_of_its_file(recipe_file):
    made = recipe.load_recipe(str(recipe_file), "discs")
    assert made.settings == toy.Discs(noise=0.2)
    assert (
        made.training.batch,
        made.training.steps,
        made.optimiser.warm_up_steps,
        made.validation.n_examples,
    ) == (
        4,
        60,
        5,
        6,
    )
    assert made.plain_values["network"] == {"kind": "toy_net", "width": 4}
    assert recipe.override_training(made, seed=9).plain_values != made.plain_values


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("batch = 4", "bach = 4", "no parameter 'bach'; there are seed, batch"),
        ("batch = 4", "batch = 0", "batch must lie within 1 and 4096, got 0"),
        ("batch = 4", "batch = [4]", "batch must be a whole number"),
        ("noise = 0.2", "noise = 7.0", r"\[settings\] noise must lie within 0 and 1"),
        ("noise = 0.2", "nose = 0.2", r"\[settings\] no parameter 'nose'; there are noise"),
        (
            "warm_up_steps = 5",
            'schedule = "up"',
            r"\[optimiser\] schedule must be one of cosine, poly, constant",
        ),
        ("n_evaluations = 2", "tims = 2", r"\[validation\] no parameter 'tims'"),
        ('task = "discs"', 'task = "dics"', "no task 'dics'; there are .*discs"),
        ('task = "discs"', "", "task: it is missing"),
        ('kind = "toy_net"', "", r"\[network\] must name its kind"),
        ("width = 4", "width = [4]", r"\[network\] width must be a plain value"),
        (
            "warm_up_steps = 5",
            'rate_factors = {"a" = "b"}',
            "optimiser.rate_factors.*: expected a number, got a text",
        ),
        ("[settings]", "[[settings]]", "settings: expected a table, got a list"),
        ("steps = 60", "steps = ", "not valid TOML"),
    ],
)
def test_an_invalid_recipe_names_the_key(recipe_file, old, new, sentence):
    recipe_file.write_text(toy.RECIPE.replace(old, new))
    with pytest.raises(FileProblem, match=sentence):
        recipe.load_recipe(str(recipe_file))


def test_a_recipe_of_another_subcommand_and_a_missing_one_are_refused(recipe_file, tmp_path):
    with pytest.raises(FileProblem, match="it trains discs, not depth"):
        recipe.load_recipe(str(recipe_file), "depth")
    with pytest.raises(
        SettingProblem, match=r"no recipe 'unheard'; there are .*or give a \.toml file"
    ):
        recipe.load_recipe("unheard", "depth")
    with pytest.raises(FileProblem, match="cannot read the recipe"):
        recipe.load_recipe(str(tmp_path / "missing.toml"))


# `latent_pairs` has the network of the weights that its user gives
@pytest.mark.parametrize("name", sorted({*recipe.list_shipped_recipes()} - {"latent_pairs"}))
def test_every_shipped_recipe_is_valid(name):
    made = recipe.load_recipe(name)
    assert name in recipe.list_shipped_recipes(task.TASKS[made.task].subcommand)
