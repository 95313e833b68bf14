"""What a primitive is worth to the pictures, against pictures drawn without it; and which ones go for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest
import torch
from core_scenes import plain_camera, random_rays, random_set
from schedules import befall, due
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, Rendering, View, rasterize, trace
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.gaussians.importance import removal_errors, without_least
from envgs_bench.methods.registry import create_method
from envgs_bench.testing import tiny_scene

RAYS = random_rays(33 * 33)
SH_0 = 0.28209479177387814  # the constant spherical harmonic, ½·√(1/π); a color is ½ and that times its coefficient


def draw(sets: Mapping[str, GaussianSet], camera: Camera) -> Rendering:
    """The base over gray, and half of what random rays see of the environment."""
    base = rasterize(sets["base"], camera, background=torch.full((3,), 0.5), backend="cpu")
    seen = trace(sets["env"], *RAYS, backend="cpu").color.reshape(base.color.shape)
    base.color = base.color + 0.5 * seen
    return base


def without(gaussians: GaussianSet, row: int) -> GaussianSet:
    others = torch.arange(len(gaussians)) != row
    return gaussians.map(lambda values: values[others])


def test_an_error_is_the_change_of_pictures_without_the_primitive() -> None:
    camera = plain_camera()
    sets = {"base": random_set(9), "env": random_set(7, extras=0, seed=1)}
    whole = draw(sets, camera).color
    view = View("view", camera, torch.zeros(whole.shape, dtype=torch.uint8))
    errors = removal_errors(sets, draw, [view])
    for name, gaussians in sets.items():
        expected = torch.stack(
            [
                (draw(sets | {name: without(gaussians, row)}, camera).color - whole).square().sum()
                for row in range(len(gaussians))
            ]
        )
        assert (expected > 0.01).sum() >= 5
        torch.testing.assert_close(errors[name], expected, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(
    ("most", "base", "env"),
    [
        (0.0, [True, False, True], [True, True]),  # what no view shows goes for nothing
        (3.9, [False, False, True], [True, True]),
        (4.0, [False, False, True], [False, True]),
        (1e9, [False, False, True], [False, True]),  # the last of a set stays
    ],
)
def test_the_least_go_first_whichever_set_they_are_of(most: float, base: list[bool], env: list[bool]) -> None:
    errors: dict[str, Tensor] = {"base": torch.tensor([1.0, 0.0, 9.0]), "env": torch.tensor([3.0, 5.0])}

    def lacking(kept: Mapping[str, Tensor]) -> float:
        return sum(float(errors[name][~rows].sum()) for name, rows in kept.items())

    kept = without_least(errors, most, lacking)
    assert kept["base"].tolist() == base
    assert kept["env"].tolist() == env


REFLECTS = {"warm_up": 9_000, "env_grid": 3, "env_far_count": 50}


def trained(kind: str, steps: int, **settings: Any) -> GaussianMethod:
    """In a run of 60 steps."""
    method = create_method(kind, settings | (REFLECTS if kind == "envgs" else {}), seed=1)
    assert isinstance(method, GaussianMethod)
    scene = tiny_scene()
    method.initialize(scene, 60)
    for step in range(1, steps + 1):
        method.training_step(scene.train[step % len(scene.train)], step)
    return method


def squared_error(method: GaussianMethod) -> float:
    method.model.prepared.clear()
    return sum(float((method.render(v.camera).color - v.rgb("cpu")).square().sum()) for v in tiny_scene().train)


@pytest.mark.parametrize("kind", ["2dgs", "3dgs", "envgs"])
def test_published_prunings_go_by_opacity_or_by_what_a_primitive_fills(kind: str) -> None:
    """What it fills of the views: their pictures' sum where it alone is white, and all else black."""
    method = trained(kind, 3, prune_by="opacity")
    assert method.drawn is not None
    opacities = method.model.sets["base"].parameters.tensors["opacity_logits"].detach().sigmoid()
    torch.testing.assert_close(method.drawn.worth()["base"], opacities)
    method = trained(kind, 3, prune_by="weight")
    assert method.drawn is not None
    with torch.no_grad():
        weights = method.drawn.worth()["base"]
        method.prepare()
        base = method.model.prepared["base"]
        for row in weights.argsort(descending=True)[:20:3].tolist():
            sh = torch.full_like(base.sh, 0.0)
            sh[:, 0] = -0.5 / SH_0
            sh[row, 0] = 0.5 / SH_0
            shown = replace(base, sh=sh, extras=None)
            drawn = [rasterize(shown, view.camera, near=method.model.near).color for view in tiny_scene().train]
            assert float(weights[row]) == pytest.approx(
                sum(float(picture[..., 0].sum()) for picture in drawn), rel=1e-3
            )


@pytest.mark.parametrize("kind", ["2dgs", "3dgs", "envgs"])
def test_a_pruning_leaves_what_the_pictures_need(kind: str) -> None:
    method = trained(kind, 29, prune_error=0.02, prune_from=10_000, densify_until=0)
    assert [step for step in range(1, 61) if "prune" in due(method, step)] == [30]
    before, count = squared_error(method), sum(method.primitives().values())
    with torch.no_grad():
        befall(method, 30, {"prune"})
    assert sum(method.primitives().values()) < count
    assert squared_error(method) <= 1.02 * before * (1 + 1e-3)
    assert all(len(s.record.weights) == len(s.parameters) for s in method.model.sets.values())
    method.training_step(tiny_scene().train[0], 30)


@pytest.mark.parametrize("growth", ["gradient", "mcmc", "guided"])
def test_nothing_grows_after_a_pruning_and_an_interruption_forgets_none(growth: str) -> None:
    grows = {"densify_until": 30_000, "max_primitives": 250, "densify_threshold": 1e-9, "min_coverage": 0.0}
    grows |= {"rules": {"growth": growth, "min_views": 0.0}}
    method = trained("2dgs", 29, prune_error=0.02, prune_from=10_000, **grows)
    method.model.densify("base", 29)
    grown = method.primitives()["base"]
    assert grown > 200
    with torch.no_grad():
        befall(method, 30, {"prune"})
        left = method.primitives()["base"]
        again = create_method("2dgs", {"prune_error": 0.02, "prune_from": 10_000, **grows}, seed=1)
        again.resume(tiny_scene(), 60, method.training_state() or {})
        for each in (method, again):
            assert isinstance(each, GaussianMethod)
            each.model.densify("base", 30)
            assert each.primitives()["base"] <= left < grown


@pytest.mark.parametrize("growth", ["mcmc", "guided"])
@pytest.mark.parametrize(("limit", "until", "pruned"), [(400, 30_000, False), (400, 10_000, True), (205, 30_000, True)])
def test_prunings_wait_until_growth_has_filled_the_size_limit_or_ends(
    growth: str, limit: int, until: int, pruned: bool
) -> None:
    own = {"prune_error": 0.02, "prune_from": 10_000, "max_primitives": limit, "densify_until": until}
    method = trained("2dgs", 1, rules={"growth": growth}, **own)
    assert ("prune" in due(method, 30)) == pruned


def test_what_a_pruning_costs_is_told_by_a_few_views_from_all_over() -> None:
    method, scene = create_method("2dgs", {}, seed=1), tiny_scene()
    assert isinstance(method, GaussianMethod)
    for count, sampled in ((5, [0, 1, 2, 3, 4]), (40, list(range(0, 40, 3)))):
        views = [replace(scene.train[index % 5], name=str(index)) for index in range(count)]
        method.initialize(replace(scene, train=views), 60)
        assert method.drawn is not None
        assert [view.name for view in method.drawn.sample()] == [str(index) for index in sampled]
        assert len(list(method.drawn.views())) == count


def test_errors_reach_through_reflections() -> None:
    """Exact for what reflected rays meet; of the base, in order, as β and the rays change too."""
    method = trained("envgs", 29)
    view = tiny_scene().train[0]
    method.prepare()
    sets = dict(method.model.prepared)

    def picture(shown: Mapping[str, GaussianSet], camera: Camera) -> Rendering:
        method.model.prepared = dict(shown)
        method.parts["reflection"].prepare()  # rays are traced through the opacities that they were prepared with
        return method.draw(camera, None)[0]

    errors = removal_errors(sets, picture, [view])
    whole = picture(sets, view.camera).color.detach()
    for name in ("base", "env"):
        rows = errors[name].argsort(descending=True)[:40]
        drawn = []
        for row in rows.tolist():
            opacities = sets[name].opacities.clone()
            opacities[row] = 0.0
            shown = sets | {name: replace(sets[name], opacities=opacities)}
            drawn.append((picture(shown, view.camera).color.detach() - whole).square().sum())
        expected, found = torch.stack(drawn), errors[name][rows]
        if name == "env":
            torch.testing.assert_close(found, expected, rtol=0.02, atol=1e-4)
        else:
            assert torch.corrcoef(torch.stack([found, expected]))[0, 1] > 0.98
