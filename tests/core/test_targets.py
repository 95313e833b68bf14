"""The CPU backend as it is compiled for each kind of CPU, of those that this machine's runs."""

from __future__ import annotations

import importlib
import importlib.util

import pytest
import torch
from core_scenes import Backend
from oracle import compare, drawn_with, image, oracle_image, oracle_ray_batch, ray_batch

from envgs_bench.core import cpu
from envgs_bench.core.cpu import native

PIXELS_AT_ONCE = {"x86-64-v2": 4, "x86-64-v3": 8, "x86-64-v4": 16}


@pytest.fixture(params=["x86-64-v2", "x86-64-v3", "x86-64-v4", "aarch64", "arm64"])
def compiled(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Backend:
    supported = importlib.import_module("envgs_bench.core.cpu._targets").supported()
    if request.param not in supported:
        pytest.skip(f"this CPU runs {', '.join(supported)}")
    if importlib.util.find_spec(f"{cpu.__name__}._native_{request.param.replace('-', '_')}") is None:
        pytest.skip("not compiled here: install with --config-settings=cmake.define.CPUS=all")
    monkeypatch.setenv(native.VARIABLE, request.param)
    target, module = native.load()
    assert target == request.param
    assert module.pixel_lanes == PIXELS_AT_ONCE.get(target, 4)
    monkeypatch.setattr(cpu, "_native", module)
    return Backend.named("cpu")


@pytest.mark.parametrize("as_gaussians_3d", [False, True], ids=["surfels", "gaussians_3d"])
def test_images(compiled, as_gaussians_3d):
    gaussians, keep, expected = oracle_image("many", as_gaussians_3d, True)
    drawn = drawn_with(compiled, gaussians, image(True), keep, ())
    compare(drawn, expected, keep)
    assert torch.equal(drawn_with(compiled, gaussians, image(True), keep, ())[0].color, drawn[0].color)


def test_ray_batches(compiled):
    gaussians, rays, expected = oracle_ray_batch("many", "center")
    keep = torch.ones(len(rays[0])) > 0
    compare(drawn_with(compiled, gaussians, ray_batch("center"), keep, rays), expected, keep)


def test_a_target_that_this_cpu_does_not_run_is_refused(monkeypatch):
    monkeypatch.setenv(native.VARIABLE, "x86-64-v9")
    with pytest.raises(ImportError, match=r"x86-64-v9, this CPU runs .+: choose one of these"):
        native.load()


def test_what_another_kind_of_cpu_compiled_for_itself_is_refused(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"another kind of CPU, this one runs .+: install it on this machine"):
        native.load()


def test_sources_that_are_newer_than_what_was_compiled_are_told(monkeypatch, tmp_path):
    for folder in native.FOLDERS:
        (tmp_path / folder.name).mkdir()
        for file in folder.iterdir():
            if file.suffix in (".cpp", ".h"):
                (tmp_path / folder.name / file.name).write_bytes(file.read_bytes())
    (tmp_path / "cpu" / "bindings.cpp").touch()  # an installed package has no sources
    monkeypatch.setattr(native, "FOLDERS", (tmp_path / "cpu", tmp_path / "kernels"))
    (tmp_path / "kernels" / "sh.h").write_text("// another\n", encoding="utf-8")
    with pytest.raises(ImportError, match="compiled from other sources than this checkout has: install the package"):
        native.load()
