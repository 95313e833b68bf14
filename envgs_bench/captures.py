"""Captures: data sets of one name that are not the same data, and what to call each."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath


@dataclass(frozen=True)
class Capture:
    """What a run learned from.

    Attributes:
        name: of the data set.
        root: the folder that it was read from; "" where it comes from none.
        data: a hash of the files that were read; None in older records.
    """

    name: str
    root: str
    data: str | None = None


def places(captures: Sequence[Capture]) -> list[str]:
    """Of each the part of its folder's path that tells it from other data of its name; "" where there are no others.

    Data are the same where they lie in one folder, as before and after a correction, or hold the same, as before and
    after they were moved.
    """
    by_name: dict[str, list[Capture]] = defaultdict(list)
    for capture in dict.fromkeys(captures):
        by_name[capture.name].append(capture)
    found: dict[Capture, str] = {}
    for alike in by_name.values():
        groups = _same_data(alike)
        firsts = sorted(set(groups))
        parts = dict(zip(firsts, _differing([PurePath(alike[first].root).parts for first in firsts]), strict=True))
        found |= {capture: parts[group] for capture, group in zip(alike, groups, strict=True)}
    return [found[capture] for capture in captures]


def told_apart(captures: Sequence[Capture]) -> list[str]:
    """Their names, with the `places` of those that need one."""
    return [
        f"{capture.name} [root={place}]" if place else capture.name
        for capture, place in zip(captures, places(captures), strict=True)
    ]


def _same_data(captures: Sequence[Capture]) -> list[int]:
    """The first of those that each is the same data as, by their places in the list."""
    groups = list(range(len(captures)))
    for index, capture in enumerate(captures):
        for other in range(index):
            if groups[other] != groups[index] and _are_same(capture, captures[other]):
                low, high = sorted((groups[other], groups[index]))
                groups = [low if group == high else group for group in groups]
    return groups


def _are_same(one: Capture, other: Capture) -> bool:
    return one.root == other.root or one.data == other.data  # older records are not told apart


def _differing(paths: Sequence[tuple[str, ...]]) -> list[str]:
    """Of each path as few of its last parts as tell them apart, without those that all end with."""
    if len(paths) < 2:
        return [""] * len(paths)
    longest = max(map(len, paths))
    end = next(n for n in range(longest + 1) if len({path[len(path) - n - 1 :][:1] for path in paths}) > 1)
    begin = next(n for n in range(end + 1, longest + 1) if len({path[-n:] for path in paths}) == len(paths))
    return ["-".join(path[-begin : len(path) - end]) or "-".join(path) for path in paths]
