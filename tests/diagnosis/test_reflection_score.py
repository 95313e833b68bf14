"""Reflections that photographs show by themselves: a cube with a flat mirror, whose surfaces are known exactly."""

from __future__ import annotations

import torch
from mirror_room import MIRROR, mirror_room, walls
from torch import Tensor

from envgs_bench.core import View
from envgs_bench.diagnosis.reflection_score import Surface, reflection_score, reflects
from envgs_bench.methods.lighting.plane_proposals import inside_of


def surface(view: View, has_mirror: bool = True) -> Surface:
    """With the depths of walls, and of the mirror before them."""
    origins, rays = view.camera.rays()
    distance, _ = walls(origins, rays)
    within, before = inside_of(MIRROR, origins, rays, 1e-6)
    if has_mirror:
        distance = torch.where((within > 0) & (before < distance), before, distance)
    return Surface.of(view, distance)


def found(reflectance: float) -> tuple[Tensor, Tensor, Tensor]:
    """Scores [V, h, w] of some views, which of their pixels reflect, and which do in truth."""
    views = mirror_room(size=48, reflectance=reflectance).train
    surfaces = [surface(view, has_mirror=reflectance > 0) for view in views]
    scores = [reflection_score(own, [each for each in surfaces if each is not own]) for own in surfaces[::4]]
    told = [reflects(score, 48, 48) for score in scores]
    return torch.stack(scores), torch.stack(told), torch.stack([view.masks["reflective"] for view in views[::4]])


def test_what_a_mirror_shows_differs_from_view_to_view() -> None:
    scores, told, truth = found(1.0)
    known = scores.isfinite()
    assert (known & truth).sum() > 0.5 * truth.sum()
    both, either = (told & truth & known).sum(), ((told | truth) & known).sum()
    assert both / either > 0.6
    assert scores[known & truth].median() > 3 * scores[known & ~truth].median()


def test_walls_look_alike_from_everywhere() -> None:
    scores, told, _ = found(0.0)
    assert scores.isfinite().float().mean() > 0.5
    assert told.float().mean() < 0.01


def test_nothing_is_known_where_nothing_stands() -> None:
    views = mirror_room(size=24).train
    empty = [Surface.of(view, torch.zeros(24, 24)) for view in views[:6]]
    score = reflection_score(empty[0], empty[1:])
    assert score.isnan().all()
    assert not reflects(score, 24, 24).any()


def test_a_large_picture_is_looked_at_reduced() -> None:
    view = mirror_room(size=40).train[0]
    assert Surface.size(view.camera) == (40, 40)
    assert Surface.size(view.camera.resized(1000, 700)) == (70, 100)
