"""Views that stay on a device: which of them, and that none is taken for another."""

from __future__ import annotations

import torch

from envgs_bench.core import Camera, View
from envgs_bench.methods.resident_views import ResidentViews

DEVICE = torch.device("cpu")
BYTES = 6 * 8 * 3 * (1 + 4)  # image and normals


def view(name: str) -> View:
    camera = Camera(torch.eye(4), torch.tensor([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]]), 8, 6)
    image = torch.zeros(6, 8, 3, dtype=torch.uint8)
    return View(name, camera, image, {"all": torch.ones(6, 8, dtype=torch.bool)}, torch.zeros(6, 8, 3))


def test_a_view_is_copied_once() -> None:
    views, one = ResidentViews(DEVICE, room=BYTES), view("a")
    copy = views.on_device(one)
    torch.testing.assert_close([copy.image, copy.normal], [one.image, one.normal])
    assert copy.masks == {}
    assert views.on_device(one) is copy


def test_a_view_without_room_is_copied_each_time() -> None:
    views, one, other = ResidentViews(DEVICE, room=2 * BYTES - 1), view("a"), view("b")
    stays = views.on_device(one)
    assert views.on_device(other) is not views.on_device(other)
    assert views.on_device(one) is stays


def test_views_of_one_name_are_not_mixed_up() -> None:
    views = ResidentViews(DEVICE, room=2 * BYTES)
    assert views.on_device(view("a")) is not views.on_device(view("a"))
