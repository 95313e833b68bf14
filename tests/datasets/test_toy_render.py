"""The toy ray tracer against closed forms, and against testing every triangle."""

from __future__ import annotations

import kornia
import numpy as np
import pytest
import torch
from toy_scenes import BLACK, GRAY, camera_at

from envgs_bench.core import Camera
from envgs_bench.datasets.formats.srgb import to_linear, to_srgb
from envgs_bench.datasets.toy import lighting
from envgs_bench.datasets.toy.lathe import Lathe
from envgs_bench.datasets.toy.paths import _lobe_samples, _microfacets, radiance
from envgs_bench.datasets.toy.render import geometry, picture
from envgs_bench.datasets.toy.rod import Rod
from envgs_bench.datasets.toy.shapes import Cone, Disc, Mesh, Rectangle, Shape, Sphere, Torus, box, tessellate
from envgs_bench.datasets.toy.waves import Wave, Waves
from envgs_bench.datasets.toy.world import Part, World, reflect_directions

SHAPES = [
    Sphere((0.1, -0.2, 0.3), 0.8),
    Sphere((0.0, 0.0, 0.0), 1.0, top=0.6),
    Cone((0.0, 0.1, -0.5), 0.8, 0.4, 1.1),
    Torus((0.0, 0.0, 0.0), 0.7, 0.25),
    Disc((0.0, 0.0, 0.1), 0.9, inner=0.3),
    Rectangle((-0.8, 0.3, 0.9), (1.5, 0.2, 0.0), (0.1, -0.4, -1.4)),
    box((0.0, 0.0, -0.4), (0.9, 0.7, 0.8), 25.0)[0],
    Rod((-0.4, 0.2, -0.6), (0.3, -0.1, 0.8), 0.3),
    Lathe((0.1, 0.0, -0.5), ((0.05, 1.0), (0.3, 0.7), (0.7, 0.5), (0.5, 0.1), (0.3, 0.0))),
    Waves((-0.8, 0.3, 0.9), (1.5, 0.2, 0.0), (0.1, -0.4, -1.4), (Wave(0.03, 1.4, 0.5), Wave(0.02, -0.4, 2.7, 0.3))),
]


def rays(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    origins, directions = camera.rays()
    return origins.reshape(-1, 3).double().numpy(), directions.reshape(-1, 3).double().numpy()


def first_hits(mesh: Mesh, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Distance to the first triangle along each ray, all tested (Möller and Trumbore), infinite without one."""
    corner, edge1, edge2 = (
        mesh.vertices[mesh.faces[:, 0]],
        *(mesh.vertices[mesh.faces[:, i]] - mesh.vertices[mesh.faces[:, 0]] for i in (1, 2)),
    )
    nearest = []
    for origin, direction in zip(origins, directions, strict=True):
        p, s = np.cross(direction, edge2), origin - corner
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1 / (edge1 * p).sum(1)
            q = np.cross(s, edge1)
            u, v, t = (s * p).sum(1) * scale, q @ direction * scale, (edge2 * q).sum(1) * scale
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        nearest.append(t[hit].min(initial=np.inf))
    return np.array(nearest)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_hits_are_the_first_of_all_triangles(shape: Shape) -> None:
    camera = camera_at((2.2, -1.4, 1.3), size=9)
    found = geometry(World([Part(shape, GRAY)], BLACK), camera).depth.reshape(-1)
    expected = first_hits(tessellate(shape), *rays(camera))
    assert np.isfinite(expected).sum() > 5
    np.testing.assert_allclose(found, np.where(np.isfinite(expected), expected, 0), atol=1e-4)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_normals_are_the_surface_derivatives_cross_product(shape: Shape) -> None:
    u, v = np.random.default_rng(0).uniform(0.05, 0.95, (2, 200))
    step = 1e-5
    along_u = (shape.evaluate(u + step, v)[0] - shape.evaluate(u - step, v)[0]) / (2 * step)
    along_v = (shape.evaluate(u, v + step)[0] - shape.evaluate(u, v - step)[0]) / (2 * step)
    normal = np.cross(along_v, along_u)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(shape.evaluate(u, v)[1], normal, atol=1e-6)


def test_depth_and_normals_of_a_plane_are_in_closed_form() -> None:
    plane = Rectangle((-5, -5, 5), (10, 0, 0), (0, 10, -10))  # y + z = 0
    camera = camera_at((0.3, -2.0, 1.0), (0.2, 0.5, 0.4))
    exact = geometry(World([Part(plane, GRAY)], BLACK), camera)
    normal = np.array([0, -1, -1]) / np.sqrt(2)
    origins, directions = rays(camera)
    depth = -(origins @ normal) / (directions @ normal)
    np.testing.assert_allclose(exact.depth.reshape(-1), depth, rtol=1e-5)
    np.testing.assert_allclose(exact.normal.reshape(-1, 3), np.broadcast_to(normal, (depth.size, 3)), atol=1e-6)
    assert ((exact.normal.reshape(-1, 3) * directions).sum(1) < 0).all()


def test_a_mirror_ball_shows_the_plane_that_analytic_rays_meet() -> None:
    """A ball over a floor whose color is linear in x and y, so that its texture interpolates exactly."""
    texels = (np.arange(64) + 0.5) / 64
    floor_color = np.stack([*np.meshgrid(texels, texels), np.full((64, 64), 0.2)], axis=-1)
    sky = np.full((4, 8, 3), (0.1, 0.2, 0.9))
    center, radius = np.array([0.0, 0.0, 1.2]), 0.8
    floor = Rectangle((-4, 4, 0), (8, 0, 0), (0, -8, 0))
    world = World([Part(Sphere(tuple(center), radius), GRAY, reflectance=1.0), Part(floor, floor_color)], sky)
    world.set_textures([GRAY, floor_color])
    camera = camera_at((2.6, 0.4, 1.9), (0, 0, 1.2))
    origins, directions = rays(camera)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    b = ((origins - center) * directions).sum(1)
    inside = b**2 - ((origins - center) ** 2).sum(1) + radius**2
    ball = inside > 0.02  # rays that graze the ball amplify the mesh's own error
    origins, directions = origins[ball], directions[ball]
    points = origins + (-b[ball] - np.sqrt(inside[ball]))[:, None] * directions
    mirrored = reflect_directions(directions, (points - center) / radius)
    with np.errstate(divide="ignore"):
        x, y = (points - points[:, 2:] / mirrored[:, 2:] * mirrored)[:, :2].T
    on_floor = (mirrored[:, 2] < 0) & (abs(x) < 3.9) & (abs(y) < 3.9)
    expected = np.where(on_floor[:, None], np.stack([x / 8 + 0.5, 0.5 - y / 8, 0 * x + 0.2], axis=1), sky[0, 0])
    on_edge = (mirrored[:, 2] < 0) & ~on_floor & (np.maximum(abs(x), abs(y)) < 4.1)

    seen = radiance(world, origins.astype(np.float32), directions.astype(np.float32), np.random.default_rng(0))
    assert on_floor.sum() > 150
    assert (~on_floor).sum() > 100
    np.testing.assert_allclose(seen[~on_edge], expected[~on_edge], atol=2e-3)

    near_field = geometry(world, camera).regions["near_field"].reshape(-1)[ball]
    np.testing.assert_array_equal(near_field[~on_edge], on_floor[~on_edge])


def test_facing_mirrors_of_one_color_show_that_color() -> None:
    """Each bounce keeps (1 − k) of the diffuse color; the series adds up to all of it, the last mirror included."""
    facing = [Rectangle((-9, -9, 0), (18, 0, 0), (0, 18, 0)), Rectangle((-9, -9, 1), (18, 0, 0), (0, 18, 0))]
    world = World([Part(shape, GRAY, reflectance=0.7) for shape in facing], BLACK)
    world.set_textures([GRAY, GRAY])
    directions = np.float32([[0.1, 0.05, 1.0], [0.0, 0.2, -1.0]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    seen = radiance(world, np.float32([[0, 0, 0.5]] * 2), directions, np.random.default_rng(0))
    np.testing.assert_allclose(seen, 0.5, atol=1e-6)


@pytest.mark.parametrize("bounces", [5, 12])
def test_each_bounce_is_weighted_by_the_reflectances_before_it(bounces: int) -> None:
    """Two facing mirrors, one of them black: only odd bounces carry light, Σ k^(2i+1)·(1 − k)·½."""
    k = 0.7
    facing = [Rectangle((-9, -9, 0), (18, 0, 0), (0, 18, 0)), Rectangle((-9, -9, 1), (18, 0, 0), (0, 18, 0))]
    world = World([Part(shape, GRAY, reflectance=k) for shape in facing], BLACK, bounces)
    world.set_textures([0 * GRAY, GRAY])
    seen = radiance(world, np.float32([[0, 0, 0.5]]), np.float32([[0, 0, -1]]), np.random.default_rng(0))
    kept = [k**i * (1 - k if i < bounces else 1) for i in range(bounces + 1)]
    np.testing.assert_allclose(seen, 0.5 * sum(kept[1::2]), atol=1e-6)


def test_a_pixel_is_its_areas_mean_in_linear_light() -> None:
    fine = np.indices((256, 256)).sum(0) % 2  # a checker too fine for any pixel: half the area is white
    board = np.broadcast_to(fine[..., None], (256, 256, 3)).astype(float)
    world = World([Part(Rectangle((-1, 1, 0), (2, 0, 0), (0, -2, 0)), board)], BLACK)
    world.set_textures([board])
    camera = camera_at((0.01, 0, 0.8), size=6)
    pixels = picture(world, camera, 24, np.random.default_rng(0))
    assert abs(pixels.mean() - 255 * float(to_srgb(0.5))) < 1.5
    assert pixels.std() < 4


def test_supersampling_agrees_with_the_mean_of_a_large_picture() -> None:
    rng = np.random.default_rng(1)
    parts = [
        Part(Sphere((0, 0, 0.9), 0.7), rng.uniform(size=(32, 64, 3)), reflectance=0.6),
        Part(Rectangle((-3, 3, 0), (6, 0, 0), (0, -6, 0)), rng.uniform(size=(48, 48, 3))),
    ]
    world = World(parts, rng.uniform(size=(16, 32, 3)))
    world.set_textures([part.albedo for part in parts])
    small = camera_at((2.5, 1.0, 2.0), (0, 0, 0.5), size=16)
    large = picture(world, small.resized(16 * 12, 16 * 12), 1, np.random.default_rng(2))
    mean = to_linear(large / 255).reshape(16, 12, 16, 12, 3).mean((1, 3))
    difference = picture(world, small, 12, np.random.default_rng(3)) - 255 * to_srgb(mean)
    assert abs(difference).mean() < 2.0
    assert abs(difference.mean()) < 0.3


def test_rough_facets_follow_ggx() -> None:
    """Under GGX, half of the facets tilt by tan θ < alpha, and a fifth by tan θ < alpha/2."""
    count, roughness = 40000, 0.2
    normals = np.float32([[0, 0, 1]] * count)
    samples = _lobe_samples(np.full(count // 8, 8), np.random.default_rng(0))
    facets = _microfacets(normals, -normals, np.full(count, roughness, dtype=np.float32), samples)
    tilt = np.hypot(facets[:, 0], facets[:, 1]) / facets[:, 2]
    for factor, share in ((1.0, 0.5), (0.5, 0.2)):
        assert np.mean(tilt < factor * roughness**2) == pytest.approx(share, abs=0.01)
    assert np.linalg.norm(facets.mean(0)[:2]) < 0.01


def test_a_glossy_surface_in_even_light_looks_like_a_mirror() -> None:
    even = np.full((4, 8, 3), 0.37)
    world = World([Part(Sphere((0, 0, 0), 1.0), GRAY, reflectance=0.8, roughness=0.4)], even)
    world.set_textures([np.full((2, 2, 3), 0.37)])
    origins, directions = (array.astype(np.float32) for array in rays(camera_at((3, 0, 0.5))))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_allclose(radiance(world, origins, directions, np.random.default_rng(0)), 0.37, atol=1e-5)


def test_baked_light_of_a_disc_is_in_closed_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """Below the middle of a parallel disc of radiance L, radius r, at height h: E/π = L·r²/(r² + h²)."""
    monkeypatch.setattr(lighting, "GATHERED_RAYS", 1024)
    monkeypatch.setattr(lighting, "PASSES", 1)
    albedo = np.full((5, 5, 3), 0.6)
    patch = Rectangle((-0.01, 0.01, 0), (0.02, 0, 0), (0, -0.02, 0))
    lamp = Part(Disc((0, 0, 1.5), 1.0), np.ones((2, 2, 3)), emission=3.0)
    world = World([Part(patch, albedo), lamp], BLACK)
    lighting.bake(world, np.random.default_rng(0))
    np.testing.assert_allclose(world.textures[0], 0.6 * 3.0 / (1 + 1.5**2), rtol=0.02)


def test_an_open_surface_under_an_even_sky_returns_its_albedo() -> None:
    sky = np.zeros((4, 8, 3))
    sky[:2] = 0.8  # the upper half
    level = Part(Rectangle((-1, 1, 0), (2, 0, 0), (0, -2, 0)), np.full((9, 9, 3), 0.4))
    upright = Part(Rectangle((-1, 50, 2), (2, 0, 0), (0, 0, -2)), np.full((9, 9, 3), 0.4))
    world = World([level, upright], sky)
    lighting.bake(world, np.random.default_rng(0))
    np.testing.assert_allclose(world.textures[0], 0.4 * 0.8, rtol=0.01)
    np.testing.assert_allclose(world.textures[1], 0.4 * 0.8 / 2, rtol=0.08)


def test_color_curve_is_that_of_kornia() -> None:
    values = torch.linspace(0, 1, 301, dtype=torch.float64)
    image = values.expand(1, 3, 1, -1)
    np.testing.assert_allclose(to_srgb(values), kornia.color.linear_rgb_to_rgb(image)[0, 0, 0], atol=1e-6)
    np.testing.assert_allclose(to_linear(values), kornia.color.rgb_to_linear_rgb(image)[0, 0, 0], atol=1e-6)
