"""Weights: tensors by name that a method learns besides its sets, with Adam's moments."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.parts import ENV

from .optimizer import adam, detached, optimizer_state, restore_optimizer
from .schedule import Part


class Weights(Part):
    """Tensors of fixed shapes.

    Attributes:
        tensors: by name; leaves that require gradients.
    """

    def __init__(
        self, shapes: Mapping[str, tuple[int, ...]], rates: Mapping[str, float], device: torch.device, **options: Any
    ) -> None:
        """
        Args:
            rates: the learning rate of each.
            options: of Adam, beside its rates.
        """
        self._shapes, self._rates, self._device, self._options = dict(shapes), dict(rates), device, options
        self.become({name: torch.zeros(shape) for name, shape in shapes.items()})

    def become(self, values: Mapping[str, Tensor]) -> None:
        """Take these values, of which nothing has been learned."""
        self.tensors = {name: values[name].detach().to(self._device).requires_grad_() for name in self._shapes}
        groups = [
            {"params": [tensor], "name": name, "lr": self._rates[name], **self._options}
            for name, tensor in self.tensors.items()
        ]
        self.optimizer = adam(groups)

    def optimizers(self) -> Sequence[torch.optim.Optimizer]:
        return (self.optimizer,)

    def most_bytes(self) -> int:
        return 4 * sum(map(math.prod, self._shapes.values()))

    def model_bytes(self) -> dict[str, int]:
        return {ENV: self.most_bytes()}

    def training_state(self) -> dict[str, Any]:
        return {"weights": detached(self.tensors), "moments": optimizer_state(self.optimizer, self.tensors)}

    def restore_training(self, state: Mapping[str, Any]) -> None:
        self.become(state["weights"])
        restore_optimizer(self.optimizer, self.tensors, state["moments"])

    def state(self) -> dict[str, Any]:
        return detached(self.tensors)

    def restore(self, state: Mapping[str, Any]) -> None:
        for name, shape in self._shapes.items():
            if state[name].shape != shape:
                raise ValueError(f"the checkpoint's {name} has shape {tuple(state[name].shape)}, expected {shape}")
        self.become(state)


def layer_shapes(sizes: Sequence[int]) -> dict[str, tuple[int, ...]]:
    """The shapes of a network's weights and biases, of so many inputs, neurons of each hidden layer, and outputs."""
    shapes: dict[str, tuple[int, ...]] = {}
    for layer, (inputs, outputs) in enumerate(pairwise(sizes)):
        shapes |= {f"layer{layer}_weight": (outputs, inputs), f"layer{layer}_bias": (outputs,)}
    return shapes


def random_layers(sizes: Sequence[int], generator: torch.Generator) -> dict[str, Tensor]:
    """Weights and biases uniform within ± 1/√inputs of their layer, as PyTorch's."""
    made = {}
    for name, shape in layer_shapes(sizes).items():
        inputs = sizes[int(name.removeprefix("layer").partition("_")[0])]
        made[name] = inputs**-0.5 * (2 * torch.rand(shape, generator=generator) - 1)
    return made


def network(tensors: Mapping[str, Tensor], inputs: Tensor) -> Tensor:
    """The network's outputs [R, outputs] of inputs [R, inputs], with ReLU between layers."""
    layers = sum(name.startswith("layer") for name in tensors) // 2
    for layer in range(layers):
        inputs = functional.linear(inputs, tensors[f"layer{layer}_weight"], tensors[f"layer{layer}_bias"])
        if layer < layers - 1:
            inputs = inputs.relu()
    return inputs
