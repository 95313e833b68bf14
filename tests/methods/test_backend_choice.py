"""`backend` in a method's settings decides for all that a training step computes, not for its drawing alone."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Any, NoReturn

import pytest
import torch

from envgs_bench.core import backends, cpu, cuda
from envgs_bench.methods.registry import create_method
from envgs_bench.testing import tiny_scene

STEPS = 6
WITH_MAP = ["envmap", "3dgs_dr", "ref_gaussian", "gaussian_shader"]
SMALL = {
    **{kind: {"envmap_size": 8} for kind in WITH_MAP},
    "envgs": {"env_grid": 2},
    "3igs": {"field_size": 4},
}
CALLS = [
    importlib.import_module(f"envgs_bench.core.{name}") for name in ["rasterize", "trace", "reflect", "normals", "ssim"]
]


class Untouchable:
    """A native module that must not be asked for anything."""

    def __getattr__(self, name: str) -> NoReturn:
        raise AssertionError(f"native code was called: {name}")


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> dict[str, set[str]]:
    """For each of the core's calls the backends that it is asked for, by name; native code raises."""
    names: dict[str, set[str]] = {}

    def recording(module: ModuleType) -> Any:
        def load(name: str, device: torch.device, dtype: torch.dtype) -> ModuleType:
            names.setdefault(module.__name__.rpartition(".")[2], set()).add(name)
            return backends.load_backend(name, device, dtype)

        return load

    for module in CALLS:
        monkeypatch.setattr(module, "load_backend", recording(module))
    monkeypatch.setattr(cpu, "_native", Untouchable())
    for name in cuda.__all__:
        monkeypatch.setattr(cuda, name, Untouchable().__getattr__)
    return names


@pytest.mark.parametrize("kind", ["2dgs", "3dgs", "3igs", "envgs", "envgs_single_set", *WITH_MAP])
def test_the_torch_backend_trains_and_draws_without_native_code(kind: str, asked: dict[str, set[str]]) -> None:
    method = create_method(kind, {"backend": "torch", **SMALL.get(kind, {})})
    scene = tiny_scene()
    method.initialize(scene, STEPS)
    for step in range(1, STEPS + 1):
        losses = method.training_step(scene.train[step % len(scene.train)], step)
        assert torch.isfinite(torch.as_tensor(losses["loss"]))
    method.prepare()
    assert method.render(scene.test[0].camera).color.dtype == torch.float32
    expected = {"rasterize", "ssim"}
    if kind not in ("3dgs", "3igs", "3dgs_dr"):  # no loss on normals
        expected.add("normals")
    if kind not in ("2dgs", "3dgs", "3igs", "gaussian_shader"):
        expected.add("reflect")
    if kind in ("envgs", "envgs_single_set", "ref_gaussian"):
        expected.add("trace")
    assert asked == {name: {"torch"} for name in expected}


def test_the_default_backend_is_native_and_would_raise(asked: dict[str, set[str]]) -> None:
    method = create_method("2dgs")
    method.initialize(tiny_scene(), STEPS)
    with pytest.raises(AssertionError, match="native code was called: raster_pass"):
        method.training_step(tiny_scene().train[0], 1)
