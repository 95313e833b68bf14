"""Budget: the most that a model may have at any moment, and how its sets share that."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import Tensor

from envgs_bench.parts import BASE

from ..method import Budget

LEAST_PRIMITIVES = 100  # of a model with a budget
LEAST_SHARE = 0.05  # of the budget, for each set, whatever it contributes
FIRST_SHARE = 0.15  # of each set but the base, until it can be measured what it contributes
MEGA = 1_000_000


class SharedBudget:
    """A budget that the sets of one model share by what they contribute to its pictures.

    With contributions c, Σc = 1, each of n sets has the share LEAST_SHARE + (1 − n·LEAST_SHARE)·c of the budget: none
    starves, so that it may still show what it is worth. Contributions are measured over the steps since the shares
    were last decided. A set whose own bound is below its share leaves the rest to the others, and no set grows into
    what another still holds: the sum of all is within the budget whichever set changes first.
    """

    def __init__(self, budget: Budget, bytes_each: Mapping[str, int], fixed_bytes: int = 0) -> None:
        """
        Args:
            bytes_each: the sets and the bytes of one primitive of each.
            fixed_bytes: what the model holds besides primitives.

        Raises:
            ValueError: there is no limit in the budget, or one below what any model needs.
        """
        if budget.primitives is None and budget.mb is None:
            raise ValueError("the budget limits neither primitives nor mb, expected one of them or both")
        self.budget = budget
        self._limits: list[tuple[int, dict[str, int]]] = []  # (in all, of a primitive of each set)
        if budget.primitives is not None:
            if budget.primitives < LEAST_PRIMITIVES:
                raise ValueError(f"budget.primitives is {budget.primitives}, expected at least {LEAST_PRIMITIVES}")
            self._limits.append((budget.primitives, dict.fromkeys(bytes_each, 1)))
        if budget.mb is not None:
            least = LEAST_PRIMITIVES * max(bytes_each.values())
            if not budget.mb * MEGA >= fixed_bytes + least:
                besides = f" besides {fixed_bytes / MEGA:.4g} MB that are no primitives" if fixed_bytes else ""
                raise ValueError(
                    f"budget.mb is {budget.mb:g}, expected at least {(fixed_bytes + least) / MEGA:.4g}: "
                    f"{LEAST_PRIMITIVES} primitives{besides}"
                )
            self._limits.append((int(budget.mb * MEGA) - fixed_bytes, dict(bytes_each)))
        self._names = tuple(bytes_each)
        self.restart()

    def restart(self) -> None:
        """Forget what was measured: a new training begins."""
        others = [name for name in self._names if name != BASE]
        self.shares = {BASE: 1 - FIRST_SHARE * len(others)} | dict.fromkeys(others, FIRST_SHARE)
        self._contributed: dict[str, Tensor] = {}

    def measure(self, contributed: Mapping[str, Tensor]) -> None:
        """Add what each set gave to one step's picture, scalars; nothing where that says little as yet."""
        for name, amount in contributed.items():
            if name in self._contributed:
                self._contributed[name] += amount
            else:
                self._contributed[name] = amount.clone()

    def decide(self) -> None:
        """Share the budget anew, by what was measured since the last time; as before where nothing was."""
        given = {name: max(0.0, float(amount)) for name, amount in self._contributed.items()}
        for amount in self._contributed.values():
            amount.zero_()
        total = sum(given.values())
        if total > 0:
            rest = 1 - LEAST_SHARE * len(self._names)
            self.shares = {name: LEAST_SHARE + rest * given[name] / total for name in self._names}

    def bound(self, name: str, counts: Mapping[str, int], own: Mapping[str, int]) -> int:
        """The most primitives that the set `name` may have now.

        Args:
            counts: what each set has now.
            own: the most that each may have without a budget; 0: any number.
        """
        others = {other: max(counts[other], self._share(other, own[other])) for other in self._names if other != name}
        room = self._room(name, others)
        return min(room, own[name] or room)

    def _share(self, name: str, own: int) -> int:
        share = min(int(self.shares[name] * total) // costs[name] for total, costs in self._limits)
        return min(share, own or share)

    def _room(self, name: str, others: Mapping[str, int]) -> int:
        return min(
            (total - sum(costs[other] * count for other, count in others.items())) // costs[name]
            for total, costs in self._limits
        )

    def training_state(self) -> dict[str, Any]:
        return {"shares": dict(self.shares), "contributed": {name: x.clone() for name, x in self._contributed.items()}}

    def restore_training(self, state: Mapping[str, Any], device: Any) -> None:
        """Become what `training_state` returned, tensors on `device`."""
        self.shares = dict(state["shares"])
        self._contributed = {name: amount.to(device) for name, amount in state["contributed"].items()}
