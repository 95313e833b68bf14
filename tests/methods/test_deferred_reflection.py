"""3DGS-DR: its schedule step by step as released, what is its own, and that reflections teach it normals."""

from __future__ import annotations

import math

import pytest
import torch
from mirror_ball import facing_angle, mirror_ball
from rules import with_rules
from schedules import befall, begin, optimizers_of, steps_of_events
from torch.nn import functional

from envgs_bench.core import Scene, View
from envgs_bench.methods.deferred_reflection import DeferredReflection
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.lighting.cubemap import layout_of, sample_cubemap
from envgs_bench.methods.lighting.disturbance import beta_of
from envgs_bench.methods.registry import create_method
from envgs_bench.testing import tiny_scene

RUN = 61_000
CAMERA = tiny_scene().test[0].camera


def initialized(steps: int = RUN, **settings) -> DeferredReflection:
    method = create_method("3dgs_dr", with_rules(**{"envmap_size": 8, **settings}))
    assert isinstance(method, DeferredReflection)
    method.initialize(tiny_scene(), steps)
    return method


@pytest.mark.parametrize("kind", ["3dgs_dr", "ref_gaussian"])
def test_adam_counts_the_steps_of_reflection_strength_from_the_first_reflection_on(kind: str) -> None:
    """Its first step, whatever the gradients are, is the learning rate; after three steps of zeros it is 0.6 of it."""
    rates, moved, scene = {"3dgs_dr": 6e-3, "ref_gaussian": 5e-3}, {}, tiny_scene()
    for anew in (True, False):
        settings = with_rules(envmap_size=8, warm_up=3, beta_starts_anew=anew, shade_until=0)
        if kind == "3dgs_dr":
            del settings["shade_until"]
        method = create_method(kind, settings)
        assert isinstance(method, GaussianMethod)
        method.initialize(scene, RUN)
        for step in range(1, 5):
            before = method.model.sets["base"].parameters.tensors["beta_logits"].detach().clone()
            method.training_step(scene.train[0], step)
        after = method.model.sets["base"].parameters.tensors["beta_logits"].detach()
        moved[anew] = float((after - before).abs().max())
    assert moved[True] == pytest.approx(rates[kind], rel=1e-2)
    assert moved[False] < 0.7 * rates[kind]


def test_events_fall_on_the_released_steps() -> None:
    found = steps_of_events(initialized(), RUN)
    resets = list(range(3_000, 30_000, 3_000))
    between = [step for step in range(4_000, 24_001, 1_000) if step % 3_000]
    assert found["reset_base_opacity"] == found["reset_beta"] == resets
    assert found["sabotage"] == found["propagate"] == between
    grown = {*range(600, 3_001, 100), *range(3_500, 24_001, 500), *range(24_100, 30_000, 100)}
    recovering = {step for reset in resets for step in range(reset + 1, reset + 100)}
    assert set(found["densify_base"]) == grown - recovering


def test_its_rules_are_the_released_ones() -> None:
    """Learning rates and thresholds of the authors' code; those of 3DGS that it shares are tested with 3DGS."""
    method = initialized()
    begin(method, 3_001)
    groups = [group for optimizer in optimizers_of(method) for group in optimizer.param_groups]
    rates = {group["name"]: group["lr"] for group in groups}
    assert rates["beta_logits"] == pytest.approx(0.006)
    assert rates["texels"] == pytest.approx(0.05)
    assert rates["sh_dc"] == pytest.approx(0.0025)
    assert rates["quaternions"] == pytest.approx(0.001)
    rule = method.model.policies["base"].rule
    assert (rule.gradient_threshold, rule.min_opacity, rule.max_primitives) == (2e-4, 0.005, 0)
    assert (rule.min_coverage, rule.min_views, rule.max_growth) == (0, 0, 0)
    torch.testing.assert_close(beta_of(method.model), torch.full((200,), 1e-3))
    degrees = [
        method.model.gaussians("base", step).sh_degree for step in (10_000, 10_999, 11_000, 12_000, 13_000, 20_000)
    ]
    assert degrees == [0, 0, 1, 2, 3, 3]
    assert method.training_steps(100_000) == RUN


def test_normals_and_reflection_strength_justify_no_growth() -> None:
    """Nothing asks for the gradient from 30,000 on, when growth has ended."""
    method, pulled = initialized(), {}
    for step in (4_000, 30_000):
        drawn = method.model.rasterize(CAMERA, step)
        (drawn.normal.sum() + drawn.extras.sum()).backward()
        assert drawn.statistics.position_gradients is not None
        pulled[step] = bool(drawn.statistics.position_gradients.any())
    assert pulled == {4_000: False, 30_000: True}
    assert method.phase(29_999) != method.phase(30_000)


def test_its_map_starts_from_random_logits() -> None:
    """Uniform from −5 to 5, texel by texel."""
    method = initialized(envmap_size=32)
    begin(method, 3_001)
    logits = method.reflection.light.texels.detach().flatten()
    assert logits.shape == (6 * 32 * 32 * 3,)
    quantiles = torch.quantile(logits, torch.tensor([0.0, 0.25, 0.5, 0.75, 1.0]))
    torch.testing.assert_close(quantiles, torch.tensor([-5.0, -2.5, 0.0, 2.5, 5.0]), atol=0.2, rtol=0)


def test_normals_propagate_along_the_surface() -> None:
    """What reflects grows by a half, but not along its shortest axis."""
    method = initialized()
    parameters = method.model.sets["base"].parameters
    log_scales = torch.tensor([0.1, 0.01, 0.2]).log().repeat(200, 1)
    parameters.replace("log_scales", log_scales)
    beta = torch.cat([torch.full((100, 1), 0.01), torch.full((100, 1), 0.03)])
    parameters.replace("beta_logits", beta.logit())
    befall(method, 4_000, {"propagate"})
    growth = (parameters.tensors["log_scales"].detach() - log_scales).exp()
    torch.testing.assert_close(growth[:100], torch.ones(100, 3))
    torch.testing.assert_close(growth[100:], torch.tensor([1.5, 1.0, 1.5]).expand(100, 3))


def test_resets_raise_the_reflection_strength_to_its_start() -> None:
    method = initialized(initial_beta=0.1)
    method.model.sets["base"].parameters.replace("beta_logits", torch.tensor([0.01, 0.5]).logit().repeat(100)[:, None])
    befall(method, 3_000, {"reset_beta"})
    torch.testing.assert_close(beta_of(method.model), torch.tensor([0.1, 0.5]).repeat(100))


def test_only_the_ball_that_the_cameras_look_at_may_reflect() -> None:
    """The cameras of the tiny scene stand 4 from the origin: at half of that, points within 2 of it may."""
    method = initialized(scope_radius=0.5, warm_up=0)
    parameters = method.model.sets["base"].parameters
    inside = tiny_scene().points.norm(dim=1) <= 2
    assert 20 < inside.sum() < 180
    assert torch.equal(method.parts["disturbance"].may_reflect(), inside)

    before = {name: value.clone() for name, value in parameters.detached().items()}
    parameters.replace("beta_logits", torch.full((200, 1), 0.03).logit())
    for event in ("sabotage", "propagate", "reset_beta"):
        befall(method, 4_000, {event})
    now = parameters.detached()
    assert torch.equal((now["opacity_logits"] != before["opacity_logits"]), inside)
    assert torch.equal((now["log_scales"] != before["log_scales"]).any(1), inside)
    begin(method, 1)
    terms = method.losses(method.draw(CAMERA, 1)[0], torch.zeros(24, 32, 3), tiny_scene().test[0], 1)
    assert float(terms["scope"].detach()) == pytest.approx(0.4 * 0.03, rel=1e-5)
    terms["scope"].backward()
    assert torch.equal(parameters.tensors["beta_logits"].grad[:, 0] > 0, ~inside)


def test_a_pixel_is_the_blend_of_its_own_color_and_the_maps() -> None:
    method = initialized(warm_up=0)
    begin(method, 1)
    assert method.reflection.light.texels.shape == (6, 8, 8, 3)
    method.reflection.light.become(torch.randn(6, 8, 8, 3))
    method.model.sets["base"].parameters.replace("beta_logits", torch.zeros(200, 1))
    shown = method.render(CAMERA)
    base = method.model.rasterize(CAMERA, None)
    rays, normal = (functional.normalize(v, dim=-1) for v in (CAMERA.rays()[1], base.normal))
    mirrored = rays - 2 * (rays * normal).sum(-1, keepdim=True) * normal
    color = (
        sample_cubemap(method.reflection.light.texels.detach(), mirrored.reshape(-1, 3), layout_of(8))
        .sigmoid()
        .reshape(24, 32, 3)
    )
    strength = base.extras
    expected = (1 - strength) * base.color + strength * color
    solid = (base.alpha > 0.05) & (base.normal.norm(dim=-1) > 0.02)
    assert solid.any()
    torch.testing.assert_close(shown.color[solid], expected[solid], atol=1e-4, rtol=0)


@pytest.mark.slow
def test_reflections_alone_teach_normals_of_a_mirror() -> None:
    """Gaussians that lie on a mirror ball, flat, but turned by 20° on average, come to lie along it."""
    scene = mirror_ball()
    settings = {"envmap_size": 32, "initial_orientation": "surface", "initial_beta": 0.5, "sh_from": 30_000}
    settings |= {"map_start": "gray"}  # 400 steps are few to forget a random one
    method = create_method(
        "3dgs_dr", with_rules(**settings) | {"densify_until": 0, "disturb_every": 0, "opacity_reset_every": 0}
    )
    steps = 400
    method.initialize(scene, steps)
    parameters = method.model.sets["base"].parameters
    generator = torch.Generator().manual_seed(0)
    quaternions = parameters.tensors["quaternions"].detach()
    parameters.replace("quaternions", quaternions + 0.1 * torch.randn(quaternions.shape, generator=generator))
    flat = parameters.tensors["log_scales"].detach() + torch.tensor([0.0, 0.0, -math.log(10)])
    parameters.replace("log_scales", flat)
    parameters.replace("opacity_logits", torch.full((len(flat),), 2.0))

    before = quality(method, scene)
    for step in range(1, steps + 1):
        method.training_step(scene.train[5 * step % len(scene.train)], step)
    psnr, angle = quality(method, scene)
    assert psnr > before[0] + 5
    assert angle < 0.6 * before[1]
    assert angle < 10


def quality(method: DeferredReflection, scene: Scene) -> tuple[float, float]:
    """PSNR of the test views, and the mean angle in degrees of the normals on the ball."""

    def error(view: View) -> tuple[float, float]:
        shown = method.render(view.camera)
        return float((shown.color - view.rgb()).square().mean()), facing_angle(shown.normal, view)

    errors, angles = zip(*map(error, scene.test), strict=True)
    return -10 * math.log10(sum(errors) / len(errors)), sum(angles) / len(angles)
