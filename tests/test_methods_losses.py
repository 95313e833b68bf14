"""Losses and depth-to-normal on surfaces whose answer is known."""

import math

import pytest
import torch
from torch import Tensor

from envgs_bench.core import Camera
from envgs_bench.core.ssim import ssim
from envgs_bench.methods.losses import depth_normals, nearness, normal_distance, normal_loss, photometric_loss, psnr


def make_camera(width: int = 48, height: int = 36) -> Camera:
    """Turned, and with its principal point off the image's centre."""
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
    point = camera.centre + 3 * directions[18, 24]
    depth = ((point - origins) @ normal) / (directions @ normal)
    found = depth_normals(depth, directions)
    torch.testing.assert_close(found[1:-1, 1:-1], normal.expand(34, 46, 3), atol=2e-4, rtol=0)
    assert not found[0].any()
    assert not found[:, -1].any()


def sphere_depth(camera: Camera, centre: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """Depth [H, W] of a sphere, 0 where missed, and its normals [H, W, 3]."""
    origins, directions = camera.rays()
    a, b = directions.square().sum(-1), ((origins - centre) * directions).sum(-1)
    c = (origins - centre).square().sum(-1) - radius**2
    root = (b * b - a * c).clamp_min(0).sqrt()
    depth = torch.where(b * b > a * c, (-b - root) / a, 0.0)
    return depth, (origins + depth[..., None] * directions - centre) / radius


def test_normals_of_a_sphere():
    camera = make_camera(480, 360)
    camera = Camera(camera.world_to_camera, torch.tensor([[500.0, 0, 200], [0, 450, 210], [0, 0, 1]]), 480, 360)
    directions = camera.rays()[1]
    depth, normals = sphere_depth(camera, camera.centre + 4 * directions[180, 240], 1.0)
    found = depth_normals(depth, directions)
    inner = (normals * torch.nn.functional.normalize(directions, dim=-1)).sum(-1) < -0.5
    inner &= found.abs().sum(-1) > 0
    assert inner.sum() > 10_000
    assert (found * normals).sum(-1)[inner].min() > math.cos(math.radians(0.5))


def test_normals_need_all_four_neighbours():
    camera = make_camera()
    depth = torch.full((36, 48), 2.0)
    depth[10, 20] = 0
    found = depth_normals(depth, camera.rays()[1])
    missing = (found[1:-1, 1:-1].abs().sum(-1) == 0).nonzero() + 1
    assert sorted(map(tuple, missing.tolist())) == [(9, 20), (10, 19), (10, 21), (11, 20)]


def test_depth_normals_gradient():
    camera = make_camera(6, 5)
    depth = (
        2 + 0.1 * torch.rand(5, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    ).requires_grad_()
    directions = camera.rays()[1].double()
    assert torch.autograd.gradcheck(lambda d: depth_normals(d, directions), depth)


def test_normal_loss_is_one_minus_cosine_and_spares_unknown_pixels():
    angle = math.radians(60)
    reference = torch.zeros(2, 2, 3)
    reference[0, :, 2] = -1
    normal = torch.tensor([0.0, math.sin(angle), -math.cos(angle)]).expand(2, 2, 3)
    assert normal_loss(normal, reference).item() == pytest.approx(0.5 * (1 - math.cos(angle)))
    weight = torch.tensor([[1.0, 0.0], [1.0, 1.0]])
    assert normal_loss(normal, reference, weight).item() == pytest.approx(0.25 * (1 - math.cos(angle)))


def test_normal_distance_grows_with_the_angle_from_the_start():
    """|n − N|₁ of a normal turned by θ in the xz-plane is sin θ + 1 − cos θ: its slope at 0 is 1, that of 1 − cos 0."""
    angle = torch.tensor(0.02, dtype=torch.float64, requires_grad=True)
    reference = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(2, 2, 3).clone()
    reference[0, 0] = 0  # unknown
    turned = torch.stack([angle.sin(), torch.zeros_like(angle), angle.cos()]).expand(2, 2, 3)
    loss = normal_distance(turned, reference)
    torch.testing.assert_close(loss, 0.75 * (angle.sin() + 1 - angle.cos()))
    (slope,) = torch.autograd.grad(loss, angle)
    torch.testing.assert_close(slope, 0.75 * (angle.cos() + angle.sin()))


def test_photometric_loss_is_the_stated_mixture():
    generator = torch.Generator().manual_seed(0)
    image, target = torch.rand(20, 30, 3, generator=generator), torch.rand(20, 30, 3, generator=generator)
    expected = 0.8 * (image - target).abs().mean() + 0.2 * (1 - ssim(image, target))
    torch.testing.assert_close(photometric_loss(image, target), expected)
    assert photometric_loss(target, target).item() == pytest.approx(0, abs=1e-6)


def test_nearness():
    depth = torch.tensor([[2.0, 6.0], [4.0, 0.0]])
    assert nearness(depth).tolist() == [[1.0, 0.0], [0.5, 1.0]]
    assert nearness(torch.full((2, 2), 3.0)).tolist() == [[1.0, 1.0], [1.0, 1.0]]
    assert nearness(torch.zeros(2, 2)).tolist() == [[1.0, 1.0], [1.0, 1.0]]


def test_psnr():
    assert psnr(torch.full((4, 4, 3), 0.6), torch.full((4, 4, 3), 0.5)).item() == pytest.approx(20, abs=1e-3)
