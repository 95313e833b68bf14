"""Workload: what a case is timed on. The room makes one of any size, a trained run one of its own sets and cameras."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from envgs_bench.core import GaussianSet, View
from envgs_bench.methods.gaussian_method import GaussianMethod


@dataclass(frozen=True)
class Model:
    """A method in the middle of a training."""

    method: GaussianMethod
    views: Sequence[View]  # to train on, on the method's device
    step: int  # one that draws all there is, and neither densifies nor resets anything


class Workload(ABC):
    """Sets, views, rays, a map and a model on one device, each made when it is asked for.

    Attributes:
        near: hits nearer to a camera are not drawn, world units.
        views: what is drawn; each is timed by itself.
    """

    near: float
    views: Sequence[View]

    @abstractmethod
    def rasterized(self, view: View) -> GaussianSet:
        """The set that the view's picture is drawn from, without gradients."""

    @abstractmethod
    def traced(self) -> GaussianSet:
        """The surfels that rays meet, without gradients."""

    @abstractmethod
    def rays(self, view: View) -> tuple[Tensor, Tensor]:
        """Origins and directions [H, W, 3] of the view's reflected rays, no gradients; 0 where none is."""

    @abstractmethod
    def texels(self) -> Tensor:
        """The logits of a cube map's colors, [6, S, S, 3], without gradients."""

    @abstractmethod
    def model(self) -> Model: ...
