"""Training views as they are learned from, on the method's device: made once, as long as there is room for them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from envgs_bench.core import View
from envgs_bench.memory import machine_memory

SHARE_OF_MEMORY = 0.25  # of a GPU's, or of what this process may take, that views may stay in


def as_given(view: View) -> View:
    return view


class ResidentViews:
    """Views with what training reads of them, camera, image and normals, on one device.

    A GPU's step waits for every copy from the CPU's memory: at 800×800 pixels, image and normals are 10 MB. To turn the
    normals of as large a view takes a CPU 0.1 s.

    Args:
        device: where the views go.
        room: bytes that may stay there besides the views as given; those that come later are made whenever asked for.
        learned: what becomes of a view on its way, the same for the same view.
    """

    def __init__(self, device: torch.device, room: int, learned: Callable[[View], View] = as_given) -> None:
        self.device, self._room, self._learned = device, room, learned
        self._copies: dict[int, tuple[View, View]] = {}  # by id(view); the view is kept, so that no other gets it

    @classmethod
    def of(cls, device: torch.device, learned: Callable[[View], View] = as_given) -> ResidentViews:
        """With room for SHARE_OF_MEMORY."""
        memory = torch.cuda.mem_get_info(device)[1] if device.type == "cuda" else machine_memory()
        return cls(device, int(SHARE_OF_MEMORY * memory), learned)

    def all_of(self, views: Sequence[View]) -> Callable[[], Iterable[View]]:
        """Those views there, one after the other at each call."""
        return lambda: map(self.on_device, views)

    def on_device(self, view: View) -> View:
        """The view there, without masks and depth."""
        known = self._copies.get(id(view))
        if known is not None:
            return known[1]
        copy = self._learned(replace(view.pixels_on(self.device), masks={}, depth=None))
        copy = replace(copy, camera=copy.camera.to(self.device))
        made = _bytes_made(copy.image, view.image) + _bytes_made(copy.normal, view.normal)
        if made <= self._room:
            self._room -= made
            if self.device.type == "cuda":
                normal = None if copy.normal is None else _by_planes(copy.normal)
                copy = replace(copy, image=_by_planes(copy.image), normal=normal)
            self._copies[id(view)] = view, copy
        return copy


def _bytes_made(pixels: Tensor | None, given: Tensor | None) -> int:
    return 0 if pixels is None or pixels is given else pixels.nbytes


def _by_planes(pixels: Tensor) -> Tensor:
    """The same [H, W, C], in memory a plane a channel as what the core draws: kernels then read both side by side."""
    return pixels.movedim(2, 0).contiguous().movedim(0, 2)
