"""Ref-Gaussian: its stages, its equation pixel by pixel, gradients, and that materials are stored with their model."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch
from finite_differences import assert_gradients_are_differences, mean_of_picture
from mirror_ball import gain_of_training, mirror_ball
from rules import with_rules
from schedules import begin, steps_of_events
from torch.nn import functional

from envgs_bench.core import Scene
from envgs_bench.core.torch.sh import sh_basis
from envgs_bench.methods.lighting.brdf_table import specular_weight
from envgs_bench.methods.lighting.disturbance import beta_of
from envgs_bench.methods.lighting.prefiltered_cubemap import prefilter_of, rough_map
from envgs_bench.methods.ref_gaussian import MATERIALS, RefGaussian
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.storage.layouts import LAYOUTS
from envgs_bench.methods.training.losses import edge_aware_smoothness
from envgs_bench.testing import tiny_scene

RUN = 50_000
CAMERA = tiny_scene().test[0].camera


def initialized(scene: Scene | None = None, steps: int = RUN, **settings) -> RefGaussian:
    method = create_method("ref_gaussian", with_rules(**{"envmap_size": 8, **settings}))
    assert isinstance(method, RefGaussian)
    method.initialize(scene or tiny_scene(), steps)
    return method


def at_step(step: int, **settings) -> RefGaussian:
    """A method before a step of a run of 50,000, whatever else it learned drawn at random."""
    method = initialized(**settings)
    begin(method, step)
    generator = torch.Generator().manual_seed(2)
    parameters = method.model.sets["base"].parameters
    for name in ("beta_logits", *MATERIALS):
        parameters.replace(name, torch.randn(parameters.tensors[name].shape, generator=generator))
    method.reflection.light.become(torch.randn(6, 8, 8, 3, generator=generator))
    return method


def test_surfels_are_shaded_before_pixels_and_light_each_other_last() -> None:
    method = initialized()
    stages = []
    for step in (1, 18_000, 18_001, 20_000, 20_001):
        begin(method, step)
        stages.append((method.reflection.begun, method.surfaces.deferred, method.surfaces.occluders.traced))
    assert stages == [
        (True, False, False),
        (True, False, False),
        (True, True, False),
        (True, True, False),
        (True, True, True),
    ]


def test_materials_start_anew_when_pixels_are_shaded() -> None:
    method = at_step(1)
    parameters = method.model.sets["base"].parameters
    indirect = parameters.tensors["indirect_rest"].detach().clone()
    begin(method, 18_001)
    values = {name: parameters.tensors[name].detach().sigmoid() for name in ("roughness_logits", "albedo_logits")}
    torch.testing.assert_close(beta_of(method.model), torch.full((200,), 0.01))
    torch.testing.assert_close(values["roughness_logits"], torch.full((200, 1), 0.1))
    assert (values["albedo_logits"] - 0.5).abs().max() <= 0.025 + 1e-6
    assert (method.reflection.light.texels == 0).all()
    assert torch.equal(parameters.tensors["indirect_rest"], indirect)


def test_events_fall_on_the_released_steps() -> None:
    found = steps_of_events(initialized(), RUN)
    resets = list(range(3_000, 25_000, 3_000))
    assert found["reset_base_opacity"] == found["reset_beta"] == resets
    assert found["propagate"] == [step for step in range(1_000, 25_001, 1_000) if step % 3_000]
    recovering = {step for reset in resets for step in range(reset + 1, reset + 100)}
    assert set(found["densify_base"]) == set(range(1_000, 25_000, 500)) - recovering


def test_smooth_metal_grows_and_only_what_pixels_shade_is_sabotaged() -> None:
    method = at_step(1)
    parameters = method.model.sets["base"].parameters
    parameters.replace("beta_logits", torch.tensor([0.01, 0.03, 0.03, 0.01]).logit().repeat(50)[:, None])
    parameters.replace("roughness_logits", torch.tensor([0.005, 0.005, 0.02, 0.02]).logit().repeat(50)[:, None])
    assert method.surfaces.spreads().tolist() == [False, True, False, False] * 50
    assert not method.surfaces.is_sabotaged().any()
    method.surfaces.deferred = True
    assert method.surfaces.is_sabotaged().tolist() == [True, False, False, True] * 50


def test_nothing_is_sabotaged_where_surfels_are_never_shaded() -> None:
    """As in the authors' commands for captures."""
    method = at_step(18_001, shade_until=0)
    assert method.surfaces.deferred
    assert not method.surfaces.is_sabotaged().any()


def test_a_pixel_follows_the_split_sum() -> None:
    """Direct light only, against the equation written out with the maps that the core draws."""
    method = at_step(18_001)
    shown, drawn = method.render(CAMERA), method.model.rasterize(CAMERA, None)
    metallic, roughness, albedo, _ = drawn.extras.split([1, 1, 3, 3], dim=-1)
    rays, normal = functional.normalize(CAMERA.rays()[1], dim=-1), drawn.normal / drawn.alpha[..., None].clamp_min(1e-6)
    assert (normal.norm(dim=-1)[drawn.alpha > 0.05] < 0.9).any()
    cosine = -(rays * normal).sum(-1)
    outgoing = functional.normalize(rays + 2 * cosine[..., None] * normal, dim=-1)
    light = rough_map(method.reflection.light.texels.detach().sigmoid(), prefilter_of(8))
    seen = light.specular(outgoing.reshape(-1, 3), roughness.reshape(-1)).reshape(24, 32, 3)
    reflectance = 0.04 * (1 - metallic) + albedo * metallic
    weight = specular_weight(reflectance, cosine, roughness[..., 0])
    expected = (1 - metallic) * drawn.color + drawn.alpha[..., None] * weight * seen
    solid = (drawn.alpha > 0.05) & (drawn.normal.norm(dim=-1) > 0.02)
    assert solid.any()
    torch.testing.assert_close(shown.color[solid], expected[solid], atol=1e-4, rtol=0)


def test_what_hides_the_map_lights_in_its_place() -> None:
    """Two surfels: the map lights the mirror unless the other is in the way, and not too far off."""
    scene = tiny_scene()
    center = scene.test[0].camera.center
    toward = functional.normalize(center, dim=0)
    lone = Scene("lone", scene.train, scene.test, torch.zeros(2, 3), torch.full((2, 3), 0.5))
    colors = {}
    for where in (6.0, 9.0):
        method = initialized(lone, warm_up=0, shade_until=0, indirect_from=0)
        begin(method, 1)
        parameters = method.model.sets["base"].parameters
        behind = toward * where  # the camera, which is at 4: on the mirrored ray
        facing = torch.linalg.cross(torch.tensor([0.0, 0, 1]), toward)
        quaternion = functional.normalize(torch.cat([1 + toward[2:], facing]), dim=0)
        parameters.replace("means", torch.stack([torch.zeros(3), behind]))
        parameters.replace("quaternions", quaternion.repeat(2, 1))
        parameters.replace("log_scales", torch.tensor([[0.3, 0.3], [2.0, 2.0]]).log())
        parameters.replace("opacity_logits", torch.full((2,), 6.0))
        parameters.replace("beta_logits", torch.full((2, 1), 9.0))
        parameters.replace("albedo_logits", torch.full((2, 3), 9.0))
        parameters.replace("roughness_logits", torch.full((2, 1), -9.0))
        indirect = torch.tensor([[0.2, 0.0, 0.6]]) / float(sh_basis(toward, 0)[0])
        parameters.replace("indirect_dc", indirect.repeat(2, 1))
        method.reflection.light.become(torch.full((6, 8, 8, 3), 9.0))
        shown = method.render(scene.test[0].camera)
        row, column = divmod(int(shown.alpha.argmax()), CAMERA.width)
        colors[where] = (shown.color / shown.alpha[..., None].square())[row, column]
    torch.testing.assert_close(colors[9.0], torch.ones(3), atol=0.04, rtol=0)
    torch.testing.assert_close(colors[6.0], torch.tensor([0.2, 0.0, 0.6]), atol=0.04, rtol=0)


@pytest.mark.parametrize("step", [1, 18_001, 20_001])
def test_gradients_are_those_of_finite_differences(step: int) -> None:
    """A loss on a picture, by each material and the map, in either stage; the core's own gradients have their tests."""
    method = at_step(step)
    tensors = method.model.sets["base"].parameters.tensors
    inputs = {"texels": method.reflection.light.texels} | {name: tensors[name] for name in ("beta_logits", *MATERIALS)}
    unused = [inputs.pop(name) for name in ("indirect_dc", "indirect_rest")] if step < 20_001 else []
    assert_gradients_are_differences(mean_of_picture(method, CAMERA, step), inputs, by=2e-2, rel=0.03)
    assert all(values.grad is None or not values.grad.any() for values in unused)


def test_smoothness_spares_the_pictures_edges() -> None:
    normal = torch.zeros(4, 6, 3)
    normal[:, 3:, 0] = 1.0
    plain, edged = torch.zeros(4, 6, 3), torch.zeros(4, 6, 3)
    edged[:, 3:] = 1.0
    assert edge_aware_smoothness(normal, plain) == pytest.approx(1 / 5)  # one of five steps across turns by 1
    assert edge_aware_smoothness(normal, edged) == pytest.approx(math.exp(-1) / 5)
    assert edge_aware_smoothness(torch.ones(4, 6, 3), edged) == 0


@pytest.mark.parametrize("layout", ["ply", "compact"])
def test_a_stored_model_keeps_its_materials(layout: str, tmp_path: Path) -> None:
    method = at_step(20_001)
    before = method.render(CAMERA)
    LAYOUTS[layout].write(method, tmp_path)
    assert LAYOUTS[layout].lacks(method) == (["texels"] if layout == "ply" else [])
    method.restore(LAYOUTS[layout].read(method, tmp_path))
    method.prepare()
    after = method.render(CAMERA)
    if layout == "ply":
        assert torch.equal(before.color, after.color)
    assert (before.color - after.color).abs().mean() < 5e-3


def test_viewers_layouts_name_the_materials_that_they_lack() -> None:
    assert LAYOUTS["spz"].lacks(at_step(1)) == ["β", *sorted(MATERIALS), "texels"]


@pytest.mark.slow
def test_a_mirror_ball_is_learned() -> None:
    scene = mirror_ball()
    steps = 140
    method = initialized(
        scene,
        steps,
        **{"envmap_size": 32, "initial_orientation": "surface", "initial_beta": 0.5, "sh_from": 30_000},
        **{"densify_until": 0, "disturb_every": 0, "opacity_reset_every": 0, "shade_until": 6_000},
    )
    assert gain_of_training(method, scene, steps) > 2
    assert method.surfaces.deferred
