"""What tells runs apart: two runs of one method with different settings never share a row."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, replace
from typing import Any

from envgs_bench.captures import Capture, places
from envgs_bench.records import Record

from .cards import newest_cards
from .runs import Run
from .settings import as_number, flat_settings, method_settings

SET_UP = ("method.", "budget.")  # how overrides begin that make a run another than one of the method as it is


@dataclass(frozen=True)
class Label:
    """A row's method or a table's data set, with the settings in which it differs from others of its name.

    Attributes:
        settings: all that vary among these.
        usual: those of them that the method as it is has, which need no words.
        order: a method's place among others, by its card.
    """

    name: str
    settings: tuple[tuple[str, str], ...] = ()
    usual: frozenset[tuple[str, str]] = frozenset()
    order: int = field(default=0, compare=False)

    def __str__(self) -> str:
        told = [setting for setting in self.settings if setting not in self.usual]
        if not told:
            return self.name
        settings = ", ".join(f"{key.rsplit('.', 1)[-1]}={value}" for key, value in told)
        return f"{self.name} [{settings}]"


def is_set_up(run: Run) -> bool:
    """Whether an override makes the run another than one of the method as it is."""
    return any(override.lstrip("+~").startswith(SET_UP) for override in run.record.overrides)


def label_runs(runs: list[Run]) -> dict[int, tuple[Label, Label]]:
    """(data set, method) of each run by its index, spelling out what varies among runs of one name.

    A data set's settings (size, views, noise…) are its own. A method's settings, budget and number of steps are spelled
    out where they vary on one data set; a method may well be set up differently for another data set. Where some runs
    are of the method as it is, the others are called by what they change.
    """
    records = [run.record for run in runs]
    datasets = _labels(
        [
            (record.dataset, flat_settings(record.config.get("dataset")) | ({"root": place} if place else {}))
            for record, place in zip(records, places([_capture(record) for record in records]), strict=True)
        ],
        [""] * len(runs),
        [False] * len(runs),
    )
    methods = _labels(
        [(record.method, method_settings(record) | {"steps": str(_steps(record))}) for record in records],
        [str(dataset) for dataset in datasets],
        [not is_set_up(run) for run in runs],
    )
    cards = newest_cards(records)
    methods = [replace(label, order=cards[label.name].order) for label in methods]
    return dict(enumerate(zip(datasets, methods, strict=True)))


def _capture(record: Record) -> Capture:
    settings = record.config.get("dataset")
    root = settings.get("root") if isinstance(settings, dict) else None
    return Capture(record.dataset, str(root or ""), record.data)


def _steps(record: Record) -> Any:
    """A perturbed run is set up as its partner: by the steps that it was given, whatever became of them."""
    return record.steps if record.perturbation is None else record.config.get("steps", record.steps)


def method_order(label: Label) -> tuple[int, str, tuple[tuple[str, float, str], ...]]:
    """Sort key: by the methods' cards, then by name; rows of a swept setting by its value."""
    return label.order, label.name, tuple((key, _position(value), value) for key, value in label.settings)


def _labels(named: list[tuple[str, dict[str, str]]], groups: list[str], plain: list[bool]) -> list[Label]:
    """The label of each (name, settings), with the keys that vary among equal names within some group.

    What all `plain` ones of a name have in common is usual.
    """
    seen: dict[tuple[str, str, str], set[str]] = defaultdict(set)
    usual: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    for (name, settings), group, as_it_is in zip(named, groups, plain, strict=True):
        for key, value in settings.items():
            seen[name, group, key].add(value)
            if as_it_is:
                usual[name][key].add(value)
    varying: dict[str, set[str]] = defaultdict(set)
    for (name, _, key), values in seen.items():
        if len(values) > 1:
            varying[name].add(key)
    common = {
        name: frozenset((key, value) for key, values in keys.items() if len(values) == 1 for value in values)
        for name, keys in usual.items()
    }
    return [
        Label(
            name,
            tuple((key, settings.get(key, "unset")) for key in sorted(varying[name])),
            common.get(name, frozenset()),
        )
        for name, settings in named
    ]


def _position(value: str) -> float:
    number = as_number(value)
    return float("inf") if number is None else number
