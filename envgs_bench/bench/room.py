"""The room: a workload of Gaussians on the walls of a room and the spheres in it, and rays that its surfaces reflect.

What a reflective scene asks of the core: surfels of differing size, opacity and tilt, a few layers deep on every
surface, some thirty blended hits a ray, and rays from everywhere in all directions.
"""

from __future__ import annotations

import math

import torch
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn.functional import normalize

from envgs_bench.core import Camera, GaussianSet

LOWER, UPPER = torch.tensor([-4.0, 0.0, -4.0]), torch.tensor([4.0, 4.0, 4.0])  # the room, y up
SPHERES = torch.tensor(  # x, y, z, radius
    [[0.0, 0.9, 0.0, 0.9], [2.0, 0.5, 1.5, 0.5], [-2.0, 0.4, 1.0, 0.4], [-1.5, 0.6, -2.0, 0.6], [1.5, 0.3, -1.5, 0.3]]
)
EYE, TARGET = torch.tensor([3.0, 1.8, 3.0]), torch.tensor([0.0, 0.8, 0.0])
SH_C0 = 0.28209479177387814


def room_gaussians(count: int, *, columns: int = 2, seed: int = 0) -> GaussianSet:
    """`count` Gaussians spread evenly over the room's surfaces, SH degree 2, float32.

    They lie off their surface by a normal deviate of 0.3 spacings and are tilted by about 0.15 radians. Scales are
    log-normal around the spacing, opacities logistic-normal around ½. As 3D Gaussians (columns = 3) they are the same
    surfels, a tenth of a spacing thick.
    """
    generator = torch.Generator().manual_seed(seed)
    points, normals, area = surface_points(count, generator)
    spacing = 0.9 * math.sqrt(area / max(count, 1))

    def deviates(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    means = points + 0.3 * spacing * deviates(count, 1) * normals
    normals = normalize(normals + 0.15 * deviates(count, 3), dim=1)
    tangents = normalize(torch.linalg.cross(deviates(count, 3), normals), dim=1)
    frames = torch.stack([tangents, torch.linalg.cross(normals, tangents), normals], dim=2)
    scales = spacing * (0.6 * deviates(count, 2)).exp()
    colors = torch.rand(count, 3, generator=generator)
    sh = torch.cat([((colors - 0.5) / SH_C0)[:, None], 0.05 * deviates(count, 8, 3)], dim=1)
    if columns == 3:
        scales = torch.cat([scales, torch.full((count, 1), 0.1 * spacing)], dim=1)
    return GaussianSet(
        means=means,
        quaternions=quaternions(frames),
        scales=scales,
        opacities=(2 * deviates(count) + 0.5).sigmoid(),
        sh=sh,
    )


def surface_points(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor, float]:
    """Points [N, 3] on the room's sides and spheres, evenly by area, their inward or outward normals, and the area."""
    extent = UPPER - LOWER
    axes = torch.arange(3).repeat(2)
    side_areas = (extent.prod() / extent)[axes]
    areas = torch.cat([side_areas, 4 * math.pi * SPHERES[:, 3] ** 2])
    surface = torch.multinomial(areas, max(count, 1), replacement=True, generator=generator)[:count]

    on_side = surface < 6
    axis = axes[surface.clamp_max(5)]
    upper = surface >= 3
    normals = torch.eye(3)[axis] * torch.where(upper, -1.0, 1.0)[:, None]
    in_room = LOWER + extent * torch.rand(count, 3, generator=generator)
    on_sides = torch.where(normals != 0, torch.where(upper[:, None], UPPER, LOWER), in_room)

    sphere = SPHERES[(surface - 6).clamp_min(0)]
    outward = normalize(torch.randn(count, 3, generator=generator), dim=1)
    points = torch.where(on_side[:, None], on_sides, sphere[:, :3] + sphere[:, 3:] * outward)
    return points, torch.where(on_side[:, None], normals, outward), float(areas.sum())


def quaternions(frames: Tensor) -> Tensor:
    """Quaternions [N, 4] (wxyz) of rotation matrices [N, 3, 3]."""
    if len(frames) == 0:
        return torch.empty(0, 4)
    return torch.from_numpy(Rotation.from_matrix(frames.double().numpy()).as_quat(scalar_first=True)).float()


def room_camera(width: int, height: int) -> Camera:
    """A view of the spheres from a corner, focal length 0.9 image widths."""
    forward = normalize(TARGET - EYE, dim=0)
    right = normalize(torch.linalg.cross(forward, torch.tensor([0.0, 1.0, 0.0])), dim=0)
    pose = torch.eye(4)
    pose[:3, :3] = torch.stack([right, torch.linalg.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ EYE
    focal = 0.9 * width
    return Camera(pose, torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]), width, height)


def reflected_rays(width: int, height: int) -> tuple[Tensor, Tensor]:
    """Origins and unit directions [H, W, 3] of the view's rays after a mirror-like bounce where they first hit.

    Normals are rough by 0.01, and rays start 0.02 off their surface.
    """
    directions = normalize(room_camera(width, height).rays()[1].reshape(-1, 3), dim=1)
    distances, normals = first_hits(EYE.expand_as(directions), directions)
    roughness = 0.01 * torch.randn(directions.shape, generator=torch.Generator().manual_seed(1))
    normals = normalize(normals + roughness, dim=1)
    mirrored = directions - 2 * (directions * normals).sum(1, keepdim=True) * normals
    origins = EYE + distances[:, None] * directions + 0.02 * normals
    return origins.reshape(height, width, 3), mirrored.reshape(height, width, 3)


def first_hits(origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
    """Distances [R] and normals [R, 3] of the nearest side or sphere along unit directions [R, 3] from inside."""
    to_sides = (torch.where(directions > 0, UPPER, LOWER) - origins) / directions
    nearest, axis = to_sides.min(dim=1)
    normals = -torch.eye(3)[axis] * directions.sign()
    for sphere in SPHERES:
        offsets = origins - sphere[:3]
        half_b = (offsets * directions).sum(1)
        discriminant = half_b**2 - (offsets * offsets).sum(1) + sphere[3] ** 2
        distance = -half_b - discriminant.clamp_min(0).sqrt()
        closer = (discriminant > 0) & (distance > 0) & (distance < nearest)
        nearest = torch.where(closer, distance, nearest)
        outward = (offsets + distance[:, None] * directions) / sphere[3]
        normals = torch.where(closer[:, None], outward, normals)
    return nearest, normals
