"""The stability study: every case of it is one that there is, with its partner, and all of one size and length."""

from __future__ import annotations

import math
import re

from sweeps import one_run, swept

from envgs_bench.cli.composition import CONF
from envgs_bench.datasets.perturbations.registry import PERTURBATIONS as OF_SCENES
from envgs_bench.settings import PerturbationChoice
from envgs_bench.stages.perturbations import perturbation_of, perturbed_settings
from envgs_bench.stages.setting_perturbations import PERTURBATIONS as OF_SETTINGS

PAGE = (CONF.parent / "docs" / "reference" / "perturbations.md").read_text(encoding="utf-8")


def test_every_case_can_be_run_and_has_its_partner() -> None:
    choices = swept("stability")
    kinds, severities = choices["perturb.kind"], choices["perturb.severity"]
    assert kinds[0] == "none"
    assert len(set(kinds)) == len(kinds)
    method = choices["method"][0]
    for kind in [*kinds, *of_the_page()]:
        run = one_run("stability", method=method, perturb__kind=kind, perturb__severity=severities[0])
        assert (run.perturb is None) == (kind == "none")
        for severity in map(int, severities if kind in kinds and run.perturb else ()):
            case = run.model_copy(update={"perturb": PerturbationChoice(kind=kind, severity=severity)})
            found = perturbation_of(case)
            assert found is not None
            assert (found.kind, found.severity) == (kind, severity)
            perturbed_settings(case)


def test_who_is_judged_by_a_baseline_is_swept_beside_it() -> None:
    gates = one_run("stability").gates
    assert gates is not None
    assert gates.baseline in swept("stability")["method"]


def test_the_study_is_of_one_size_and_five_seeds() -> None:
    run = one_run("stability")
    assert (run.dataset["width"], run.dataset["height"], run.steps) == (64, 48, 300)
    assert len(swept("stability")["seed"]) == 5
    assert next(iter(swept("stability"))) == "seed"  # a study that was cut short has whole seeds
    large = one_run("stability", size="full")
    assert (large.dataset["width"], large.dataset["height"], large.steps) == (160, 120, 3000)


def of_the_page() -> set[str]:
    """The kinds that the page's commands sweep over."""
    return {kind for kinds in re.findall(r"perturb\.kind=([\w,]+)", PAGE) for kind in kinds.split(",")}


def test_no_kind_is_forgotten() -> None:
    swept_over = {*swept("stability")["perturb.kind"], *of_the_page()}
    left_out = {"masks_grown", "masks_shrunk"}  # masks matter to no training
    assert {*OF_SCENES, *OF_SETTINGS} - swept_over == left_out


def test_the_study_fits_into_three_hours_on_two_cores() -> None:
    """By the processor time that docs/reference/perturbations.md states: seconds of one run, start to record."""
    seconds = {"2dgs_tuned": 8, "3dgs_tuned": 8, "envmap": 10, "envgs": 33, "envgs_single_set": 20}
    choices = swept("stability")
    cases = 1 + (len(choices["perturb.kind"]) - 1) * len(choices["perturb.severity"])
    perturbed = len(choices["seed"]) * cases * math.fsum(seconds[method] for method in choices["method"])
    scenes = len(choices["seed"]) * 7 * math.fsum(seconds.values())
    assert (perturbed + scenes) / 2 < 3 * 3600


def test_lengths_reach_from_300_to_100_000_steps_and_widths_from_64_to_1_600_pixels() -> None:
    run = one_run("stability", size="full")
    changed = [
        OF_SETTINGS[kind].applied(run, severity, kind, 0)
        for kind in ("steps_fewer", "steps_more", "pixels_fewer", "pixels_more")
        for severity in (1, 2, 3)
    ]
    assert {300, 1_000, 3_000, 9_000, 30_000, 100_000} <= {run.steps for run in changed}
    assert {64, 80, 120, 320, 640, 1_600} <= {run.dataset["width"] for run in changed}
