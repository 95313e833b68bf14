"""Glass in the toy ray tracer against optics in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from toy_scenes import BLACK, GRAY, camera_at

from envgs_bench.datasets.toy import lighting
from envgs_bench.datasets.toy.dielectric import fresnel, refract
from envgs_bench.datasets.toy.paths import radiance
from envgs_bench.datasets.toy.render import geometry
from envgs_bench.datasets.toy.shapes import Rectangle, Sphere
from envgs_bench.datasets.toy.world import Part, World

NO_PICTURE = np.zeros((1, 1, 3))
PANE = 0.2  # thickness


def pane(ior: float = 1.5) -> list[Part]:
    """A wide slab between z = 0 and z = PANE, its normals pointing out."""
    lower = Rectangle((-50, -50, 0), (100, 0, 0), (0, 100, 0))
    upper = Rectangle((-50, 50, PANE), (100, 0, 0), (0, -100, 0))
    return [Part(shape, NO_PICTURE, ior=ior) for shape in (lower, upper)]


def look(world: World, origin: tuple[float, float, float], direction: np.ndarray) -> np.ndarray:
    seen = radiance(world, np.float32([origin]), np.float32([direction]), np.random.default_rng(0))
    return seen[0]


def tilted(degrees: float) -> np.ndarray:
    """A direction that goes down at this angle from the vertical, toward +x."""
    return np.array([np.sin(np.radians(degrees)), 0.0, -np.cos(np.radians(degrees))])


def test_fresnel_has_its_textbook_values() -> None:
    def reflected(degrees: float, ratio: float) -> float:
        return float(fresnel(np.array([np.cos(np.radians(degrees))]), np.array([ratio]))[0])

    assert reflected(0, 1 / 1.5) == pytest.approx(0.04)
    assert reflected(0, 1 / 2.42) == pytest.approx(0.172, abs=5e-4)  # diamond
    assert reflected(45, 1 / 1.5) == pytest.approx((0.0920 + 0.00847) / 2, abs=5e-5)  # s and p polarized
    assert reflected(90, 1 / 1.5) == pytest.approx(1)
    # at Brewster's angle only s is reflected, cos²(2·angle) of it
    brewster = np.arctan(1.5)
    assert reflected(np.degrees(brewster), 1 / 1.5) == pytest.approx(np.cos(2 * brewster) ** 2 / 2)
    critical = np.degrees(np.arcsin(1 / 1.5))
    assert reflected(critical + 0.01, 1.5) == 1
    assert reflected(critical - 0.01, 1.5) < 0.97


def test_fresnel_is_the_same_from_both_sides() -> None:
    outside = np.radians(np.linspace(1, 89, 45))
    inside = np.arcsin(np.sin(outside) / 1.5)
    one, other = np.full(45, 1 / 1.5), np.full(45, 1.5)
    np.testing.assert_allclose(fresnel(np.cos(outside), one), fresnel(np.cos(inside), other), rtol=1e-9)


def test_refracted_rays_follow_snell() -> None:
    rng = np.random.default_rng(0)
    normals, directions = (
        vectors / np.linalg.norm(vectors, axis=1, keepdims=True) for vectors in rng.normal(size=(2, 200, 3))
    )
    directions *= -np.sign((normals * directions).sum(1))[:, None]
    bent = refract(directions, normals, np.full(200, 1 / 1.33))
    np.testing.assert_allclose(np.linalg.norm(bent, axis=1), 1)
    # n₁·(d × n) = n₂·(d′ × n): Snell's law with its plane of incidence
    np.testing.assert_allclose(np.cross(directions, normals), 1.33 * np.cross(bent, normals), atol=1e-12)
    assert ((bent * normals).sum(1) < 0).all()


def test_glass_is_invisible_in_even_light() -> None:
    """Whatever the paths, their shares add up to one."""
    world = World([*pane(), Part(Sphere((0, 0, -2), 1.0), NO_PICTURE, ior=1.7)], np.full((4, 8, 3), 0.37), bounces=64)
    for degrees in (0, 30, 60, 85):
        np.testing.assert_allclose(
            look(world, (-2 * np.tan(np.radians(degrees)), 0.1, 2), tilted(degrees)), 0.37, rtol=2e-3
        )


@pytest.mark.parametrize("degrees", [0, 40, 70])
def test_a_pane_lets_through_what_all_inner_reflections_add_up_to(degrees: float) -> None:
    """(1 − F)/(1 + F) of what lies beyond, and 2F/(1 + F) of what lies before it."""
    beyond = Part(Rectangle((-80, 80, -1), (160, 0, 0), (0, -160, 0)), GRAY)
    sky = np.zeros((64, 8, 3))
    sky[:32] = 0.25
    world = World([*pane(), beyond], sky, bounces=40)
    world.set_textures([NO_PICTURE, NO_PICTURE, np.ones((2, 2, 3))])
    share = float(fresnel(np.array([np.cos(np.radians(degrees))]), np.array([1 / 1.5]))[0])
    expected = ((1 - share) * 1.0 + 2 * share * 0.25) / (1 + share)
    np.testing.assert_allclose(look(world, (0, 0, 1), tilted(degrees)), expected, rtol=1e-3)


@pytest.mark.parametrize("degrees", [20.0, 50.0])
def test_a_pane_shifts_what_is_seen_through_it(degrees: float) -> None:
    """By t·sin θ·(1 − cos θ / √(n² − sin² θ)) across the ray: a lamp shows where that says, and not beside it."""
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    across = PANE * sine * (1 - cosine / np.sqrt(1.5**2 - sine**2))
    straight = 2 * np.tan(np.radians(degrees))  # from z = 1 down to z = −1
    place = straight - across / cosine
    for offset, bright in ((0.0, True), (0.03, False), (-0.03, False)):
        lamp = Part(Rectangle((place + offset - 0.01, 0.01, -1), (0.02, 0, 0), (0, -0.02, 0)), GRAY)
        world = World([*pane(), lamp], BLACK, bounces=8)
        world.set_textures([NO_PICTURE, NO_PICTURE, np.ones((2, 2, 3))])
        assert (look(world, (0, 0, 1), tilted(degrees))[0] > 0.8) == bright


def test_a_ball_turns_a_ray_by_twice_the_difference_of_its_angles() -> None:
    """A ray at height h enters at sin θ₁ = h, sin θ₂ = h/n, and leaves turned by 2(θ₁ − θ₂), as a ball lens does."""
    for height in (0.2, 0.5, 0.8):
        turn = 2 * (np.arcsin(height) - np.arcsin(height / 1.5))
        sky = np.zeros((720, 4, 3))  # a row is a quarter of a degree of colatitude
        # it travels along +x at z = height and is turned down
        row = int((90 + np.degrees(turn)) * 4)
        sky[row - 3 : row + 4] = 1.0
        world = World([Part(Sphere((0, 0, 0), 1.0), NO_PICTURE, ior=1.5)], sky, bounces=4)
        assert look(world, (-3, 0, height), np.array([1.0, 0, 0]))[0] > 0.75
        sky[row - 3 : row + 4] = 0.0
        assert look(World(world.parts, sky, 4), (-3, 0, height), np.array([1.0, 0, 0]))[0] == 0


def test_light_falls_through_glass_when_it_is_baked() -> None:
    sky = np.full((4, 8, 3), 0.8)
    floor = Part(Rectangle((-1, 1, -0.5), (2, 0, 0), (0, -2, 0)), np.full((9, 9, 3), 0.4))
    world = World([*pane(), floor], sky)
    lighting.bake(world, np.random.default_rng(0))
    np.testing.assert_allclose(world.textures[2], 0.4 * 0.8, rtol=0.01)
    assert (world.textures[0] == 0).all()


def test_glass_is_a_region_of_its_own() -> None:
    mirror = Part(Sphere((1.2, 0, 0), 0.5), GRAY, reflectance=0.5)
    glass = Part(Sphere((-1.2, 0, 0), 0.5), NO_PICTURE, ior=1.5)
    found = geometry(World([mirror, glass], BLACK), camera_at((0, -4, 0))).regions
    assert 20 < found["transmissive"].sum() < found["reflective"].sum()
    assert not (found["transmissive"] & ~found["reflective"]).any()
    x = np.arange(40)[found["transmissive"].any(0)]
    assert x.max() < 20  # the left of the picture
