"""A colored cube with a flat mirror in it, seen from inside: what a plane mirrors is known exactly."""

from __future__ import annotations

import torch
from torch import Tensor

from envgs_bench.core import Camera, Scene, View
from envgs_bench.core.vectors import unit
from envgs_bench.methods.lighting.plane_proposals import Rectangle, inside_of

HALF = 2.0  # of the cube
MIRROR = Rectangle(
    torch.tensor([0.1, 1.5, -0.1]),
    torch.tensor([[-1.0, 0, 0], [0, 0, 1], [0, -1.0, 0]]),
    torch.tensor([0.9, 0.6]),
)


def wall_color(points: Tensor) -> Tensor:
    """The color [..., 3] of the cube's walls at points [..., 3]."""
    turned = points @ torch.tensor([[2.0, 0.6, 0.0], [-0.5, 1.8, 0.9], [0.8, -0.7, 2.1]])
    return 0.5 + 0.45 * turned.sin()


def walls(origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
    """How far the cube's walls are along rays from inside it, [...], and their inner normals [..., 3]."""
    distances = (HALF * directions.sign() - origins) / torch.where(directions == 0, 1e-9, directions)
    distance, axis = distances.min(-1)
    normal = -torch.nn.functional.one_hot(axis, 3) * directions.sign()
    return distance, normal


def mirror_room(views: int = 24, size: int = 40, reflectance: float = 1.0) -> Scene:
    """Views along an arc before the mirror; every eighth tests. Without a mirror where the reflectance is 0."""
    made = [_view(index, 2 * torch.pi * index / views, size, reflectance) for index in range(views)]
    generator = torch.Generator().manual_seed(0)
    points = HALF * (2 * torch.rand(1_200, 3, generator=generator) - 1)
    rows, axis = torch.arange(len(points)), torch.randint(0, 3, (len(points),), generator=generator)
    points[rows, axis] = HALF * points[rows, axis].sign()
    train = [view for index, view in enumerate(made) if index % 8]
    return Scene("mirror_room", train, made[::8], points, wall_color(points), bounds=HALF)


def _view(index: int, angle: float, size: int, reflectance: float) -> View:
    angle = torch.tensor(angle)
    center = torch.stack([0.9 * angle.cos(), -0.4 + 0.5 * angle.sin(), 0.7 * (2 * angle).sin()])
    forward = unit(torch.tensor([0.2, 1.5, 0.0]) * torch.tensor([1.0, 1, 1]) - center)
    right = unit(torch.linalg.cross(torch.tensor([0.0, 0, 1]), forward))
    pose = torch.eye(4)
    pose[:3, :3] = torch.stack([right, torch.linalg.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ center
    camera = Camera(pose, torch.tensor([[0.6 * size, 0, size / 2], [0, 0.6 * size, size / 2], [0, 0, 1]]), size, size)
    origins, rays = camera.rays()
    rays = unit(rays)
    distance, normal = walls(origins, rays)
    image = wall_color(origins + distance[..., None] * rays)
    within, before = inside_of(MIRROR, origins, rays, 1e-6)
    mirror = (within > 0) & (before < distance) & (reflectance > 0)
    there = origins + before[..., None] * rays
    facing = MIRROR.axes[2]
    mirrored = rays - 2 * (rays @ facing)[..., None] * facing
    seen = wall_color(there + walls(there, mirrored)[0][..., None] * mirrored)
    image = torch.where(mirror[..., None], reflectance * seen, image)
    normal = torch.where(mirror[..., None], facing, normal)
    return View(f"{index:02d}", camera, (255 * image).round().byte(), {"reflective": mirror}, normal)
