"""Adam as every method uses it: a group a field, whose rate and whose moments outlive changes of its rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from envgs_bench.core import cuda

from .schedule import set_rate

EPSILON = 1e-15  # as 3DGS: gradients of a mean over pixels are tiny


def adam(groups: Sequence[dict[str, Any]]) -> torch.optim.Adam:
    """Adam of parameters on one device, a group {"params", "lr", "name"} each; `set_rate` changes a rate."""
    device = groups[0]["params"][0].device
    if device.type != "cuda":
        return HostAdam(groups, eps=EPSILON, fused=True)
    groups = [{**group, "lr": torch.full((), group["lr"], device=device)} for group in groups]
    kind = torch.optim.Adam if cuda.why_unavailable() else KernelAdam
    return kind(groups, eps=EPSILON, fused=True, capturable=True)


# PyTorch keeps its compiler away from these four; to do so it imports it, which takes longer than a short training.
# Nothing here is compiled by it: as they are marked, they are called as they stand.
for _method in ("add_param_group", "load_state_dict", "state_dict", "zero_grad"):
    _function = getattr(getattr(torch.optim.Optimizer, _method), "__wrapped__", None)
    if _function is not None:
        _function.__dynamo_disable = _function


class HostAdam(torch.optim.Adam):
    """PyTorch's Adam on a CPU, its step without what lets the compiler break a graph there."""

    step = torch.no_grad()(getattr(torch.optim.Adam.step, "__wrapped__", torch.optim.Adam.step))


class KernelAdam(torch.optim.Adam):
    """Adam by the CUDA backend's kernel, a launch a parameter; torch's takes three, of too few threads to fill a GPU.

    Rates and counts of steps lie on the device, where a CUDA graph reads them. `found_inf` skips a step, as torch's.
    What it remembers is there before the first step: a recording that made it would make it anew at every replay.
    """

    def __init__(self, groups: Sequence[dict[str, Any]], **options: Any) -> None:
        super().__init__(groups, **options)
        for group in self.param_groups:
            for parameter in group["params"]:
                self.forget(parameter)

    def forget(self, parameter: Tensor) -> None:
        """Become as if the parameter had not been moved yet."""
        self.state[parameter] = {
            "step": torch.zeros((), device=parameter.device),
            "exp_avg": torch.zeros_like(parameter),
            "exp_avg_sq": torch.zeros_like(parameter),
        }

    @torch.no_grad()
    def step(self, closure: Any = None) -> None:  # type: ignore[override]  # nothing is evaluated again
        moved = [(p, group) for group in self.param_groups for p in group["params"] if p.grad is not None]
        if not moved:
            return
        skipped = getattr(self, "found_inf", None)
        taken = torch.ones_like(self.state[moved[0][0]]["step"]) if skipped is None else 1 - skipped
        counts = [self.state[parameter]["step"] for parameter, _ in moved]
        torch._foreach_add_(counts, [taken] * len(counts))  # as a list: one tensor for all would be read by the host
        for parameter, group in moved:
            state = self.state[parameter]
            assert parameter.grad is not None
            cuda.adam_step(
                parameter,
                parameter.grad,
                state["exp_avg"],
                state["exp_avg_sq"],
                group["lr"],
                state["step"],
                skipped,
                group["betas"],
                group["eps"],
            )


def optimizer_state(optimizer: torch.optim.Optimizer, parameters: Mapping[str, Tensor]) -> dict[str, Any]:
    """What Adam remembers of each parameter, nothing of some that it has not moved, and its rate, by the names."""
    rates = {id(parameter): group["lr"] for group in optimizer.param_groups for parameter in group["params"]}
    return {
        name: {"lr": float(rates[id(parameter)]), **optimizer.state.get(parameter, {})}
        for name, parameter in parameters.items()
    }


def restore_optimizer(
    optimizer: torch.optim.Optimizer, parameters: Mapping[str, Tensor], state: Mapping[str, Any]
) -> None:
    """Make the optimizer of these parameters what `optimizer_state` found."""
    groups = {id(parameter): group for group in optimizer.param_groups for parameter in group["params"]}
    for name, parameter in parameters.items():
        moments = {key: value.to(parameter.device) for key, value in state[name].items() if key != "lr"}
        set_rate(groups[id(parameter)], float(state[name]["lr"]))
        if moments:
            optimizer.state[parameter] = moments
        elif isinstance(optimizer, KernelAdam):
            optimizer.forget(parameter)
        else:
            optimizer.state.pop(parameter, None)


def detached(parameters: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name: values.detach() for name, values in parameters.items()}
