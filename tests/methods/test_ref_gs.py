"""Ref-GS and Ref-DGS: a pixel's equation, when and where it mirrors, gradients, and what is stored and learned."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from finite_differences import assert_gradients_are_differences, mean_of_picture
from mirror_ball import gain_of_training, mirror_ball
from rules import with_rules
from schedules import begin
from torch.nn import functional

from envgs_bench.core import Scene, rasterize
from envgs_bench.datasets.formats import srgb
from envgs_bench.methods.lighting.latlong import all_levels, looked_up
from envgs_bench.methods.lighting.shading import to_linear, to_srgb
from envgs_bench.methods.ref_gs import RefGS
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.storage.layouts import LAYOUTS
from envgs_bench.testing import tiny_scene

CAMERA = tiny_scene().test[0].camera
NEAR: dict[str, Any] = {"near_count": 60}


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


@pytest.mark.parametrize("near", [False, True])
def test_a_pixel_is_its_albedo_and_what_the_network_makes_of_the_map(near: bool) -> None:
    method = at_random(**(NEAR if near else {}))
    shown, drawn = method.render(CAMERA), method.model.rasterize(CAMERA, None)
    solid = drawn.alpha > 0.05
    alpha = drawn.alpha[solid][:, None]
    material = drawn.extras[solid] / alpha
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
    expected = alpha * torch.from_numpy(srgb.to_srgb((material[:, 1:4] + layer).detach().numpy())).float()
    torch.testing.assert_close(shown.color[solid], expected, atol=2e-4, rtol=1e-4)


def test_it_mirrors_after_the_first_steps_and_in_the_ball_alone() -> None:
    method = initialized(scope_radius=0.4)
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


def test_albedos_begin_as_the_points_colors() -> None:
    method = initialized()
    albedo = method.surfaces.shaded(method.model.gaussians("base", 1), CAMERA, 1).extras[:, 1:4]
    torch.testing.assert_close(to_srgb(albedo), tiny_scene().point_colors, atol=3e-3, rtol=0)


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
@pytest.mark.parametrize("near", [0, 200])
def test_a_mirror_ball_is_learned(near: int) -> None:
    """By 1 dB more than by surfels that mirror nothing."""
    scene = mirror_ball()
    still = {"densify_until": 0, "opacity_reset_every": 0, "mono_weight": 0.05, "initial_orientation": "surface"}
    mirrors, plain = (
        gain_of_training(initialized(scene, 300, map_levels=5, near_count=near, warm_up=start, **still), scene, 300)
        for start in (0, 30_000)
    )
    assert mirrors > plain + 1
