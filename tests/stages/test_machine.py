"""What the machine does to a training: neighbors that take its cores, another backend, another device."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch_threads import torch_threads
from toy_scenes import coarse_toys

from envgs_bench.core import Scene
from envgs_bench.core import cuda as gpu
from envgs_bench.datasets import load_scene
from envgs_bench.methods.method import Method
from envgs_bench.methods.registry import create_method
from envgs_bench.stages.training import Training

ENVGS = {"env_grid": 5, "env_far_count": 100}
SEEDS = (0, 1, 2)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def room(width: int, cache: Path) -> Scene:
    toy = {"kind": "toy", "scene": "chrome_room", "views": 17, "supersampling": 1, "normal_noise": 5.0}
    with coarse_toys():
        return load_scene({**toy, "width": width, "height": width * 3 // 4}, cache)


def trained(scene: Scene, steps: int, folder: Path, seed: int = 0, device: str = "cpu", **settings: Any) -> Method:
    method = create_method("envgs", ENVGS | settings, device, seed)
    Training(method, scene, steps, seed).run(folder / "curve.csv", lambda event: None)
    return method


def psnr(method: Method, scene: Scene) -> float:
    pairs = [(method.render(view.camera).color.cpu().clamp(0, 1), view.rgb()) for view in scene.test]
    return float(np.mean([-10 * float((a - b).square().mean().log10()) for a, b in pairs]))


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """Beside processes that do nothing but take time."""
    started = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


def assert_within_the_seeds_spread(own: Sequence[float], others: Sequence[float]) -> None:
    """The same seeds elsewhere are no further off than seeds are from each other, and on average much nearer."""
    spread = max(abs(a - b) for a, b in combinations(own, 2))
    apart = np.abs(np.subtract(own, others))
    assert apart.max() <= spread, (own, others)
    assert abs(np.mean(np.subtract(own, others))) <= 0.5 * spread, (own, others)


@pytest.mark.slow
def test_two_threads_beside_a_busy_machine_learn_the_same_to_the_last_bit(cache: Path, tmp_path: Path) -> None:
    scene = room(40, cache)
    with torch_threads(2):
        alone = trained(scene, 60, tmp_path)
        with busy(4):
            crowded = trained(scene, 60, tmp_path)
    for view in scene.test:
        first, second = (method.render(view.camera) for method in (alone, crowded))
        assert torch.equal(first.color, second.color)
        assert torch.equal(first.normal, second.normal)


@pytest.mark.slow
def test_the_backend_that_is_fast_ends_where_the_one_in_torch_does(cache: Path, tmp_path: Path) -> None:
    scene = room(16, cache)
    small = {"env_grid": 3, "env_far_count": 30}
    own, oracle = (
        [psnr(trained(scene, 60, tmp_path, seed, backend=backend, **small), scene) for seed in SEEDS]
        for backend in ("cpu", "torch")
    )
    assert_within_the_seeds_spread(own, oracle)


@pytest.mark.slow
@pytest.mark.skipif(gpu.why_unavailable() is not None, reason=f"backend cuda: {gpu.why_unavailable()}")
def test_a_gpu_ends_within_the_seeds_spread_of_the_cpu(cache: Path, tmp_path: Path) -> None:
    scene = room(64, cache)
    own, there = (
        [psnr(trained(scene, 300, tmp_path, seed, device), scene) for seed in SEEDS] for device in ("cpu", "cuda")
    )
    assert_within_the_seeds_spread(own, there)
