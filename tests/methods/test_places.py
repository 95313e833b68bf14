"""Places: what is added up is what lies near, wherever it is seen from."""

from __future__ import annotations

import itertools
import math

import torch

from envgs_bench.methods.training.places import sums_by_place


def test_sums_are_those_of_eight_grids() -> None:
    generator = torch.Generator().manual_seed(3)
    points = 4 * torch.rand(60, 3, generator=generator) - 2
    values = torch.rand(2, 60, generator=generator)
    expected = torch.zeros(2, 60, dtype=torch.float64)
    for index, point in enumerate(points.tolist()):
        for shift in itertools.product((0.0, 0.35), repeat=3):  # half an edge along each axis
            cube = [math.floor((x + s) / 0.7) for x, s in zip(point, shift, strict=True)]
            for other, numbers in zip(points.tolist(), values.T.double(), strict=True):
                if [math.floor((x + s) / 0.7) for x, s in zip(other, shift, strict=True)] == cube:
                    expected[:, index] += numbers
    torch.testing.assert_close(sums_by_place(points, values, 0.7), expected)


def test_a_place_far_from_all_others_is_alone() -> None:
    points = torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [1e7, 0, 0], [-1e7, 0, 0]])
    sums = sums_by_place(points, torch.tensor([[1.0, 3.0, 1.0, 5.0]]), 0.5)
    assert sums.tolist() == [[32.0, 32.0, 8.0, 40.0]]
