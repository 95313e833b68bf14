"""Recipes: what is wrong with one is named, with its key; what is right becomes words."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from fakes.recipes import content

from envgs_bench.datasets.export import FORMATS
from envgs_bench.programs.recipe import (
    ProgramChoice,
    Recipe,
    RecipeError,
    files_of,
    folder_of,
    parse_choice,
    read_recipe,
    shipped_recipes,
    words_of,
)
from envgs_bench.programs.work import Work

VALUES = {"data": "/a b", "steps": "30", "arguments": "--x '1 2'", "on_white": ""}


@pytest.mark.parametrize("name", shipped_recipes())
def test_recipes_that_ship_can_be_read_and_name_what_they_are_for(name: str) -> None:
    recipe = read_recipe(name)
    assert recipe.layout in FORMATS
    assert recipe.commit
    assert recipe.licence
    assert "{output}" in (recipe.pictures.files if recipe.pictures else recipe.model.file if recipe.model else "")


def test_names_of_recipes_that_ship_are_rows_of_their_own() -> None:
    names = [read_recipe(name).name for name in shipped_recipes()]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": None}, "name: Input should be a valid string"),
        ({"layout": "ngp"}, "layout: Input should be 'colmap', 'colmap-text' or 'blender'"),
        ({"train": "python {here}"}, r"train: {here} is no placeholder; there are data, output"),
        ({"train": "python 'half"}, "train: cannot be split into words"),
        ({"train": "  "}, "train: is empty, expected a command"),
        ({"train": []}, "train: Value should have at least 1 item"),
        ({"train": "python --more={arguments}"}, "stand as words of their own"),
        ({"page": "somewhere"}, "page: String should match pattern"),
        ({"pictures": {"files": "{out}/a"}}, r"pictures.files: {out} is no placeholder"),
        ({"pictures": {"files": "a", "match": "guess"}}, "pictures.match: Input should be 'order' or 'name'"),
        ({"step": "step"}, r"step: expected one group"),
        ({"seconds": {"pattern": "([0-9]"}}, "seconds.pattern: is no regular expression"),
        ({"isolation": {"kind": "conda"}}, "isolation: kind conda needs a name"),
        ({"isolation": {"kind": "none", "name": "a"}}, "isolation: kind none takes no name"),
        ({"model": {"file": "a.ply", "near": 0}}, "model.near: Input should be greater than 0"),
        ({"pictures": None}, "needs pictures, or a model"),
        ({"sees_test_views": False}, "pictures of test views need sees_test_views: true"),
        ({"build": "make"}, "build: Extra inputs are not permitted"),
    ],
)
def test_what_is_wrong_with_a_recipe_is_named(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(json.dumps(content("fine") | change))
    with pytest.raises(RecipeError) as caught:
        read_recipe(str(path))
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)


def test_a_recipe_that_is_no_yaml_or_not_there_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("train: [")
    with pytest.raises(RecipeError, match=r"a\.yaml: is no YAML"):
        read_recipe(str(tmp_path / "a.yaml"))
    (tmp_path / "a.yaml").write_text("train")
    with pytest.raises(RecipeError, match=r"a\.yaml: holds str, expected keys"):
        read_recipe(str(tmp_path / "a.yaml"))
    with pytest.raises(RecipeError, match=r"b\.yaml: cannot be read .*expected a YAML file, or one of"):
        read_recipe(str(tmp_path / "b.yaml"))


def test_a_program_that_lies_somewhere_has_to_be_told_where(tmp_path: Path) -> None:
    recipe = Recipe.model_validate(content("fine", train="python {home}/train.py"))
    with pytest.raises(RecipeError, match=r"give method\.settings\.home=FOLDER \(https://example\.org"):
        parse_choice({"recipe": recipe})
    with pytest.raises(RecipeError, match="there is no such folder"):
        parse_choice({"recipe": recipe, "home": str(tmp_path / "none")})
    assert parse_choice({"recipe": recipe, "home": str(tmp_path)}).home == str(tmp_path)


def test_commands_are_words_and_no_shell_sees_them() -> None:
    found = words_of("run --data={data} '{steps} steps; $HOME' {arguments} {on_white}", VALUES)
    assert found == ["run", "--data=/a b", "30 steps; $HOME", "--x", "1 2"]


def test_words_of_the_user_have_to_be_words() -> None:
    with pytest.raises(RecipeError, match="cannot be split into words"):
        parse_choice({"recipe": Recipe.model_validate(content("fine")), "arguments": "'half"})


@pytest.mark.parametrize("steps", [1, 7, 100, 2999, 7000, 29_999, 30_000, 123_457])
def test_a_share_of_the_published_steps_is_the_steps_again(tmp_path: Path, steps: int) -> None:
    work = Work(ProgramChoice(recipe=Recipe.model_validate(content("fine"))), tmp_path, steps, 0, "cpu")
    assert int(30_000 * float(work.values["share"])) == steps


def test_patterns_of_files_leave_folders_out(tmp_path: Path) -> None:
    (tmp_path / "deep" / "a.png").mkdir(parents=True)
    (tmp_path / "deep" / "b.png").touch()
    assert files_of("{data}/**/*.png", {"data": str(tmp_path)}) == [tmp_path / "deep" / "b.png"]


@pytest.mark.parametrize(
    ("pattern", "folder"),
    [("{data}/rgb/*.png", "rgb"), ("{data}/**/RENDER/*.png", ""), ("{data}/a/b[0-9]/c.png", "a"), ("{data}/a.png", "")],
)
def test_the_folder_of_a_pattern_ends_before_its_wildcards(tmp_path: Path, pattern: str, folder: str) -> None:
    assert folder_of(pattern, {"data": str(tmp_path)}) == tmp_path / folder


def test_a_choice_comes_back_from_a_runs_settings() -> None:
    choice = ProgramChoice(recipe=Recipe.model_validate(content("fine")), arguments="--a 1")
    assert parse_choice(json.loads(choice.model_dump_json())) == choice
