"""Does a method conform? For whoever adds one: call `check_method` in a test."""

from __future__ import annotations

import dataclasses
import math
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from envgs_bench.methods.method import Method
from envgs_bench.methods.registry import create_method

from .core import Camera, Rendering, Scene, View

WIDTH, HEIGHT = 32, 24
VIEWS = 6
POINTS = 200
STEPS = 8


def check_method(kind: str, settings: Mapping[str, Any] | None = None, device: str = "cpu", steps: int = STEPS) -> None:
    """Train the method for a few steps on a tiny scene and hold it against the contract of `Method`.

    Settings are a frozen dataclass with defaults; losses are finite, with their total as "loss"; primitives and
    bytes are counted under the same keys throughout; renders are finite, of the camera's size and without gradients;
    what is saved and loaded renders the same; the same seed trains to the same picture (to 1e-3 on a GPU).

    Args:
        kind: the method's name or import path, as in `method.kind`.
        settings: overrides of its settings, small enough for a tiny scene.
        device: where it is tried, "cpu" or "cuda".
        steps: length of the training.

    Raises:
        AssertionError: it does not conform; the message says in what.
    """
    scene = tiny_scene()
    method = create_method(kind, settings, device, seed=1)
    _check_settings(method)
    _train(method, scene, steps)
    camera = scene.test[0].camera.to(device)
    picture = _check_rendering(method.render(camera), camera)
    _check_counts(method)
    with tempfile.TemporaryDirectory() as folder:
        method.save(Path(folder) / "checkpoint")
        loaded = create_method(kind, settings, device, seed=2)
        loaded.load(Path(folder) / "checkpoint")
    loaded.prepare()
    _expect_equal(picture, loaded.render(camera).color, 0.0, "a loaded checkpoint does not render as what was saved")
    again = create_method(kind, settings, device, seed=1)
    _train(again, scene, steps)
    tolerance = 0.0 if device == "cpu" else 1e-3
    _expect_equal(picture, again.render(camera).color, tolerance, "the same seed does not train to the same picture")


def tiny_scene() -> Scene:
    """Cameras in a ring that look at the origin, in a world whose color is that of the viewing direction."""
    generator = torch.Generator().manual_seed(0)
    views = [_view(f"view{index}", 2 * math.pi * index / VIEWS) for index in range(VIEWS)]
    points = torch.randn(POINTS, 3, generator=generator)
    colors = torch.rand(POINTS, 3, generator=generator)
    return Scene("tiny", train=views[1:], test=views[:1], points=points, point_colors=colors)


def _view(name: str, angle: float) -> View:
    forward = torch.tensor([-math.sin(angle), 0.0, -math.cos(angle)])
    down = torch.tensor([0.0, -1.0, 0.0])
    rotation = torch.stack([torch.linalg.cross(down, forward), down, forward])
    pose = torch.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, rotation @ (4 * forward)
    focal = float(WIDTH)
    intrinsics = torch.tensor([[focal, 0.0, WIDTH / 2], [0.0, focal, HEIGHT / 2], [0.0, 0.0, 1.0]])
    camera = Camera(pose, intrinsics, WIDTH, HEIGHT)
    directions = torch.nn.functional.normalize(camera.rays()[1], dim=-1)
    return View(name, camera, ((directions + 1) * 127.5).round().to(torch.uint8), normal=-directions)


def _check_settings(method: Method) -> None:
    kind = type(method).Settings
    _expect(dataclasses.is_dataclass(kind), f"Settings is {kind!r}, expected a dataclass")
    _expect(kind.__dataclass_params__.frozen, "Settings is not frozen: @dataclass(frozen=True)")  # type: ignore[attr-defined]
    kind()  # every field has a default


def _train(method: Method, scene: Scene, steps: int) -> None:
    method.initialize(scene, steps)
    sets = set(method.primitives())
    for step in range(1, steps + 1):
        losses = method.training_step(scene.train[step % len(scene.train)], step)
        _expect("loss" in losses, f"training_step returned {sorted(losses)}, expected the total as 'loss' among them")
        for name, value in losses.items():
            single = value.numel() == 1 if isinstance(value, Tensor) else isinstance(value, float)
            _expect(single, f"loss {name!r} is {value!r:.100}, expected a float or a tensor of one value")
            _expect(math.isfinite(value), f"loss {name!r} is {value} in step {step}")
        now = set(method.primitives())
        _expect(now == sets, f"primitives() has keys {sorted(now)} in step {step}, {sorted(sets)} before: keep them")
    _expect(int(method.skipped_steps) == 0, f"skipped_steps is {method.skipped_steps} though every loss was finite")
    method.prepare()


def _check_rendering(rendering: Rendering, camera: Camera) -> Tensor:
    size = (camera.height, camera.width)
    for name, shape in {"color": (*size, 3), "alpha": size, "depth": size, "normal": (*size, 3)}.items():
        value = getattr(rendering, name)
        _expect(tuple(value.shape) == shape, f"render().{name} has shape {tuple(value.shape)}, expected {shape}")
        _expect(value.dtype == torch.float32, f"render().{name} is {value.dtype}, expected torch.float32")
        _expect(not value.requires_grad, f"render().{name} carries gradients: render under torch.no_grad()")
        _expect(bool(torch.isfinite(value).all()), f"render().{name} is not finite everywhere")
    for name, layer in rendering.layers.items():
        fits = tuple(layer.shape) in (size, (*size, 1), (*size, 3))
        _expect(fits, f"layer {name!r} has shape {tuple(layer.shape)}, expected {size} with 1, 3 or no channels")
    return rendering.color


def _check_counts(method: Method) -> None:
    counts, sizes = method.primitives(), method.model_bytes()
    _expect(set(counts) == set(sizes), f"primitives() has keys {sorted(counts)}, model_bytes() has {sorted(sizes)}")
    for name, value in [*counts.items(), *sizes.items()]:
        _expect(isinstance(value, int) and value >= 0, f"set {name!r} counts {value!r}, expected an integer ≥ 0")
    _expect(sum(sizes.values()) > 0, "model_bytes() is 0: a trained model has a size")


def _expect_equal(a: Tensor, b: Tensor, tolerance: float, problem: str) -> None:
    difference = float((a - b).abs().max())
    _expect(difference <= tolerance, f"{problem}: they differ by up to {difference:.3g}")


def _expect(condition: bool, problem: str) -> None:
    if not condition:
        raise AssertionError(problem)
