"""The ladder's sweeps: every rung, on the same seeds, at one size."""

from __future__ import annotations

import re

from sweeps import one_run, swept

from envgs_bench.cli.composition import CONF
from envgs_bench.reports.numbers.ladder import RUNGS
from envgs_bench.reports.numbers.statistics import FEWEST_SEEDS


def test_the_sweep_has_every_rung_on_enough_seeds() -> None:
    choices = swept("ladder")
    assert choices["method"] == list(RUNGS)
    assert len(choices["seed"]) >= FEWEST_SEEDS
    assert next(iter(choices)) == "seed"  # a sweep that was cut short has whole ladders


def test_it_is_of_the_demos_length_unless_told_otherwise() -> None:
    assert one_run("ladder").steps == one_run("demo").steps == 800
    assert one_run("ladder", size="full").steps == 3000


def test_the_results_suite_is_the_scenes_of_the_results() -> None:
    text = (CONF.parent / "docs" / "results.md").read_text(encoding="utf-8")
    table = text.split("## What holds")[1].split("What does not hold")[0]
    scenes = set(re.findall(r"^\| (?:held out: )?`(\w+)`", table, re.MULTILINE))
    assert {dataset.rpartition("/")[2] for dataset in swept("scores")["dataset"]} == scenes
