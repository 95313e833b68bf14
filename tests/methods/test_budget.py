"""A budget holds at every moment, is shared by contribution, and is refused where no model fits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from rules import with_rules

from envgs_bench.core import Rendering, Statistics
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.gaussians.budget import FIRST_SHARE, LEAST_PRIMITIVES, LEAST_SHARE, SharedBudget
from envgs_bench.methods.gaussians.importance import least_of
from envgs_bench.methods.gaussians.initialization import evenly_thinned
from envgs_bench.methods.gaussians.parameters import GaussianParameters
from envgs_bench.methods.method import Budget
from envgs_bench.methods.registry import BUILT_IN, create_method
from envgs_bench.testing import tiny_scene

BASE_BYTES, ENV_BYTES = 4 * 38, 4 * 37
BOTH = {"base": BASE_BYTES, "env": ENV_BYTES}
NO_BOUND = {"base": 0, "env": 0}
GROWS = with_rules(growth="gradient", densify_threshold=1e-9, min_coverage=0.0, min_views=0.0, primitives_per_pixel=0.0)
REFLECTS = {"warm_up": 300, "densify_until": 30_000, **GROWS}
METHODS: dict[str, dict[str, Any]] = {
    "2dgs": GROWS,
    "3dgs": GROWS,  # doubles, without max_growth
    "envmap": {**REFLECTS, "envmap_size": 16},
    "envgs": {
        **REFLECTS,
        **{"env_densify_threshold": 1e-9, "env_densify_until": 30_000, "env_grid": 4},
        "env_far_count": 90,
    },
    "envgs_single_set": REFLECTS,
    "ref_gaussian": {**GROWS, "densify_until": 30_000, "envmap_size": 16},
    "3igs": {**GROWS, "densify_until": 30_000, "field_size": 4},
    "3dgs_dr": {**REFLECTS, "envmap_size": 16},
    "gaussian_shader": {**GROWS, "densify_until": 30_000, "envmap_size": 16},
    "ref_gs": {**GROWS, "densify_until": 30_000, "map_levels": 4},
    "rt_splatting": {**REFLECTS, "map_levels": 4, "perceptual_weight": 0.0},  # VGG-16 would be most of a step
}
STEPS = 155  # reflections from step 2 on; sets grow every 30 steps, the environment from 120 on


class Largest:
    """The largest sizes of a method at any moment: whenever any tensor of a set has been replaced."""

    def __init__(self, method: GaussianMethod, patch: pytest.MonkeyPatch) -> None:
        self.method, self.primitives, self.bytes, self.changes = method, 0, 0, 0
        swap = GaussianParameters._swap

        def watched(*arguments: Any) -> None:
            swap(*arguments)
            self.look()

        patch.setattr(GaussianParameters, "_swap", watched)

    def look(self) -> None:
        fields = [[len(value) for value in s.parameters.tensors.values()] for s in self.method.model.sets.values()]
        self.primitives = max(self.primitives, sum(max(lengths) for lengths in fields))
        self.bytes = max(self.bytes, sum(self.method.model_bytes().values()))
        self.changes += 1


@pytest.mark.parametrize(
    ("kind", "budget"),
    [
        ("2dgs", Budget(primitives=400, mb=1.0)),
        ("3dgs", Budget(mb=0.06)),
        ("envmap", Budget(mb=0.06)),
        ("envgs", Budget(primitives=400, mb=0.05)),
        pytest.param("2dgs", Budget(primitives=150), marks=pytest.mark.slow),
        pytest.param("3dgs", Budget(primitives=333), marks=pytest.mark.slow),
        pytest.param("envmap", Budget(primitives=257), marks=pytest.mark.slow),
        pytest.param("envgs", Budget(primitives=140), marks=pytest.mark.slow),
        pytest.param("envgs", Budget(primitives=450), marks=pytest.mark.slow),
        pytest.param("ref_gaussian", Budget(mb=0.15), marks=pytest.mark.slow),
        pytest.param("3igs", Budget(mb=0.3), marks=pytest.mark.slow),
        pytest.param("envgs_single_set", Budget(primitives=300), marks=pytest.mark.slow),
        pytest.param("3dgs_dr", Budget(primitives=300), marks=pytest.mark.slow),
        pytest.param("gaussian_shader", Budget(primitives=300), marks=pytest.mark.slow),
        pytest.param("ref_gs", Budget(mb=0.42), marks=pytest.mark.slow),
        pytest.param("rt_splatting", Budget(primitives=300), marks=pytest.mark.slow),
    ],
)
def test_no_moment_of_a_training_is_above_the_budget(
    kind: str, budget: Budget, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = tiny_scene()
    method = create_method(kind, METHODS[kind], seed=1)
    assert isinstance(method, GaussianMethod)
    method.limit(budget)
    largest = Largest(method, monkeypatch)
    steps = STEPS if kind == "envgs" else 95
    method.initialize(scene, steps)
    for step in range(1, steps + 1):
        largest.look()
        method.training_step(scene.train[step % len(scene.train)], step)
        largest.look()
    method.render(scene.test[0].camera)
    assert largest.changes > 2 * steps
    most, most_bytes = budget.primitives or 10**9, 1e6 * (budget.mb or 1e9)
    assert largest.primitives <= most
    assert largest.bytes <= most_bytes
    used = max(largest.primitives / most, largest.bytes / most_bytes)
    assert used > 0.9  # the budget is what holds them, not a lack of growth


@pytest.mark.parametrize(
    ("growth", "kind", "budget"),
    [
        ("mcmc", "2dgs", Budget(primitives=190)),
        ("guided", "2dgs", Budget(primitives=190)),
        ("guided", "envmap", Budget(mb=0.051)),
        ("guided", "envgs", Budget(primitives=330, mb=0.047)),
        pytest.param("guided", "envgs", Budget(primitives=140), marks=pytest.mark.slow),
        pytest.param("guided", "envgs_single_set", Budget(primitives=220), marks=pytest.mark.slow),
    ],
)
def test_growth_that_fills_a_limit_stays_within_the_budget(
    growth: str, kind: str, budget: Budget, monkeypatch: pytest.MonkeyPatch
) -> None:
    fills = {**METHODS[kind], **with_rules(growth=growth), "max_primitives": 5_000, "densify_until": 30_000}
    monkeypatch.setitem(METHODS, kind, fills)
    test_no_moment_of_a_training_is_above_the_budget(kind, budget, monkeypatch)


@pytest.mark.parametrize("kind", METHODS)
def test_a_limit_that_comes_while_it_trains_holds_at_once_and_from_then_on(kind: str) -> None:
    """And the least worth goes: fewer pixels change than where as many go by chance."""
    scene = tiny_scene()
    method = create_method(kind, METHODS[kind], seed=1)
    assert isinstance(method, GaussianMethod)
    method.limit(Budget(primitives=1_000))
    method.initialize(scene, 95)
    for step in range(1, 41):
        method.training_step(scene.train[step % len(scene.train)], step)
    camera, before = scene.train[0].camera, method.primitives()
    whole, most = method.render(camera).color, sum(before.values()) * 3 // 4
    by_chance = least_of({name: torch.rand(size, generator=method.generator) for name, size in before.items()})
    hidden = by_chance(sum(before.values()) - most)
    shown = method.model.prepared
    for name, kept in hidden.items():
        if before[name]:
            shown[name] = replace(shown[name], opacities=torch.where(kept, shown[name].opacities, 0.0))
    for part in method.parts.values():
        part.prepare()
    chance = (method.draw(camera, None)[0].color - whole).square().mean()
    method.limit(Budget(primitives=most))
    assert sum(method.primitives().values()) == most
    assert (method.render(camera).color - whole).square().mean() < chance
    for step in range(41, 96):
        method.training_step(scene.train[step % len(scene.train)], step)
        assert sum(method.primitives().values()) <= most


def test_every_method_built_in_is_held_to_a_budget() -> None:
    assert set(METHODS) == set(BUILT_IN)


@settings(deadline=None)
@given(
    st.integers(LEAST_PRIMITIVES, 3000),
    st.one_of(st.none(), st.floats(0.05, 1)),
    st.dictionaries(st.sampled_from(["base", "env"]), st.integers(0, 2000), min_size=2),
    st.lists(st.tuples(st.sampled_from(["base", "env"]), st.floats(0, 1), st.floats(0, 1)), max_size=20),
)
def test_whichever_set_changes_next_the_sum_is_within_the_budget(
    primitives: int, mb: float | None, own: dict[str, int], changes: list[tuple[str, float, float]]
) -> None:
    shared = SharedBudget(Budget(primitives, mb), BOTH, fixed_bytes=1000)
    counts = {"base": 0, "env": 0}
    for name, beta, filled in [("base", 0.5, 1.0), *changes]:
        shared.measure({"base": torch.tensor(1 - beta), "env": torch.tensor(beta)})
        shared.decide()
        bound = shared.bound(name, counts, own)
        assert bound > 0 or not counts[name]
        assert bound <= (own[name] or bound)
        counts[name] = int(filled * bound)
        assert sum(counts.values()) <= primitives
        assert mb is None or 1000 + sum(BOTH[each] * count for each, count in counts.items()) <= 1e6 * mb


def test_sets_share_by_what_they_contribute_and_none_starves() -> None:
    shared = SharedBudget(Budget(primitives=1000), BOTH)
    assert shared.shares == {"base": 1 - FIRST_SHARE, "env": FIRST_SHARE}
    shared.decide()
    assert shared.shares["env"] == FIRST_SHARE  # nothing was measured
    for beta in (0.2, 0.4):
        shared.measure({"base": torch.tensor(1 - beta), "env": torch.tensor(beta)})
    shared.decide()
    assert shared.shares["env"] == pytest.approx(LEAST_SHARE + (1 - 2 * LEAST_SHARE) * 0.3)
    assert sum(shared.shares.values()) == pytest.approx(1)
    shared.measure({"base": torch.tensor(7.0), "env": torch.tensor(0.0)})
    shared.decide()
    assert shared.shares["env"] == pytest.approx(LEAST_SHARE)
    assert shared.bound("env", {"base": 500, "env": 300}, NO_BOUND) == 50
    assert shared.bound("base", {"base": 500, "env": 300}, NO_BOUND) == 700  # until the environment has shrunk
    assert shared.bound("base", {"base": 500, "env": 20}, NO_BOUND) == 950


def test_a_set_leaves_what_its_own_bound_forbids_to_the_other() -> None:
    shared = SharedBudget(Budget(primitives=1000), BOTH)
    assert shared.bound("base", {"base": 0, "env": 0}, {"base": 0, "env": 40}) == 960
    assert shared.bound("env", {"base": 300, "env": 0}, {"base": 300, "env": 0}) == 700
    assert shared.bound("env", {"base": 300, "env": 0}, {"base": 300, "env": 40}) == 40


@pytest.mark.parametrize("beta", [0.0, 0.1, 0.5, 1.0])
def test_a_set_contributes_what_the_picture_would_lose_without_it(beta: float) -> None:
    """A gray base before black under a white reflection: ½·β without the environment, ½ + ½·β without the base."""
    method = create_method("envgs", METHODS["envgs"])
    assert isinstance(method, GaussianMethod)
    method.initialize(tiny_scene(), 1000)
    gray, flat = torch.full((3, 4, 3), 0.5), torch.ones(3, 4)
    rendering = Rendering(
        color=torch.lerp(gray, torch.ones_like(gray), beta),
        **{"alpha": flat, "depth": flat, "normal": gray, "extras": flat[..., None] * beta, "hits": flat.int()},
        statistics=Statistics(weights=torch.ones(1)),
        layers={"base": gray},
    )
    given = method.model.contributions(rendering, 500)
    assert float(given["env"]) / 36 == pytest.approx(beta / 2)
    assert float(given["base"]) / 36 == pytest.approx((1 + beta) / 2)
    assert method.model.contributions(rendering, 105) == {}  # reflections start at 10: too early to say


def test_the_environment_gives_way_where_it_contributes_nothing() -> None:
    scene = tiny_scene()
    method = create_method("envgs", {**METHODS["envgs"], "initial_beta": 1e-6, "beta_lr": 0.0}, seed=1)
    assert isinstance(method, GaussianMethod)
    method.limit(Budget(primitives=400))
    method.initialize(scene, STEPS)
    counts = []
    for step in range(1, 121):
        method.training_step(scene.train[step % len(scene.train)], step)
        counts.append(method.primitives()["env"])
    assert counts[100] == FIRST_SHARE * 400  # while it is young
    assert 0 < counts[-1] <= LEAST_SHARE * 400 + 1


@pytest.mark.slow
def test_an_interrupted_training_shares_the_budget_as_it_would_have() -> None:
    scene = tiny_scene()
    whole, first, second = (create_method("envgs", METHODS["envgs"], seed=1) for _ in range(3))
    for method in (whole, first, second):
        method.limit(Budget(primitives=300))
    for method in (whole, first):
        method.initialize(scene, STEPS)
    for step in range(1, STEPS + 1):
        if step == 115:  # something has been measured, and not been decided upon
            second.resume(scene, STEPS, first.training_state() or {})
        for method in (whole, first if step < 115 else second):
            method.training_step(scene.train[step % len(scene.train)], step)
    assert whole.primitives() == second.primitives()
    for name in ("base", "env"):
        for field, values in whole.model.sets[name].parameters.tensors.items():
            assert torch.equal(values, second.model.sets[name].parameters.tensors[field])


def test_without_a_budget_nothing_is_thinned_or_measured() -> None:
    method = create_method("envgs", METHODS["envgs"])
    assert isinstance(method, GaussianMethod)
    method.initialize(tiny_scene(), STEPS)
    assert (method.primitives()["base"], method.model.bound("base"), method.model.bound("env")) == (
        200,
        1_800_000,
        630_000,
    )


@pytest.mark.parametrize(
    ("kind", "budget", "problem"),
    [
        ("2dgs", Budget(), "limits neither"),
        ("2dgs", Budget(primitives=0), "primitives is 0, expected at least 100"),
        ("envgs", Budget(primitives=-5), "primitives is -5, expected at least 100"),
        ("3dgs", Budget(primitives=99), "primitives is 99, expected at least 100"),
        ("3dgs", Budget(mb=-1.0), r"mb is -1, expected at least 0\.0236"),
        ("3dgs", Budget(mb=float("nan")), r"mb is nan, expected at least 0\.0236"),
        ("envmap", Budget(mb=0.03), r"expected at least 0\.03363: 100 primitives besides 0\.01843 MB"),
    ],
)
def test_a_budget_that_no_model_fits_into_is_refused(kind: str, budget: Budget, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        create_method(kind, METHODS[kind]).limit(budget)


def test_a_method_that_keeps_to_no_budget_says_so() -> None:
    with pytest.raises(ValueError, match="MeanColor keeps to no budget"):
        create_method("fakes.methods:MeanColor").limit(Budget(primitives=1000))


@settings(deadline=None)
@given(st.integers(1, 300), st.integers(1, 300), st.booleans())
def test_thinning_keeps_so_many_rows_each_once(number: int, count: int, flat: bool) -> None:
    count = min(number, count)
    points = torch.rand(number, 3, generator=torch.Generator().manual_seed(number))
    points[:, 2] *= not flat
    rows = evenly_thinned(points, count, torch.Generator().manual_seed(1))
    assert len(rows) == count == len(rows.unique())
    assert torch.equal(rows, rows.sort().values)


def test_thinning_is_even_and_of_its_seed() -> None:
    """Of 8,000 points, half of them in an eighth of the space, every octant keeps its tenth."""
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(8000, 3, generator=generator)
    points[4000:] *= 0.5
    rows = evenly_thinned(points, 800, generator)
    octants = ((points >= 0.5) * torch.tensor([1, 2, 4])).sum(1)
    kept, there = octants[rows].bincount(minlength=8), octants.bincount(minlength=8)
    assert (kept - there / 10).abs().max() <= 1
    same = evenly_thinned(points, 800, torch.Generator().manual_seed(5))
    assert torch.equal(same, evenly_thinned(points, 800, torch.Generator().manual_seed(5)))
    assert not torch.equal(same, rows)
