"""depth_normals() on surfaces whose normals are known."""

import math

import pytest
import torch
from torch import Tensor

from envgs_bench.core import Camera, depth_normals


def make_camera(width: int = 48, height: int = 36) -> Camera:
    """Turned, and with its principal point off the image's center."""
    angle = 0.4
    pose = torch.eye(4)
    pose[:3, :3] = torch.tensor(
        [[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]]
    )
    pose[:3, 3] = torch.tensor([0.3, -0.1, 2.0])
    return Camera(pose, torch.tensor([[50.0, 0, 20], [0, 45.0, 21], [0, 0, 1]]), width, height)


def test_normals_of_a_plane_are_exact():
    camera = make_camera()
    origins, directions = camera.rays()
    normal = torch.nn.functional.normalize(camera.world_to_camera[:3, :3].T @ torch.tensor([0.2, 0.3, -1.0]), dim=0)
    point = camera.center + 3 * directions[18, 24]
    depth = ((point - origins) @ normal) / (directions @ normal)
    found = depth_normals(depth, camera)
    torch.testing.assert_close(found[1:-1, 1:-1], normal.expand(34, 46, 3), atol=2e-4, rtol=0)
    assert not found[0].any()
    assert not found[:, -1].any()


def sphere_depth(camera: Camera, center: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """Depth [H, W] of a sphere, 0 where missed, and its normals [H, W, 3]."""
    origins, directions = camera.rays()
    a, b = directions.square().sum(-1), ((origins - center) * directions).sum(-1)
    c = (origins - center).square().sum(-1) - radius**2
    root = (b * b - a * c).clamp_min(0).sqrt()
    depth = torch.where(b * b > a * c, (-b - root) / a, 0.0)
    return depth, (origins + depth[..., None] * directions - center) / radius


def test_normals_of_a_sphere():
    camera = make_camera(480, 360)
    camera = Camera(camera.world_to_camera, torch.tensor([[500.0, 0, 200], [0, 450, 210], [0, 0, 1]]), 480, 360)
    directions = camera.rays()[1]
    depth, normals = sphere_depth(camera, camera.center + 4 * directions[180, 240], 1.0)
    found = depth_normals(depth, camera)
    inner = (normals * torch.nn.functional.normalize(directions, dim=-1)).sum(-1) < -0.5
    inner &= found.abs().sum(-1) > 0
    assert inner.sum() > 10_000
    assert (found * normals).sum(-1)[inner].min() > math.cos(math.radians(0.5))


def test_normals_need_all_four_neighbors():
    camera = make_camera()
    depth = torch.full((36, 48), 2.0)
    depth[10, 20] = 0
    found = depth_normals(depth, camera)
    missing = (found[1:-1, 1:-1].abs().sum(-1) == 0).nonzero() + 1
    assert sorted(map(tuple, missing.tolist())) == [(9, 20), (10, 19), (10, 21), (11, 20)]


def test_gradients_against_finite_differences():
    camera = make_camera(6, 5)
    depth = (
        2 + 0.1 * torch.rand(5, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    ).requires_grad_()
    camera = Camera(camera.world_to_camera.double(), camera.intrinsics.double(), 6, 5)
    assert torch.autograd.gradcheck(lambda d: depth_normals(d, camera, backend="torch"), depth)


def test_a_map_of_another_size_is_refused():
    with pytest.raises(ValueError, match=r"depth \(36, 47\) is not of the camera's size \(36, 48\)"):
        depth_normals(torch.ones(36, 47), make_camera())
