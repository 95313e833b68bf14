"""Ref-GS and Ref-DGS: a pixel's equation, when and where it mirrors, gradients, and what is stored and learned."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import torch
from finite_differences import assert_gradients_are_differences, mean_of_picture
from mirror_ball import gain_of_training, mirror_ball
from rules import with_rules
from schedules import begin, due, steps_of_events
from torch.nn import functional

from envgs_bench.core import Scene, rasterize
from envgs_bench.core.ssim import ssim
from envgs_bench.datasets.formats import srgb
from envgs_bench.methods.lighting.latlong import all_levels, looked_up
from envgs_bench.methods.lighting.shading import to_linear, to_srgb
from envgs_bench.methods.ref_gs import RefGS
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.storage.layouts import LAYOUTS
from envgs_bench.testing import tiny_scene

CAMERA = tiny_scene().test[0].camera
NEAR: dict[str, Any] = {"near_set": True}
DGS: dict[str, Any] = {"recipe": "ref_dgs", "near_set": True}
OURS: dict[str, Any] = {"shown_first": "albedo", "mirror_alpha": "learned"}  # what tuned methods have


def initialized(scene: Scene | None = None, steps: int = 30_000, **settings: Any) -> RefGS:
    method = create_method("ref_gs", with_rules(**{"map_levels": 3, **settings}))
    assert isinstance(method, RefGS)
    method.initialize(scene or tiny_scene(), steps)
    return method


def at_random(**settings: Any) -> RefGS:
    """A method that mirrors, whatever it learned drawn at random."""
    method = initialized(**settings)
    generator = torch.Generator().manual_seed(2)
    for trained in method.model.sets.values():
        for name in {"roughness_logits", "feature_logits"} & set(trained.parameters.tensors):
            trained.parameters.replace(name, torch.randn(trained.parameters.tensors[name].shape, generator=generator))
    with torch.no_grad():
        method.light.tensors["map"].normal_(generator=generator)
    begin(method, 5_000)
    return method


def test_srgb_is_what_photographs_are_decoded_by() -> None:
    values = torch.linspace(0, 1, 257, dtype=torch.float64)
    torch.testing.assert_close(to_linear(values), torch.from_numpy(srgb.to_linear(values.numpy())))
    torch.testing.assert_close(to_srgb(values), torch.from_numpy(srgb.to_srgb(values.numpy())))


@pytest.mark.parametrize("near", [{}, NEAR])
@pytest.mark.parametrize("rules", [{}, OURS])
def test_a_pixel_is_its_albedo_and_what_the_network_makes_of_the_map(
    near: dict[str, Any], rules: dict[str, Any]
) -> None:
    method = at_random(**near, **rules)
    with torch.no_grad():
        method.light.tensors["layer2_bias"] += 0 if rules else 1.4
    shown, drawn = method.render(CAMERA), method.model.rasterize(CAMERA, None)
    solid = drawn.alpha > 0.05
    alpha = drawn.alpha[solid][:, None]
    material = drawn.extras[solid] / (alpha if rules else 1)
    rays, normal = (functional.normalize(v[solid], dim=-1) for v in (CAMERA.rays()[1], drawn.normal))
    cosine = -(rays * normal).sum(-1, keepdim=True)
    levels = all_levels(method.light.tensors["map"].detach())
    far = looked_up(levels, rays + 2 * cosine * normal, material[:, 0], 3)
    if near:
        second = method.model.gaussians("env", None)
        features = method.model.sets["env"].parameters.detached()["feature_logits"].tanh()
        apart = rasterize(
            second.__class__(**{**vars(second), "extras": features}), CAMERA, near=method.model.near
        ).extras[solid]
        known = torch.cat([far, apart, material[:, :1], cosine], dim=1)
    else:
        known = torch.cat([torch.einsum("ni,nj->nij", functional.normalize(material[:, 4:]), far).flatten(1), far], 1)
    w, layer = method.light.tensors, known
    for number in range(3):
        layer = layer @ w[f"layer{number}_weight"].T + w[f"layer{number}_bias"]
        layer = layer.clamp_min(0) if number < 2 else layer.clamp_max(5).exp()
    light = (material[:, 1:4] + layer).detach()
    expected = alpha * torch.from_numpy(srgb.to_srgb(light.clamp_max(1).numpy())).float()
    compared = (light <= 1) | (not rules)  # brighter light is cut by the published rules alone
    assert 0.1 < (light <= 1).float().mean() < 1
    torch.testing.assert_close(shown.color[solid][compared], expected[compared], atol=2e-4, rtol=1e-4)


def test_it_mirrors_after_the_first_steps_and_in_the_ball_alone() -> None:
    method = initialized(scope_radius=0.4, **OURS)
    for step, begun in ((700, False), (701, True)):
        begin(method, step)
        assert method.light.begun == begun
    with torch.no_grad():
        method.light.tensors["layer2_bias"] += 3
    before = method.model.rasterize(CAMERA, 701).color
    shown, _ = method.draw(CAMERA, 701)
    inside = method.surfaces.scope.inside(shown, CAMERA)[..., 0]
    assert 0 < inside.float().mean() < 1
    assert torch.equal(shown.color[~inside], before[~inside])
    assert (shown.color[inside] > before[inside]).float().mean() > 0.9


def test_albedos_begin_as_the_points_colors_or_dark() -> None:
    begun = []
    for rules in (OURS, {}):
        method = initialized(**rules)
        begun.append(method.surfaces.shaded(method.model.gaussians("base", 1), CAMERA, 1).extras[:, 1:4].detach())
    torch.testing.assert_close(to_srgb(begun[0]), tiny_scene().point_colors, atol=3e-3, rtol=0)
    torch.testing.assert_close(begun[1], torch.full_like(begun[1], math.exp(-2) / 5))


def test_surfels_begin_at_a_tenth_of_their_neighbors_squared_distance() -> None:
    points = tiny_scene().points
    squared = torch.cdist(points, points).square().topk(4, largest=False).values[:, 1:].mean(1)
    scales = initialized().model.gaussians("base", 1).scales.detach()
    torch.testing.assert_close(scales.square(), (0.1 * squared)[:, None].repeat(1, 2), rtol=1e-3, atol=0)


def test_to_step_700_spherical_harmonics_are_learned_alone() -> None:
    method, view = initialized(scope_radius=0.4), tiny_scene().train[0]
    begin(method, 700)
    shown, _ = method.draw(view.camera, 700)
    plain = method.model.rasterize(view.camera, 700)
    assert torch.equal(shown.color, plain.color)
    assert set(method.losses(shown, view.rgb(), view, 700)) == {"rgb"}
    begin(method, 701)
    shown, _ = method.draw(view.camera, 701)
    assert set(method.losses(shown, view.rgb(), view, 701)) == {"rgb", "normal", "plain", "entropy"}


def test_what_weighs_a_mirroring_pixel_has_no_gradient() -> None:
    """Opacities are learned by what is blended, as if alpha was the number that it is."""
    method, step = at_random(), 5_000
    logits = method.model.sets["base"].parameters.tensors["opacity_logits"]
    weights = torch.rand(CAMERA.height, CAMERA.width, 3, generator=torch.Generator().manual_seed(4))
    kept = method.model.rasterize(CAMERA, step).alpha.detach()[..., None]

    def loss() -> torch.Tensor:
        base = method.model.rasterize(CAMERA, step)
        roughness, albedo, features = base.extras.split([1, 3, 4], dim=-1)
        light = albedo + method.light.seen(base, CAMERA, step, roughness, features)
        return (weights * kept * to_srgb(light.clamp_max(1))).double().mean()

    (method.draw(CAMERA, step)[0].color * weights).mean().backward()
    gradient = logits.grad
    assert gradient is not None
    move = 2e-3 * gradient / gradient.norm()  # farther, some would come to show that do not
    with torch.no_grad():
        logits += move
        above = loss()
        logits -= 2 * move
        below = loss()
    assert float(above - below) / 4e-3 == pytest.approx(float(gradient.norm()), rel=0.04)


def test_what_does_not_mirror_is_compared_by_itself_too() -> None:
    """Weighed by its alpha, by 0.8·L1 + 0.2·(1 − SSIM)."""
    method, view = initialized(scope_radius=0.4), tiny_scene().train[0]
    begin(method, 701)
    shown, _ = method.draw(view.camera, 701)
    plain = method.model.rasterize(view.camera, 701)
    outside = plain.alpha[..., None].detach() * ~method.surfaces.scope.inside(plain, view.camera)
    assert 0 < (outside > 0).float().mean() < 1
    image, target = (each * outside for each in (plain.color, view.rgb()))
    expected = 0.8 * (image - target).abs().mean() + 0.2 * (1 - ssim(image, target))
    assert method.losses(shown, view.rgb(), view, 701)["plain"].item() == pytest.approx(expected.item(), rel=1e-5)


def test_the_entropy_is_that_of_opacities_in_view() -> None:
    method, view = initialized(), tiny_scene().train[0]
    parameters = method.model.sets["base"].parameters
    logits = 3 * torch.randn(len(parameters), generator=torch.Generator().manual_seed(3))
    parameters.replace("opacity_logits", logits)
    behind = torch.arange(len(logits)) % 3 == 0
    means, camera = parameters.tensors["means"].detach().clone(), view.camera
    means[behind] = camera.center - 5 * camera.world_to_camera[2, :3]
    means[~behind] = camera.center + 5 * camera.world_to_camera[2, :3]
    parameters.replace("means", means)
    begin(method, 701)
    shown, _ = method.draw(camera, 701)
    expected = torch.distributions.Bernoulli(logits=logits[~behind]).entropy().mean()
    term = method.losses(shown, view.rgb(), view, 701)["entropy"]
    assert term.item() == pytest.approx(1e-3 * float(expected), rel=1e-4)


def test_what_is_near_begins_at_the_points_as_the_base_does() -> None:
    """By Ref-DGS's code on captures: as many surfels, as large, and turned by numbers between 0 and 1."""
    sets = {name: each.parameters.detached() for name, each in initialized(**DGS).model.sets.items()}
    for name in ("means", "log_scales", "opacity_logits"):
        torch.testing.assert_close(sets["env"][name], sets["base"][name])
    assert sets["env"]["quaternions"].min() >= 0


def test_its_network_has_three_hidden_layers() -> None:
    tensors = initialized(**DGS).light.tensors
    shapes = [tuple(tensors[f"layer{number}_weight"].shape) for number in range(4)]
    assert shapes == [(64, 10), (64, 64), (64, 64), (3, 64)]
    torch.testing.assert_close(tensors["layer3_bias"].exp(), torch.full((3,), 0.25))
    assert "layer3_weight" not in initialized(**NEAR).light.tensors


def test_what_a_pixel_does_not_mirror_of_it_is_spherical_harmonics() -> None:
    """Where a pixel mirrors by its alpha a, by Ref-DGS's code: a·mirrored + (1 − a)·SH, and 1 − a in their own loss."""
    method, view, step = at_random(**DGS, scope_radius=0.4), tiny_scene().train[0], 5_000
    shown, _ = method.draw(view.camera, step)
    base = method.model.rasterize(view.camera, step)
    own = method.model.rasterize(view.camera, step, method.surfaces.near(step)).extras
    light = base.extras[..., 1:] + method.light.seen(base, view.camera, step, base.extras[..., :1], own)
    share = base.alpha[..., None].detach() * method.surfaces.scope.inside(base, view.camera)
    assert ((share > 0.1) & (share < 0.9)).any()
    expected = share * to_srgb(light.clamp_max(1)) + (1 - share) * base.color
    torch.testing.assert_close(shown.color, expected)
    image, target = (each * (1 - share) for each in (base.color, view.rgb()))
    plain = 0.8 * (image - target).abs().mean() + 0.2 * (1 - ssim(image, target))
    assert method.losses(shown, view.rgb(), view, step)["plain"].item() == pytest.approx(plain.item(), rel=1e-5)


def test_what_is_near_grows_from_its_first_hundredth_step_on() -> None:
    """Of a run of 25,000; both sets to step 10,000."""
    method = initialized(**DGS, densify_until=10_000, steps=25_000)
    found = steps_of_events(method, 25_000)
    assert found["densify_base"] == [*range(600, 10_000, 100)]
    assert found["densify_env"] == [*range(800, 10_000, 100)]
    assert found["reset_base_opacity"] == found["reset_env_opacity"] == [3_000, 6_000, 9_000]
    assert "densify_env" not in due(initialized(**NEAR, growth="guided", max_primitives=1_000), 800)


def test_what_is_near_counts_as_seen_wherever_it_is_in_view() -> None:
    """By Ref-DGS's code: drawn or not."""
    method, view = at_random(**DGS), tiny_scene().train[0]
    parameters, camera = method.model.sets["env"].parameters, view.camera
    ahead = camera.world_to_camera[2, :3]
    distances = torch.linspace(3, 20, len(parameters))
    distances[::3] = -5
    parameters.replace("means", camera.center + distances[:, None] * ahead)
    faint = torch.arange(len(parameters)) % 3 == 1
    parameters.replace("opacity_logits", torch.where(faint, -9.0, 2.0))
    method.training_step(view, 5_001)
    record = method.model.sets["env"].record
    assert torch.equal(record.steps > 0, distances > method.model.near)
    assert (record.weights[faint] == 0).all()


@pytest.mark.parametrize("settings", [{}, NEAR])
def test_gradients_are_those_of_finite_differences(settings: dict[str, Any]) -> None:
    method = at_random(**settings)
    base = method.model.sets["base"].parameters.tensors
    inputs = dict(method.light.tensors) | {name: base[name] for name in ("albedo_logs",)}
    second = method.model.sets["env" if settings else "base"].parameters.tensors
    inputs["features"] = second["feature_logits"]
    assert_gradients_are_differences(mean_of_picture(method, CAMERA), inputs, by=2e-2)


@pytest.mark.parametrize("layout", ["ply", "compact"])
def test_a_stored_model_keeps_its_materials(layout: str, tmp_path: Path) -> None:
    method = at_random(**NEAR)
    before = method.render(CAMERA)
    LAYOUTS[layout].write(method, tmp_path)
    if layout == "ply":
        assert set(LAYOUTS[layout].lacks(method)) == set(method.light.tensors)
    method.restore(LAYOUTS[layout].read(method, tmp_path))
    method.prepare()
    assert (before.color - method.render(CAMERA).color).abs().mean() < (1e-7 if layout == "ply" else 2e-2)


@pytest.mark.slow
@pytest.mark.parametrize("near", [False, True])
def test_a_mirror_ball_is_learned(near: bool) -> None:
    """By 1 dB more than by surfels that mirror nothing."""
    scene = mirror_ball()
    still = {"densify_until": 0, "opacity_reset_every": 0, "mono_weight": 0.05, "initial_orientation": "surface"}
    mirrors, plain = (
        gain_of_training(initialized(scene, 300, map_levels=5, near_set=near, warm_up=start, **still), scene, 300)
        for start in (0, 30_000)
    )
    assert mirrors > plain + 1
