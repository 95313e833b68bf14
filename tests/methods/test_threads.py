"""Small images and sets are trained and drawn with torch's own operations on one thread."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import torch
from torch_threads import torch_threads

from envgs_bench.core import View
from envgs_bench.methods.gaussians import model
from envgs_bench.methods.registry import create_method
from envgs_bench.testing import tiny_scene

THREADS = 3


@pytest.fixture(autouse=True)
def several_threads() -> Iterator[None]:
    with torch_threads(THREADS):
        yield
        assert torch.get_num_threads() == THREADS


def threads_seen(kind: str, monkeypatch: pytest.MonkeyPatch, **settings: Any) -> list[int]:
    """How many torch has as a training step draws, as its losses are made, and as an image is drawn."""
    method, seen, scene = create_method(kind, settings), [], tiny_scene()
    draw, losses = type(method).draw, type(method).losses

    def drawn(*arguments: Any) -> Any:
        seen.append(torch.get_num_threads())
        return draw(*arguments)

    def judged(*arguments: Any) -> Any:
        seen.append(torch.get_num_threads())
        return losses(*arguments)

    monkeypatch.setattr(type(method), "draw", drawn)
    monkeypatch.setattr(type(method), "losses", judged)
    method.initialize(scene, 10)
    view: View = scene.train[0]
    method.training_step(view, 1)
    method.render(view.camera)
    return seen


@pytest.mark.parametrize("kind", ["2dgs", "3dgs", "envgs"])
def test_small_ones_take_one(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = {"env_grid": 2} if kind == "envgs" else {}
    assert threads_seen(kind, monkeypatch, **settings) == [1, 1, 1]


@pytest.mark.parametrize("bound", ["SMALL_IMAGE", "SMALL_SETS"])
def test_larger_ones_take_all(bound: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model, bound, 3)
    assert threads_seen("2dgs", monkeypatch) == [THREADS] * 3


def test_the_torch_backend_takes_all(monkeypatch: pytest.MonkeyPatch) -> None:
    assert threads_seen("2dgs", monkeypatch, backend="torch") == [THREADS] * 3


def test_a_perceptual_loss_is_learned_from_with_all(monkeypatch: pytest.MonkeyPatch) -> None:
    assert threads_seen("2dgs", monkeypatch, perceptual_weight=0.01) == [THREADS, THREADS, 1]
