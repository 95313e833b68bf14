"""Importance: how much pictures change without a primitive, and which primitives they can do without."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import torch
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, Rendering, View, removal_gradients

HALVINGS = 7  # of the number of primitives that may go, to find how many do


def removal_errors(
    sets: Mapping[str, GaussianSet],
    draw: Callable[[Mapping[str, GaussianSet], Camera], Rendering],
    views: Iterable[View],
) -> dict[str, Tensor]:
    """How much the views would change without a primitive: squares' sum over pixels and channels, [N] of each set.

    Exact, whatever lies before and behind the primitive (`envgs_bench/core/removals.py`), where a set is drawn as it
    is. What reflected rays meet counts by what its reflection adds to the picture. What a base primitive has to do with
    a reflection counts to first order, through β and through the ray that its normal and depth turn.

    Args:
        sets: what is drawn, by name.
        draw: the picture of such sets, by the core's `rasterize` and `trace`.
        views: on the sets' device.
    """
    opacities = {name: gaussians.opacities.detach().requires_grad_() for name, gaussians in sets.items()}
    shown = {name: replace(gaussians, opacities=opacities[name]) for name, gaussians in sets.items()}
    errors = {name: torch.zeros_like(gaussians.opacities) for name, gaussians in sets.items()}
    for view in views:
        with torch.enable_grad(), removal_gradients():
            channels = [channel.sum() for channel in draw(shown, view.camera).color.unbind(-1)]
        for channel in channels:  # one after the other: a pixel's changes are squared before they are summed
            more = channel is not channels[-1]
            sums = torch.autograd.grad(channel, list(opacities.values()), retain_graph=more, allow_unused=True)
            for name, squares in zip(opacities, sums, strict=True):
                if squares is not None:
                    errors[name] += squares
    return errors


def without_least(
    worth: Mapping[str, Tensor], most: float, error_with: Callable[[Mapping[str, Tensor]], float]
) -> dict[str, Tensor]:
    """Masks [N] of the primitives to keep, of each set: as few as draw the views with a squared error of `most`.

    Those that are worth the least [N] go, whichever set they are of, but for the last of a set. How many is found by
    trying, to 1/128 of all: errors do not add up where one primitive stands in for another.

    Args:
        error_with: the views' squared error where only the primitives of such masks are drawn.
    """
    kept = least_of(worth)
    low, high = 0, sum(map(len, worth.values()))
    for _ in range(HALVINGS):
        middle = (low + high) // 2
        low, high = (middle, high) if error_with(kept(middle)) <= most else (low, middle)
    return kept(low)


def least_of(worth: Mapping[str, Tensor]) -> Callable[[int], dict[str, Tensor]]:
    """Masks [N] of each set of what stays where so many go: those that are worth the least, but for a set's last."""
    ranks = torch.cat(list(worth.values())).argsort(stable=True).argsort()
    by_set = dict(zip(worth, ranks.split([len(values) for values in worth.values()]), strict=True))
    last = {name: int(of_set.max()) for name, of_set in by_set.items() if len(of_set)}
    return lambda gone: {name: (of_set >= gone) | (of_set == last.get(name, -1)) for name, of_set in by_set.items()}
