"""RT-Splatting: a pixel's equation, what lies behind glass, its losses, its gate, its resets, and what is stored."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from finite_differences import assert_gradients_are_differences, mean_of_picture
from rules import with_rules
from schedules import befall, begin, steps_of_events
from scipy import ndimage
from torch.nn import functional

from envgs_bench.core import Scene, depth_normals, rasterize
from envgs_bench.core.torch.rotation import rotation_matrices
from envgs_bench.methods.lighting.latlong import all_levels, looked_up
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.rt_splatting import LEARNED, RTSplatting, cross_entropy, gated
from envgs_bench.methods.storage.layouts import LAYOUTS
from envgs_bench.stages.execution import given_of
from envgs_bench.testing import tiny_scene

CAMERA = tiny_scene().test[0].camera


def initialized(scene: Scene | None = None, steps: int = 30_000, **settings: Any) -> RTSplatting:
    method = create_method("rt_splatting", with_rules(**{"map_levels": 3, "perceptual_weight": 0.0, **settings}))
    assert isinstance(method, RTSplatting)
    method.initialize(scene or tiny_scene(), steps)
    return method


def at_random(**settings: Any) -> RTSplatting:
    """A method whose materials and map are drawn at random."""
    method = initialized(**settings)
    generator = torch.Generator().manual_seed(2)
    parameters = method.model.sets["base"].parameters
    for name in [each for each in parameters.tensors if each.endswith("_logits")]:
        parameters.replace(name, torch.randn(parameters.tensors[name].shape, generator=generator))
    with torch.no_grad():
        method.light.tensors["map"].normal_(generator=generator)
    begin(method, 5_000)
    return method


def masked(scene: Scene) -> Scene:
    """Its training views' left halves are glass."""

    def half(columns: int, rows: int) -> torch.Tensor:
        return (torch.arange(columns) < columns // 2).expand(rows, columns)

    train = [replace(v, masks={"transmissive": half(v.camera.width, v.camera.height)}) for v in scene.train]
    return replace(scene, train=train)


def test_a_pixel_is_what_its_surface_mirrors_transmits_and_scatters() -> None:
    method = at_random()
    shown = method.render(CAMERA)
    base, tensors = method.model.gaussians("base", None), method.model.sets["base"].parameters.detached()
    materials = [tensors[f"{name}_logits"].sigmoid() for name in ("roughness", "reflectance", "transmission")]
    features, alpha = tensors["feature_logits"].tanh(), tensors["hiding_logits"].sigmoid()
    near = {"near": method.model.near}
    surface = rasterize(replace(base, extras=torch.cat([*materials, features], dim=1)), CAMERA, **near)
    volume = rasterize(replace(base, opacities=base.opacities * alpha[:, 0]), CAMERA, **near)
    roughness, rho, tau = surface.extras[..., :3].split(1, dim=-1)
    axes = replace(base, extras=rotation_matrices(base.quaternions)[:, :, 2])
    rays, normal = (functional.normalize(v, dim=-1) for v in (CAMERA.rays()[1], rasterize(axes, CAMERA, **near).extras))
    mirrored = rays - 2 * (rays * normal).sum(-1, keepdim=True) * normal
    levels = all_levels(method.light.tensors["map"].detach())
    far = looked_up(levels, mirrored.reshape(-1, 3), roughness.reshape(-1), 3).reshape(*CAMERA.rays()[1].shape[:2], -1)
    own = functional.normalize(surface.extras[..., 3:], dim=-1)
    layer = torch.cat([torch.einsum("hwi,hwj->hwij", own, far).flatten(2), far], dim=-1)
    w = method.light.tensors
    for number in range(3):
        layer = layer @ w[f"layer{number}_weight"].T + w[f"layer{number}_bias"]
        layer = layer.clamp_min(0) if number < 2 else layer
    left = 1 - (1 - layer[..., 3:].sigmoid()) * surface.alpha[..., None]
    expected = layer[..., :3].exp() * rho + left * (tau * volume.color + (1 - tau) * surface.color)
    solid = surface.alpha > 0.05
    assert float(solid.float().mean()) > 0.1
    torch.testing.assert_close(shown.color[solid], expected.detach()[solid], atol=2e-4, rtol=1e-4)


def test_glass_shows_what_lies_behind_and_has_its_own_normal() -> None:
    """A surfel of occupancy 1 that hides nothing stands before a red one: the pixel is red, its depth the glass's."""
    method = initialized()
    begin(method, 5_000)
    still = method.model.sets["base"].parameters.detached()
    two = {name: values[:2].clone() for name, values in still.items()}
    camera = CAMERA
    ahead = camera.center + torch.tensor([[1.0], [2.0]]) * camera.world_to_camera[2, :3]
    toward = camera.world_to_camera[:3, :3]  # its rows are the camera's axes: a surfel that faces it has these
    quaternion = _quaternion(toward.T)
    two |= {"means": ahead, "quaternions": quaternion.expand(2, 4), "log_scales": torch.zeros(2, 2)}
    two |= {"opacity_logits": torch.full((2,), 9.0), "sh_rest": torch.zeros_like(two["sh_rest"])}
    two["sh_dc"] = (torch.tensor([[[0.0, 0, 1]], [[1.0, 0, 0]]]) - 0.5) / 0.28209479
    hides = torch.tensor([[-20.0], [20.0]])
    two |= {"hiding_logits": hides, "transmission_logits": -hides, "reflectance_logits": torch.full((2, 1), -20.0)}
    method.model.sets["base"] = method.model.set_of("base", two)
    with torch.no_grad():
        method.light.tensors["layer2_bias"][3] = 20.0  # nothing is lost at the surface
    shown = method.render(camera)
    middle = shown.color[camera.height // 2, camera.width // 2]
    torch.testing.assert_close(middle, torch.tensor([1.0, 0, 0]), atol=0.02, rtol=0)
    assert float(shown.depth[camera.height // 2, camera.width // 2]) == pytest.approx(1.0, abs=0.02)
    picture, statistics = method.draw(camera, 5_000)
    picture.color.square().mean().backward()
    moved = statistics["base"].position_gradients
    assert moved is not None
    assert moved[1].norm() > 0  # what lies behind glass grows by the light that glass lets through
    assert (statistics["base"].weights > 0).all()


def _quaternion(rotation: torch.Tensor) -> torch.Tensor:
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation.double().numpy()).as_quat()
    return torch.tensor([[w, x, y, z]], dtype=torch.float32)


def test_gradients_are_those_of_finite_differences() -> None:
    method = at_random()
    tensors = method.model.sets["base"].parameters.tensors
    inputs = {name: tensors[name] for name in ("hiding_logits", "transmission_logits", "reflectance_logits")}
    weights = mean_of_picture(method, CAMERA)
    behind = gated_off(method)
    assert_gradients_are_differences(weights, inputs | dict(method.light.tensors), by=2e-2)
    behind()


def gated_off(method: RTSplatting) -> Any:
    """The gate withholds gradients on purpose: let it be open."""
    from envgs_bench.methods import rt_splatting

    before, rt_splatting.GATE = rt_splatting.GATE, 0.0
    return lambda: setattr(rt_splatting, "GATE", before)


def test_what_lies_behind_learns_less_where_the_mirrored_varies() -> None:
    generator = torch.Generator().manual_seed(0)
    specular, weights = (torch.rand(9, 11, size, generator=generator) for size in (3, 1))
    behind = torch.rand(9, 11, 3, generator=generator, requires_grad=True)
    shown = gated(behind, specular, weights)
    torch.testing.assert_close(shown, behind)
    shown.sum().backward()
    x, w = specular.double().numpy(), weights.double().numpy()
    mean = lambda values: ndimage.uniform_filter(values, (3, 3, 1), mode="mirror")  # noqa: E731
    spread = np.sqrt(np.maximum(mean(w * x * x) - mean(w * x) ** 2 / mean(w), 0))
    np.testing.assert_allclose(behind.grad, np.exp(-4 * spread), atol=2e-5)


def test_masks_say_what_is_glass() -> None:
    scene = masked(tiny_scene())
    method, plain = initialized(scene), initialized()
    begin(method, 701)
    begin(plain, 701)
    view = scene.train[0]
    mask = view.masks["transmissive"]
    generator = torch.Generator().manual_seed(1)
    opacity, transmission = (0.01 + 0.98 * torch.rand(mask.shape, generator=generator) for _ in range(2))
    scattered = torch.rand(*mask.shape, 3, generator=generator)
    drawn = method.draw(view.camera, 701)[0]
    drawn = replace(drawn, layers=drawn.layers | dict(zip(LEARNED, (opacity, transmission, scattered), strict=True)))
    terms = method.panes.losses(drawn, view, 701)
    truth, clear = mask.double().numpy(), 1 - opacity.double().numpy()
    missed = -np.log(np.where(truth == 1, clear, 1 - clear)).mean()
    assert float(terms["transparent"]) == pytest.approx(0.01 * missed, rel=1e-4)
    outside = -np.log(1 - transmission[~mask].double().numpy()).mean()
    assert float(terms["transmission"]) == pytest.approx(0.01 * outside, rel=1e-4)
    of_glass, colors = transmission[mask].double().numpy(), scattered[mask].double().numpy()
    unlike = len(of_glass) * (of_glass.var() + colors.var(axis=0).mean())
    assert float(terms["glass"]) == pytest.approx(2e-6 * unlike, rel=1e-4)
    assert float(terms["occupancy"].detach()) == pytest.approx(1e-3 * 0.1, rel=1e-3)  # which surfels start with
    assert float(cross_entropy(torch.ones(2, 2), torch.zeros(2, 2))) < 20  # finite where it is all wrong
    assert set(plain.panes.losses(drawn, view, 701)) == {"occupancy"}  # of a scene without masks
    assert given_of(scene, method) == ["masks of mirrors and glass"]


def test_to_step_700_what_lies_behind_is_learned_alone() -> None:
    """Without a loss of normals, masks or occupancy; and an image shows it through surfaces that transmit half."""
    scene = masked(tiny_scene())
    method, view = initialized(scene), scene.train[0]
    begin(method, 700)
    tensors = method.model.sets["base"].parameters.tensors
    shown, statistics = method.draw(view.camera, 700)
    gaussians = method.model.gaussians("base", 700)
    volume = method.model.rasterize(view.camera, 700, replace(gaussians, opacities=gaussians.opacities * 0.5))
    surface = method.model.rasterize(view.camera, 700, gaussians)
    torch.testing.assert_close(shown.color, volume.color)
    terms = method.losses(shown, view.rgb(), view, 700)
    assert set(terms) == {"rgb"}
    terms["rgb"].backward()
    assert statistics["base"].position_gradients is not None
    assert all(tensors[f"{name}_logits"].grad is None for name in ("transmission", "reflectance", "roughness"))
    half = 0.5 * surface.alpha[..., None]  # τ as it is blended
    both = half * volume.color + (1 - half) * surface.color
    torch.testing.assert_close(method.render(view.camera).color, both.detach(), atol=1e-5, rtol=0)
    begin(method, 701)
    shown, _ = method.draw(view.camera, 701)
    terms = method.losses(shown, view.rgb(), view, 701)
    assert set(terms) == {"rgb", "normal", "occupancy", "transparent", "transmission", "glass"}


def test_normals_stay_on_the_side_that_their_surfels_have() -> None:
    """Turned over, all surfels show the other side, and their normals are held to the depth map's from there."""
    method, view = initialized(), tiny_scene().train[0]
    begin(method, 701)
    parameters, errors, shown = method.model.sets["base"].parameters, [], []
    ways = view.camera.center - parameters.tensors["means"].detach()
    facing = two_axes_and(functional.normalize(ways, dim=-1))
    for side in (1, -1):
        frames = facing * torch.tensor([1.0, side, side])
        parameters.replace("quaternions", torch.cat([_quaternion(frame) for frame in frames]))
        drawn, _ = method.draw(view.camera, 701)
        shown.append(drawn.normal.detach())
        errors.append(float(method.losses(drawn, view.rgb(), view, 701)["normal"].detach()))
    torch.testing.assert_close(shown[0], -shown[1], atol=1e-5, rtol=0)
    assert errors[1] > errors[0]
    turned = initialized(normal_side="camera")
    begin(turned, 701)
    turned.model.sets["base"].parameters.replace("quaternions", parameters.tensors["quaternions"].detach())
    torch.testing.assert_close(turned.draw(view.camera, 701)[0].normal, shown[0], atol=1e-4, rtol=0)


def two_axes_and(third: torch.Tensor) -> torch.Tensor:
    """Rotations [N, 3, 3] whose third column is given, [N, 3] of length 1."""
    helper = torch.tensor([0.3, -0.5, 0.81]).expand_as(third)
    first = functional.normalize(torch.linalg.cross(helper, third), dim=-1)
    return torch.stack([first, torch.linalg.cross(third, first), third], dim=-1)


def test_normals_may_count_before_anything_mirrors() -> None:
    """Then a step learns what an image shows."""
    method, view = initialized(normal_from=300), tiny_scene().train[0]
    begin(method, 500)
    shown, _ = method.draw(view.camera, 500)
    assert not shown.layers["reflection"].any()
    assert set(method.losses(shown, view.rgb(), view, 500)) == {"rgb", "normal"}
    torch.testing.assert_close(shown.color.detach(), method.render(view.camera).color, atol=1e-5, rtol=0)


def test_normals_count_by_what_may_mirror() -> None:
    """Both at length 1, the depth map's × alpha, and their error × alpha in the ball; alpha learns nothing of it."""
    method, view = initialized(scope_radius=0.4), tiny_scene().train[0]
    begin(method, 701)
    shown, _ = method.draw(view.camera, 701)
    alpha = shown.alpha[..., None].detach()
    reference = depth_normals(shown.depth, view.camera)
    inside = method.panes.inside(shown, view.camera)
    known = reference.any(-1, keepdim=True)
    agreed = (functional.normalize(shown.normal, dim=-1) * reference * alpha).sum(-1, keepdim=True)
    error = (known * 1.0 - agreed) * alpha * inside
    found = method.losses(shown, view.rgb(), view, 701)["normal"]
    assert 0 < float(inside.float().mean()) < 1
    assert found.item() == pytest.approx(0.05 * error.mean().item(), rel=1e-4)


def test_occupancy_falls_where_a_view_looks() -> None:
    method, view = initialized(), tiny_scene().train[0]
    parameters, camera = method.model.sets["base"].parameters, view.camera
    logits = torch.randn(len(parameters), generator=torch.Generator().manual_seed(3))
    parameters.replace("opacity_logits", logits)
    behind = torch.arange(len(logits)) % 3 == 0
    means = camera.center + torch.where(behind, -5.0, 5.0)[:, None] * camera.world_to_camera[2, :3]
    parameters.replace("means", means)
    begin(method, 701)
    shown, _ = method.draw(camera, 701)
    found = method.panes.losses(shown, view, 701)["occupancy"]
    assert found.item() == pytest.approx(1e-3 * float(logits[~behind].sigmoid().mean()), rel=1e-4)
    found.backward()
    gradient = parameters.tensors["opacity_logits"].grad
    assert gradient is not None
    assert torch.equal(gradient == 0, behind)


def test_surfels_begin_at_a_tenth_of_their_neighbors_squared_distance() -> None:
    points = tiny_scene().points
    squared = torch.cdist(points, points).square().topk(4, largest=False).values[:, 1:].mean(1)
    scales = initialized().model.gaussians("base", 1).scales.detach()
    torch.testing.assert_close(scales.square(), (0.1 * squared)[:, None].repeat(1, 2), rtol=1e-3, atol=0)


def test_opacities_are_reset_half_way_between_two_resets_of_occupancy() -> None:
    method = initialized(steps=30_000)
    steps = steps_of_events(method, 30_000)
    assert steps["reset_base_opacity"] == [3_000, 6_000, 9_000, 12_000]
    assert steps["reset_hiding"] == [4_500, 7_500, 10_500, 13_500]
    befall(method, 4_500, {"reset_hiding"})
    assert float(method.model.sets["base"].parameters.detached()["hiding_logits"].sigmoid().max()) <= 0.0101


def test_nothing_mirrors_nor_transmits_outside_the_ball() -> None:
    method = at_random(scope_radius=0.4)
    shown = method.render(CAMERA)
    base = method.model.rasterize(CAMERA, None)
    outside = ~method.panes.inside(base, CAMERA)[..., 0]
    assert 0 < outside.float().mean() < 1
    torch.testing.assert_close(shown.color[outside], base.color[outside], atol=1e-6, rtol=0)


@pytest.mark.parametrize("layout", ["ply", "compact"])
def test_a_stored_model_keeps_its_materials(layout: str, tmp_path: Path) -> None:
    method = at_random()
    before = method.render(CAMERA)
    LAYOUTS[layout].write(method, tmp_path)
    method.restore(LAYOUTS[layout].read(method, tmp_path))
    method.prepare()
    assert (before.color - method.render(CAMERA).color).abs().mean() < (1e-7 if layout == "ply" else 2e-2)
