"""EnvGS above the others where near things reflect: trained here, near-field PSNR composited on white, in dB.

| chrome_room | seeds | EnvGS | environment map | 2DGS |
|---|---|---|---|---|
| 20 views of 64×48, 250 steps, no bound by pixels, coarse textures and light | 0 | 22.20 | 18.59 | 19.52 |
| the same, fine ones | 0, 1 | 21.42, 21.66 | 18.45, 18.29 | 19.41, 19.35 |
| the same, 500 steps | 0 (1, 2 threads) | 23.20, 22.89 | 19.94, 20.04 | 20.43, 20.15 |
| the same, GCC 14 in place of 12 | 0 (2 threads) | 22.48 | 19.98 | 20.25 |
| the same with scales that learn half as fast | 0 (1, 2 threads) | 22.92, 22.78 | 19.37, 19.16 | 19.58, 20.06 |
| 48 of 160×120, 3,000 steps, likewise | 0, 1, 2 | 26.41, 26.31, 26.39 | 22.69, 22.68, 22.82 | 22.48, 22.26, 22.56 |
| the same, growth that is guided | 0 | 27.14 | 23.65 | 23.76 |

The paper's order is EnvGS, environment map, 2DGS. Guided growth gives 2DGS 1.3 dB and the environment map 0.9: they are
level then, as an environment map knows nothing near.
"""

from __future__ import annotations

import pytest
import torch
from toy_scenes import coarse_toys
from tuned_baselines import TUNED

from envgs_bench.core import Scene
from envgs_bench.datasets import load_scene
from envgs_bench.methods.method import Method
from envgs_bench.methods.registry import create_method
from envgs_bench.metrics import get_protocol
from envgs_bench.stages.evaluation import normal_error

ROOM = {"kind": "toy", "scene": "chrome_room"}
PRIOR = {"mono_weight": 0.1}


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    with coarse_toys():
        return load_scene({**ROOM, "width": 64, "height": 48, "views": 20}, tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def trained(scene: Scene) -> dict[str, Method]:
    return train(scene, 250)


def train(scene: Scene, steps: int, **settings: float) -> dict[str, Method]:
    """Three methods with these settings; the environment map and EnvGS learn from normals, too."""
    methods = {}
    for kind, prior in {"2dgs": TUNED, "envmap": PRIOR, "envgs": PRIOR}.items():
        method = methods[kind] = create_method(kind, {**prior, **settings})
        method.initialize(scene, steps)
        order = torch.Generator().manual_seed(0)
        for step in range(1, steps + 1):
            turn = (step - 1) % len(scene.train)
            if turn == 0:
                views = torch.randperm(len(scene.train), generator=order)
            method.training_step(scene.train[views[turn]], step)
    return methods


def near_field(method: Method, scene: Scene) -> float:
    """Mean PSNR of the test views inside `near_field`, in dB."""
    score = get_protocol("envgs").score
    images = [(method.render(view.camera).color, view) for view in scene.test]
    scores = [score(image, view.rgb(), view.masks["near_field"])["psnr"] for image, view in images]
    return sum(scores) / len(scores)


def test_near_things_reflect_best_in_envgs(trained, scene):
    psnr = {kind: near_field(method, scene) for kind, method in trained.items()}
    assert psnr["envgs"] > psnr["2dgs"] + 1.2, psnr
    assert psnr["envgs"] > psnr["envmap"] + 1.8, psnr


@pytest.mark.slow
def test_near_things_reflect_best_in_envgs_in_longer_runs_of_larger_pictures(tmp_path):
    scene = load_scene({**ROOM, "normal_noise": 5.0}, tmp_path)
    trained = train(scene, 3000, min_coverage=3.0)
    psnr = {kind: near_field(method, scene) for kind, method in trained.items()}
    assert psnr["envgs"] > max(psnr["envmap"], psnr["2dgs"]) + 2.8, psnr


def test_envgs_finds_what_reflects_and_where_it_faces(trained, scene):
    """β is larger on mirrors than beside them, and normals there are at most half as wrong as 2DGS's."""
    errors: dict[str, list[float]] = {"2dgs": [], "envgs": []}
    betas = []
    for view in scene.test:
        mirrors = view.masks["reflective"]
        for kind, found in errors.items():
            found.append(normal_error(trained[kind].render(view.camera).normal, view.normal, mirrors))
        beta = trained["envgs"].render(view.camera).layers["beta"][..., 0]
        betas.append((beta[mirrors].mean(), beta[~mirrors].mean()))
    assert sum(errors["envgs"]) < 0.5 * sum(errors["2dgs"]), errors
    assert all(on > beside for on, beside in betas), betas
