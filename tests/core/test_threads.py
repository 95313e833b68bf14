"""Torch's own operations on one thread, and the backend's on as many as before."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from core_scenes import plain_camera, random_set
from torch_threads import torch_threads

from envgs_bench.core import rasterize, torch_on_one_thread
from envgs_bench.core.threads import workers

THREADS = 3


@pytest.fixture(autouse=True)
def several_threads() -> Iterator[None]:
    with torch_threads(THREADS):
        yield


def test_the_backend_keeps_its_threads_however_deep() -> None:
    with torch_on_one_thread():
        assert (torch.get_num_threads(), workers()) == (1, THREADS)
        with torch_on_one_thread():
            assert (torch.get_num_threads(), workers()) == (1, THREADS)
        assert (torch.get_num_threads(), workers()) == (1, THREADS)
    assert (torch.get_num_threads(), workers()) == (THREADS, THREADS)


def test_an_error_leaves_torch_its_threads() -> None:
    with pytest.raises(ValueError, match="inside"), torch_on_one_thread():
        raise ValueError("inside")
    assert (torch.get_num_threads(), workers()) == (THREADS, THREADS)


def gradients_of_an_image() -> list[torch.Tensor]:
    surfels = random_set(300, degree=2).map(lambda field: field.requires_grad_())
    rasterize(surfels, plain_camera(), backend="cpu").color.square().sum().backward()
    return [field.grad for field in vars(surfels).values() if field is not None and field.grad is not None]


def test_gradients_are_the_same_to_the_last_bit() -> None:
    """Which they are only of as many workers: each adds up its part, and the parts are added up."""
    outside = gradients_of_an_image()
    with torch_on_one_thread():
        inside = gradients_of_an_image()
    with torch_threads(1):
        alone = gradients_of_an_image()
    assert len(outside) > 4
    assert all(torch.equal(a, b) for a, b in zip(outside, inside, strict=True))
    assert not all(torch.equal(a, b) for a, b in zip(outside, alone, strict=True))
