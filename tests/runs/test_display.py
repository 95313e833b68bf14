"""Progress as lines and as a bar."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from envgs_bench.runs.display import Bar, Lines
from envgs_bench.runs.estimates import training_left

COUNTS = {"base": 1234, "env": 56}


def training(step: int, steps: int) -> dict:
    state = {"step": step, "steps": steps, "loss": 0.5, "psnr": 21.5, "primitives": COUNTS}
    return {"stage": "training", **state}


def test_lines_are_sparse_and_say_what_matters() -> None:
    stream = io.StringIO()
    display = Lines(stream)
    display.start("room · envgs · seed 0")
    display.update({"stage": "loading"})
    for step in range(1, 1001):
        display.update(training(step, 1000))
    for step in range(5):
        display.update({"stage": "scoring", "step": step, "steps": 5})
    display.stop()
    lines = stream.getvalue().splitlines()
    assert len(lines) == 14
    assert all(line.startswith("room · envgs · seed 0: ") for line in lines)
    assert "step 500/1000  loss 0.5000  PSNR 21.50  base 1,234  env 56" in lines[7]
    assert lines[7].endswith("s left")
    assert lines[-1].endswith("scoring")


def test_the_bar_shows_step_loss_psnr_and_primitives() -> None:
    stream = io.StringIO()
    display = Bar(Console(file=stream, force_terminal=True, width=200))
    display.start("room · envgs · seed 0")
    display.update({"stage": "loading"})
    display.update(training(30, 1000))
    display.stop()
    display.update(training(40, 1000))  # the reader may lag behind the end
    shown = stream.getvalue()
    for part in ("room · envgs · seed 0", "training", "30/1000", "loss 0.5000", "PSNR 21.50", "base 1,234", "env 56"):
        assert part in shown


def test_a_set_that_is_not_there_and_what_was_noted_of_the_data() -> None:
    stream = io.StringIO()
    display = Lines(stream)
    display.start("room")
    display.update({"stage": "loading"})
    display.update({"stage": "loading", "notes": ["3 of 9 images are left out"]})
    display.update({**training(1, 9), "primitives": {"base": 7, "env": 0}})
    assert stream.getvalue().splitlines()[2:] == [
        "room: 3 of 9 images are left out",
        "room: step 1/9  loss 0.5000  PSNR 21.50  base 7",
    ]


def test_what_is_left_of_a_training_knows_that_models_grow() -> None:
    """Step costs that rise to 2.5 first steps' until half of the run and then stay, summed step by step."""
    costs = [1 + 1.5 * min((step + 0.5) / 500, 1) for step in range(1000)]
    for first, step in ((0, 10), (0, 300), (200, 600), (0, 999)):
        so_far, left = sum(costs[first:step]), sum(costs[step:])
        assert training_left(so_far, first, step, 1000) == pytest.approx(left, rel=1e-3)
    assert training_left(3.0, 5, 5, 9) == 0.0


DROPPED = {"mono": "no normals [at all]", "gloss": "no varnish"}


def test_lines_say_once_and_first_what_is_trained_without() -> None:
    stream = io.StringIO()
    display = Lines(stream)
    display.start("room · envgs · seed 0")
    display.update({"stage": "loading"})
    display.update({"stage": "training", "steps": 1000, "dropped_losses": DROPPED})
    for step in range(1, 1001):
        display.update(training(step, 1000))
    lines = stream.getvalue().splitlines()
    assert lines[2:4] == [
        "room · envgs · seed 0: trains without L_mono: no normals [at all]",
        "room · envgs · seed 0: trains without gloss: no varnish",
    ]
    assert "step 1/1000  loss 0.5000" in lines[4]
    assert len(lines) == 15


def test_the_bar_leaves_a_line_that_says_what_is_trained_without() -> None:
    stream = io.StringIO()
    display = Bar(Console(file=stream, force_terminal=True, width=200))
    display.start("room · envgs · seed 0")
    display.update({"stage": "training", "steps": 1000, "dropped_losses": DROPPED})
    display.update(training(30, 1000))
    display.stop()
    shown = stream.getvalue()
    assert shown.count("room · envgs · seed 0: trains without L_mono: no normals [at all]\n") == 1
    assert "30/1000" in shown  # the bar knows the steps all the same


def test_no_terminal_obeys_a_name_a_reason_or_a_warning() -> None:
    """Neither escape sequences nor markup: they are shown."""
    hostile = "a[/b]\x1b[31m\r"
    warning = {"kind": "non_finite", "step": 3, "part": hostile, "message": hostile, "times": 1}
    events = [
        {"stage": "training", "steps": 9, "dropped_losses": {hostile: hostile}},
        {"stage": "training", "step": 3, "steps": 9, "warning": warning},
    ]
    lines, console = io.StringIO(), Console(file=io.StringIO(), width=200)
    for display in (Lines(lines), Bar(console)):
        display.start(hostile)
        for event in events:
            display.update(event)
        display.stop()
    for shown in (lines.getvalue(), console.file.getvalue()):  # type: ignore[attr-defined]
        assert "\x1b[31m" not in shown
        assert shown.count("warning at step 3: a[/b]?[31m?") == 1
        assert shown.count("trains without a[/b]?[31m?: a[/b]?[31m?") == 1
