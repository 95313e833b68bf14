"""Importance: how much pictures change without a primitive, and which primitives they can do without."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import torch
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, Rendering, View

PROBES = 1  # of each view: those of all views that show a primitive add up
HALVINGS = 7  # of the number of primitives that may go, to find how many do


def removal_errors(
    sets: Mapping[str, GaussianSet],
    draw: Callable[[Mapping[str, GaussianSet], Camera], Rendering],
    views: Iterable[View],
    generator: torch.Generator,
) -> dict[str, Tensor]:
    """How much the views would change without a primitive: squares' sum over pixels and channels, [N] of each set.

    A blended color C is affine in each primitive's alpha, and alpha is its opacity o times what does not depend on o.
    So without the primitive C changes by −o·∂C/∂o, whatever lies before and behind it; what reflected rays meet counts
    by what its reflection adds to the picture, and what turns a reflection's normals to first order. The squares' sum
    over pixels is the mean of (∂/∂o Σ zC)² over random signs z (Hutchinson 1990), here of PROBES draws of them a view.
    In the very center of an opaque primitive, where alpha is clamped, there is no gradient to count.

    Args:
        sets: what is drawn, by name.
        draw: the picture of such sets, differentiable in their opacities.
        views: on the sets' device.
        generator: of the signs, on the CPU.
    """
    opacities = {name: gaussians.opacities.detach().requires_grad_() for name, gaussians in sets.items()}
    shown = {name: replace(gaussians, opacities=opacities[name]) for name, gaussians in sets.items()}
    errors = {name: torch.zeros_like(gaussians.opacities) for name, gaussians in sets.items()}
    for view in views:
        with torch.enable_grad():
            color = draw(shown, view.camera).color
        for probe in range(PROBES):
            signs = 2 * torch.randint(2, color.shape, generator=generator, dtype=torch.int8).to(color) - 1
            more = probe < PROBES - 1
            slopes = torch.autograd.grad(color, list(opacities.values()), signs, retain_graph=more, allow_unused=True)
            for (name, values), slope in zip(opacities.items(), slopes, strict=True):
                if slope is not None:
                    errors[name] += (values.detach() * slope).square() / PROBES
    return errors


def without_least(
    errors: Mapping[str, Tensor], most: float, error_with: Callable[[Mapping[str, Tensor]], float]
) -> dict[str, Tensor]:
    """Masks [N] of the primitives to keep, of each set: as few as draw the views with a squared error of `most`.

    Those of the least errors [N] go, whichever set they are of, but for the last of a set. How many is found by trying,
    to 1/128 of all: errors do not add up where one primitive stands in for another.

    Args:
        error_with: the views' squared error where only the primitives of such masks are drawn.
    """
    ranks = torch.cat(list(errors.values())).argsort(stable=True).argsort()
    by_set = dict(zip(errors, ranks.split([len(values) for values in errors.values()]), strict=True))
    last = {name: int(of_set.max()) for name, of_set in by_set.items() if len(of_set)}

    def kept(gone: int) -> dict[str, Tensor]:
        return {name: (of_set >= gone) | (of_set == last.get(name, -1)) for name, of_set in by_set.items()}

    low, high = 0, len(ranks)
    for _ in range(HALVINGS):
        middle = (low + high) // 2
        low, high = (middle, high) if error_with(kept(middle)) <= most else (low, middle)
    return kept(low)
