"""What reflected rays see of the set that they are traced through."""

import pytest
import torch
from reflection_scenes import HEIGHT, WIDTH, make_camera
from rules import with_rules
from torch import Tensor

from envgs_bench.core import Scene, View
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.gaussians.initialization import initial_tensors
from envgs_bench.methods.lighting import reflection
from envgs_bench.methods.method import Budget
from envgs_bench.methods.registry import create_method
from envgs_bench.testing import check_method, tiny_scene


def facing_a_wall(
    z: float = 3.0, background: tuple[float, ...] = (0.0, 0.0, 0.0), kind: str = "envgs", **settings
) -> GaussianMethod:
    """A method whose environment is one wide surfel in the plane of that z, nearly opaque, red from below."""
    method = create_method(kind, with_rules(backend="cpu", sh_degree=1, **settings))
    assert isinstance(method, GaussianMethod)
    assert isinstance(method.reflection.light, reflection.Traced)
    name = method.reflection.light.name
    view = View("view", make_camera(), torch.zeros(HEIGHT, WIDTH, 3, dtype=torch.uint8))
    scene = Scene("wall", [view], [], torch.rand(8, 3), torch.rand(8, 3), background=torch.tensor(background))
    method.initialize(scene, 100)
    tensors = initial_tensors(
        torch.tensor([[0.0, 0.0, z]]),
        torch.full((1, 3), 0.5),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        axes=2,
        sh_degree=1,
        opacity=0.9,
        beta=None,
        radius=1.0,
    )
    tensors["log_scales"] = torch.full((1, 2), 2.0)
    tensors["sh_rest"][0, 0, 0] = 0.5
    if name == "base":
        tensors["beta_logits"] = torch.zeros(1, 1)
    method.restore({**method.state(), "reflects": True, "sets": {**method.state()["sets"], name: tensors}})
    method.prepare()
    return method


def seen(method: GaussianMethod, origins: Tensor, directions: Tensor, step: int | None) -> Tensor:
    with torch.set_grad_enabled(step is not None):
        return method.reflection.light.color(origins, directions, step)[0]


@pytest.mark.parametrize("step", [None, 50])
@pytest.mark.parametrize("sh_direction", ["center", "ray"])
def test_parallel_rays_see_one_color_along_the_ray_and_two_toward_the_center(sh_direction, step):
    method = facing_a_wall(traced_sh_direction=sh_direction)
    origins = torch.tensor([[[0.0, -2.0, 0.0], [0.0, 2.0, 0.0]]])
    directions = torch.tensor([[[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]])
    below, above = seen(method, origins, directions, step)[0]
    difference = (below - above).abs()
    if sh_direction == "ray":
        assert difference.max() < 1e-6
    else:
        assert difference[0] > 0.1
        assert difference[1:].max() < 1e-6


@pytest.mark.parametrize("step", [None, 50])
@pytest.mark.parametrize(("behind", "expected"), [("scene", (0.2, 0.4, 0.8)), ("black", (0.0, 0.0, 0.0))])
def test_what_is_behind_the_environment(behind, expected, step):
    method = facing_a_wall(background=(0.2, 0.4, 0.8), traced_background=behind)
    away = seen(method, torch.zeros(1, 1, 3), torch.tensor([[[0.0, 0.0, -1.0]]]), step)
    assert away[0, 0].tolist() == pytest.approx(expected)


@pytest.mark.parametrize("kind", ["envgs", "envgs_single_set"])
@pytest.mark.parametrize("step", [None, 50])
def test_a_map_behind_what_is_traced_shows_as_far_as_a_background_would(step, kind):
    """Between black and white the background's share is known; the map has one color."""
    rays = (
        torch.zeros(1, 3, 3),
        torch.nn.functional.normalize(torch.tensor([[[0.1, 0.2, 1.0], [0.9, -0.4, 0.3], [0.3, 0.1, -1.0]]]), dim=-1),
    )
    black, white = (seen(facing_a_wall(background=(level,) * 3, kind=kind), *rays, step) for level in (0.0, 1.0))
    method = facing_a_wall(kind=kind, traced_background="map")
    logits = torch.tensor([1.5, -0.5, 0.25])
    method.restore({**method.state(), "texels": logits.expand(6, 16, 16, 3).clone()})
    method.prepare()
    torch.testing.assert_close(seen(method, *rays, step), black + (white - black) * logits.sigmoid())
    first, _, last = (white - black)[0, :, 0].tolist()
    assert 0 < first < 0.2 < 0.99 < last


@pytest.mark.parametrize("kind", ["envgs", "envgs_single_set"])
def test_what_a_map_behind_what_is_traced_learns_are_differences(kind):
    method = facing_a_wall(kind=kind, traced_background="map")
    generator = torch.Generator().manual_seed(0)
    rays = torch.zeros(4, 4, 3), torch.nn.functional.normalize(torch.randn(4, 4, 3, generator=generator), dim=-1)
    texels = torch.randn(6, 16, 16, 3, generator=generator)
    step = torch.randn(texels.shape, generator=generator)
    method.restore({**method.state(), "texels": texels})
    seen(method, *rays, 50).sum().backward()
    learned = float((method.parts["far_map"].texels.grad * step).sum())
    sums = []
    for sign in (1, -1):
        method.restore({**method.state(), "texels": texels + sign * 1e-2 * step})
        sums.append(float(seen(method, *rays, 50).detach().sum()))
    assert learned == pytest.approx((sums[0] - sums[1]) / 2e-2, rel=2e-3)


def test_a_budget_counts_the_map_behind_the_environment():
    method = facing_a_wall(traced_background="map")
    with pytest.raises(ValueError, match=r"besides 1\.18 MB that are no primitives"):
        method.limit(Budget(mb=1.18))
    assert method.model_bytes()["env"] == 4 * 6 * 128**2 * 3 + facing_a_wall().model_bytes()["env"]


@pytest.mark.parametrize("step", [None, 50])
def test_hits_nearer_than_the_setting_are_not_drawn(step):
    method = facing_a_wall(traced_near=0.06)
    origins = torch.tensor([[[0.0, 0.0, 3 - 0.059], [0.0, 0.0, 3 - 0.061]]])
    drawn = seen(method, origins, torch.tensor([[[0.0, 0.0, 1.0]] * 2]), step)
    assert drawn.any(dim=-1).tolist() == [[False, True]]


@pytest.mark.parametrize("kind", ["envgs", "envgs_single_set"])
def test_only_what_nobody_differentiates_is_traced_for_color_alone(kind, monkeypatch):
    method, called = facing_a_wall(kind=kind), []
    for name in ("trace", "trace_color"):
        draw = getattr(reflection, name)
        monkeypatch.setattr(reflection, name, lambda *a, n=name, d=draw, **k: called.append(n) or d(*a, **k))
    rays = torch.zeros(1, 1, 3), torch.tensor([[[0.0, 0.0, 1.0]]])
    image = method.monitor.reflected(rays[0][0], rays[1][0])
    with torch.no_grad():
        picture, statistics = method.reflection.light.color(*rays, None)
    assert called == ["trace_color"] * 2
    assert statistics == {}
    recorded, _ = method.reflection.light.color(*rays, None)  # as pruning draws it
    learned, statistics = method.reflection.light.color(*rays, 50)
    assert called[2:] == ["trace"] * 2
    assert statistics.keys() == ({"env"} if kind == "envgs" else set())
    for color in (image[None], picture, recorded, learned):
        torch.testing.assert_close(color, picture)


@pytest.mark.parametrize("step", [None, 50])
def test_what_would_not_be_seen_is_not_traced(step):
    """Behind what leaves a twentieth of the light, a ray goes on where its weight lets that be seen."""
    method = facing_a_wall(background=(1.0, 1.0, 1.0))
    tensors = method.state()["sets"]["env"]
    several = {name: values.repeat(4, *[1] * (values.ndim - 1)) for name, values in tensors.items()}
    several["means"] = torch.tensor([[0.0, 0.0, 3.0 + k] for k in range(4)])
    several["sh_dc"] = several["sh_dc"] * 0 - 0.5 / 0.28209479  # black
    several["sh_rest"] = several["sh_rest"] * 0
    several["opacity_logits"] = torch.full((4, 1), 0.95).logit().reshape(several["opacity_logits"].shape)
    method.restore({**method.state(), "sets": {**method.state()["sets"], "env": several}})
    method.prepare()
    beta = torch.tensor([[1.0, 0.5, 0.01]])
    rays = torch.zeros(1, 3, 3), torch.tensor([[[0.0, 0.0, 1.0]]]).repeat(1, 3, 1)
    with torch.set_grad_enabled(step is not None):
        every, some = (method.reflection.light.color(*rays, step, weights)[0] for weights in (None, beta))
    left = some[0, :, 0].tolist()  # of the background's light
    assert left == pytest.approx([0.05**2, 0.05**2, 0.05], rel=0.02, abs=2e-4)
    assert every[0, :, 0].tolist() == pytest.approx([0.05**4] * 3, abs=2e-4)
    assert float((beta * (some - every).detach().abs().amax(dim=-1)).max()) <= 1 / 255


def test_an_unknown_background_is_refused():
    with pytest.raises(ValueError, match="traced_background is 'white', expected 'scene', 'black' or 'map'"):
        create_method("envgs", with_rules(traced_background="white"))


def test_an_unknown_direction_of_color_is_refused():
    with pytest.raises(ValueError, match="traced_sh_direction is 'mean', expected 'center' or 'ray'"):
        create_method("envgs", with_rules(traced_sh_direction="mean"))


def reflecting(env_start: str, budget: Budget | None = None) -> GaussianMethod:
    """A method of which the step before the first reflection has just been taken."""
    settings = {"env_start": env_start, "backend": "cpu", "warm_up": 6_000, "env_grid": 2, "env_far_count": 10}
    method, scene = create_method("envgs", settings), tiny_scene()
    assert isinstance(method, GaussianMethod)
    if budget:
        method.limit(budget)
    method.initialize(scene, 30)
    for step in range(1, 7):
        method.training_step(scene.train[0], step)
    method.reflection.begin_step(7)
    return method


def test_an_environment_that_starts_as_the_base_shows_what_the_base_shows():
    method = reflecting("base")
    base, env = (method.model.sets[name].parameters.tensors for name in ("base", "env"))
    assert set(base) - set(env) == {"beta_logits"}
    for field, values in env.items():
        assert torch.equal(values, base[field]), field
        assert values is not base[field]
    random = reflecting("random").model.sets["env"].parameters.tensors
    assert len(random["means"]) != len(base["means"])


def test_a_copy_of_the_base_keeps_to_the_budget():
    method = reflecting("base", Budget(primitives=150))
    sizes = method.primitives()
    assert sum(sizes.values()) <= 150
    assert sizes["env"] > 0


def test_a_method_whose_environment_starts_as_the_base_conforms():
    check_method("envgs", {"env_start": "base", "warm_up": 9_000})
