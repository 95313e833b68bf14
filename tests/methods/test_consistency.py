"""Consistency: views' points and patches fall where projective geometry has them, and views that agree cost nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from envgs_bench.core import Camera, Scene
from envgs_bench.methods.envgs import CONSISTENCY, EnvGS
from envgs_bench.methods.lighting import consistency
from envgs_bench.methods.lighting.consistency import (
    COLORS,
    DEPTHS,
    PATCH,
    STRENGTHS,
    Seen,
    correlation,
    disagreement,
    neighbors,
    returned,
    sampled,
    warped,
)
from envgs_bench.methods.registry import create_method
from envgs_bench.testing import check_method, tiny_scene

EVERY = slice(None), slice(None)
PLANE = torch.tensor([0.2, -0.1, -1.0], dtype=torch.float64), -3.0  # n·x = c, before both cameras
SMALL: dict[str, Any] = {"env_grid": 2, "env_far_count": 50}


def camera(turn: float, shift: tuple[float, float, float], width: int = 24, height: int = 18) -> Camera:
    """A camera at `shift`, turned about its vertical by `turn` radians, with unlike focal lengths and a skew."""
    c, s = np.cos(turn), np.sin(turn)
    rotation = torch.tensor([[c, 0, -s], [0, 1, 0], [s, 0, c]], dtype=torch.float64)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ torch.tensor(shift, dtype=torch.float64)
    k = [[1.1 * width, 0.4, 0.52 * width], [0, 1.2 * width, 0.47 * height], [0, 0, 1]]
    return Camera(pose, torch.tensor(k, dtype=torch.float64), width, height)


ONE, OTHER = camera(0.0, (0.0, 0.0, 0.0)), camera(0.15, (0.4, 0.1, -0.1), 30, 20)


def plane_depth(view: Camera) -> Tensor:
    """Where a camera's rays meet the plane, [H, W]."""
    normal, constant = PLANE
    origins, directions = view.rays()
    return (constant - origins @ normal) / (directions @ normal)


def homography(one: Camera, other: Camera) -> NDArray[np.float64]:
    """Pixels of one view -> of another, of the plane: K₂(R + t nᵀ/d)K₁⁻¹ in the first camera's frame."""
    normal, constant = (np.asarray(each) for each in PLANE)
    r1, t1 = one.world_to_camera[:3, :3].numpy(), one.world_to_camera[:3, 3].numpy()
    r2, t2 = other.world_to_camera[:3, :3].numpy(), other.world_to_camera[:3, 3].numpy()
    r, t = r2 @ r1.T, t2 - r2 @ r1.T @ t1
    n = r1 @ normal
    d = constant + n @ t1  # n·x = d for x in the first camera's frame
    return other.intrinsics.numpy() @ (r + np.outer(t, n) / d) @ np.linalg.inv(one.intrinsics.numpy())


def moved(matrix: NDArray[np.float64], pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    seen = np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1) @ matrix.T
    return np.asarray(seen[..., :2] / seen[..., 2:])


def test_patches_are_moved_as_the_planes_homography_moves_them() -> None:
    normal = PLANE[0].expand(18, 24, 3)
    own, there = warped(plane_depth(ONE), normal, ONE, OTHER, EVERY)
    assert own.shape == there.shape == (18, 24, (2 * PATCH + 1) ** 2, 2)
    np.testing.assert_allclose(own[5, 7].numpy().min(0), (7.5 - PATCH, 5.5 - PATCH), atol=1e-9)
    np.testing.assert_allclose(own[5, 7].numpy().max(0), (7.5 + PATCH, 5.5 + PATCH), atol=1e-9)
    np.testing.assert_allclose(there.numpy(), moved(homography(ONE, OTHER), own.numpy()), atol=1e-8)


def test_a_part_of_the_patches_is_the_same_ones() -> None:
    normal = PLANE[0].expand(18, 24, 3)
    every, part = (
        warped(plane_depth(ONE), normal, ONE, OTHER, rows) for rows in (EVERY, (slice(1, None, 3), slice(2, None, 3)))
    )
    for one, other in zip(every, part, strict=True):
        torch.testing.assert_close(one[1::3, 2::3], other)


def test_points_of_a_surface_that_both_see_return_to_their_pixels() -> None:
    at, noise = returned(plane_depth(ONE), plane_depth(OTHER), ONE, OTHER)
    rows, columns = np.mgrid[:18, :24] + 0.5
    np.testing.assert_allclose(at.numpy(), moved(homography(ONE, OTHER), np.stack([columns, rows], -1)), atol=1e-8)
    inside = ((at > 0.5) & (at < torch.tensor([29.5, 19.5]))).all(-1)
    assert 0.3 < inside.double().mean() < 1
    assert noise[inside].max() < 0.02  # z is interpolated, of which the inverse alone is linear over a plane
    outside = ((at < 0) | (at > torch.tensor([30.0, 20.0]))).any(-1)
    assert outside.any()
    assert noise[outside].isinf().all()


def test_how_far_beside_a_point_returns_is_how_deep_the_other_view_has_it() -> None:
    """By hand: the other's ray through where it lies, taken 1.1 times as far."""
    at, noise = returned(plane_depth(ONE), 1.1 * plane_depth(OTHER), ONE, OTHER)
    row, column = 9, 12
    x, y = at[row, column].numpy()
    ray = np.linalg.inv(OTHER.intrinsics.numpy()) @ np.array([x, y, 1.0])
    pose = OTHER.world_to_camera.numpy()
    normal, constant = PLANE[0].numpy(), PLANE[1]
    center = -pose[:3, :3].T @ pose[:3, 3]
    way = pose[:3, :3].T @ ray
    point = center + 1.1 * (constant - normal @ center) / (normal @ way) * way
    h = ONE.intrinsics.numpy() @ point
    expected = np.hypot(*(h[:2] / h[2] - (column + 0.5, row + 0.5)))
    assert float(noise[row, column]) == pytest.approx(expected, abs=0.02)
    assert expected > 0.3


def test_what_is_behind_a_camera_or_has_no_depth_is_not_seen() -> None:
    away = camera(np.pi, (0.0, 0.0, 0.0))
    assert returned(plane_depth(ONE), plane_depth(ONE), ONE, away)[1].isinf().all()
    assert returned(torch.zeros(18, 24, dtype=torch.float64), plane_depth(OTHER), ONE, OTHER)[1].isinf().all()
    assert returned(plane_depth(ONE), torch.zeros(20, 30, dtype=torch.float64), ONE, OTHER)[1].isinf().all()


def test_gradients_are_differences() -> None:
    depth, others = plane_depth(ONE)[6:9, 8:11], 1.02 * plane_depth(OTHER)
    small = Camera(ONE.world_to_camera, ONE.intrinsics - torch.tensor([[0, 0, 8.0], [0, 0, 6], [0, 0, 0]]), 3, 3)
    normal = PLANE[0].expand(3, 3, 3) + 0.01
    assert returned(depth, others, small, OTHER)[1].isfinite().all()
    assert torch.autograd.gradcheck(
        lambda a, b: returned(a, b, small, OTHER), (depth.requires_grad_(), others.requires_grad_())
    )
    assert torch.autograd.gradcheck(
        lambda a, n: warped(a, n, small, OTHER, EVERY)[1], (depth.detach().requires_grad_(), normal.requires_grad_())
    )


def test_values_between_pixels_are_scipys() -> None:
    values = torch.rand(7, 9, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    at = torch.tensor([[3.2, 4.9], [0.5, 0.5], [8.99, 6.4], [0.1, 3.0], [12.0, -2.0]], dtype=torch.float64)
    place = (at - 0.5).flip(-1).numpy().T
    expected = [ndimage.map_coordinates(values[..., c].numpy(), place, order=1, mode="nearest") for c in (0, 1)]
    np.testing.assert_allclose(sampled(values, at).numpy(), np.stack(expected, -1), atol=1e-12)


def test_correlation_is_numpys_and_of_nothing_nothing() -> None:
    one, other = torch.rand(2, 5, 49, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    expected = [np.corrcoef(a, b)[0, 1] for a, b in zip(one.numpy(), other.numpy(), strict=True)]
    np.testing.assert_allclose(correlation(one, other).numpy(), expected, atol=1e-4)
    torch.testing.assert_close(correlation(one, 0.3 * one + 0.2), torch.ones(5, dtype=torch.float64), atol=1e-4, rtol=0)
    assert not correlation(one, torch.full_like(other, 0.7)).any()


def test_neighbors_are_the_nearest_that_look_about_the_same_way() -> None:
    """Every 9° of a ring: three on either side look at most 30° away. The one in the same place is none."""
    turns = [np.deg2rad(9 * step) for step in range(40)]
    ring = [camera(turn, (-3 * np.sin(turn), 0.0, -3 * np.cos(turn))) for turn in turns]
    found = neighbors([*ring, ring[0]], 0.01)
    assert set(found[5]) == {2, 3, 4, 6, 7, 8}
    assert set(found[5][:2]) == {4, 6}
    assert set(found[0]) == {37, 38, 39, 1, 2, 3}


# What is minimized


def seen(view: Camera, farther: float = 1.0, color: float = 0.5, beta: float = 0.0) -> Seen:
    """The plane as a model has it: its depth × `farther`, one base color and one β; its photograph is a closed form."""
    depth = plane_depth(view)
    origins, directions = view.rays()
    points = origins + depth[..., None] * directions
    gray = 0.5 + 0.2 * (9 * points[..., :1]).sin() + 0.2 * (11 * points[..., 1:2]).cos()
    blank = torch.zeros_like(gray)
    return Seen(view, farther * depth, PLANE[0].expand_as(points), blank.expand_as(points) + color, blank + beta, gray)


def test_views_that_agree_lose_little() -> None:
    assert float(disagreement(seen(ONE), seen(OTHER), 1, True)) < 0.01


def test_patches_agree_best_where_the_surface_is() -> None:
    """Depths of both views are wrong alike, so that φ stays small and photographs alone tell."""
    losses = {by: float(disagreement(seen(ONE, by), seen(OTHER, by), 1, False)) for by in (0.96, 0.98, 1.0, 1.02, 1.04)}
    assert min(losses, key=losses.__getitem__) == 1.0
    assert losses[0.96] > losses[0.98]
    assert losses[1.04] > losses[1.02]


def test_photographs_of_what_mirrors_are_not_compared() -> None:
    wrong = {
        beta: disagreement(seen(ONE, 1.02, beta=beta), seen(OTHER, 1.02, beta=beta), 1, False) for beta in (0.1, 0.3)
    }
    assert float(wrong[0.1]) > 5 * float(wrong[0.3])


def test_base_colors_and_strengths_are_compared_as_said() -> None:
    """φ is about 0, so that every pixel that both see counts alike: constants by hand."""
    plain = disagreement(seen(ONE), seen(OTHER), 1, True)
    redder = disagreement(seen(ONE, color=0.6), seen(OTHER, color=0.4), 1, True) - plain
    assert float(redder) == pytest.approx(COLORS * 3 * 0.2, rel=0.02)
    shinier = disagreement(seen(ONE, beta=0.9), seen(OTHER, beta=0.5), 1, True)
    shinier -= disagreement(seen(ONE, beta=0.9), seen(OTHER, beta=0.9), 1, True)
    assert float(shinier) == pytest.approx(STRENGTHS * 0.9 * 0.4, rel=0.02)


def test_the_lesser_strength_alone_is_pulled() -> None:
    one, other = seen(ONE, beta=0.9), seen(OTHER, beta=0.5)
    one.beta.requires_grad_(), other.beta.requires_grad_()
    disagreement(one, other, 1, True).backward()
    assert one.beta.grad is not None
    assert other.beta.grad is not None
    assert not one.beta.grad.any()
    assert (other.beta.grad <= 0).all()
    assert other.beta.grad.any()


def test_depths_that_disagree_are_pulled_together() -> None:
    """The one view's surface is a little too far: its depth falls with the loss, and the other's rises."""
    one, other = seen(ONE, 1.01), seen(OTHER)
    one.depth.requires_grad_(), other.depth.requires_grad_()
    flat = replace(one, gray=torch.full_like(one.gray, 0.5))  # whose patches say nothing
    loss = disagreement(flat, other, 1, False)
    loss.backward()
    assert one.depth.grad is not None
    assert other.depth.grad is not None
    assert 0 < float(loss.detach()) < DEPTHS
    assert float(one.depth.grad.sum()) > 0 > float(other.depth.grad.sum())


# In EnvGS


def ring_of(views: int = 24) -> Scene:
    """`tiny_scene`, its cameras nearer together."""
    scene = tiny_scene()
    first = scene.train[0]
    turned = []
    for index in range(views):
        turn = 2 * torch.pi * torch.tensor(index / views)
        spin = torch.eye(4)
        spin[0, 0], spin[0, 2], spin[2, 0], spin[2, 2] = turn.cos(), turn.sin(), -turn.sin(), turn.cos()
        pose = first.camera.world_to_camera @ spin
        turned.append(replace(first, name=f"ring{index}", camera=replace(first.camera, world_to_camera=pose)))
    return replace(scene, train=turned)


def test_it_counts_when_surfaces_have_settled_and_not_without_a_weight() -> None:
    scene = ring_of()
    for weight, expected in ((0.0, [False, False]), (1.0, [False, True])):
        method = create_method("envgs", {**SMALL, "consistency_weight": weight})
        assert isinstance(method, EnvGS)
        assert (CONSISTENCY in method.parts) == (weight > 0)
        method.initialize(scene, 30_000)
        counted = ["consistency" in method.training_step(scene.train[0], step) for step in (7_000, 7_001)]
        assert counted == expected


def test_views_without_neighbors_have_no_such_loss() -> None:
    scene = tiny_scene()  # 60° apart
    method = create_method("envgs", {**SMALL, "consistency_weight": 1.0})
    method.initialize(scene, 30_000)
    assert "consistency" not in method.training_step(scene.train[0], 20_000)


def test_envgs_with_it_conforms(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(consistency, "TURN", 90.0)  # the views of that scene are 60° apart
    check_method("envgs", {**SMALL, "consistency_weight": 1.0}, steps=10)
