"""Places: what is added up is what lies near, wherever it is seen from."""

from __future__ import annotations

import itertools
import math

import pytest
import torch

from envgs_bench.methods.training.places import gained_by_place


def test_sums_are_those_of_eight_grids() -> None:
    generator = torch.Generator().manual_seed(3)
    points = 4 * torch.rand(60, 3, generator=generator) - 2
    before, after = torch.rand(2, 60, generator=generator)
    gained = gained_by_place(points, before, after, 0.7)
    for index, point in enumerate(points.tolist()):
        sums = [0.0, 0.0]
        for shift in itertools.product((0.0, 0.35), repeat=3):  # half an edge along each axis
            cube = [math.floor((x + s) / 0.7) for x, s in zip(point, shift, strict=True)]
            for other, errors in zip(points.tolist(), torch.stack([before, after], dim=1).tolist(), strict=True):
                if [math.floor((x + s) / 0.7) for x, s in zip(other, shift, strict=True)] == cube:
                    sums = [total + error for total, error in zip(sums, errors, strict=True)]
        assert float(gained[index]) == pytest.approx(10 * math.log10(sums[0] / sums[1]), abs=1e-3)


def test_a_place_far_from_all_others_is_alone() -> None:
    points = torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [1e7, 0, 0], [-1e7, 0, 0]])
    gained = gained_by_place(points, torch.tensor([1.0, 3.0, 1.0, 1.0]), torch.tensor([2.0, 2.0, 0.1, 10.0]), 0.5)
    torch.testing.assert_close(gained, torch.tensor([0.0, 0.0, 10.0, -10.0]), atol=1e-3, rtol=0)


def test_nothing_wrong_before_or_after_is_finite() -> None:
    gained = gained_by_place(torch.zeros(2, 3), torch.zeros(2), torch.zeros(2), 1.0)
    assert gained.tolist() == [0.0, 0.0]
