"""Views that stay on a device: which of them, what room they take there, and that none is taken for another."""

from __future__ import annotations

from dataclasses import replace

import torch

from envgs_bench.core import Camera, View
from envgs_bench.methods.training.resident_views import ResidentViews

DEVICE = torch.device("cpu")
NORMAL_BYTES = 6 * 8 * 3 * 4
BYTES = NORMAL_BYTES + 6 * 8 * 3  # with the image


def view(name: str) -> View:
    camera = Camera(torch.eye(4), torch.tensor([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]]), 8, 6)
    image = torch.zeros(6, 8, 3, dtype=torch.uint8)
    return View(name, camera, image, {"all": torch.ones(6, 8, dtype=torch.bool)}, torch.zeros(6, 8, 3))


def moved(view: View) -> View:
    """As if the device were another."""
    assert view.normal is not None
    return replace(view, image=view.image.clone(), normal=view.normal.clone())


def test_a_view_is_copied_once() -> None:
    views, one = ResidentViews(DEVICE, BYTES, moved), view("a")
    copy = views.on_device(one)
    torch.testing.assert_close([copy.image, copy.normal], [one.image, one.normal])
    assert copy.masks == {}
    assert views.on_device(one) is copy


def test_a_view_without_room_is_copied_each_time() -> None:
    views, one, other = ResidentViews(DEVICE, 2 * BYTES - 1, moved), view("a"), view("b")
    stays = views.on_device(one)
    assert views.on_device(other) is not views.on_device(other)
    assert views.on_device(one) is stays


def test_what_the_view_has_itself_takes_no_room() -> None:
    """On a CPU images stay the tensors that they are; normals that are turned are made once, not at every step."""
    learned = []

    def with_other_normals(view: View) -> View:
        learned.append(view.name)
        assert view.normal is not None
        return replace(view, normal=view.normal + 1)

    views, one = ResidentViews(DEVICE, NORMAL_BYTES, with_other_normals), view("a")
    for _ in range(2):
        assert views.on_device(one).image is one.image
    assert learned == ["a"]
    as_given = ResidentViews(DEVICE, room=0)
    assert as_given.on_device(one) is as_given.on_device(one)


def test_views_of_one_name_are_not_mixed_up() -> None:
    views = ResidentViews(DEVICE, room=2 * BYTES)
    assert views.on_device(view("a")) is not views.on_device(view("a"))
