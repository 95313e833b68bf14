"""A mirror ball before black under an analytic sky: what a method with a map of the surroundings shows exactly."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, Scene, View
from envgs_bench.methods.gaussian_method import GaussianMethod

SIZE = 32
VIEWS = 48
POINTS = 600


def sky(directions: Tensor) -> Tensor:
    """The color [..., 3] that the sky has in unit directions [..., 3]."""
    turned = 0.6 * directions @ torch.tensor([[4.0, 1.0, 0.0], [-1.0, 3.0, 2.0], [2.0, -2.0, 4.0]])
    return 0.5 + 0.4 * turned.sin()


def mirror_ball() -> Scene:
    """The unit ball at the origin, seen from cameras all around; every eighth view tests."""
    points = _spiral(POINTS)
    views = [_view(f"view{index}", 3.5 * center) for index, center in enumerate(_spiral(VIEWS))]
    train, test = [v for i, v in enumerate(views) if i % 8], views[::8]
    return Scene("mirror_ball", train, test, points, torch.full((POINTS, 3), 0.5))


def gain_of_training(method: GaussianMethod, scene: Scene, steps: int) -> float:
    """What `steps` steps add to the mean PSNR of the test views, dB, of the mean squared error over all of them."""

    def psnr() -> float:
        errors = [(method.render(view.camera).color - view.rgb()).square().mean() for view in scene.test]
        return -10 * math.log10(sum(map(float, errors)) / len(errors))

    before = psnr()
    for step in range(1, steps + 1):
        method.training_step(scene.train[5 * step % len(scene.train)], step)
    return psnr() - before


def facing_angle(normals: Tensor, view: View) -> float:
    """The mean angle in degrees between normals [H, W, 3] as rendered and the view's own, where the ball faces it."""
    assert view.normal is not None
    rays = functional.normalize(view.camera.rays()[1], dim=-1)
    ball = -(rays * view.normal).sum(-1) > 0.3  # the rim's pixels show more than the ball
    cosine = (functional.normalize(normals, dim=-1) * view.normal).sum(-1)[ball]
    return float(torch.rad2deg(cosine.clamp(-1, 1).arccos()).mean())


def _view(name: str, center: Tensor) -> View:
    forward = -functional.normalize(center, dim=0)
    right = functional.normalize(torch.linalg.cross(torch.tensor([0.1, 0.2, 1.0]), forward), dim=0)
    pose = torch.eye(4)
    pose[:3, :3] = torch.stack([right, torch.linalg.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ center
    intrinsics = torch.tensor([[1.4 * SIZE, 0, SIZE / 2], [0, 1.4 * SIZE, SIZE / 2], [0, 0, 1]])
    camera = Camera(pose, intrinsics, SIZE, SIZE)

    rays = functional.normalize(camera.rays()[1], dim=-1)
    along = -(rays @ center)
    beneath = along.square() - center @ center + 1
    normal = torch.where(
        (beneath > 0)[..., None], center + (along - beneath.clamp_min(0).sqrt())[..., None] * rays, torch.zeros(3)
    )
    mirrored = rays - 2 * (rays * normal).sum(-1, keepdim=True) * normal
    image = torch.where((beneath > 0)[..., None], sky(mirrored), torch.zeros(3))
    return View(name, camera, (255 * image).round().byte(), {"reflective": beneath > 0}, normal)


def _spiral(count: int) -> Tensor:
    """Points [count, 3] evenly on the unit sphere."""
    height = 1 - (2 * torch.arange(count) + 1) / count
    angle = torch.arange(count) * (math.pi * (3 - math.sqrt(5)))
    radius = (1 - height.square()).sqrt()
    return torch.stack([radius * angle.cos(), radius * angle.sin(), height], dim=1)
