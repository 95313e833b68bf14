"""What settings and configurations may grow to: these numbers only go down."""

from __future__ import annotations

import ast
import dataclasses
from pathlib import Path

import pytest
import yaml

from envgs_bench.cli.composition import CONF
from envgs_bench.datasets.registry import BUILT_IN as DATASET_KINDS
from envgs_bench.methods.recipes import RECIPES, Rules
from envgs_bench.methods.registry import BUILT_IN, method_class
from envgs_bench.methods.settings import setting_groups

METHODS = Path(__file__).parents[2] / "methods"
SETTINGS, FILES = 55, 100  # the most that there may be: of EnvGS; of configurations
GROUPS = ["run", "rates", "growth", "losses", "reflection", "environment"]


def test_envgs_has_few_settings_in_six_groups() -> None:
    groups = setting_groups(method_class("envgs").Settings)
    assert list(groups) == GROUPS
    assert sum(map(len, groups.values())) == len(dataclasses.fields(method_class("envgs").Settings)) <= SETTINGS


@pytest.mark.parametrize("kind", BUILT_IN)
def test_a_rule_is_no_setting_beside(kind: str) -> None:
    rules = {field.name for field in dataclasses.fields(Rules)}
    assert not rules & {field.name for field in dataclasses.fields(method_class(kind).Settings)}


def test_a_rule_tells_recipes_or_a_scenes_release_apart() -> None:
    """What is the same everywhere is no rule but a constant of the code."""
    presets = [yaml.safe_load(path.read_text(encoding="utf-8")) for path in (CONF / "dataset").rglob("*.yaml")]
    released = {
        rule for preset in presets for own in preset.get("release", {}).values() for rule in own.get("rules", {})
    }
    configured = [yaml.safe_load(path.read_text(encoding="utf-8")) for path in (CONF / "method").rglob("*.yaml")]
    overridden = {rule for one in configured for rule in (one.get("settings") or {}).get("rules", {})}
    for field in dataclasses.fields(Rules):
        values = {getattr(rules, field.name) for rules in RECIPES.values()}
        assert len(values) > 1 or field.name in released | overridden, field.name


def test_configurations_are_few_and_data_sets_defaults_stand_in_none() -> None:
    assert len([path for path in CONF.rglob("*") if path.is_file()]) <= FILES
    assert not {path.stem for path in (CONF / "dataset").glob("*.yaml")} & set(DATASET_KINDS)


def test_settings_are_checked_in_one_place() -> None:
    """No method refuses a setting by itself: its field's type says what is allowed."""
    for path in METHODS.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for made in [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name == "__init__"]:
            names = {node.id for node in ast.walk(made) if isinstance(node, ast.Name)}
            refuses = any(isinstance(node, ast.Raise) for node in ast.walk(made))
            assert not (refuses and "settings" in names), path
