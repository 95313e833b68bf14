"""Planes: found where mirrors are, shown by the equation, aligned with photographs, and no change without any."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from finite_differences import assert_gradients_are_differences
from mirror_ball import gain_of_training
from mirror_room import MIRROR, mirror_room, wall_color, walls

from envgs_bench.core import Camera, GaussianSet, Scene, View
from envgs_bench.core.normal_prior import NormalPrior
from envgs_bench.core.vectors import rotated, unit
from envgs_bench.methods.envgs import PLANES, EnvGS
from envgs_bench.methods.lighting.plane_alignment import Aligned, aligned
from envgs_bench.methods.lighting.plane_proposals import Rectangle, inside_of, proposed
from envgs_bench.methods.lighting.planes import Planes, behind
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.training import seen_through_pilot
from envgs_bench.methods.training.pilot_run import SHORTEST_RUN
from envgs_bench.methods.training.seen_through_pilot import CELLS
from envgs_bench.stages.execution import given_of
from envgs_bench.testing import check_method, tiny_scene

PANE = Rectangle(
    torch.tensor([0.0, 0, 0.1]), torch.tensor([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]), torch.tensor([0.8, 0.5])
)
BALL = torch.tensor([0.6, 1.3, 0.2])  # of radius 0.5

SMALL: dict[str, Any] = {"env_grid": 2, "env_far_count": 50}


def made(**settings: Any) -> EnvGS:
    method = create_method("envgs", {**SMALL, "planes": "masks", **settings})
    assert isinstance(method, EnvGS)
    return method


def planes_of(method: EnvGS) -> Planes:
    planes = method.parts[PLANES]
    assert isinstance(planes, Planes)
    return planes


def wall_set(count: int = 48) -> GaussianSet:
    """The cube's walls as opaque surfels, a lattice a wall."""
    places = 2 * ((torch.arange(count) + 0.5) / count * 2 - 1)
    u, v = (each.flatten() for each in torch.meshgrid(places, places, indexing="ij"))
    means, quaternions = [], []
    turns = {0: [0.5**0.5, 0, 0.5**0.5, 0], 1: [0.5**0.5, -(0.5**0.5), 0, 0], 2: [1.0, 0, 0, 0]}
    for axis in range(3):
        for side in (-2.0, 2.0):
            wall = torch.full((len(u), 3), side)
            wall[:, [each for each in range(3) if each != axis]] = torch.stack([u, v], dim=1)
            means.append(wall)
            quaternions.append(torch.tensor(turns[axis]).expand(len(u), 4))
    means = torch.cat(means)
    sh = ((wall_color(means) - 0.5) / 0.28209479)[:, None]
    scales = torch.full((len(means), 2), 0.6 * 4 / count)
    return GaussianSet(means, torch.cat(quaternions), scales, torch.full((len(means),), 0.99), sh)


def with_walls(method: EnvGS) -> None:
    """Let the method's base set be the cube's walls."""
    walls_ = wall_set()
    policy = method.model.policies["base"]
    tensors = method.model.new_set("base", walls_.means, torch.zeros(len(walls_), 3)).parameters.detached()
    rest = torch.zeros_like(tensors["sh_rest"])
    logits = torch.full((len(walls_),), 4.6)
    own = {"quaternions": walls_.quaternions, "log_scales": walls_.scales.log(), "sh_dc": walls_.sh, "sh_rest": rest}
    method.model.sets["base"] = method.model.set_of("base", tensors | own | {"opacity_logits": logits})
    assert policy.start.beta is not None


def test_a_mirror_is_proposed_where_it_is() -> None:
    (found,) = proposed(mirror_room(), "masks")
    assert float(found.axes[2] @ MIRROR.axes[2]) > 0.999
    assert abs(float((found.center - MIRROR.center) @ MIRROR.axes[2])) < 0.05
    torch.testing.assert_close(found.center, MIRROR.center, atol=0.06, rtol=0)
    torch.testing.assert_close(found.half.sort().values, MIRROR.half.sort().values, atol=0.08, rtol=0)


def panes(*upright: Rectangle, count: int = 24, size: int = 64) -> Scene:
    """Upright panes, and a ball beside them, from cameras all around; marks and normals in closed form."""
    views = []
    for index in range(count):
        angle = torch.tensor(2 * torch.pi * index / count)
        center = torch.stack([3 * angle.cos(), 3 * angle.sin(), torch.tensor(0.4)])
        forward = -unit(center)
        right = unit(torch.linalg.cross(forward, torch.tensor([0.0, 0, 1])))
        pose = torch.eye(4)
        pose[:3, :3] = torch.stack([right, torch.linalg.cross(forward, right), forward])
        pose[:3, 3] = -pose[:3, :3] @ center
        camera = Camera(pose, torch.tensor([[60.0, 0, size / 2], [0, 60, size / 2], [0, 0, 1]]), size, size)
        origins, rays = camera.rays()
        rays = unit(rays)
        met = [inside_of(pane, origins, rays, 1e-6) for pane in upright]
        far, first = torch.stack([torch.where(within > 0, far, torch.inf) for within, far in met]).min(0)
        facing = torch.stack([pane.axes[2] for pane in upright])[first]
        away = center - BALL
        middle = -(rays @ away)
        half = middle.square() - away @ away + 0.25
        near = middle - half.clamp_min(0).sqrt()
        ball, pane = (half > 0) & ~(far < near), far.isfinite()
        toward = -facing * (rays * facing).sum(-1, keepdim=True).sign()
        normal = torch.where(pane[..., None], toward, 0.0)
        normal = torch.where(ball[..., None], (away + near[..., None] * rays) / 0.5, normal)
        image = torch.zeros(size, size, 3, dtype=torch.uint8)
        views.append(View(f"view{index}", camera, image, {"transmissive": pane | ball}, normal))
    return Scene("panes", views, views[:1], torch.zeros(1, 3), torch.zeros(1, 3))


def test_a_pane_is_proposed_that_cameras_stand_around_and_a_ball_is_none() -> None:
    """Once, though its two sides have opposite normals and are seen by other views."""
    (found,) = proposed(panes(PANE), "masks")
    assert abs(float(found.axes[2] @ PANE.axes[2])) > 0.999
    torch.testing.assert_close(found.center, PANE.center, atol=0.08, rtol=0)
    torch.testing.assert_close(found.half.sort().values, PANE.half.sort().values, atol=0.1, rtol=0)


def test_panes_before_and_behind_the_middle_are_proposed_where_they_are() -> None:
    """Close to the cameras two views have hardly anything in common, but that agrees: no plane is to be there."""
    both = [replace(PANE, center=torch.tensor([x, 0, 0.1]), half=torch.tensor([0.7, 0.6])) for x in (1.2, -1.2)]
    found = sorted(proposed(panes(*both), "masks"), key=lambda each: -float(each.center[0]))
    assert len(found) == 2
    for each, pane in zip(found, both, strict=True):
        torch.testing.assert_close(each.center, pane.center, atol=0.08, rtol=0)
        torch.testing.assert_close(each.half.sort().values, pane.half.sort().values, atol=0.08, rtol=0)


def test_a_run_says_that_a_method_was_given_masks_where_there_are_any() -> None:
    assert given_of(mirror_room(), made()) == ["normals", "masks of mirrors and glass"]
    assert given_of(tiny_scene(), made()) == ["normals"]
    assert given_of(mirror_room(), made(planes="photographs", mono_weight=0.0)) == []
    assert given_of(tiny_scene(), create_method("ref_gs", {"scope_radius": 0.5})) == ["a ball that may reflect"]


def test_nothing_is_proposed_where_nothing_is_flat_or_marked() -> None:
    assert proposed(mirror_room(reflectance=0), "masks") == []
    assert proposed(mirror_room(), "photographs") == []  # nobody has said where something lies behind
    assert proposed(tiny_scene(), "masks") == []


def test_what_a_plane_hides_lies_behind_its_rectangle() -> None:
    center = torch.tensor([0.1, -0.5, -0.1])
    points = torch.tensor([[0.1, 1.9, -0.1], [0.1, 1.2, -0.1], [1.9, 1.9, -0.1], [0.1, 1.49, -0.1], [0.1, -2, 0]])
    assert behind(points, center, [MIRROR], 0.0).tolist() == [True, False, False, False, False]
    assert behind(points, center, [MIRROR], 0.05).tolist() == [True, False, False, True, False]


@pytest.mark.parametrize("reflectance", [0.2, 0.9])
def test_a_pixel_mirrors_what_schlick_lets_it(reflectance: float) -> None:
    scene = mirror_room()
    method = made()
    method.initialize(scene, 30_000)
    with_walls(method)
    planes = planes_of(method)
    planes._become([MIRROR], [reflectance])
    planes.begun = True
    camera = scene.test[1].camera
    method.model.prepare()
    planes.prepare()
    with torch.no_grad():
        before = method.model.rasterize(camera, None)
        shown = planes.over(before, camera, None).color
    origins, rays = camera.rays()
    rays = unit(rays)
    within = inside_of(MIRROR, origins, rays, 1e-6)[0] > 0
    cosine = (rays @ MIRROR.axes[2]).abs()
    weight = (reflectance + (1 - reflectance) * (1 - cosine) ** 5)[..., None]
    true = scene.test[1].rgb()
    expected = torch.where(within[..., None], (1 - weight) * before.color + weight * true, before.color)
    error = (shown - expected).abs().mean(-1)
    assert error[within].mean() < 0.03  # surfels show walls so well
    assert error[~within].mean() < 3e-3


def test_two_mirrors_show_each_other() -> None:
    """Between facing mirrors of the whole room, three bounces along the cube's axis show the wall beside them."""
    scene = mirror_room()
    method = made()
    method.initialize(scene, 30_000)
    with_walls(method)
    planes = planes_of(method)
    facing = Rectangle(
        MIRROR.center * torch.tensor([1.0, -1, 1]), rotated(MIRROR.axes, torch.tensor([[torch.pi, 0, 0]])), MIRROR.half
    )
    planes._become([MIRROR, facing], [0.999, 0.999])
    planes.begun = True
    method.model.prepare()
    planes.prepare()
    origins, rays = torch.tensor([[[0.1, 0.0, -0.1]]]), unit(torch.tensor([[[0.08, 1.0, 0.0]]]))
    base = method.model.gaussians("base", None)
    with torch.no_grad():
        _, points, mirrored = planes._met(planes.rectangles(), origins, rays)
        seen = planes._seen(base, planes._bvh, planes.rectangles(), points, mirrored, 3)[0, 0]
    place, ray = origins[0, 0], rays[0, 0]
    bounces = 0
    while bounces < 3:
        met = [(inside_of(each, place, ray, 1e-6), each) for each in (MIRROR, facing)]
        hits = [(float(d), each) for (w, d), each in met if w > 0 and d > 1e-3]
        if not hits:
            break
        distance, each = min(hits, key=lambda hit: hit[0])
        place = place + distance * ray
        ray = ray - 2 * (ray @ each.axes[2]) * each.axes[2]
        bounces += 1
    assert bounces >= 2
    expected = wall_color(place + walls(place, ray)[0] * ray)
    torch.testing.assert_close(seen, expected, atol=0.08, rtol=0)


def test_a_plane_beside_its_place_is_moved_and_turned_to_what_photographs_show() -> None:
    scene = mirror_room()
    method = made()
    method.initialize(scene, 30_000)
    with_walls(method)
    turned = rotated(MIRROR.axes, torch.tensor([[0.02, 0, 0.03]]))
    off = Rectangle(MIRROR.center + 0.06 * MIRROR.axes[2], turned, MIRROR.half)
    (found,) = aligned(method.model.gaussians("base", 1), [Aligned(off, 0.1)], scene.train, method.model, 0.04)
    assert found.reflectance > 0.8
    assert float((found.rectangle.axes[2] * MIRROR.axes[2]).sum().acos().rad2deg()) < 0.4
    assert abs(float((found.rectangle.center - MIRROR.center) @ MIRROR.axes[2])) < 0.03


@pytest.mark.parametrize(("by", "kept"), [("masks", 2), ("photographs", 1)])
def test_what_photographs_took_for_a_plane_and_nothing_mirrors_goes(by: str, kept: int) -> None:
    """A wall, beside a mirror: masks may mean glass by it, photographs alone do not."""
    scene, method = mirror_room(), made(planes=by)
    method.initialize(scene, 30_000)
    with_walls(method)
    planes = planes_of(method)
    wall = Rectangle(torch.tensor([0.0, 0, -1.9]), torch.eye(3), torch.ones(2))
    planes._become([MIRROR, wall])
    planes.begun = True
    planes.begin_step(6_100)
    assert planes.settled
    assert len(planes.frames) == kept
    if by == "photographs":
        planes._become([wall])
        planes.settled = False
        planes.begin_step(6_200)
        assert not len(planes.frames)
        method.model.prepare()
        drawn = method.model.rasterize(scene.test[0].camera, None)
        assert planes.over(drawn, scene.test[0].camera, None) is drawn
        assert planes.optimizers() == ()


def test_gradients_of_a_plane_are_finite_differences() -> None:
    scene = mirror_room()
    method = made(warm_up=0, rules={"average_from": 0})
    method.initialize(scene, 30_000)
    with_walls(method)
    planes = planes_of(method)
    planes._become([MIRROR], [0.7])
    planes.begun = True
    camera = scene.train[3].camera
    weights = torch.rand(40, 40, 3, generator=torch.Generator().manual_seed(4))
    base = method.model.rasterize(camera, 10_000)
    picture = replace(base, color=base.color.detach())

    def loss() -> torch.Tensor:
        return (planes.over(picture, camera, 10_000).color * weights).mean()

    weights_of = planes.weights.tensors
    moved = {name: weights_of[name] for name in ("plane_centers", "plane_turns")}
    of_edges = 0.25  # which a picture has
    assert_gradients_are_differences(loss, {"reflectances": weights_of["plane_reflectances"]}, by=1e-2, rel=of_edges)
    assert_gradients_are_differences(loss, moved, by=2e-3, rel=of_edges)


def test_nothing_changes_where_there_are_none() -> None:
    """To the last bit, of a scene without marks."""
    pictures = []
    for planes in ("none", "masks"):
        method = made(planes=planes, warm_up=0)
        scene = tiny_scene()
        method.initialize(scene, 30)
        for step in range(1, 31):
            method.training_step(scene.train[step % len(scene.train)], step)
        pictures.append(method.render(scene.test[0].camera).color)
    assert torch.equal(*pictures)


def test_a_method_with_planes_conforms(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = mirror_room(views=8, size=32)
    monkeypatch.setattr("envgs_bench.testing.tiny_scene", lambda: scene)
    monkeypatch.setattr("envgs_bench.methods.lighting.planes.DETACHED", 0)
    check_method("envgs", {**SMALL, "planes": "masks"}, steps=10)


def test_what_lies_behind_a_mirror_becomes_transparent() -> None:
    scene = mirror_room()
    method = made()
    method.initialize(scene, 30_000)
    planes = planes_of(method)
    planes._become([MIRROR], [0.9])
    planes.begun = True
    planes.clear(4_000)
    logits = method.model.sets["base"].parameters.detached()["opacity_logits"]
    means = method.model.sets["base"].parameters.detached()["means"]
    cleared = logits.sigmoid() < 0.03
    assert cleared.any()
    assert (means[cleared][:, 1] > 1.5).all()


@pytest.mark.slow
def test_a_mirror_is_learned_better_with_its_plane() -> None:
    scene = mirror_room()
    still = {"densify_until": 0, "opacity_reset_every": 0, "reflection_pilot": False}
    gains = []
    for planes in ("none", "masks"):
        method = made(planes=planes, **still)
        method.initialize(scene, 150)
        gains.append(gain_of_training(method, scene, 150))
    assert gains[1] > gains[0] + 1


def test_no_normals_are_learned_of_glass_that_masks_name() -> None:
    """What shows there lies behind them; by photographs nobody has said so, and a pilot run says it itself."""
    scene = mirror_room()
    glass = [replace(view, masks={"transmissive": view.masks["reflective"]}) for view in scene.train]
    for by, left in (("masks", 0.0), ("photographs", 1.0)):
        method = made(planes=by)
        method.initialize(replace(scene, train=glass), 30)
        learned = method.runner.views.on_device(glass[3])
        mask = glass[3].masks["transmissive"]
        assert learned.normal is not None
        torch.testing.assert_close(learned.normal.norm(dim=-1), torch.where(mask, left, 1.0), atol=1e-3, rtol=0)
        assert any("transmissive" in note for note in method.notes) == (by == "masks")


def test_where_a_pilot_run_says_which_normals_are_learned_masks_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = mirror_room()
    glass = [replace(view, masks={"transmissive": view.masks["reflective"]}) for view in scene.train]
    upper = torch.arange(CELLS)[:, None].expand(CELLS, CELLS) < CELLS // 2
    cells = {view.name: upper for view in glass}
    monkeypatch.setattr(seen_through_pilot, "better_without", lambda *_: cells)
    prior = NormalPrior(lambda view: view, maybe_seen_through=cells)
    method = made(rules={"normals": "agreed"})
    method.initialize(replace(scene, train=glass, normals=prior), SHORTEST_RUN)
    learned = method.runner.views.on_device(glass[3])
    assert learned.normal is not None
    assert torch.equal(learned.normal.any(dim=-1), torch.arange(40)[:, None].expand(40, 40) >= 20)
    assert not any("transmissive" in note for note in method.notes)
