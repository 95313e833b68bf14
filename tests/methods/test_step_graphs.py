"""Steps replayed from a graph: when one is recorded, and what happens to those that it had too little room for."""

import dataclasses
import gc
import math

import pytest
import torch
from recordable import WaitsForTheDevice, pinhole, points_scene
from rules import with_rules
from schedules import begin
from small_methods import SMALL

from envgs_bench.core import Scene, View
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.lighting.prefiltered_cubemap import prefilter_of
from envgs_bench.methods.method import Budget
from envgs_bench.methods.registry import create_method, method_names
from envgs_bench.methods.training import cuda_graphs, step_graphs
from envgs_bench.methods.training.losses import StepNumbers
from envgs_bench.methods.training.step_graphs import (
    GraphWarning,
    Learning,
    StepGraphs,
    difference,
    is_compared,
)
from envgs_bench.methods.two_d_gs import TwoDGS, TwoDGSSettings

needs_cuda = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
STEPS = 80
FEW = 60  # a run's, with events of all kinds
FEWER = 24  # of which the last are looked at
SEVERAL_PHASES = {"gaussian_shader": {"sh_degree": 2}}  # as published its colors have one phase


class PlainGraph(step_graphs._Graph):
    """Does what it recorded one kernel after the other, and has too little room as often as `spoils` says."""

    recorded = 0
    spoils = 0

    def __init__(self, kind, holds, launch, view, step):
        self._kind, self._holds, self.learn, self.step = kind, holds, launch, step
        PlainGraph.recorded += 1

    def replay(self, view):
        if PlainGraph.spoils:
            PlainGraph.spoils -= 1
            return StepNumbers(("loss",), (), torch.tensor([math.nan]), {})
        return self.learn(view, self.step)


class Arrived:
    def __init__(self, values):
        self.values = values

    def is_finite(self):
        return bool(self.values.isfinite().all())


@pytest.fixture
def plain_graphs(monkeypatch):
    monkeypatch.setattr(step_graphs, "_Graph", PlainGraph)
    monkeypatch.setattr(step_graphs, "_Copy", Arrived)
    PlainGraph.recorded = PlainGraph.spoils = 0
    return PlainGraph


class Learner:
    """Tells which steps it took, and how: the loss of a step is 1, or its `loss_of` it, unless it is one of `bad`."""

    def __init__(self, bad=(), loss_of=lambda step: 1.0):
        self.bad, self.calls, self.loss_of, self.moves = bad, [], loss_of, True
        self.steps = StepGraphs(Learning(self.learn, self.learn_again, self.without_moving), "Learner")

    def learn(self, view, step):
        if self.moves:
            self.calls.append((view.name, step))
        loss = math.nan if view.name in self.bad else self.loss_of(step)
        return StepNumbers(("loss",), (), torch.tensor([loss]), {})

    def without_moving(self, replay):
        self.moves = False
        numbers = replay()
        self.moves = True
        return numbers

    def learn_again(self, view, step):
        self.calls.append("again")
        return self.learn(view, step)

    def take(self, step, name="view", phase=0, holds=()):
        view = View(name, pinhole(), torch.zeros(4, 4, 3, dtype=torch.uint8))
        return self.steps.take(view, step, phase, holds)


def test_the_first_step_of_a_phase_is_taken_without_a_graph_and_others_share_one(plain_graphs):
    learner = Learner()
    for step in range(1, 5):
        learner.take(step)
    assert plain_graphs.recorded == 1
    learner.take(5, phase=1)
    assert plain_graphs.recorded == 1
    learner.take(6, phase=1)
    assert plain_graphs.recorded == 2


def test_another_graph_is_recorded_for_other_tensors_and_after_a_release(plain_graphs):
    learner, one = Learner(), torch.zeros(3)
    other = torch.zeros(3)  # equal, and yet another
    for step, holds in enumerate([(one,), (one,), (one,), (other,), (other,), (other, one)], 1):
        learner.take(step, holds=holds)
    assert plain_graphs.recorded == 3
    learner.take(7, holds=(other, one))
    assert plain_graphs.recorded == 3
    learner.steps.release()
    learner.take(8, holds=(other, one))
    assert plain_graphs.recorded == 4


def test_a_step_that_lacked_room_is_taken_again_after_the_next_one(plain_graphs):
    learner = Learner()
    for step in (1, 2):  # launched, and compared
        learner.take(step)
    plain_graphs.spoils = 1
    lacked = learner.take(3, name="lacked")
    assert lacked.losses()["loss"].isnan()
    learner.take(4)
    learner.steps.settle()
    assert float(lacked.losses()["loss"]) == 1.0
    # A graph's step is the one that it was recorded as.
    assert learner.calls == [("view", 1), ("view", 2), ("view", 1), "again", ("lacked", 3)]
    learner.take(5)
    assert plain_graphs.recorded == 2


def test_a_compared_step_that_lacked_room_shows_nothing_and_is_launched(plain_graphs):
    learner = Learner()
    learner.take(1)
    plain_graphs.spoils = 1
    assert float(learner.take(2).losses()["loss"]) == 1.0
    assert not learner.steps.proved_wrong
    learner.take(3)
    assert plain_graphs.recorded == 2


@pytest.mark.parametrize("first_other", [2, 5, 17])
def test_steps_that_depend_on_their_number_are_launched_once_a_comparison_shows_it(first_other, plain_graphs):
    """Recorded as of step 1, and compared at the replays 1, 4 and 16, which are those of steps 2, 5 and 17."""
    learner = Learner(loss_of=lambda step: 1.0 if step < first_other else 1.01)
    for step in range(1, first_other):
        learner.take(step)
    with pytest.warns(GraphWarning, match="Learner is not what its CUDA graph replays: loss loss is 1 replayed"):
        learner.take(first_other)
    for step in range(first_other + 1, first_other + 4):
        assert float(learner.take(step).losses()["loss"]) == pytest.approx(1.01)
    assert [step for _, step in learner.calls[first_other - 1 :]] == list(range(first_other, first_other + 4))


def test_steps_that_differ_by_rounding_are_replayed(plain_graphs, recwarn):
    learner = Learner(loss_of=lambda step: 1.0 + 1e-5 * (step % 2))
    for step in range(1, 20):
        learner.take(step)
    assert not learner.steps.proved_wrong
    assert not recwarn.list


def test_few_replays_of_a_phase_are_compared():
    assert [count for count in range(1, 30_000) if is_compared(count)] == [4**k for k in range(8)]


@pytest.mark.parametrize(
    ("replayed", "launched", "wrong"),
    [((1.0, 2.0), (1.0, 2.0), ""), ((1.0, 2.1), (1.0, 2.0), ""), ((1.0, 3.0), (1.0, 2.0), "gradient of means is 3"),
     ((1.1, 2.0), (1.0, 2.0), "loss rgb is 1.1"), ((0.0, 0.0), (0.0, 0.0), "")],
)  # fmt: skip
def test_what_differs_is_named(replayed, launched, wrong):
    one, other = (StepNumbers(("rgb",), ("means",), torch.tensor(values), {}) for values in (replayed, launched))
    assert difference(one, other).startswith(wrong)
    assert bool(difference(one, other)) == bool(wrong)


def test_only_what_a_class_says_itself_is_recorded():
    class Inherits(TwoDGS):
        pass

    assert vars(TwoDGS).get("cuda_graph")
    assert not vars(Inherits).get("cuda_graph")


class Brightening(TwoDGS):
    """Draws by its step's number, and says that graphs may hold it."""

    cuda_graph = True

    def draw(self, camera, step):
        drawn, statistics = super().draw(camera, step)
        share = 1.0 if step is None else min(1, step / 100)
        return dataclasses.replace(drawn, color=drawn.color * share), statistics


def test_a_method_that_draws_by_its_number_is_trained_as_if_there_were_no_graphs(plain_graphs):
    scene, losses = points_scene(), {}
    for uses_graphs in (False, True):
        method = Brightening(TwoDGSSettings(backend="cpu"))
        method.runner.uses_graphs = uses_graphs
        if uses_graphs:
            with pytest.warns(GraphWarning, match="Brightening is not what its CUDA graph replays") as found:
                losses[uses_graphs] = train(method, scene)
            assert len(found) == 1
        else:
            losses[uses_graphs] = train(method, scene)
    assert losses[True] == losses[False]


def test_a_step_that_is_not_finite_without_a_graph_either_stays_so(plain_graphs):
    learner = Learner(bad=("black",))
    for step in (1, 2):
        learner.take(step)
    bad = learner.take(3, name="black")
    learner.steps.settle()
    assert bad.losses()["loss"].isnan()
    assert learner.calls.count("again") == 1
    learner.take(4)
    assert plain_graphs.recorded == 1


class CrampedGraph(PlainGraph):
    """The fourth of all replays ends with a gradient of NaN, which the optimizers skip and count."""

    replays = 0

    def replay(self, view):
        CrampedGraph.replays += 1
        if CrampedGraph.replays != 4:
            return self.learn(view, self.step)
        spoiled = self._holds[0].register_hook(lambda gradient: gradient * math.nan)
        numbers = self.learn(view, self.step)
        spoiled.remove()
        return numbers


@pytest.mark.parametrize("kind", SMALL)
def test_steps_from_graphs_are_those_without(kind, plain_graphs, monkeypatch):
    """On the CPU, where both are the same to the last bit: events, rates and phases come at the same steps."""
    scene, trained = points_scene(), {}
    for captures in (False, True):
        method = create_method(kind, {"backend": "cpu", **SMALL[kind], **SEVERAL_PHASES.get(kind, {})})
        method.runner.uses_graphs = captures
        trained[captures] = method, train(method, scene, FEW, of=FEW)
    (plain, expected), (method, losses) = trained[False], trained[True]
    assert plain_graphs.recorded > 1
    assert losses == expected
    for name, values in plain.model.sets["base"].parameters.tensors.items():
        assert torch.equal(method.model.sets["base"].parameters.tensors[name], values), name


def test_a_step_that_lacked_room_is_taken_again_before_a_picture_is_drawn(plain_graphs, monkeypatch):
    monkeypatch.setattr(step_graphs, "_Graph", CrampedGraph)
    monkeypatch.setattr(CrampedGraph, "replays", 0)
    method, scene = create_method("2dgs", {"backend": "cpu"}), points_scene()
    method.runner.uses_graphs = True
    method.initialize(scene, 1000)
    rows = [method.training_step(scene.train[step % 4], step) for step in range(1, 6)]  # the last one from a graph
    method.render(scene.test[0].camera)
    assert CrampedGraph.replays == 4
    assert int(method.skipped_steps) == 0
    assert all(math.isfinite(row["loss"]) for row in rows)


def test_a_picture_that_lacked_room_is_no_skipped_step(plain_graphs, monkeypatch):
    monkeypatch.setattr(step_graphs, "_Graph", CrampedGraph)
    monkeypatch.setattr(CrampedGraph, "replays", 0)
    method, scene = create_method("2dgs", {"backend": "cpu"}), points_scene()
    method.runner.uses_graphs = True
    losses = train(method, scene, steps=12, of=1000)
    assert CrampedGraph.recorded == 2
    assert int(method.skipped_steps) == 0
    assert method.monitor.non_finite_gradients() == []
    assert all(math.isfinite(row["loss"]) for row in losses)


@needs_cuda
@pytest.mark.parametrize("kind", SMALL)
def test_a_recorded_step_learns_what_the_step_without_a_graph_does_cuda(kind, monkeypatch):
    """Sums of gradients come in any order on a GPU, so runs part: slowly, and around the same losses."""
    scene, curves = points_scene(width=96, height=72), {}
    for captures in (True, False):  # what is made once must not be missing while a step is recorded
        method = create_method(kind, SMALL[kind], device="cuda")
        method.runner.uses_graphs = captures
        curves[captures] = torch.tensor([row["loss"] for row in train(method, scene)])
        if captures:
            assert method.runner.graphs._graph is not None
            assert int(method.skipped_steps) == 0
    torch.testing.assert_close(curves[True][:5], curves[False][:5], rtol=1e-3, atol=0)
    assert abs(float(curves[True][-20:].mean() / curves[False][-20:].mean()) - 1) < 0.05


@needs_cuda
def test_a_map_that_has_doubled_remembers_its_gradients_cuda():
    method, scene = create_method("envmap", SMALL["envmap"], device="cuda"), points_scene(width=96, height=72)
    method.initialize(scene, STEPS)
    sizes, since = [], 0
    for step in range(1, STEPS + 1):
        method.training_step(scene.train[0], step)
        sizes.append(method.reflection.light.texels.shape[1])
        since = since + 1 if sizes[-2:] == sizes[-1:] * 2 else 1
    method.settle()
    assert len(set(sizes)) > 2
    assert method.runner.graphs._graph is not None
    assert 1 < since < STEPS
    assert int(method.reflection.light.optimizer.state[method.reflection.light.texels]["step"]) == since


@needs_cuda
def test_garbage_waits_until_a_recording_ends_cuda():
    """Methods refer to themselves, so their graphs are freed when Python looks for garbage: here, at every chance."""
    scene, thresholds = points_scene(width=96, height=72), gc.get_threshold()
    gc.disable()
    try:
        for seed in range(3):
            method = create_method("2dgs", {}, device="cuda", seed=seed)
            method.initialize(scene, 1000)
            for step in range(1, 6):
                method.training_step(scene.train[0], step)
            assert method.runner.graphs._graph is not None
            method.settle()
            gc.set_threshold(1, 1, 1)
            gc.enable()
    finally:
        gc.set_threshold(*thresholds)
        gc.enable()


@needs_cuda
def test_memory_of_earlier_recordings_is_given_back_cuda(monkeypatch):
    monkeypatch.setattr(cuda_graphs, "SPARE_SHARE", 0)
    method, scene = create_method("2dgs", {}, device="cuda"), points_scene(width=96, height=72)
    method.initialize(scene, 1000)
    reserved = []
    for step in range(1, 13):
        method.training_step(scene.train[0], step)
        if step % 3 == 0:
            reserved.append(torch.cuda.memory_reserved())
            method.runner.graphs.release()
    assert max(reserved) <= 2 * reserved[0]


@needs_cuda
def test_an_image_that_outgrows_its_graph_is_learned_all_the_same_cuda(monkeypatch):
    from envgs_bench.core.cuda import raster_pass

    monkeypatch.setattr(raster_pass, "MIN_CAPACITY", 1)
    method, scene = create_method("2dgs", {}, device="cuda"), points_scene(width=96, height=72)
    method.initialize(scene, 1000)
    for step in range(1, 4):
        method.training_step(scene.train[0], step)
    with torch.no_grad():  # every primitive now covers many more tiles than the graph has room for
        method.model.sets["base"].parameters.tensors["log_scales"] += 2
    losses = [method.training_step(scene.train[0], step) for step in range(4, 10)]
    method.settle()
    assert int(method.skipped_steps) == 0
    assert all(bool(row["loss"].isfinite()) for row in losses)
    raster_pass._latest_instances.clear()


@needs_cuda
def test_a_step_that_is_not_finite_is_skipped_from_a_graph_too_cuda():
    method, scene = create_method("2dgs", {"mono_weight": 0.1}, device="cuda"), points_scene(width=96, height=72)
    method.initialize(scene, 1000)
    for step in range(1, 5):
        method.training_step(scene.train[0], step)
    method.settle()
    before = {name: values.detach().clone() for name, values in method.model.sets["base"].parameters.tensors.items()}
    normal = scene.train[1].normal
    method.training_step(dataclasses.replace(scene.train[1], normal=torch.full_like(normal, math.nan)), 5)
    method.settle()
    assert int(method.skipped_steps) == 1
    assert method.monitor.non_finite_gradients()
    for name, values in method.model.sets["base"].parameters.tensors.items():
        assert torch.equal(values, before[name]), name


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        *((kind, {}) for kind in SMALL),
        ("envgs", with_rules(normal_weighting="depth", mono_weight=0.1, reflect_alpha=0.5, normal_reference="alpha")),
        ("envgs", {"supersampling": 2}),
        ("envmap", {"supersampling": 2}),
        ("3dgs_dr", {"scope_radius": 1.5}),
        ("2dgs", {"rules": {"mean_gradient_over": "in_view"}}),
        ("ref_gaussian", {"smooth_weight": 0.1, "smooth_until": 30_000}),
    ],
)
def test_no_step_waits_for_the_device(kind, settings):
    """In the last steps of a run, when all losses count and reflections are there; a graph could hold nothing else."""
    method, scene = create_method(kind, {"backend": "cpu", **SMALL[kind], **settings}), points_scene()
    method.limit(Budget(primitives=5_000))
    train(method, scene, steps=FEWER - 2, of=FEWER)
    for step in (FEWER - 1, FEWER):
        prefilter_of.cache_clear()  # as where a map has another size
        begin(method, step)
        with WaitsForTheDevice() as waits:
            method.runner.learn(scene.train[0], step)
        assert waits.found == []


def test_only_methods_whose_steps_are_tested_here_are_recorded():
    """A subclass that decides more on the host than its parent's `phase` tells has to say that it is not."""
    classes = {kind: create_method(kind, {}) for kind in method_names()}
    assert {kind for kind, method in classes.items() if vars(type(method)).get("cuda_graph")} == set(SMALL)


def train(method: GaussianMethod, scene: Scene, steps: int = STEPS, of: int = STEPS) -> list[dict[str, float]]:
    """The losses of the first steps of a run that is `of` steps long."""
    method.initialize(scene, of)
    rows = [method.training_step(scene.train[step % len(scene.train)], step) for step in range(1, steps + 1)]
    method.settle()
    return [{name: float(value) for name, value in row.items()} for row in rows]
