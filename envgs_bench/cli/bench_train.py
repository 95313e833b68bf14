"""`envgs-bench bench train`: PSNR against seconds of training, of our methods and of gsplat's, on one data set."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from .explained import explained

if TYPE_CHECKING:
    from envgs_bench.bench.train import Contest, Entry, Row
    from envgs_bench.parts import MethodCard
    from envgs_bench.settings import RunSettings

DESCRIPTION = """\
Train methods on a data set, one after the other and each once, and stop now and then to compare views that nothing is
learned from: every eighth training view, which is taken out for that, or with score_on=test the test views. The clock
stands still at stops. It counts what begins a training and its steps, and no loading; a short training goes before, for
nothing, so that nothing is compiled while it counts.

  envgs-bench bench train method=2dgs,3dgs,envgs dataset=toy/chrome_room steps=3000 --chart out/train.png
  envgs-bench bench train method=3dgs dataset=colmap dataset.root=FOLDER steps=30000 --gsplat 3dgs,3dgs_mcmc
  envgs-bench bench train method=envgs --at-seconds 10,30,60 --json out/train.json

KEY=VALUE are those of `envgs-bench run`; of methods there may be several.
"""


def main(arguments: Sequence[str]) -> int:
    """Train, and print PSNR against seconds; the exit status."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench bench train",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="as for `envgs-bench run`")
    parser.add_argument(
        "--at-steps", type=_numbers, default=[], metavar="LIST", help="stop after these steps: 500,1000"
    )
    parser.add_argument(
        "--at-seconds",
        type=_numbers,
        default=[],
        metavar="LIST",
        help="stop after so many seconds of training: 10,30,60. Where nothing is said: after 1/32, 1/16 … of the steps",
    )
    parser.add_argument(
        "--gsplat",
        type=lambda text: text.split(","),
        default=[],
        metavar="LIST",
        help="also what gsplat trains from the same points: 3dgs,2dgs by its default strategy, 3dgs_mcmc by the other",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write a row a stop here")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="the same as a table")
    parser.add_argument("--chart", type=Path, metavar="FILE", help="draw PSNR against seconds (a png, with a pdf)")
    options = parser.parse_args(arguments)
    if options.csv is not None and options.csv.suffix != ".csv":
        parser.error(f"--csv {options.csv}: expected a file whose name ends in .csv")
    return explained("bench train", lambda: _train(options))


def _numbers(text: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = [0.0]
    if min(values) <= 0:
        raise argparse.ArgumentTypeError(f"{text!r}: expected numbers above 0 with commas between them, as 10,30,60")
    return values


def _train(options: argparse.Namespace) -> int:
    from rich.console import Console

    from envgs_bench.bench.interruptible import interruptible
    from envgs_bench.bench.train import entered, results_table, write_rows

    contest, entries = _contest(options)
    rows: list[Row] = []
    console = Console(stderr=True)
    try:
        with interruptible() as ending:
            for entry in entries:
                for row in entered(entry, contest):
                    rows.append(row)
                    console.print(f"{entry.label}: {row['step']:,} steps, {row['seconds']:.1f} s, {row['psnr']:.2f} dB")
                    for path in filter(None, (options.json, options.csv)):
                        write_rows(rows, path)
    finally:
        if rows:
            Console(width=None if sys.stdout.isatty() else 120).print(results_table(rows))
    if ending.status:
        print(f"envgs-bench bench train: interrupted after {len(rows)} stops", file=sys.stderr)
        return ending.status
    if options.chart is not None:
        from envgs_bench.bench.train_chart import draw_training

        print(f"chart: {draw_training(rows, options.chart.with_suffix(''), _cards(options.overrides))[0]}")
    return 0


def _cards(overrides: Sequence[str]) -> dict[str, MethodCard]:
    """Those of the methods that are asked for, by name."""
    from envgs_bench.runs.descriptions import card_of

    methods = [settings.method for settings in _settings(overrides)]
    found = {method.name: card_of(method.name, method.kind) for method in methods}
    return {name: card for name, card in found.items() if card is not None}


def _contest(options: argparse.Namespace) -> tuple[Contest, list[Entry]]:
    """What is trained on, and by whom. Raises ValueError where something of that cannot be had."""
    from envgs_bench.bench.course import Stops
    from envgs_bench.bench.gsplat_training import GsplatTraining
    from envgs_bench.bench.train import GSPLAT, Contest, Entry, default_steps
    from envgs_bench.diagnosis.diagnosis import Diagnosis
    from envgs_bench.diagnosis.repair import repaired
    from envgs_bench.runs.job import resolve_device
    from envgs_bench.stages.evaluation import scored_views
    from envgs_bench.stages.loading import check_scene
    from envgs_bench.stages.perturbations import load_run_scene

    chosen = _settings(options.overrides)
    first = chosen[0]
    device = resolve_device(first.device)
    _check_gsplat(options.gsplat, device)
    scene = load_run_scene(first)
    check_scene(scene)
    scene = repaired(Diagnosis(scene, device), first.repair)[0].scene
    views = scored_views(scene, first.score_on)
    entries = [_entry(settings, device) for settings in chosen]
    steps = first.steps
    entries += [Entry(recipe, GSPLAT, steps, partial(GsplatTraining, recipe, scaled=True)) for recipe in options.gsplat]
    stops = Stops([int(step) for step in options.at_steps], options.at_seconds)
    if not stops.steps and not stops.seconds:
        stops = Stops(default_steps(steps))
    return Contest(scene, views, first.score_on, first.seed, device, stops), entries


def _settings(overrides: Sequence[str]) -> list[RunSettings]:
    """Those of a run of each method, on validation views unless told otherwise."""
    from envgs_bench.records import ELSEWHERE
    from envgs_bench.settings import SettingsError

    from .composition import composed

    named = [text for text in overrides if text.startswith("method=")]
    others = [text for text in overrides if not text.startswith("method=")]
    if not any(text.startswith("score_on=") for text in others):
        others.append("score_on=validation")
    methods = named[-1].partition("=")[2].split(",") if named else ["envgs"]
    chosen = [composed([f"method={method}", *others]) for method in methods]
    if foreign := [settings.method.kind for settings in chosen if settings.method.kind in ELSEWHERE]:
        raise SettingsError(f"method={foreign[0]}: another program drew its pictures, nothing of ours trains")
    if any(settings.budget and settings.budget.frame_ms for settings in chosen):
        raise SettingsError("budget.frame_ms: frames are not timed between these steps; give budget.primitives or mb")
    return chosen


def _entry(settings: RunSettings, device: str) -> Entry:
    from envgs_bench.bench.course import MethodTraining
    from envgs_bench.bench.train import OURS, Entry
    from envgs_bench.stages.budget import limited_method
    from envgs_bench.stages.execution import offer_perceptual_loss
    from envgs_bench.stages.perturbations import perturbed_settings

    actual = perturbed_settings(settings)

    def make() -> MethodTraining:
        method = limited_method(actual, device)
        offer_perceptual_loss(method)
        return MethodTraining(method)

    return Entry(settings.method_name, OURS, make().method.training_steps(actual.steps), make)


def _check_gsplat(recipes: Sequence[str], device: str) -> None:
    """Raise a ValueError where gsplat is asked for something that it cannot train here."""
    from envgs_bench.bench.gsplat_training import RECIPES
    from envgs_bench.bench.peers import why_unavailable

    unknown = [recipe for recipe in recipes if recipe not in RECIPES]
    if unknown:
        raise ValueError(f"--gsplat {','.join(unknown)}: expected some of {', '.join(RECIPES)}")
    if recipes and (reason := why_unavailable()):
        raise ValueError(f"--gsplat: {reason}")
    if recipes and not device.startswith("cuda"):
        raise ValueError(f"--gsplat: gsplat trains on a GPU only, and the device is {device}; leave --gsplat out")
