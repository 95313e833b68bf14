"""Gradients of what a method draws, against differences of the picture itself."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
import torch
from torch import Tensor

from envgs_bench.core import Camera
from envgs_bench.methods.gaussian_method import GaussianMethod


def assert_gradients_are_differences(
    method: GaussianMethod, camera: Camera, inputs: Mapping[str, Tensor], step: float
) -> None:
    """∂/∂inputs of a random mean of a training step's picture, along themselves, by central differences.

    Args:
        inputs: leaves, by the name that a failure tells.
        step: how far along its gradient an input is moved to either side.
    """
    weights = torch.rand(camera.height, camera.width, 3, generator=torch.Generator().manual_seed(4))

    def loss() -> Tensor:
        return (method.draw(camera, 1)[0].color * weights).mean()

    loss().backward()
    for name, values in inputs.items():
        gradient = values.grad
        assert gradient is not None, name
        move = step * gradient / gradient.norm()
        with torch.no_grad():
            values += move
            above = loss()
            values -= 2 * move
            below = loss()
            values += move
        assert float(above - below) / (2 * step) == pytest.approx(float(gradient.norm()), rel=0.04), name
