"""How a reflection is blended, which rays are traced, and what the events of a reflective method's training do."""

from dataclasses import replace

import pytest
import torch
from reflection_scenes import HEIGHT, WIDTH, make_camera, make_rendering, mirror
from rules import with_rules
from schedules import befall, begin, due

from envgs_bench.core import Scene, View
from envgs_bench.methods.envmap import EnvMap, EnvMapSettings
from envgs_bench.methods.registry import create_method


@pytest.mark.parametrize("joint", [True, False])
def test_joint_optimization_lets_gradients_through(joint):
    camera = make_camera()
    rendering = mirror(camera, torch.tensor([0.0, 0.0, -1.0]), -4.0)
    rendering.depth.requires_grad_()
    rendering.normal = rendering.normal.clone().requires_grad_()
    method = EnvMap(EnvMapSettings(envmap_size=4, joint=joint))
    origins, directions, _ = method.reflection.rays(rendering, camera, 1)
    assert origins.requires_grad == directions.requires_grad == joint
    if joint:
        depth, normal = rendering.depth, rendering.normal
        (origins.sum() + directions.sum()).backward()
        assert depth.grad is not None
        assert depth.grad.abs().sum() > 0
        assert normal.grad is not None
        assert normal.grad.abs().sum() > 0


@pytest.mark.parametrize("least", [0.0, 0.5, 1.0])
def test_reflected_rays_move_the_surface_where_it_reflects_more_than_at_the_start(least):
    """Pixels whose β is at least that share of initial_beta have gradients."""
    camera = make_camera()
    shown = mirror(camera, torch.tensor([0.0, 0.0, -1.0]), -4.0)
    beta = torch.rand(HEIGHT, WIDTH, generator=torch.Generator().manual_seed(0))
    rendering = make_rendering(shown.depth, shown.normal.clone().requires_grad_(), shown.alpha, beta)
    method = EnvMap(EnvMapSettings(envmap_size=4, initial_beta=0.3, rules={"joint_from": least}))
    origins, directions, _ = method.reflection.rays(rendering, camera, 1)
    weights = torch.rand(HEIGHT, WIDTH, 3, generator=torch.Generator().manual_seed(1))
    (weights * (origins + directions)).sum().backward()
    moved = rendering.normal.grad.abs().sum(-1) > 0
    assert torch.equal(moved, beta >= least * 0.3)


@pytest.mark.parametrize(("step", "filtered"), [(None, True), (50, False), (51, True)])
def test_pixels_of_little_alpha_do_not_reflect_late_in_training_and_in_images(step, filtered):
    """From half of a run of 100 steps on, alpha must be above 0.75; so far 0.01 is enough."""
    camera = make_camera()
    shown = mirror(camera, torch.tensor([0.0, 0.0, -1.0]), -4.0)
    shown.alpha[0], shown.alpha[1], shown.alpha[2] = 0.74, 0.76, 0.009
    method, _ = initialized(100, reflect_alpha=0.75, reflect_alpha_from=15_000)
    _, directions, beta = method.reflection.rays(shown, camera, step)
    expected = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    expected[0], expected[2] = not filtered, False
    assert torch.equal(directions.any(-1), expected)
    assert torch.equal(beta, torch.where(expected, 0.5, 0.0))


def test_base_and_reflection_are_blended_by_beta(monkeypatch):
    """Equation 5, pixel by pixel, with a cube map of one color; pixels without a surface keep the base color."""
    camera = make_camera()
    beta = torch.rand(HEIGHT, WIDTH, generator=torch.Generator().manual_seed(0))
    shown = mirror(camera, torch.tensor([0.0, 0.0, -1.0]), -4.0)
    alpha = shown.alpha.clone()
    alpha[3] = 0
    rendering = make_rendering(shown.depth, shown.normal, alpha, beta)
    method = EnvMap(EnvMapSettings(envmap_size=4, rules={"beta_threshold": 0.2}))
    method.reflection.light.become(torch.logit(torch.tensor([0.9, 0.5, 0.2])).expand(6, 4, 4, 3).clone())
    method.reflection.begun = True
    monkeypatch.setattr(method.model, "rasterize", lambda camera, step: rendering)
    image = method.draw(camera, None)[0]

    expected = (1 - beta[..., None]) * 0.25 + beta[..., None] * torch.tensor([0.9, 0.5, 0.2])
    expected[beta <= 0.2] = 0.25
    expected[3] = 0.25
    torch.testing.assert_close(image.color.detach(), expected)
    assert set(image.layers) == {"base", "reflection", "beta"}
    assert torch.equal(image.layers["beta"][..., 0], beta)


@pytest.mark.parametrize(("share", "traced"), [(0.0, 256), (0.5, 160), (0.75, 80), (0.9, 32)])
def test_the_filter_traces_the_pixels_of_the_greatest_beta(monkeypatch, share, traced):
    """With β rising over 320 pixels from 0 to 1, the threshold 0.199 leaves 256 and the filter its share of all 320."""
    beta = torch.linspace(0, 1, WIDTH * HEIGHT).reshape(HEIGHT, WIDTH)
    shown = mirror(make_camera(), torch.tensor([0.0, 0.0, -1.0]), -4.0)
    rendering = make_rendering(shown.depth, shown.normal, shown.alpha, beta)
    method = EnvMap(EnvMapSettings(envmap_size=4, rules={"beta_threshold": 0.199}, beta_filter=share))
    method.reflection.begun = True
    monkeypatch.setattr(method.model, "rasterize", lambda camera, step: rendering)
    image = method.draw(make_camera(), None)[0]
    seen = image.layers["reflection"].sum(-1).reshape(-1) > 0
    assert seen.sum() == traced
    assert seen[-traced:].all()


def test_the_default_threshold_moves_no_pixel_visibly(monkeypatch):
    """Colors in [0, 1] and β up to 2/255: what is left out is at most 1/255, and half of the rays are left out."""
    generator = torch.Generator().manual_seed(2)
    shown = mirror(make_camera(), torch.tensor([0.0, 0.0, -1.0]), -4.0)
    beta = 2 / 255 * torch.rand(HEIGHT, WIDTH, generator=generator)
    rendering = make_rendering(shown.depth, shown.normal, shown.alpha, beta)
    rendering.color = torch.rand(HEIGHT, WIDTH, 3, generator=generator).round()
    images = {}
    for name, settings in {
        "default": EnvMapSettings(envmap_size=4),
        "all": EnvMapSettings(envmap_size=4, rules={"beta_threshold": 0.0}),
    }.items():
        method = EnvMap(settings)
        method.reflection.light.become(20 * torch.randn(6, 4, 4, 3, generator=torch.Generator().manual_seed(3)))
        method.reflection.begun = True
        monkeypatch.setattr(method.model, "rasterize", lambda camera, step: rendering)
        images[name] = method.draw(make_camera(), None)[0]
    traced = [(image.layers["reflection"].sum(-1) > 0).float().mean() for image in images.values()]
    assert traced[0] < 0.6 < 0.9 < traced[1]
    difference = (images["default"].color - images["all"].color).abs()
    assert 0.5 / 255 < difference.max() <= 1 / 255 + 1e-6


def test_envgs_and_envmap_differ_in_the_reflected_color_only():
    """The shared settings have one default, and the shared class decides everything but that color."""
    envgs, envmap = create_method("envgs"), create_method("envmap")
    shared = set(vars(envgs.settings)) & set(vars(envmap.settings))
    assert {name: getattr(envgs.settings, name) for name in shared} == {
        name: getattr(envmap.settings, name) for name in shared
    }
    for name in ("draw", "losses", "phase", "training_step"):
        assert getattr(type(envgs), name) is getattr(type(envmap), name), name
    assert type(envgs.reflection) is type(envmap.reflection)
    assert type(envgs.parts["disturbance"]) is type(envmap.parts["disturbance"])


def test_the_environment_grows_by_the_bases_rule_but_for_its_threshold_and_its_cap():
    settings = {"min_coverage": 2.0, "min_views": 4.0, "env_densify_threshold": 0.5, "env_max_primitives": 7}
    method = create_method("envgs", with_rules(**settings))
    base, env = method.model.policies["base"].rule, method.model.policies["env"].rule
    assert env == replace(base, gradient_threshold=0.5, max_primitives=7)
    assert (env.min_coverage, env.min_views) == (2.0, 4.0)


def test_the_views_own_normals_count_where_something_reflects():
    beta = torch.zeros(HEIGHT, WIDTH)
    beta[0, :4] = torch.tensor([0.001, 0.05, 0.1, 0.7])
    shown = mirror(make_camera(), torch.tensor([0.0, 0.0, -1.0]), -4.0)
    rendering = make_rendering(shown.depth, shown.normal, shown.alpha, beta)
    method = EnvMap(EnvMapSettings(envmap_size=4, initial_beta=0.1, rules={"mono_floor": 0.2}))
    weights = method.reflection.mono_weights(rendering)
    torch.testing.assert_close(weights[0, :5], torch.tensor([0.2, 0.5, 1.0, 1.0, 0.2]))
    assert EnvMap(EnvMapSettings(envmap_size=4, rules={"mono_floor": 1.0})).reflection.mono_weights(rendering) is None


def initialized(steps: int, **settings) -> tuple[EnvMap, View]:
    """An environment-map method after `initialize` over three points, and the view that it trains on."""
    method = create_method("envmap", with_rules(**settings))
    view = View("a", make_camera(), torch.zeros(HEIGHT, WIDTH, 3, dtype=torch.uint8))
    method.initialize(Scene("three", [view], [view], torch.eye(3), torch.full((3, 3), 0.5)), steps)
    return method, view


def trained_base(**settings) -> EnvMap:
    """A method in a run of 3,000 steps, its three primitives with β 0.01, 0.03 and 0.2."""
    method, _ = initialized(3000, **{"envmap_size": 4, "disturb_every": 1000, **settings})
    method.model.sets["base"].parameters.replace("beta_logits", torch.logit(torch.tensor([[0.01], [0.03], [0.2]])))
    return method


def test_sabotage_disturbs_what_does_not_reflect():
    method = trained_base()
    before = method.model.sets["base"].parameters.tensors["sh_dc"].detach().clone()
    befall(method, 1, {"sabotage"})
    change = (method.model.sets["base"].parameters.tensors["sh_dc"].detach() - before).abs().amax(dim=(1, 2))
    assert (change[:2] > 0).all()
    assert change.max() <= 0.4
    assert change[2] == 0


def test_propagation_grows_what_reflects_and_holds_opacities():
    method = trained_base()
    parameters = method.model.sets["base"].parameters
    before = parameters.tensors["log_scales"].detach().exp().clone()
    befall(method, 100, {"propagate"})
    growth = parameters.tensors["log_scales"].detach().exp() / before
    torch.testing.assert_close(growth, torch.tensor([[1.0, 1.0], [1.5, 1.5], [1.5, 1.5]]))
    torch.testing.assert_close(parameters.tensors["opacity_logits"].sigmoid().detach(), torch.full((3,), 0.9))
    rates = []
    for step in (101, 120, 121):  # 200 of 30,000 steps are 20 of 3,000
        begin(method, step)
        rates.append({g["name"]: g["lr"] for g in parameters.optimizer.param_groups}["opacity_logits"])
    assert rates == [0.0, 0.0, 0.05]


@pytest.mark.parametrize(
    ("first", "expected"), [(6_000, [0.01, 0.02, 0.02]), (9_000, [0.01, 0.03, 0.2]), (0, [0.01, 0.03, 0.2])]
)
def test_beta_resets(first, expected):
    method = trained_base(beta_reset_from=first, initial_beta=0.02, growth="gradient")  # with its opacity resets
    step = 600  # 6,000 of 30,000
    befall(method, step, due(method, step) & {"reset_beta"})
    found = method.model.sets["base"].parameters.tensors["beta_logits"].detach().sigmoid()[:, 0]
    torch.testing.assert_close(found, torch.tensor(expected))


def test_the_opacity_reset_leaves_what_is_below():
    method = trained_base(growth="gradient")
    parameters = method.model.sets["base"].parameters
    parameters.replace("opacity_logits", torch.logit(torch.tensor([0.005, 0.01, 0.8])))
    befall(method, 1, {"reset_base_opacity"})
    torch.testing.assert_close(
        parameters.tensors["opacity_logits"].detach().sigmoid(), torch.tensor([0.005, 0.01, 0.01])
    )


def test_the_environment_map_doubles_three_times_and_keeps_what_it_showed():
    method = trained_base(envmap_size=32)
    directions = torch.nn.functional.normalize(torch.randn(500, 3), dim=-1)
    sizes = {}
    for step in range(1, 3001):
        before = method.reflection.light.texels.shape[1], method.reflection.light.color(None, directions, step)[0]
        begin(method, step)
        size = method.reflection.light.texels.shape[1]
        if size != before[0]:
            sizes[step] = size
            if step > 301:
                after = method.reflection.light.color(None, directions, step)[0]
                assert (after - before[1]).abs().mean() < 0.6 * (before[1] - before[1].mean(0)).abs().mean()
            method.reflection.light.become(torch.randn(6, size, size, 3))
    assert sizes == {301: 4, 750: 8, 1350: 16, 2100: 32}


@pytest.mark.parametrize("steps", [1, 2, 7])
def test_the_shortest_run_ends_with_a_whole_map(steps, tmp_path):
    method, view = initialized(steps, envmap_size=16)
    for step in range(1, steps + 1):
        method.training_step(view, step)
    method.save(tmp_path)
    create_method("envmap", {"envmap_size": 16}).load(tmp_path)
    assert method.reflection.light.texels.shape[1] == 16


@pytest.mark.parametrize("stop", [305, 800, 2_500])
def test_what_an_interrupted_training_left_is_read_while_its_map_is_small(stop, tmp_path):
    method = trained_base(envmap_size=32)
    for step in (301, stop):
        begin(method, step)
    method.save(tmp_path)
    read = create_method("envmap", {"envmap_size": 32})
    read.load(tmp_path)
    assert read.reflection.light.texels.shape[1] == {305: 4, 800: 8, 2_500: 32}[stop]
    torch.testing.assert_close(read.reflection.light.texels, method.reflection.light.texels)
    with pytest.raises(ValueError, match="expected 64: envmap_size is 64"):
        create_method("envmap", {"envmap_size": 64, "envmap_doublings": 0}).load(tmp_path)
