"""One set of surfels for the scene and for what it reflects: the design that the paper's App. B.3 decides against."""

from __future__ import annotations

from typing import ClassVar

from torch import Tensor

from envgs_bench.core import Statistics
from envgs_bench.parts import BASE, MethodCard

from .traced import TracedReflection


class SingleSet(TracedReflection):
    """EnvGS without environment Gaussians: reflected rays are traced through the base set (paper, App. B.3).

    A wrong reflected ray then pulls at the scene's own geometry, which sends it elsewhere; the paper reports that this
    does not converge. Densification uses the statistics of the picture's own pass only.
    """

    card = MethodCard("envgs_single_set", "EnvGS, one set", 50, "#66001A")
    traced: ClassVar[str] = BASE
    captured: ClassVar[bool] = True

    def start_reflection(self) -> None:
        pass

    def reflected_color(
        self, origins: Tensor, directions: Tensor, step: int | None
    ) -> tuple[Tensor, dict[str, Statistics]]:
        return super().reflected_color(origins, directions, step)[0], {}
