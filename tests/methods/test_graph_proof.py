"""Steps from CUDA graphs are the steps that are launched, or they are launched: on a GPU."""

import dataclasses

import pytest
import torch
from mirror_room import mirror_room
from recordable import points_scene
from small_methods import SMALL

from envgs_bench.methods.registry import create_method
from envgs_bench.methods.training.step_graphs import GraphWarning
from envgs_bench.methods.two_d_gs import TwoDGS, TwoDGSSettings

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
STEPS = 100


class Brightening(TwoDGS):
    """Draws by its step's number."""

    def draw(self, camera, step):
        drawn, statistics = super().draw(camera, step)
        share = 1.0 if step is None else min(1, step / 100)
        return dataclasses.replace(drawn, color=drawn.color * share), statistics


class SaysSo(Brightening):
    """And says that graphs may hold it."""

    cuda_graph = True


def losses(method: TwoDGS, steps: int = STEPS) -> torch.Tensor:
    scene = points_scene(width=96, height=72)
    method.initialize(scene, steps)
    rows = [method.training_step(scene.train[step % 4], step) for step in range(1, steps + 1)]
    method.settle()
    return torch.stack([row["loss"] for row in rows]).cpu()


def launched(kind: type[TwoDGS]) -> torch.Tensor:
    method = kind(TwoDGSSettings(), "cuda", seed=1)
    method.runner.uses_graphs = False
    return losses(method)


def test_a_subclass_that_says_nothing_is_launched_cuda() -> None:
    method = Brightening(TwoDGSSettings(), "cuda", seed=1)
    torch.testing.assert_close(losses(method), launched(Brightening), rtol=2e-3, atol=0)
    assert not method.runner.uses_graphs


def test_a_subclass_that_says_it_wrongly_is_found_out_cuda() -> None:
    method = SaysSo(TwoDGSSettings(), "cuda", seed=1)
    with pytest.warns(GraphWarning, match="SaysSo is not what its CUDA graph replays"):
        found = losses(method)
    torch.testing.assert_close(found, launched(SaysSo), rtol=2e-3, atol=0)


@pytest.mark.parametrize(
    "kind",
    [
        "2dgs",
        "3dgs",
        "envmap",
        "envgs",
        "envgs_single_set",
        "3dgs_dr",
        "ref_gaussian",
        "ref_gs",
        "gaussian_shader",
        "3igs",
    ],
)
def test_no_method_of_this_package_is_found_out_cuda(kind: str) -> None:
    method = create_method(kind, SMALL[kind], device="cuda", seed=1)
    losses(method, steps=400)
    assert method.runner.uses_graphs
    assert method.runner.graphs.proved_wrong == ""


def test_a_comparison_moves_nothing_cuda() -> None:
    method, scene = TwoDGS(TwoDGSSettings(), "cuda", seed=1), points_scene(width=96, height=72)
    method.initialize(scene, 1000)
    for step in range(1, 4):
        method.training_step(scene.train[0], step)
    method.settle()
    graphs, view = method.runner.graphs, method.runner.views.on_device(scene.train[1])
    before = {name: values.detach().clone() for name, values in method.model.named_parameters()}
    record = {name: values.clone() for name, values in vars(method.model.sets["base"].record).items()}
    skipped = int(method.skipped_steps)
    method.runner._without_moving(lambda: graphs._graph.replay(view))
    assert int(method.skipped_steps) == skipped
    for name, values in method.model.named_parameters():
        assert torch.equal(values, before[name]), name
    for name, values in vars(method.model.sets["base"].record).items():
        assert torch.equal(values, record[name]), name


@pytest.mark.parametrize("by", ["masks", "sites"])
def test_planes_and_sites_are_not_found_out_cuda(by: str) -> None:
    settings = {"planes": "masks"} if by == "masks" else {"color": "sites"}
    method, scene = create_method("envgs", SMALL["envgs"] | settings, "cuda", seed=1), mirror_room(size=64)
    method.initialize(scene, 400)
    for step in range(1, 401):
        numbers = method.training_step(scene.train[step % len(scene.train)], step)
    method.settle()
    assert numbers["loss"].isfinite()
    assert by == "sites" or (method.parts["planes"].begun and len(method.parts["planes"].frames))
    assert method.runner.uses_graphs
    assert method.runner.graphs.proved_wrong == ""
    assert method.picture(scene.test[0].camera.to("cuda")).isfinite().all()
