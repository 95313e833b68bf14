"""Training views on the method's device: copied once, as long as there is room, and not again at every step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from envgs_bench.core import View

SHARE_OF_DEVICE = 0.25  # part of a GPU's memory that views may stay in


def as_given(view: View) -> View:
    return view


class ResidentViews:
    """Views with what training reads of them, camera, image and normals, on one device.

    A step waits for every copy from the CPU's memory: at 800×800 pixels, image and normals are 10 MB.

    Args:
        device: where the views go.
        room: bytes that may stay there; views that come later are copied whenever they are asked for.
        mended: what becomes of a view on its way, the same for the same view.
    """

    def __init__(self, device: torch.device, room: int, mended: Callable[[View], View] = as_given) -> None:
        self.device, self._room, self._mended = device, room, mended
        self._copies: dict[int, tuple[View, View]] = {}  # by id(view); the view is kept, so that no other gets it

    @classmethod
    def of(cls, device: torch.device, mended: Callable[[View], View] = as_given) -> ResidentViews:
        """With room for SHARE_OF_DEVICE of a GPU; views on the CPU are where they are already."""
        on_gpu = device.type == "cuda"
        return cls(device, int(SHARE_OF_DEVICE * torch.cuda.mem_get_info(device)[1]) if on_gpu else 0, mended)

    def on_device(self, view: View) -> View:
        """The view there, without masks and depth."""
        known = self._copies.get(id(view))
        if known is not None:
            return known[1]
        image = view.image.to(self.device)
        normal = None if view.normal is None else view.normal.to(self.device)
        copy = self._mended(replace(view, image=image, normal=normal, masks={}, depth=None))
        copy, normal = replace(copy, camera=copy.camera.to(self.device)), copy.normal
        size = image.nbytes + (0 if normal is None else normal.nbytes)
        if size <= self._room:
            self._room -= size
            copy = replace(copy, image=_by_planes(image), normal=None if normal is None else _by_planes(normal))
            self._copies[id(view)] = view, copy
        return copy


def _by_planes(pixels: Tensor) -> Tensor:
    """The same [H, W, C], in memory a plane a channel as what the core draws: kernels then read both side by side."""
    return pixels.movedim(2, 0).contiguous().movedim(0, 2)
