"""3DGS and 2DGS here against gsplat 1.5.3 from the same points: as accurate within 0.2 dB, with 30,000 steps on a GPU.

As a script it prints the table, one row a training, as each ends:

    python tests/methods/test_gsplat_parity.py --scene chair --method 2dgs
    … --scene fox --method 3dgs --ours-only --steps 7000
    … --scene chair --save-scene chair.pt                 # the scene as plain tensors, for a machine without the data
    … --scene chair.pt --method 2dgs --set normal_weight=0 --set opacity_reset_every=0
"""

from __future__ import annotations

import argparse
import json
import os
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import torch

from envgs_bench.bench.course import MethodTraining, Trainee, course, mean_psnr
from envgs_bench.bench.gsplat_training import GsplatTraining, official_resets
from envgs_bench.core import Camera, Scene, View
from envgs_bench.methods.registry import create_method

STEPS = 30_000
WITHIN = 0.2  # dB
SCENES = {
    "chair": {"kind": "blender", "root": "nerf_synthetic_chair", "random_points": 100_000},
    "fox": {"kind": "colmap", "root": "fox", "downsample": 2},
}
LACKING = [
    why
    for why, lacks in {
        "gsplat is not installed": find_spec("gsplat") is None,
        "PyTorch sees no CUDA device": not torch.cuda.is_available(),
        "ENVGS_BENCH_DATA names no folder with captures": "ENVGS_BENCH_DATA" not in os.environ,
    }.items()
    if lacks
]


@pytest.mark.slow
@pytest.mark.skipif(bool(LACKING), reason="; ".join(LACKING))
@pytest.mark.parametrize("method", ["3dgs", "2dgs"])
@pytest.mark.parametrize("name", SCENES)
def test_ours_is_as_accurate_as_gsplats(name: str, method: str) -> None:
    scene = load(name)
    theirs = train_gsplat(method, scene, STEPS, 0, official_resets(scene, STEPS))
    ours = train_ours(method, scene, STEPS, 0, {})
    assert abs(ours["psnr"] - theirs["psnr"]) < WITHIN, (ours, theirs)


def test_a_scene_of_plain_tensors_is_the_scene(tmp_path: Path) -> None:
    generator = torch.Generator().manual_seed(0)
    image = torch.randint(0, 256, (3, 4, 3), generator=generator, dtype=torch.uint8)
    view = View("a", Camera(torch.eye(4), torch.eye(3), 4, 3), image)
    scene = Scene("s", [view], [view], torch.rand(5, 3), torch.rand(5, 3), torch.ones(3), free_space=0.5)
    save_scene(scene, tmp_path / "s.pt")
    again = load(str(tmp_path / "s.pt"))
    assert (again.name, again.free_space, len(again.train), len(again.test)) == ("s", 0.5, 1, 1)
    for name in ("points", "point_colors", "background"):
        assert torch.equal(getattr(again, name), getattr(scene, name))
    assert torch.equal(again.train[0].image, image)
    assert again.test[0].camera.width == 4
    assert again.test[0].camera.height == 3


def load(scene: str) -> Scene:
    """One of SCENES below the folder ENVGS_BENCH_DATA, or a file of `save_scene`."""
    if scene not in SCENES:
        return _scene_of(torch.load(scene, weights_only=True))
    from envgs_bench.datasets import load_scene  # a machine that is given tensors need not have what reads pictures

    settings: dict[str, Any] = {**SCENES[scene], "name": scene}
    settings["root"] = str(Path(os.environ["ENVGS_BENCH_DATA"]) / settings["root"])
    return load_scene(settings, Path(os.environ.get("ENVGS_BENCH_CACHE", Path.home() / ".cache/envgs-bench")))


def save_scene(scene: Scene, path: Path) -> None:
    """The scene as a dictionary of tensors, numbers and strings."""
    views = {part: [_tensors_of(view) for view in getattr(scene, part)] for part in ("train", "test")}
    points = {"points": scene.points, "point_colors": scene.point_colors, "background": scene.background}
    torch.save({"name": scene.name, "free_space": scene.free_space, **points, **views}, path)


def _tensors_of(view: View) -> dict[str, Any]:
    camera = view.camera
    return {
        **{"name": view.name, "world_to_camera": camera.world_to_camera, "intrinsics": camera.intrinsics},
        "image": view.image.contiguous(),
    }


def _scene_of(stored: dict[str, Any]) -> Scene:
    def views(part: str) -> list[View]:
        made = []
        for item in stored[part]:
            height, width = item["image"].shape[:2]
            camera = Camera(item["world_to_camera"], item["intrinsics"], width, height)
            made.append(View(item["name"], camera, item["image"]))
        return made

    facts = {name: stored[name] for name in ("name", "points", "point_colors", "background", "free_space")}
    return Scene(train=views("train"), test=views("test"), **facts)


def train_ours(
    method: str, scene: Scene, steps: int, seed: int, settings: dict[str, Any], device: str = "cuda"
) -> dict[str, Any]:
    """A row of the table: PSNR of test and training views in dB, primitives, seconds of training."""
    model = create_method(method, settings, device=device, seed=seed)
    row = _trained(MethodTraining(model), scene, steps, seed, device)
    return {"by": "ours", "method": method, **row, "primitives": model.primitives()["base"]}


def train_gsplat(
    method: str, scene: Scene, steps: int, seed: int, resets: list[int], prune_opacity: float | None = None
) -> dict[str, Any]:
    """A row of the table; `prune_opacity` is the original program's where None."""
    row = _trained(GsplatTraining(method, resets, prune_opacity), scene, steps, seed, "cuda")
    return {"by": "gsplat", "method": method, **row}


def _trained(trainee: Trainee, scene: Scene, steps: int, seed: int, device: str) -> dict[str, Any]:
    _, seconds = list(course(trainee, scene, steps, seed, device))[-1]
    psnr, train_psnr = (mean_psnr(trainee.picture, views, device) for views in (scene.test, scene.train))
    return {"psnr": psnr, "train_psnr": train_psnr, "primitives": len(trainee), "seconds": seconds}


def _setting(text: str) -> tuple[str, Any]:
    """A setting of ours from "name=value"; the value as JSON, or else as text."""
    name, _, value = text.partition("=")
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", required=True, help=f"{', '.join(SCENES)}, or a file of --save-scene")
    parser.add_argument("--save-scene", type=Path, help="write the scene there and train nothing")
    parser.add_argument("--method", action="append", choices=["3dgs", "2dgs"], help="both where not given")
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cuda", help="of ours; gsplat needs cuda")
    parser.add_argument("--ours-only", action="store_true")
    parser.add_argument("--gsplat-only", action="store_true")
    parser.add_argument("--no-resets", action="store_true", help="gsplat as it is: it never resets opacities")
    parser.add_argument("--prune-opacity", type=float, help="gsplat's; where not given, the original program's")
    parser.add_argument("--set", action="append", type=_setting, default=[], help="a setting of ours, name=value")
    given = parser.parse_args()
    scene = load(given.scene)
    if given.save_scene:
        save_scene(scene, given.save_scene)
        return
    resets = [] if given.no_resets else official_resets(scene, given.steps)
    print("| by | method | scene | steps | seed | PSNR | training views | primitives | seconds |", flush=True)
    print("|---|---|---|--:|--:|--:|--:|--:|--:|", flush=True)
    for method in given.method or ["3dgs", "2dgs"]:
        rows = []
        if not given.gsplat_only:
            rows.append(lambda m=method: train_ours(m, scene, given.steps, given.seed, dict(given.set), given.device))
        if not given.ours_only:
            rows.append(lambda m=method: train_gsplat(m, scene, given.steps, given.seed, resets, given.prune_opacity))
        for train in rows:
            row = train()
            print(
                f"| {row['by']} | {method} | {scene.name} | {given.steps} | {given.seed} | {row['psnr']:.2f} "
                f"| {row['train_psnr']:.2f} | {row['primitives']} | {row['seconds']:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
