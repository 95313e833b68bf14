"""The ladder's sweeps: every rung, on the same seeds, at one size."""

from __future__ import annotations

import re

import pytest
from sweeps import one_run, swept

from envgs_bench.cli.composition import CONF
from envgs_bench.reports.numbers.ladder import RUNGS
from envgs_bench.reports.numbers.statistics import FEWEST_SEEDS


@pytest.mark.parametrize("name", ["ladder", "ladder_gpu"])
def test_a_sweep_has_every_rung_on_enough_seeds(name: str) -> None:
    choices = swept(name)
    assert choices["method"] == list(RUNGS)
    assert len(choices["seed"]) >= FEWEST_SEEDS
    assert next(iter(choices)) == "seed"  # a sweep that was cut short has whole ladders


def test_the_small_ladder_is_of_the_demos_length_and_the_gpus_of_the_results() -> None:
    assert one_run("ladder").steps == one_run("demo").steps == 800
    assert one_run("ladder_gpu").steps == 3000


def test_the_gpus_ladder_is_on_the_scenes_of_the_results() -> None:
    text = (CONF.parent / "docs" / "results.md").read_text(encoding="utf-8")
    table = text.split("## What holds")[1].split("What does not hold")[0]
    scenes = set(re.findall(r"^\| (?:untouched: )?`(\w+)`", table, re.MULTILINE))
    assert {dataset.rpartition("/")[2] for dataset in swept("ladder_gpu")["dataset"]} == scenes
