"""When the events of a training happen."""

from __future__ import annotations

from envgs_bench.methods.gaussian_method import GaussianMethod


def steps_of_events(method: GaussianMethod, run: int) -> dict[str, list[int]]:
    """The steps of each event of a run of `run` steps, of those at and next to each hundredth."""
    found: dict[str, list[int]] = {}
    for step in (hundred + beside for hundred in range(100, run, 100) for beside in (-1, 0, 1)):
        for event in method.events(step):
            found.setdefault(event, []).append(step)
    return found
