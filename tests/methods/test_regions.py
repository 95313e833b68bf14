"""Regions of hand-made rooms whose masks are known in closed form."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet
from envgs_bench.methods.gaussians.regions import (
    Ball,
    foreground_ball,
    in_box,
    near_field_mask,
    reflecting,
    reflective_mask,
)

SIZE = 60
FOCAL = 40.0
FLAT = torch.tensor([1.0, 0, 0, 0])  # a surfel in a plane of equal z
STEP = 0.05
EVERYTHING = Ball(torch.zeros(3), 100.0)


def plane(x: tuple[float, float], y: tuple[float, float], z: float, beta: float) -> GaussianSet:
    """Opaque surfels on a lattice that fill a rectangle at depth z; 3σ of the outermost end about STEP beyond."""
    columns, rows = (torch.arange(low + STEP / 2, high, STEP) for low, high in (x, y))
    spots = torch.cartesian_prod(columns, rows)
    count = len(spots)
    return GaussianSet(
        means=torch.cat([spots, torch.full((count, 1), z)], dim=1),
        quaternions=FLAT.repeat(count, 1),
        scales=torch.full((count, 2), STEP / 2),
        opacities=torch.full((count,), 0.99),
        sh=torch.zeros(count, 1, 3),
        extras=torch.full((count, 1), beta),
    )


def joined(*sets: GaussianSet) -> GaussianSet:
    names = ("means", "quaternions", "scales", "opacities", "sh", "extras")
    return GaussianSet(**{name: torch.cat([getattr(one, name) for one in sets]) for name in names})


def camera() -> Camera:
    """At the origin, looking along z: pixel (c, r) looks along ((c + ½ − 30) / 40, (r + ½ − 30) / 40, 1)."""
    intrinsics = torch.tensor([[FOCAL, 0, SIZE / 2], [0, FOCAL, SIZE / 2], [0, 0, 1]])
    return Camera(torch.eye(4), intrinsics, SIZE, SIZE)


def on_plane(depth: float) -> tuple[Tensor, Tensor]:
    """World x and y at which each pixel's ray reaches this depth: [H, W] each."""
    directions = camera().rays()[1]
    return depth * directions[..., 0], depth * directions[..., 1]


def agree_but_for_edges(mask: Tensor, expected: Tensor, unsure: Tensor) -> None:
    """Equal wherever `unsure` is not; both regions and its complement are there."""
    assert expected[~unsure].any()
    assert (~expected[~unsure]).any()
    assert unsure.float().mean() < 0.2
    assert torch.equal(mask[~unsure], expected[~unsure])


MIRROR = plane((-1, 1), (-1, 1), 4.0, beta=0.9)  # 20 pixels wide
FRAME = joined(plane((-2, -1), (-2, 2), 4.0, beta=0.05), plane((1, 2), (-2, 2), 4.0, beta=0.05))
WALL = plane((0, 4), (-4, 4), -2.0, beta=0.0)  # behind the camera, on its right


def within(x: Tensor, y: Tensor, half: float) -> Tensor:
    return (x.abs() < half) & (y.abs() < half)


def test_the_reflective_mask_is_the_mirror_and_not_its_frame() -> None:
    base = joined(MIRROR, FRAME, WALL)
    kept = reflecting(base, EVERYTHING, beta_min=0.1)
    assert kept.sum() == len(MIRROR)
    x, y = on_plane(4.0)
    unsure = within(x, y, 1.11) & ~within(x, y, 0.89)  # a pixel is 0.1 wide there
    agree_but_for_edges(reflective_mask(base.map(lambda v: v[kept]), camera()), within(x, y, 1.0), unsure)


def test_rays_that_a_mirror_sends_to_a_wall_are_near_field() -> None:
    """A ray that meets the mirror (z = 4) at x comes to the wall (z = −2) at 2.5·x: the wall's edge is at x = 0."""
    base = joined(MIRROR, FRAME, WALL)
    near = near_field_mask(base, base, camera(), radius=4.0)
    x, y = on_plane(4.0)
    sure = within(x, y, 0.89) & ((2.5 * x).abs() > 0.2)
    assert sure.sum() > 200
    assert torch.equal(near[sure], (x > 0)[sure])


def test_what_lies_outside_the_box_is_far() -> None:
    base = joined(MIRROR, FRAME, WALL)
    inside = in_box(base, torch.tensor([-5.0, -5, 0]), torch.tensor([5.0, 5, 5]))
    assert inside.sum() == len(MIRROR) + len(FRAME)
    assert not near_field_mask(base, base.map(lambda v: v[inside]), camera(), radius=4.0).any()


def test_a_surface_does_not_meet_itself() -> None:
    """Whatever the mirror, its rays leave it: alone, it has no near field."""
    assert not near_field_mask(MIRROR, MIRROR, camera(), radius=4.0).any()


def test_only_the_foreground_is_kept() -> None:
    base = joined(MIRROR, plane((-1, 1), (-1, 1), 9.0, beta=0.9))
    kept = reflecting(base, Ball(torch.tensor([0.0, 0, 4]), 2.0), beta_min=0.1)
    assert torch.equal(kept.nonzero()[:, 0], torch.arange(len(MIRROR)))


def test_the_foreground_is_what_cameras_stand_around() -> None:
    """Cameras on a circle that look at one point, each rolled about its axis; the ball is the circle's."""
    target, cameras = torch.tensor([1.0, -2, 3]), []
    for angle in torch.linspace(0, 5, 7).tolist():
        z = torch.nn.functional.normalize(
            torch.tensor([-torch.tensor(angle).cos(), 0.3, -torch.tensor(angle).sin()]), dim=0
        )
        x = torch.linalg.cross(torch.tensor([0.1 * angle, 1.0, 0]), z)
        x = x / x.norm()
        pose = torch.eye(4)
        pose[:3, :3] = torch.stack([x, torch.linalg.cross(z, x), z])
        pose[:3, 3] = -pose[:3, :3] @ (target - 2.5 * z)
        cameras.append(Camera(pose, camera().intrinsics, SIZE, SIZE))
    ball = foreground_ball(cameras)
    torch.testing.assert_close(ball.center, target, atol=1e-5, rtol=0)
    assert ball.radius == pytest.approx(2.5, abs=1e-5)


def test_cameras_that_look_the_same_way_still_have_a_ball() -> None:
    ball = foreground_ball([camera(), camera()])
    assert torch.isfinite(ball.center).all()
    assert ball.radius >= 0


def test_a_set_without_beta_is_refused() -> None:
    with pytest.raises(ValueError, match="the base set has no β: reflecting things are found with a trained EnvGS"):
        reflecting(
            GaussianSet(*(getattr(MIRROR, n) for n in ("means", "quaternions", "scales", "opacities", "sh"))),
            EVERYTHING,
            0.1,
        )
