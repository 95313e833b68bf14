"""The palette as people see it, those with normal vision and those who lack a kind of cones."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from skimage.color import deltaE_ciede2000, rgb2lab

from envgs_bench.methods.registry import BUILT_IN, method_class
from envgs_bench.parts import MethodCard
from envgs_bench.reports.charts.palette import COLORS, styles

# Machado, Oliveira, Fernandes 2009, "A physiologically-based model for simulation of color vision deficiency", severity
# 1.0, on linear RGB.
VISIONS = {
    "normal": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}


def seen(color: str, vision: str) -> np.ndarray:
    """CIELAB of #rrggbb."""
    rgb = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.array(VISIONS[vision]) @ linear, 0, 1)
    return rgb2lab(np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055))


def cards() -> dict[str, MethodCard]:
    found = {kind: method_class(kind).card for kind in BUILT_IN}
    return {kind: card for kind, card in found.items() if card is not None}


@pytest.mark.parametrize("vision", VISIONS)
@pytest.mark.parametrize("own", [True, False], ids=["of cards", "without cards"])
def test_every_two_families_are_told_apart(vision: str, own: bool) -> None:
    assert np.allclose(np.sum(VISIONS[vision], axis=1), 1, atol=2e-6)  # white stays white
    colors = {card.family: card.color for card in cards().values()} if own else {color: color for color in COLORS}
    distances = {
        pair: float(deltaE_ciede2000(*(seen(colors[family], vision) for family in pair)))
        for pair in itertools.combinations(colors, 2)
    }
    assert len(colors) >= 9
    assert min(distances.values()) >= 20, min(distances, key=lambda pair: distances[pair])


def test_families_have_their_cards_colors_and_others_none_of_these() -> None:
    chosen = styles([*cards(), "somebody"], cards())
    firsts = {card.family: method for method, card in reversed(cards().items())}  # others of a family are lighter
    assert {method: chosen[method].color for method in firsts.values()} == {
        method: cards()[method].color for method in firsts.values()
    }
    assert chosen["somebody"].color not in {card.color for card in cards().values()}
    assert len({style.marker for style in chosen.values()}) == len(chosen)
    assert styles(["somebody"], {}) == styles(["somebody"], {})
