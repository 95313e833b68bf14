"""3iGS: one Gaussian's color by its equation, when it begins to shine, what is trained and stored, and gradients."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from finite_differences import assert_gradients_are_differences, mean_of_picture
from mirror_ball import gain_of_training, mirror_ball
from rules import with_rules
from schedules import begin, optimizers_of
from torch.nn import functional

from envgs_bench.core import Scene
from envgs_bench.methods.lighting.directional_encoding import encoded
from envgs_bench.methods.lighting.tensor_field import field_components
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.storage.layouts import LAYOUTS
from envgs_bench.methods.three_igs import MATERIALS, ThreeIGS
from envgs_bench.testing import tiny_scene

SH_DC = 0.28209479177387814  # the first spherical harmonic
CAMERA = tiny_scene().test[0].camera


def initialized(scene: Scene, steps: int = 30_000, **settings) -> ThreeIGS:
    method = create_method("3igs", with_rules(**{"field_size": 8, **settings}))
    assert isinstance(method, ThreeIGS)
    method.initialize(scene, steps)
    return method


def shining_at_random(scene: Scene, **settings) -> ThreeIGS:
    method = initialized(scene, **settings)
    generator = torch.Generator().manual_seed(2)
    parameters = method.model.sets["base"].parameters
    for name in MATERIALS:
        parameters.replace(name, torch.randn(parameters.tensors[name].shape, generator=generator))
    with torch.no_grad():
        for name in ("planes", "lines"):
            method.field.weights[name].normal_(generator=generator)
        method.field.weights["color_weight"] *= 2
    method.field.shines = True
    return method


def test_a_gaussians_color_is_its_diffuse_one_and_what_the_network_makes_of_its_place() -> None:
    """A round Gaussian off the middle, in a box that is longer along one axis."""
    scene = tiny_scene()
    center = torch.tensor([0.1, -0.15, 0.05])
    lone = Scene("lone", scene.train, scene.test, center[None], torch.tensor([[0.3, 0.5, 0.6]]))
    method = shining_at_random(lone)
    low, high = torch.tensor([-0.5, -0.4, -1.0]), torch.tensor([0.5, 0.6, 2.0])
    method.field._box = (low, high)
    base_color = torch.tensor([0.3, 0.5, 0.6])
    method.model.sets["base"].parameters.replace("log_scales", torch.full((1, 3), 0.3).log())
    method.model.sets["base"].parameters.replace("sh_dc", ((base_color - 0.5) / SH_DC)[None, None])
    own, w = method.model.sets["base"].parameters.detached(), method.field.weights

    place = (center - (low + high) / 2) / ((high - low) / 2)
    light = w["light_weight"] @ field_components(w["planes"], w["lines"], place[None])[0] + w["light_bias"]
    direction = functional.normalize(center - CAMERA.center, dim=0)
    blurred = encoded(direction[None], functional.softplus(own["roughness"] - 1))[0]
    seen = torch.cat([own["brdf_logits"][0].tanh(), light.tanh(), direction, blurred])
    for layer in ("first", "second"):
        seen = (w[f"{layer}_weight"] @ seen + w[f"{layer}_bias"]).relu()
    specular = (w["color_weight"] @ seen).tanh().detach()
    diffuse = base_color.exp() / (3 + base_color.exp())  # sigmoid(b − log 3)
    expected = (diffuse + specular).clamp(0, 1)
    assert specular.abs().min() > 0.01

    shown = method.render(CAMERA)
    row, column = divmod(int(shown.alpha.argmax()), CAMERA.width)
    alpha = shown.alpha[row, column]
    assert alpha > 0.05
    torch.testing.assert_close(shown.color[row, column] / alpha, expected, atol=1e-4, rtol=0)
    torch.testing.assert_close(shown.layers["base"][row, column] / alpha, diffuse, atol=1e-4, rtol=0)
    torch.testing.assert_close(shown.layers["reflection"][row, column] / alpha, expected - diffuse, atol=1e-4, rtol=0)


def test_it_shines_after_a_tenth_of_the_run() -> None:
    method = initialized(tiny_scene())
    diffuse = create_method("3dgs", {"sh_degree": 0})
    diffuse.initialize(tiny_scene(), 30_000)
    b = 0.5 + SH_DC * method.model.sets["base"].parameters.detached()["sh_dc"]
    diffuse.model.sets["base"].parameters.replace("sh_dc", (b.exp() / (3 + b.exp()) - 0.5) / SH_DC)
    begin(method, 3_000)
    torch.testing.assert_close(method.render(CAMERA).color, diffuse.render(CAMERA).color, atol=1e-6, rtol=0)
    assert not method.render(CAMERA).layers
    begin(method, 3_001)
    assert set(method.render(CAMERA).layers) == {"base", "reflection"}
    assert not torch.equal(method.render(CAMERA).color, diffuse.render(CAMERA).color)


def test_what_is_trained_and_how_fast() -> None:
    """As the released code: 150³ samples, 3 × 48 components, 48 features of each, and layers of 128."""
    method = create_method("3igs")
    assert isinstance(method, ThreeIGS)
    method.initialize(tiny_scene(), 30_000)
    begin(method, 1)
    groups = {group["name"]: group for optimizer in optimizers_of(method) for group in optimizer.param_groups}
    rates = {name: group["lr"] for name, group in groups.items()}
    assert [rates["sh_dc"] * SH_DC, rates["brdf_logits"], rates["roughness"]] == pytest.approx([2.5e-3] * 3)
    assert [rates[name] for name in ("planes", "lines")] == [2e-2] * 2
    network = ("light_weight", "light_bias", "first_weight", "first_bias", "second_weight", "second_bias")
    assert [rates[name] for name in (*network, "color_weight")] == [1e-3] * 7
    assert all(groups[name]["betas"] == (0.9, 0.99) and groups[name]["eps"] == 1e-8 for name in network)
    field = 3 * 48 * (150 * 150 + 150) + 144 * 48 + 48
    layers = (48 + 48 + 3 + 38) * 128 + 128 + 128 * 128 + 128 + 128 * 3
    assert method.field.most_bytes() == method.model_bytes()["env"] == 4 * (field + layers)


def test_features_begin_as_the_points_colors() -> None:
    scene = tiny_scene()
    method = initialized(scene)
    tensors = method.model.sets["base"].parameters.detached()
    torch.testing.assert_close(0.5 + SH_DC * tensors["brdf_logits"][:, :3], scene.point_colors)
    assert not tensors["brdf_logits"][:, 3:].any()
    b = 0.5 + SH_DC * tensors["sh_dc"]
    assert 0 <= float(b.min()) < 0.2 < 0.8 < float(b.max()) <= 1  # the diffuse color knows nothing of them
    assert 0 <= float(tensors["roughness"].min()) < float(tensors["roughness"].max()) <= 1
    low, high = method.field._box
    inside = ((scene.points >= low) & (scene.points <= high)).float().mean(0)
    torch.testing.assert_close(inside, torch.full((3,), 0.96), atol=0.02, rtol=0)


def test_its_field_and_network_are_stored_with_it(tmp_path: Path) -> None:
    """A file of Gaussians keeps their features; the field is the method's own, of which that file has none."""
    method = shining_at_random(tiny_scene())
    shown = method.render(CAMERA).color
    assert {"planes", "lines", "color_weight"} <= set(LAYOUTS["ply"].lacks(method))
    assert "brdf_logits" in LAYOUTS["spz"].lacks(method)
    for name, error in (("ply", 0.0), ("compact", 0.02)):
        LAYOUTS[name].write(method, tmp_path / name)
        again = shining_at_random(tiny_scene())
        again.restore(LAYOUTS[name].read(again, tmp_path / name))
        again.prepare()
        torch.testing.assert_close(again.render(CAMERA).color, shown, atol=error, rtol=0)
    (tmp_path / "compact" / "model.npz").rename(tmp_path / "model.npz")
    with pytest.raises(ValueError, match="has 8 samples along an axis, field_size is 9"):
        create_method("3igs", {"field_size": 9}).load(tmp_path)


def test_a_field_needs_two_samples() -> None:
    with pytest.raises(ValueError, match="field_size is 1, expected greater than or equal to 2"):
        create_method("3igs", {"field_size": 1})


def test_gradients_are_those_of_finite_differences() -> None:
    method = shining_at_random(tiny_scene())
    inputs = method.field.weights | {name: method.model.sets["base"].parameters.tensors[name] for name in MATERIALS}
    assert_gradients_are_differences(mean_of_picture(method, CAMERA), inputs, by=2e-2)


@pytest.mark.slow
def test_a_mirror_ball_is_learned_better_than_by_its_diffuse_part() -> None:
    scene, steps = mirror_ball(), 300
    settings = {"field_size": 32, "initial_orientation": "surface", "densify_until": 0, "opacity_reset_every": 0}
    gains = [
        gain_of_training(initialized(scene, steps, diffuse_until=diffuse_until, **settings), scene, steps)
        for diffuse_until in (30_000, 3_000)
    ]
    assert gains[1] > gains[0] + 1.5
