"""Gradients against differences of the loss itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pytest
import torch
from torch import Tensor

from envgs_bench.core import Camera
from envgs_bench.methods.gaussian_method import GaussianMethod


def mean_of_picture(method: GaussianMethod, camera: Camera, step: int = 1) -> Callable[[], Tensor]:
    """A random mean of what the method draws in the training step of that number, drawn at each call."""
    weights = torch.rand(camera.height, camera.width, 3, generator=torch.Generator().manual_seed(4))
    return lambda: (method.draw(camera, step)[0].color * weights).mean()


def assert_gradients_are_differences(
    loss: Callable[[], Tensor], inputs: Mapping[str, Tensor], by: float, rel: float = 0.04
) -> None:
    """∂loss/∂inputs, along themselves, by central differences.

    Args:
        inputs: leaves, by the name that a failure tells.
        by: how far along its gradient an input is moved to either side.
        rel: how far the two may be apart, of the gradient's length.
    """
    for values in inputs.values():
        values.grad = None
    loss().backward()
    for name, values in inputs.items():
        gradient = values.grad
        assert gradient is not None, name
        move = by * gradient / gradient.norm()
        with torch.no_grad():
            values += move
            above = loss()
            values -= 2 * move
            below = loss()
            values += move
        assert float(above - below) / (2 * by) == pytest.approx(float(gradient.norm()), rel=rel), name
