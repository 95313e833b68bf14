"""The page's first screen: what is gained inside reflections, at what cost, from how many seeds, and when."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..numbers.headline import Headline, headline
from ..pictures.gallery import Gallery
from ..pictures.sheets import draw_headline
from ..tables.columns import FRAME_MS, PRIMITIVES, PSNR, TRAIN_SECONDS, Column
from ..tables.sections import Section

MOST = 4  # data sets on the first screen
UNITS: dict[str, tuple[Column, str, str]] = {  # cost -> column, what it is called, unit
    "frame_ms": (FRAME_MS, "the frame time", "ms"),
    "train_seconds": (TRAIN_SECONDS, "the training", "s"),
    "primitives": (PRIMITIVES, "the primitives", ""),
}


def headlines(section: Section, galleries: Sequence[Gallery], out: Path) -> dict[str, Any] | None:
    """What the template shows of the section's data sets; None where nothing reflecting stands beside a baseline."""
    reflects = {item.method: card.reflects for item in section.runs if item.run.ok and (card := item.run.record.card)}
    found = [one for name in section.datasets if (one := headline(section.numbers, name, reflects)) is not None]
    if not found:
        return None
    dates = [item.run.record.provenance.finished[:10] for item in section.runs]
    return {
        "lines": [_line(one, section) for one in found[:MOST]],
        "more": len(found) - MOST,
        "date": max(dates),
        "picture": next((shown for one in found if (shown := _picture(one, galleries, out))), None),
    }


def _line(one: Headline, section: Section) -> dict[str, str]:
    mean, interval, seeds = one.gain.mean, one.gain.interval, one.gain.done
    assert mean is not None
    where = "inside reflections" if one.region != "full" else "over the whole picture"
    steps = sorted({item.run.record.steps for item in section.of(one.dataset) if item.run.ok and item.run.record.steps})
    count = f"{seeds} seeds" if seeds > 1 else "one seed: no interval"
    return {
        "dataset": one.dataset,
        "method": one.method,
        "baseline": one.baseline,
        "verb": "gains" if mean >= 0 else "loses",
        "gain": f"{PSNR.unsigned(abs(mean))} dB",
        "interval": "" if interval is None else f"[{PSNR.signed(interval.low)}, {PSNR.signed(interval.high)}]",
        "where": where,
        "costs": ", ".join(_cost(cost, *pair) for cost, pair in one.costs.items()),
        "basis": ", ".join([count, *(f"{count:,} steps" for count in steps[:1] if len(steps) == 1)]),
    }


def _cost(cost: str, ours: float, theirs: float) -> str:
    """ "49 times the frame time (186.51 against 3.77 ms)"."""
    column, name, unit = UNITS[cost]
    ratio = ours / theirs
    shown = f"{ratio:.0f}" if ratio >= 10 else f"{ratio:.1f}"
    return f"{shown} times {name} ({column.unsigned(ours)} against {column.unsigned(theirs)}{unit and ' ' + unit})"


def _picture(one: Headline, galleries: Sequence[Gallery], out: Path) -> dict[str, Any] | None:
    """The part of a view where both differ most: the photograph, the baseline's and the method's picture of it."""
    for gallery in galleries:
        shots = [shot for shot in gallery.shots if {one.method, one.baseline} <= shot.renders.keys()]
        if gallery.dataset != one.dataset or not shots:
            continue
        shot = next((shot for shot in shots if "median" in shot.roles), shots[0])
        path = f"{Path(gallery.files[shot.target]).parent.parent.as_posix()}/headline.png"
        if draw_headline(shot, (one.baseline, one.method), out / path):
            words = f"{shot.title} of {one.dataset}: ground truth, {one.baseline}, {one.method}"
            return {"path": path, "words": words}
    return None
