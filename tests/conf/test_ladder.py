"""The ablation ladder's sweep: every variant, on the same seeds, at one size."""

from __future__ import annotations

from sweeps import one_run, swept

from envgs_bench.methods.configurations import CONFIGURED
from envgs_bench.reports.numbers.comparison import FEWEST_SEEDS

STEPS = {own["step"]: name for name, own in CONFIGURED.items() if own.get("ladder") == "envgs"}


def test_the_sweep_has_every_variant_on_enough_seeds() -> None:
    choices = swept("ladder")
    assert choices["method"] == [STEPS[step] for step in sorted(STEPS)]
    assert len(choices["seed"]) >= FEWEST_SEEDS
    assert next(iter(choices)) == "seed"  # a sweep that was cut short has whole ladders


def test_it_is_short_unless_told_otherwise() -> None:
    assert one_run("ladder").steps == 800
    assert one_run("ladder", size="full").steps == 3000
