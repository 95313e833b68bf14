"""Perturbation: one thing that can be wrong with what a run is given, in several degrees of severity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar
from zlib import crc32

import numpy as np

Given = TypeVar("Given")


@dataclass(frozen=True)
class Perturbation(Generic[Given]):
    """A kind of perturbation. Severity 1 is the first of `levels`, and 0 leaves everything as it is."""

    change: Callable[[Given, float, np.random.Generator], Given]  # what is given, level -> what the run gets
    levels: tuple[float, ...]  # from mild to severe
    words: str  # what a level does, with {} for the level
    moves_cameras: bool = False  # whether training cameras are not where the data say

    def level(self, severity: int) -> str:
        """What the severity does, in words."""
        return self.words.format(self.levels[severity - 1])

    def applied(self, given: Given, severity: int, kind: str, seed: int) -> Given:
        """What is given, perturbed. The same random numbers at every severity: only their size grows."""
        return self.change(given, self.levels[severity - 1], np.random.default_rng([seed, crc32(kind.encode())]))
