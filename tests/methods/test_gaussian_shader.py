"""GaussianShader: one Gaussian's color and normal by its equation, its losses, and gradients."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from finite_differences import assert_gradients_are_differences, mean_of_picture
from mirror_ball import gain_of_training, mirror_ball
from rules import with_rules
from schedules import begin, optimizers_of
from scipy import ndimage
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Scene, depth_normals
from envgs_bench.methods.gaussian_shader import MATERIALS, GaussianShader, own_color
from envgs_bench.methods.gaussians.parameters import SH_DC
from envgs_bench.methods.lighting.brdf_table import specular_weight
from envgs_bench.methods.lighting.prefiltered_cubemap import prefilter_of, rough_map
from envgs_bench.methods.registry import create_method
from envgs_bench.testing import tiny_scene

CAMERA = tiny_scene().test[0].camera


def initialized(scene: Scene, steps: int = 30_000, **settings) -> GaussianShader:
    method = create_method("gaussian_shader", with_rules(**{"envmap_size": 8, **settings}))
    assert isinstance(method, GaussianShader)
    method.initialize(scene, steps)
    return method


def drawn_at_random(scene: Scene, **settings) -> GaussianShader:
    method = initialized(scene, **settings)
    generator = torch.Generator().manual_seed(2)
    parameters = method.model.sets["base"].parameters
    for name in MATERIALS:
        parameters.replace(name, 0.3 * torch.randn(parameters.tensors[name].shape, generator=generator))
    method.light.map.become(torch.rand(6, 8, 8, 3, generator=generator))
    return method


def least_around(alpha: Tensor) -> Tensor:
    """The least of the 4×4 pixels around each."""
    return torch.from_numpy(ndimage.minimum_filter(alpha.detach().numpy(), size=4, mode="constant", cval=1.0))


@pytest.mark.parametrize(("side", "field"), [(1.0, "outer_residuals"), (-1.0, "inner_residuals")])
def test_a_gaussian_is_shaded_by_the_residual_of_its_side(side: float, field: str) -> None:
    """One flat Gaussian at the origin, whose shortest axis points to the camera or away from it."""
    scene = tiny_scene()
    lone = Scene("lone", scene.train, scene.test, torch.zeros(1, 3), torch.tensor([[0.3, 0.5, 0.7]]))
    method = drawn_at_random(lone, shortest_axis="column")
    parameters = method.model.sets["base"].parameters
    toward = functional.normalize(CAMERA.center, dim=0)  # along z
    parameters.replace("quaternions", torch.tensor([[1.0, 0, 0, 0]] if side > 0 else [[0.0, 1, 0, 0]]))
    parameters.replace("log_scales", torch.tensor([[0.5, 0.5, 0.01]]).log())
    tensors = parameters.detached()
    normal = functional.normalize(toward + tensors[field][0], dim=0)
    outgoing = 2 * (normal @ toward) * normal - toward
    light = rough_map(method.light.map.texels.detach(), prefilter_of(8))
    tint, roughness = tensors["tint_logits"].sigmoid(), tensors["roughness_logits"][:, 0].sigmoid()
    weight = specular_weight(tint, (normal @ toward)[None], roughness)
    reflected = light.specular(outgoing[None], roughness) * weight + (1 - tint) * light.irradiance(normal[None])
    point = torch.tensor([0.3, 0.5, 0.7])
    expected = point.exp() / (3 + point.exp()) + reflected[0]  # sigmoid(b − log 3)

    shown = method.render(CAMERA)
    row, column = divmod(int(shown.alpha.argmax()), CAMERA.width)
    alpha = shown.alpha[row, column]
    assert alpha > 0.05
    torch.testing.assert_close(shown.color[row, column] / alpha, expected, atol=1e-4, rtol=0)
    torch.testing.assert_close(shown.normal[row, column] / alpha, normal, atol=1e-4, rtol=0)
    torch.testing.assert_close(shown.layers["beta"][row, column, 0] / alpha, tint.mean(), atol=1e-4, rtol=0)
    torch.testing.assert_close(shown.layers["reflection"][row, column] / alpha, reflected[0], atol=1e-4, rtol=0)


def test_its_own_losses_are_those_of_the_paper() -> None:
    method = drawn_at_random(tiny_scene(), normal_drawn="alone")
    drawn, _ = method.draw(CAMERA, 1)
    terms = method.losses(drawn, torch.zeros(24, 32, 3), tiny_scene().test[0], 1)
    alpha = drawn.alpha.detach().clamp(1e-3, 1 - 1e-3)
    assert float(terms["sparse"].detach()) == pytest.approx(1e-3 * float((alpha.log() + (1 - alpha).log()).mean()))
    length = drawn.extras[..., 1].detach()
    assert float(terms["residual"].detach()) == pytest.approx(1e-3 * float((least_around(drawn.alpha) * length).mean()))
    reference = depth_normals(drawn.depth.detach(), CAMERA) * drawn.alpha.detach()[..., None]
    error = reference.any(-1).float() - (drawn.normal * reference).sum(-1)
    torch.testing.assert_close(terms["normal"], 0.2 * (least_around(drawn.alpha) * error).mean())
    terms["normal"].backward()  # normals follow the depth map, which stays: no center moves through its depth
    assert method.model.sets["base"].parameters.tensors["outer_residuals"].grad.abs().max() > 0


@pytest.mark.parametrize("background", [0.0, 1.0])
def test_normals_and_depths_that_are_held_together_are_drawn_as_colors(background: float) -> None:
    """As the authors' code has them: n/2 + 1/2, and depths in red, blended over the scene's background."""
    scene = replace(tiny_scene(), background=torch.full((3,), background))
    method = drawn_at_random(scene)
    drawn, _ = method.draw(CAMERA, 1)
    alpha = drawn.alpha.detach()[..., None]
    assert 0.05 < alpha.mean() < 0.95
    picture = (drawn.normal + alpha) / 2 + (1 - alpha) * background
    depth = drawn.depth.detach() * alpha[..., 0] + (1 - alpha[..., 0]) * background
    known = depth_normals(depth, CAMERA)
    reference = known * alpha + (1 - alpha) * background
    error = known.any(-1).float() - ((2 * picture - 1) * reference).sum(-1)
    terms = method.losses(drawn, torch.zeros(24, 32, 3), tiny_scene().test[0], 1)
    torch.testing.assert_close(terms["normal"], 0.2 * (least_around(drawn.alpha) * error).mean())


def test_of_the_tuned_one_normals_are_drawn_alone_and_axes_are_axes() -> None:
    published, tuned = initialized(tiny_scene()), initialized(tiny_scene(), recipe="ours", max_primitives=100)
    assert (published.settings.rule.normal_drawn, published.settings.rule.shortest_axis) == ("as_color", "row")
    assert (tuned.settings.rule.normal_drawn, tuned.settings.rule.shortest_axis) == ("alone", "column")


def test_a_map_is_cut_to_colors_and_learns_on_from_there() -> None:
    method = initialized(tiny_scene())
    light = method.light.map
    assert light.texels.detach().unique().tolist() == [pytest.approx(0.8)]
    light.become(torch.linspace(-0.5, 1.5, 6 * 8 * 8 * 3).reshape(6, 8, 8, 3))
    begin(method, 1)
    assert (light.texels.detach().min(), light.texels.detach().max()) == (0, 1)
    method.draw(CAMERA, 1)[0].color.sum().backward()
    assert light.texels.grad is not None
    assert light.texels.grad[light.texels == 0].any()


def test_materials_and_map_slow_down_to_a_tenth() -> None:
    method = initialized(tiny_scene())
    for step, rate in ((0, 1.6e-2), (15_000, 1.6e-2 * math.sqrt(0.1)), (30_000, 1.6e-3)):
        begin(method, step)
        groups = [group for optimizer in optimizers_of(method) for group in optimizer.param_groups]
        rates = {group["name"]: group["lr"] for group in groups}
        slowing = [name for name in (*MATERIALS, "texels") if name != "inner_residuals"]
        assert [rates[name] for name in slowing] == pytest.approx([rate] * 4)
        assert rates["inner_residuals"] == pytest.approx(2e-4)
        assert rates["sh_dc"] * SH_DC == pytest.approx(rate)  # c_d's logits are ½ + Y₀ × this


def test_positions_learn_as_in_a_scene_of_radius_5() -> None:
    """As in the authors' code, whatever the scene's radius is."""
    method = initialized(tiny_scene())
    begin(method, 15_000)
    groups = {group["name"]: group["lr"] for optimizer in optimizers_of(method) for group in optimizer.param_groups}
    assert method.model.radius != pytest.approx(5, rel=1e-2)
    assert float(groups["means"]) == pytest.approx(5 * 1.6e-5)


def test_residual_color_is_that_of_the_other_harmonics() -> None:
    """Against the public formula of the first three linear terms, over c_d."""
    sh = torch.zeros(1, 4, 3)
    sh[0, 1:] = torch.arange(9.0).reshape(3, 3) / 10
    x, y, z = 0.48, -0.6, 0.64
    residual = 0.4886025 * (-y * sh[0, 1] + z * sh[0, 2] - x * sh[0, 3])
    found = own_color(sh, torch.tensor([[x, y, z]]))[0]
    torch.testing.assert_close(found, math.exp(0.5) / (3 + math.exp(0.5)) + residual)


def test_gradients_are_those_of_finite_differences() -> None:
    method = drawn_at_random(tiny_scene())
    inputs = {"texels": method.light.map.texels} | {
        name: method.model.sets["base"].parameters.tensors[name] for name in MATERIALS
    }
    # A small step: the map is bilinear, with kinks at its texels.
    assert_gradients_are_differences(mean_of_picture(method, CAMERA), inputs, by=2e-3)


@pytest.mark.slow
def test_a_mirror_ball_is_learned() -> None:
    scene = mirror_ball()
    steps = 140
    settings = {"envmap_size": 32, "initial_orientation": "surface", "densify_until": 0, "opacity_reset_every": 0}
    method = initialized(scene, steps, **settings)
    assert gain_of_training(method, scene, steps) > 2
