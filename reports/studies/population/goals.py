"""Goals: what the method of interest is to reach on a population, and how far it is from that."""

from __future__ import annotations

from dataclasses import dataclass

from .failure_map import FailureMap
from .population import Population

LEVEL_SHARE = 0.9  # of the scenes it is to be level with every other method, or ahead
MIRRORING, AHEAD_DB = 0.1, 1.0  # where so large a share of the pixels reflects it is to be so far ahead on average
WORST_DB = 0.3  # by no more is it ever to be behind
SIGNS = 0.8  # of unseen scenes on which the failure map is to tell who is ahead


@dataclass(frozen=True)
class Goal:
    """What was reached, in words that name what was to be reached."""

    text: str
    reached: bool


def goals(found: Population, mapped: FailureMap) -> list[Goal]:
    """On the scenes for judging, or on all where these are too few."""
    part = "judging" if "judging" in found.used_parts else ""
    margins, subject = found.margins(found.subject, part), found.subject
    standing = found.standing(subject, part)
    goals = [
        Goal(
            f"{subject} is level with every other method, or ahead, on {100 * standing.level:.0f} % of {len(margins)} "
            f"scenes (goal: {100 * LEVEL_SHARE:.0f} %)",
            standing.level >= LEVEL_SHARE,
        )
    ]
    if "reflective" in found.attributes:
        reflect = margins[found.attributes.loc[margins.index, "reflective"] >= MIRRORING]
        if len(reflect):
            goals.append(
                Goal(
                    f"where {100 * MIRRORING:.0f} % of the pixels or more reflect, it is {reflect.mean():+.2f} dB "
                    f"beside the best other (goal: {AHEAD_DB:+g} dB)",
                    float(reflect.mean()) >= AHEAD_DB,
                )
            )
    goals += [
        Goal(f"at worst it is {margins.min():+.2f} dB (goal: {-WORST_DB:+g} dB)", float(margins.min()) >= -WORST_DB),
        Goal(
            f"the failure map tells who is ahead on {100 * mapped.signs:.0f} % of unseen scenes "
            f"(goal: {100 * SIGNS:.0f} %)",
            mapped.signs >= SIGNS,
        ),
        Goal(f"{sum(found.failures.values())} runs failed (goal: none)", not sum(found.failures.values())),
    ]
    return goals


def told(found: list[Goal]) -> list[str]:
    """What is missed comes first."""
    names = {False: "Missed", True: "Reached"}
    return [f"{name}: {goal.text}." for reached, name in names.items() for goal in found if goal.reached == reached]
