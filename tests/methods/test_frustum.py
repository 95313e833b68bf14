"""Which primitives are in view, against boxes of points on their outlines and linearized projections."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch.autograd.functional import jacobian

from envgs_bench.core import Camera
from envgs_bench.methods.gaussians.frustum import REACH, in_view

CAMERA = Camera(torch.eye(4), torch.tensor([[50.0, 0, 20], [0, 40.0, 15], [0, 0, 1]]), 40, 30)
COLUMNS, ROWS = 48, 32  # of whole tiles


def around(count: int, axes: int, largest: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Primitives ahead, beside and behind."""
    generator = torch.Generator().manual_seed(0)
    means = 6 * torch.rand(count, 3, generator=generator) - torch.tensor([3.0, 3.0, 1.0])
    scales = largest * torch.rand(count, axes, generator=generator) + 1e-3
    return means, torch.randn(count, 4, generator=generator), scales


def frames(quaternions: torch.Tensor) -> torch.Tensor:
    matrices = Rotation.from_quat(quaternions.numpy(), scalar_first=True).as_matrix()
    return torch.from_numpy(matrices).float()


def meets(middle: torch.Tensor, reach: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Whether squares [N] in pixels meet the tiles of the picture, and whether that is by more than rounding."""
    gaps = torch.stack(
        [
            middle[:, 0] - 0.5 + reach - 1,
            COLUMNS - (middle[:, 0] - 0.5 - reach),
            middle[:, 1] - 0.5 + reach - 1,
            ROWS - (middle[:, 1] - 0.5 - reach),
        ]
    )
    return (gaps > 0).all(0), (gaps.abs() > 2e-2).all(0)


@pytest.mark.parametrize(
    ("mean", "expected"),
    [
        ((0, 0, 0.3), True),
        ((0, 0, 0.1), False),  # nearer than near
        ((0, 0, -3), False),
        ((0, 100, 3), False),
        ((0, -100, 3), False),
        ((100, 0, 3), False),
        ((1.1, 0, 3), True),
        ((1.55, 0, 3), True),  # beside the picture, in its last tile
        ((1.95, 0, 3), False),
    ],
)
@pytest.mark.parametrize("axes", [2, 3])
def test_what_is_ahead_and_not_beside_is_in_view(mean, expected, axes):
    quaternion = torch.tensor([[1.0, 0, 0, 0]])
    found = in_view(torch.tensor([mean], dtype=torch.float32), quaternion, torch.full((1, axes), 1e-3), CAMERA, 0.2)
    assert found.tolist() == [expected]


def test_a_surfel_ahead_counts_by_the_box_of_its_outline():
    """Points at three standard deviations all around, of surfels that lie whole before the camera."""
    means, quaternions, scales = around(4000, 2, 0.3)
    angles = torch.linspace(0, 2 * math.pi, 2049)[:-1]
    circle = torch.stack([angles.cos(), angles.sin()])
    points = means[:, :, None] + REACH * (frames(quaternions)[:, :, :2] * scales[:, None]) @ circle
    pixels, depths = CAMERA.project(points.transpose(1, 2))
    whole = (depths > 0.3).all(1)
    low, high = pixels.amin(1), pixels.amax(1)
    half = 0.5 * (high - low).amax(1).clamp_min(REACH * 2**0.5)
    expected, clear = meets(0.5 * (low + high), half.ceil())
    clear &= whole & ((half - half.round()).abs() > 1e-2)
    found = in_view(means, quaternions, scales, CAMERA, 0.2)
    assert 500 < int(expected[clear].sum()) < int(clear.sum()) - 500
    assert torch.equal(found[clear], expected[clear])


def test_a_gaussian_counts_by_three_deviations_of_its_linear_projection():
    """The Jacobian by automatic differentiation, eigenvalues by NumPy; centers within 1.3 half pictures."""
    means, quaternions, scales = around(600, 3, 0.3)
    found = in_view(means, quaternions, scales, CAMERA, 0.2)
    ahead = (means[:, 2] > 0.2) & (means[:, 0].abs() < 1.3 * 0.4 * means[:, 2])
    ahead &= means[:, 1].abs() < 1.3 * 0.375 * means[:, 2]
    count = 0
    for row in torch.nonzero(ahead)[:, 0].tolist():
        step = jacobian(lambda point: CAMERA.project(point)[0], means[row])
        deviations = step @ (frames(quaternions[row : row + 1])[0] * scales[row])
        variance = (deviations @ deviations.T).numpy() + 0.3 * np.eye(2)
        reach = REACH * math.sqrt(np.linalg.eigvalsh(variance)[-1])
        middle = CAMERA.project(means[row : row + 1])[0]
        expected, clear = meets(middle, torch.tensor([math.ceil(reach)]))
        if bool(clear) and abs(reach - round(reach)) > 0.1:  # the spread of the two axes has a floor
            assert bool(found[row]) == bool(expected)
            count += 1
    assert count > 50


def test_a_surfel_that_reaches_behind_the_camera_counts_by_the_box_of_a_hyperbola():
    """A sky's surfel far to the side, that no pixel shows: the formula of the box puts it into the picture."""
    mean, scales = torch.tensor([[9.0, 0, 2]]), torch.tensor([[2.0, 2.0]])
    facing = torch.tensor([[math.cos(0.6), 0, math.sin(0.6), 0]])
    shown = in_view(mean, facing, scales, CAMERA, 0.2)
    small = in_view(mean, facing, 0.1 * scales, CAMERA, 0.2)
    assert (shown.tolist(), small.tolist()) == ([True], [False])
