"""The wheel: built here, used where there is no compiler, by every kind of CPU that this machine can stand for."""

from __future__ import annotations

import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
DRAW = """
import shutil, torch
from envgs_bench.core import GaussianSet, Camera, build_bvh, cpu, rasterize, trace
assert not any(map(shutil.which, ("cc", "c++", "gcc", "g++", "clang", "clang++", "cmake")))
count, generator = 300, torch.Generator().manual_seed(0)
def uniform(*shape): return torch.rand(*shape, generator=generator)
surfels = GaussianSet(
    means=uniform(count, 3) * 2 - 1 + torch.tensor([0.0, 0.0, 3.0]), quaternions=uniform(count, 4) - 0.5,
    scales=uniform(count, 2) * 0.2 + 0.05, opacities=uniform(count), sh=uniform(count, 4, 3),
)
camera = Camera(world_to_camera=torch.eye(4), intrinsics=torch.tensor([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]),
                width=64, height=48)
drawn, traced = rasterize(surfels, camera).color, trace(surfels, *camera.rays()).color
print(cpu.__file__, cpu.target, drawn.mean().item(), traced.mean().item())
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    options = ["--no-build-isolation", "--no-deps", f"--config-settings=build-dir={folder / 'build'}"]
    pip(sys.executable, "wheel", *options, "--wheel-dir", str(folder), str(REPOSITORY))
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scripts of an environment of its own, which borrows this one's packages but not its envgs-bench."""
    folder = tmp_path_factory.mktemp("clean")
    venv.create(folder, with_pip=False)
    scripts = folder / "bin"
    (packages,) = folder.glob("lib/python*/site-packages")
    pip(sys.executable, "--python", str(scripts / "python"), "install", "--no-deps", "--no-index", str(wheel))
    borrowed = [path for path in sys.path if path.endswith("site-packages")]
    (packages / "borrowed.pth").write_text("\n".join(borrowed))
    return scripts


def pip(python: str, *arguments: str) -> None:
    done = subprocess.run([python, "-m", "pip", *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def run(scripts: Path, *command: str, **variables: str) -> str:
    """What a command of that environment prints, with nothing else on the path."""
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "CC", "CXX")}
    environment |= {"PATH": str(scripts), **variables}
    done = subprocess.run(
        [str(scripts / command[0]), *command[1:]],
        capture_output=True, text=True, env=environment, cwd=scripts, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_it_holds_a_module_for_each_target_but_no_pictures_and_no_sources_of_the_extension(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    left_out = tuple(f"envgs_bench/docs/{folder}" for folder in ("images", "notebook", "records", "site"))
    assert not [name for name in names if name.startswith(left_out) or name.endswith(".cpp")]
    assert "envgs_bench/docs/reference/core.md" in names
    assert len(names) == len(set(names))  # the links to folders of the package bring nothing twice
    for kernel in (
        "core/cuda/draw_tiles.cu",
        "core/kernels/blend.h",
        "methods/envgs.py",
        "conf/config.yaml",
        "programs/recipes/gsplat.yaml",
    ):
        assert f"envgs_bench/{kernel}" in names
    assert wheel.stat().st_size < 4e6
    modules = {name.split("/")[-1].split(".")[0] for name in names if name.startswith("envgs_bench/core/cpu/_native_")}
    assert "_native_x86_64_v2" in modules or len(modules) == 1


@pytest.mark.slow
def test_it_draws_and_starts_where_there_is_no_compiler(installed):
    targets = "from envgs_bench.core.cpu import _targets; print(*_targets.supported())"
    supported = run(installed, "python", "-c", targets)
    means = []
    for target in supported.split():
        file, ran, *values = run(installed, "python", "-c", DRAW, ENVGS_BENCH_CPU_TARGET=target).split()
        assert Path(file).is_relative_to(installed.parent)
        assert ran == target
        means.append([float(value) for value in values])
    assert all(mean == pytest.approx(means[0], rel=1e-5) for mean in means)
    assert min(means[0]) > 0.1
    assert "envgs" in run(installed, "envgs-bench", "list")
