"""What holds for every scene, odd ones included."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from core_scenes import (
    FIELDS,
    Backend,
    gradients_of,
    loss_of,
    plain_camera,
    random_rays,
    random_set,
    tilted_camera,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from envgs_bench.core import Camera, GaussianSet, Rendering

few = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])

ODD_SHAPES = ["plain", "coincident", "huge", "edge-on", "straddling", "points", "elongated", "at the camera"]
OPACITIES = [0.0, 1 / 256, 1 / 255, 1.001 / 255, 0.5, 0.99, 1.0]


@st.composite
def odd_sets(draw, columns: int) -> GaussianSet:
    """0 to 20 Gaussians of an odd shape, opacities at their limits among others."""
    count = draw(st.sampled_from([0, 1, 2, 3, 20]))
    scene = random_set(count, columns=columns, degree=draw(st.integers(0, 3)), seed=draw(st.integers(0, 1000)))
    opacities = draw(st.lists(st.sampled_from(OPACITIES), min_size=count, max_size=count))
    scene = replace(scene, opacities=torch.tensor(opacities).reshape(count), extras=torch.ones(count, 1))
    match draw(st.sampled_from(ODD_SHAPES)):
        case "coincident":
            return scene.map(lambda x: x[:1].repeat(count, *[1] * (x.ndim - 1)) if count else x)
        case "huge":
            return replace(scene, scales=torch.full_like(scene.scales, 1e3))
        case "edge-on":  # in the plane x = 0, that of the camera's middle column
            means = scene.means * torch.tensor([0.0, 1.0, 1.0])
            return replace(scene, means=means, quaternions=torch.full_like(scene.quaternions, 0.5))
        case "straddling":
            return replace(scene, means=scene.means - torch.tensor([0.0, 0.0, 4.0]), scales=scene.scales + 1)
        case "points":
            return replace(scene, scales=torch.full_like(scene.scales, 1e-6))
        case "elongated":
            scales = torch.full_like(scene.scales, 1e-5)
            scales[:, 0] = 2.0
            return replace(scene, scales=scales)
        case "at the camera":
            return replace(scene, means=torch.zeros_like(scene.means))
    return scene


def check(drawn: Rendering, leaves: GaussianSet, **rays: torch.Tensor) -> None:
    """What any drawing of a set whose extras are all one must satisfy, and finite gradients."""
    for name in FIELDS:
        assert getattr(drawn, name).isfinite().all(), name
    assert (drawn.alpha >= 0).all()
    assert (drawn.alpha <= 1 + 1e-6).all()
    assert (drawn.hits >= 0).all()
    assert (drawn.hits <= len(leaves)).all()
    assert torch.equal(drawn.alpha > 0, drawn.hits > 0)
    assert (drawn.color >= 0).all()
    torch.testing.assert_close(drawn.extras[..., 0], drawn.alpha, atol=1e-5, rtol=1e-5)  # extras of one blend to alpha
    assert (drawn.normal.norm(dim=-1) <= drawn.alpha * (1 + 1e-4) + 1e-6).all()
    weights = drawn.statistics.weights
    assert weights.shape == (len(leaves),)
    assert (weights >= 0).all()
    torch.testing.assert_close(weights.sum(), drawn.alpha.sum(), atol=1e-3, rtol=1e-4)
    assert not weights[leaves.opacities <= 1 / 255].any()

    loss_of(drawn).backward()
    for name, gradient in gradients_of(leaves, **rays).items():
        assert gradient.isfinite().all(), name


@few
@given(scene=st.sampled_from([2, 3]).flatmap(lambda columns: odd_sets(columns)), low_pass=st.booleans())
def test_images_of_odd_sets(rasterizer, scene, low_pass):
    leaves = rasterizer.take(scene)
    camera = rasterizer.take(plain_camera(19, 11, focal=15.0))
    check(rasterizer.rasterize(leaves, camera, low_pass=low_pass), leaves)


@few
@given(scene=odd_sets(2), from_camera=st.booleans())
def test_rays_through_odd_sets(tracer, scene, from_camera):
    leaves = tracer.take(scene)
    rays = plain_camera(19, 11, focal=15.0).rays() if from_camera else random_rays(100)
    origins, directions = (tracer.take(x) for x in rays)
    drawn = tracer.trace(leaves, origins, directions)
    check(drawn, leaves, origins=origins, directions=directions)
    assert (drawn.depth >= 0).all()


@pytest.mark.parametrize("columns", [2, 3])
def test_the_order_of_storage_does_not_matter(rasterizer, columns):
    scene, camera = random_set(200, columns=columns), rasterizer.take(tilted_camera())
    shuffled = torch.randperm(200, generator=torch.Generator().manual_seed(1))
    one = rasterizer.rasterize(rasterizer.take(scene), camera)
    other = rasterizer.rasterize(rasterizer.take(scene.map(lambda x: x[shuffled])), camera)
    check_same(rasterizer, one, other)
    torch.testing.assert_close(other.statistics.weights, one.statistics.weights[shuffled], atol=1e-4, rtol=1e-4)


def test_the_order_of_storage_does_not_matter_to_rays(tracer):
    scene, rays = random_set(200), [tracer.take(x) for x in random_rays(300)]
    shuffled = torch.randperm(200, generator=torch.Generator().manual_seed(1))
    one = tracer.trace(tracer.take(scene), *rays)
    other = tracer.trace(tracer.take(scene.map(lambda x: x[shuffled])), *rays)
    check_same(tracer, one, other)


def test_the_order_of_rays_does_not_matter(tracer):
    scene, rays = tracer.take(random_set(200)), [tracer.take(x) for x in random_rays(300)]
    shuffled = torch.randperm(300, generator=torch.Generator().manual_seed(2))
    one, other = tracer.trace(scene, *rays), tracer.trace(scene, *(x[shuffled] for x in rays))
    for name in FIELDS:
        assert torch.equal(getattr(one, name)[shuffled], getattr(other, name)), name


@pytest.mark.parametrize("columns", [2, 3])
def test_moving_camera_and_scene_together_changes_nothing(rasterizer, columns):
    """Degree 0: colors that depend on the direction would have to turn with the scene."""
    scene, camera = random_set(80, columns=columns, degree=0), tilted_camera()
    motion = Rotation.from_rotvec([0.4, -1.1, 0.7])
    rotation = torch.from_numpy(motion.as_matrix())
    shift = torch.tensor([2.0, -1.0, 0.5], dtype=torch.float64)
    turned = motion * Rotation.from_quat(scene.quaternions.double().numpy(), scalar_first=True)
    moved = replace(
        scene,
        means=(scene.means.double() @ rotation.T + shift).float(),
        quaternions=torch.from_numpy(turned.as_quat(scalar_first=True)).float(),
    )
    rigid = torch.eye(4, dtype=torch.float64)
    rigid[:3, :3], rigid[:3, 3] = rotation, shift
    pose = (camera.world_to_camera.double() @ rigid.inverse()).float()
    seen = Camera(pose, camera.intrinsics, camera.width, camera.height)

    one = rasterizer.rasterize(rasterizer.take(scene), rasterizer.take(camera))
    other = rasterizer.rasterize(rasterizer.take(moved), rasterizer.take(seen))
    different = (one.color - other.color).abs().amax(-1) > 1e-3
    assert different.double().mean() < 0.02
    assert one.color.max() > 0.5


def test_a_quaternions_length_and_sign_do_not_matter(rasterizer):
    scene, camera = random_set(80), rasterizer.take(tilted_camera())
    one = rasterizer.rasterize(rasterizer.take(scene), camera)
    other = rasterizer.rasterize(rasterizer.take(replace(scene, quaternions=-2 * scene.quaternions)), camera)
    check_same(rasterizer, one, other)


def check_same(backend: Backend, one: Rendering, other: Rendering) -> None:
    """Equal but for rounding; a hit on the very edge of a support may fall to either side in float32."""
    for name in FIELDS:
        difference = (getattr(one, name) - getattr(other, name)).abs()
        per_ray = difference if name in ("alpha", "depth") else difference.flatten(one.alpha.ndim).amax(-1)
        limit = 1e-9 if backend.dtype == torch.float64 else 1e-4
        assert (per_ray > limit).double().mean() < 0.005, name
