"""Stock: what a scene's surfaces are made of: its colors, its share of what shines, and its things' numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..formats.srgb import to_linear
from ..toy.shapes import Mesh, Shape
from . import patterns as pat
from .distribution import MATERIALS, NOTHING_SHINES, SHINING, between, one_of
from .materials import BLANK, DIFFUSE, METALLIC, Material, Surface, drawn_material
from .patterns import Color, Pattern

Vector = tuple[float, float, float]
Finish = tuple[Material, Pattern | None]  # None: of the material's own color


class Stock:
    """Of one scene; draws from its generator.

    Args:
        liked: classes of materials that are three times as likely as the distribution says.
    """

    def __init__(self, rng: np.random.Generator, liked: tuple[str, ...] = ()) -> None:
        self.rng = rng
        self.colors = pat.palette(rng)
        self.shining = 0.0 if rng.uniform() < NOTHING_SHINES else between(rng, SHINING)
        self.shares = {name: share * (3 if name in liked else 1) for name, share in MATERIALS.items()}
        self._things = 0

    @property
    def white(self) -> Color:
        return self.colors[-2]

    @property
    def black(self) -> Color:
        return self.colors[-1]

    def color(self) -> Color:
        return self.colors[int(self.rng.integers(len(self.colors) - 2))]

    def thing(self) -> int:
        """A number that no other thing of the scene has."""
        self._things += 1
        return self._things

    def finish(self, solid: bool = False) -> Finish:
        """What a thing is made of and painted with; of glass only where it is `solid`, closed all around."""
        if self.rng.uniform() >= self.shining:
            return DIFFUSE, self.paint()
        name = one_of(self.rng, {k: v for k, v in self.shares.items() if solid or k != "glass"})
        material = drawn_material(self.rng, name)
        if name in (*METALLIC, "glass"):
            return material, None
        return material, pat.plaster(self.color()) if name == "car_paint" else self.paint()

    def paint(self) -> Pattern:
        """A pattern for a thing of a hand's size and more."""
        first, second = self.color(), self.color()
        choices = (
            pat.glaze(first, second),
            pat.printed(self.white, first),
            pat.printed(first, self.white),
            pat.wood((0.55, 0.38, 0.22), 0.2),
            pat.weave([first, second, self.white], 0.12),
            pat.marble(self.white),
            pat.plaster(first),
            pat.terrazzo(self.white, self.colors[:4]),
        )
        return choices[int(self.rng.integers(len(choices)))]

    def surface(
        self, shape: Shape | Mesh, finish: Finish, thing: int, emission: float = 0.0, darker: float = 1.0
    ) -> Surface:
        """The shape, finished; its color times `darker`."""
        material, pattern = finish
        if pattern is None:
            return Surface(shape, material, BLANK, thing, emission)
        if isinstance(shape, Mesh):  # which has no (u, v)
            return Surface(shape, material, to_linear(np.array(self.color())).reshape(1, 1, 3), thing, emission)
        linear = darker * to_linear(pat.picture(pattern, shape.extent, self.rng))
        return Surface(shape, material, linear, thing, emission)

    def surfaces(self, shapes: Sequence[Shape], finish: Finish, thing: int | None = None) -> list[Surface]:
        """Shapes of one thing, all of one finish."""
        number = self.thing() if thing is None else thing
        return [self.surface(shape, finish, number) for shape in shapes]
