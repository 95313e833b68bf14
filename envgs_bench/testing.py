"""Does a method conform? For whoever adds one: call `check_method` in a test."""

from __future__ import annotations

import dataclasses
import math
import tempfile
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from envgs_bench.methods.method import Budget, Method
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.training.step_graphs import GraphWarning

from .core import Camera, Rendering, Scene, View
from .parts import SETS
from .stages.snapshots import read_state, write_state

WIDTH, HEIGHT = 32, 24
VIEWS = 6
POINTS = 200
STEPS = 8
HARNESS_LAYERS = ("normal", "depth", "error")  # added to every method's own, see stages/pictures.py


def check_method(kind: str, settings: Mapping[str, Any] | None = None, device: str = "cpu", steps: int = STEPS) -> None:
    """Train the method for a few steps on a tiny scene and hold it against the contract of `Method`.

    Settings are a frozen dataclass with defaults; losses are finite, with their total as "loss"; primitives and bytes
    are counted for each of `SETS` throughout; renders and layers are finite, of the camera's size, without gradients,
    and the same after another `prepare`; what is saved and loaded renders and counts the same, and an empty folder is
    refused; the same seed trains to the same picture (to 1e-3 on a GPU), and so does a training that is interrupted and
    goes on, where the method can. A method that uses the perceptual loss calls
    it where it is offered and trains without it where it is not. On a GPU, where steps come from CUDA graphs, these do
    what the steps launched do, whatever the step's number. A step on a picture that is not finite is counted in
    `skipped_steps` and changes no render. A method that takes a budget of primitives is never above it.

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
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", GraphWarning)
        _train_with_perceptual(method, scene, steps)
    found = [str(warning.message) for warning in warned if issubclass(warning.category, GraphWarning)]
    _expect(not found, "".join(found[:1]))
    camera = scene.test[0].camera.to(device)
    picture = _check_rendering(method.render(camera), camera)
    _expect_equal(picture, method.picture(camera), 1e-4, "picture() is not render()'s color")
    method.prepare()
    _expect_equal(picture, method.render(camera).color, 0.0, "another prepare() changes the picture")
    _check_counts(method)
    loaded = create_method(kind, settings, device, seed=2)
    _save_and_load(method, loaded)
    loaded.prepare()
    _expect_equal(picture, loaded.render(camera).color, 0.0, "a loaded checkpoint does not render as what was saved")
    again = create_method(kind, settings, device, seed=1)
    _train_with_perceptual(again, scene, steps)
    tolerance = 0.0 if device == "cpu" else 1e-3
    _expect_equal(picture, again.render(camera).color, tolerance, "the same seed does not train to the same picture")
    begins, goes_on = (create_method(kind, settings, device, seed=1) for _ in range(2))
    if _train_with_interruption(begins, goes_on, scene, steps):
        resumed = goes_on.render(camera).color
        _expect_equal(picture, resumed, tolerance, "an interrupted training does not end where it would have")
    _check_skipping(create_method(kind, settings, device, seed=1), scene, steps)
    _check_budget(create_method(kind, settings, device, seed=1), scene, steps)


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


def _train_with_perceptual(method: Method, scene: Scene, steps: int) -> None:
    """The whole training, with a stand-in for the perceptual loss where the method uses one."""
    calls = _offer_perceptual(method)
    _train(method, scene, steps, steps)
    _expect(bool(calls) or not method.needs.perceptual, "needs a perceptual loss, but no training step calls it")


def _offer_perceptual(method: Method) -> list[None]:
    """Offer a stand-in for the perceptual loss where the method uses one; the calls of it, as they come."""
    calls: list[None] = []

    def perceptual(image: Tensor, target: Tensor) -> Tensor:
        calls.append(None)
        return (image - target).abs().mean()

    if name := method.needs.perceptual:
        method.perceptual[name] = perceptual
    return calls


def _train_with_interruption(first: Method, second: Method, scene: Scene, steps: int) -> bool:
    """The training, its second half by another method, which goes on from the first's state; False if it cannot."""
    for method in (first, second):
        _offer_perceptual(method)
    _train(first, scene, steps, steps // 2)
    state = first.training_state()
    if state is None:
        return False
    with tempfile.TemporaryDirectory() as folder:  # it must be what a file can hold
        write_state(Path(folder) / "state", state)
        second.resume(scene, steps, read_state(Path(folder) / "state"))
    _steps(second, scene, steps // 2 + 1, steps)
    return True


def _train(method: Method, scene: Scene, steps: int, until: int) -> None:
    """The steps 1 to `until` of a run of `steps`."""
    method.initialize(scene, steps)
    _steps(method, scene, 1, until)


def _steps(method: Method, scene: Scene, first: int, last: int) -> None:
    sets = set(method.primitives())
    for step in range(first, last + 1):
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


def _check_skipping(method: Method, scene: Scene, steps: int) -> None:
    """The last step sees a picture that is not finite; the perceptual loss was not to be had."""
    _train(method, scene, steps, steps - 1)
    camera = scene.test[0].camera.to(method.device)
    before = method.render(camera).color
    spoiled = NotFinite(**vars(scene.train[0]))
    losses = method.training_step(spoiled, steps)
    if math.isfinite(losses["loss"]):
        return  # it read other pixels than `View.rgb` gives
    skipped = int(method.skipped_steps)
    _expect(skipped == 1, f"skipped_steps is {skipped} after a step whose loss was not finite, expected 1")
    method.prepare()
    after = method.render(camera).color
    _expect(bool(torch.equal(before, after)), "a step whose loss is not finite was applied: it changes the picture")


def _check_budget(method: Method, scene: Scene, steps: int) -> None:
    """Half as many primitives as the scene has points, where the method takes a budget at all."""
    most = POINTS // 2
    try:
        method.limit(Budget(primitives=most))
    except ValueError:
        return
    method.initialize(scene, steps)
    for step in range(steps + 1):
        if step:
            method.training_step(scene.train[step % len(scene.train)], step)
        count = sum(method.primitives().values())
        _expect(count <= most, f"{count} primitives after step {step}, of a budget of {most}")


class NotFinite(View):
    """A view whose picture overflowed."""

    def rgb(self, device: torch.device | str = "cpu") -> Tensor:
        return torch.full(self.image.shape, math.nan, device=device)


def _save_and_load(method: Method, loaded: Method) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            loaded.load(folder)
        except (FileNotFoundError, ValueError):
            pass
        else:
            raise AssertionError("load() of an empty folder raises neither FileNotFoundError nor ValueError")
        method.save(folder / "checkpoint")
        loaded.load(folder / "checkpoint")
    for what in ("primitives", "model_bytes"):
        saved, found = getattr(method, what)(), getattr(loaded, what)()
        _expect(saved == found, f"{what}() is {found} after load(), {saved} when it was saved")


def _check_rendering(rendering: Rendering, camera: Camera) -> Tensor:
    size = (camera.height, camera.width)
    for name, shape in {"color": (*size, 3), "alpha": size, "depth": size, "normal": (*size, 3)}.items():
        value = getattr(rendering, name)
        _expect(tuple(value.shape) == shape, f"render().{name} has shape {tuple(value.shape)}, expected {shape}")
        _expect(value.dtype == torch.float32, f"render().{name} is {value.dtype}, expected torch.float32")
        _expect(not value.requires_grad, f"render().{name} carries gradients: render under torch.no_grad()")
        _expect(bool(torch.isfinite(value).all()), f"render().{name} is not finite everywhere")
    for name, layer in rendering.layers.items():
        _expect(name not in HARNESS_LAYERS, f"a layer is called {name!r}, which the harness adds: rename it")
        fits = tuple(layer.shape) in (size, (*size, 1), (*size, 3))
        _expect(fits, f"layer {name!r} has shape {tuple(layer.shape)}, expected {size} with 1, 3 or no channels")
        _expect(not layer.requires_grad, f"layer {name!r} carries gradients: render under torch.no_grad()")
        _expect(bool(torch.isfinite(layer).all()), f"layer {name!r} is not finite everywhere")
    return rendering.color


def _check_counts(method: Method) -> None:
    counts, sizes = method.primitives(), method.model_bytes()
    for what, found in (("primitives", counts), ("model_bytes", sizes)):
        _expect(set(found) == set(SETS), f"{what}() has keys {sorted(found)}, expected {sorted(SETS)}")
    for name, value in [*counts.items(), *sizes.items()]:
        _expect(isinstance(value, int) and value >= 0, f"set {name!r} counts {value!r}, expected an integer ≥ 0")
    _expect(sum(sizes.values()) > 0, "model_bytes() is 0: a trained model has a size")


def _expect_equal(a: Tensor, b: Tensor, tolerance: float, problem: str) -> None:
    difference = float((a - b).abs().max())
    _expect(difference <= tolerance, f"{problem}: they differ by up to {difference:.3g}")


def _expect(condition: bool, problem: str) -> None:
    if not condition:
        raise AssertionError(problem)
