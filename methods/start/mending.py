"""Points, poses, exposures and normals that a method would not survive as given, judged by the photographs, and mended.

Where structure from motion failed (points that the pictures do not support, none where the pictures show something, at
the cameras' centers), a plane sweep finds others; where it found all but what is far away, a sky, that alone is added.
Views that show the points elsewhere than their poses say are turned, and those that show them brighter or darker than
the others made equal.
A scene in order is left as it is, to the last bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from envgs_bench.core import Scene, View

from .agreement import agreement, corrected
from .alignment import alignment, turned
from .evidence import CELLS, Evidence, cells_with, empty_cells, mirrored_normals
from .exposures import Exposures, equalized, exposures
from .plane_sweep import swept_points
from .windows import Windows, outside, share_of, windows

UNSUPPORTED = 0.04  # `Evidence.support` below which points are where chance put them
MISSING = 0.7  # share of a view's cells with a point below which pictures show much that no point starts
FAR = 1.5  # distance from every camera beyond which a point is far away, × the scene radius
FAR_MISSING = 0.01  # share of the views' cells in which points far away must be found to be missed
TURNED = 0.12  # share of its differences to the points' colors that the median view must lose when it is turned
AGREEING = 14.0  # degrees between two views' normals of a point up to which normals count in full: each is off by 10
CORRECTED = 1.4  # × what two corrected normals differ by at a point: mirrors, which have none, are corrected less
WINDOWS = 0.05  # share of the views' cells that must surely show windows: fewer may be chance, and matter little
LIKELY_WINDOWS = 0.1  # … that must be likely to
PER_CELL = 3  # pixels of each empty cell of a view that are swept
TRIED = 4  # × as many are drawn, and those with the strongest gradients are taken
NEAREST, FARTHEST = 0.1, 20.0  # depths that are swept, × the scene radius
MIN_POINTS = 8  # that a set can start from


@dataclass(frozen=True)
class MendedViews:
    """Training views are made as bright as all, turned where poses are off, and normals mirrored, corrected, left out.

    Attributes:
        light: by views' names the factors [3] that their pictures' linear light is divided by; none where it is equal.
        turns: by views' names the rotations [3, 3] after their own, none where poses are in order.
        mirrored: names of the views whose normals are to be mirrored from left to right.
        corrections: by views' names what their normals are then `corrected` by.
        windows: by views' names the cells [CELLS, CELLS] in which normals are of glass, and left out.
    """

    light: Mapping[str, Tensor] = field(default_factory=dict)
    turns: Mapping[str, Tensor] = field(default_factory=dict)
    mirrored: frozenset[str] = frozenset()
    corrections: Mapping[str, Tensor] = field(default_factory=dict)
    windows: Mapping[str, Tensor] = field(default_factory=dict)

    def __call__(self, view: View) -> View:
        """What to train on in the view's place; on the device that it is on."""
        if view.name in self.light:
            view = replace(view, image=equalized(view.image, self.light[view.name]))
        if view.name in self.turns:
            view = turned(view, self.turns[view.name])
        if view.normal is not None and view.name in self.mirrored:
            view = replace(view, normal=mirrored_normals(view.normal, view))
        if view.normal is not None and view.name in self.corrections:
            view = replace(view, normal=corrected(view.normal, self.corrections[view.name]))
        if view.normal is not None and view.name in self.windows:
            view = replace(view, normal=outside(view.normal, self.windows[view.name]))
        return view


@dataclass(frozen=True)
class Mended:
    """What a method starts from.

    Attributes:
        scene: the scene itself where its points are in order, else one with others.
        views: what becomes of the training views.
        normal_weight: how much the views' normals count, in (0, 1].
        notes: what is not as it was given, a sentence each.
        windows: what lies behind its normals, as far as pictures tell; none of a kind of which there is too little.
    """

    scene: Scene
    views: MendedViews = MendedViews()
    normal_weight: float = 1.0
    notes: Sequence[str] = ()
    windows: Windows = field(default_factory=Windows)

    def outside(self, cells: Mapping[str, Tensor], note: str) -> Mended:
        """The same without the normals in these windows' cells, and what is to be said of it."""
        return replace(self, views=replace(self.views, windows=cells), notes=[*self.notes, note])

    def outside_sure_windows(self) -> Mended:
        """Without the normals in windows that nothing else looks like, where there are any."""
        cells = self.windows.sure
        if not cells:
            return self
        share = share_of(cells, len(self.scene.train))
        return self.outside(
            cells,
            f"learns no normals from {share:.0%} of what the training views show, which lies behind them, as what "
            "flat mirrors show does",
        )


def mended(scene: Scene, near: float, normals: bool, generator: torch.Generator, device: torch.device) -> Mended:
    """What to start from, the scene itself where it is in order.

    Args:
        near: nearest depth that is drawn, world units: a point that is nearer to a camera is not where it should be.
        normals: whether the views' own normals are learned from.
    """
    start, views, notes = mended_points(scene, near, generator, device), MendedViews(), []
    if start is not scene:  # points that were not in order say nothing of poses and colors
        notes.append(
            f"starts from {len(start.points):,} points in place of {len(scene.points):,}: "
            "those that the training views support, and others found by a plane sweep over them"
        )
    else:
        evidence = Evidence.of(scene, near)
        bright = mended_exposures(evidence)
        views = MendedViews(bright.factors, mended_poses(evidence, device))
        if views.light:
            notes.append(
                f"makes {len(views.light)} of {len(scene.train)} training views equally bright, in each channel: what "
                f"they show at the points is off by {bright.stops:.1f} stops, the median view's"
            )
        if views.turns:
            notes.append(f"turns {len(views.turns)} of {len(scene.train)} training views to where they show the points")
        start = with_far_points(scene, near, generator, device)
        if start is not scene:
            notes.append(
                f"starts from {len(start.points) - len(scene.points):,} points far away too, found by a plane sweep "
                "over the training views: the scene has none on most of what is there"
            )
    found = Mended(start, views, notes=notes)
    has_normals = any(view.normal is not None for view in scene.train)
    return _with_mended_normals(found, near, device) if normals and has_normals else found


def _with_mended_normals(start: Mended, near: float, device: torch.device) -> Mended:
    """The same start with the views' normals mirrored back, brought into agreement and weighed, and windows told."""
    scene, views, notes = start.scene, start.views, [*start.notes]
    evidence = Evidence.of(replace(scene, train=[views(view) for view in scene.train]), near)
    mirrored = frozenset(evidence.mirrored_views())
    given = evidence.normals_unmirrored(mirrored)
    agreed = agreement(evidence, given)
    views = replace(views, mirrored=mirrored, corrections=agreed.corrections)
    if mirrored:
        notes.append(f"mirrors the normals of {len(mirrored)} of {len(scene.train)} training views back")
    disagreement = evidence.normal_disagreement(agreed.normals)
    if views.corrections:
        notes.append(
            f"turns the normals of {len(views.corrections)} of {len(scene.train)} training views, smoothly over "
            f"each picture, to agree: two views' differ by {disagreement:.1f}° at the same point, as given by "
            f"{evidence.normal_disagreement(given):.1f}°"
        )
    remaining = disagreement * (CORRECTED if views.corrections else 1)
    weight = (AGREEING / max(remaining, AGREEING)) ** 2  # as the inverse of their variance
    if weight < 1:
        notes.append(f"counts the training views' normals {weight:.2f} × as much, since these still differ so much")
    seen = windows((views(view.pixels_on(device)) for view in scene.train), *_depths(scene, near), device)
    least = ((seen.sure, WINDOWS), (seen.likely, LIKELY_WINDOWS))
    enough = (cells if share_of(cells, len(scene.train)) >= share else {} for cells, share in least)
    return Mended(scene, views, weight, notes, Windows(*enough))


@torch.no_grad()
def mended_points(scene: Scene, near: float, generator: torch.Generator, device: torch.device) -> Scene:
    """The scene with other points where those it has cannot be trained on, else the scene itself."""
    sound = without_points_at_cameras(scene, near)
    if len(sound.points) and Evidence.of(sound, near).support() < UNSUPPORTED:
        sound = _with(sound, torch.zeros(0, dtype=torch.long))
    empty, covered = empty_cells(sound, near, device)
    if covered >= MISSING:
        return scene
    started = _joined(sound, *_swept(scene, empty, near, generator, device))
    return started if len(started.points) >= MIN_POINTS else scene


@torch.no_grad()
def with_far_points(scene: Scene, near: float, generator: torch.Generator, device: torch.device) -> Scene:
    """The scene with points far away where most of what is there has none, a sky, else the scene itself.

    Of a sky structure from motion may find nothing and of all else enough. Then primitives before the cameras have to
    show it. The generator is as before if nothing is added.
    """
    empty, _ = empty_cells(scene, near, device)
    farther = FAR * (scene.radius or 1.0)
    known = scene.points.detach().to(device).float()
    is_far = _from_cameras(known, scene) > farther
    far, near_by = known[is_far], known[~is_far]
    only_far = (cells_with(far, view, near) & ~cells_with(near_by, view, near) for view in scene.train)
    least = max(FAR_MISSING * empty.numel(), 1 + sum(int(cells.sum()) for cells in only_far))  # cells to be missed
    if empty.sum() < least:
        return scene
    state = generator.get_state()
    points, colors = _swept(scene, empty, near, generator, device)
    is_far = _from_cameras(points, scene) > farther
    points, colors = points[is_far], colors[is_far]
    found = points.to(device)
    missed = sum(
        int((cells_with(found, view, near).cpu() & where).sum()) for view, where in zip(scene.train, empty, strict=True)
    )
    if missed < least:
        generator.set_state(state)
        return scene
    return _joined(scene, points, colors)


def mended_poses(evidence: Evidence, device: torch.device) -> dict[str, Tensor]:
    """Rotations [3, 3] to follow those of the training views, by name; none where poses are in order."""
    if evidence.colorless or evidence.support() < UNSUPPORTED:
        return {}
    found = alignment(evidence, device)
    if found.gain < TURNED:
        return {}
    each = zip(evidence.views, found.turns, found.gains, strict=True)
    return {view.name: turn for view, turn, gain in each if gain > 0}


def mended_exposures(evidence: Evidence) -> Exposures:
    """How bright the training views are, with factors to divide their light by; none where exposures are in order."""
    return exposures(evidence) if evidence.support() >= UNSUPPORTED else Exposures()


def without_points_at_cameras(scene: Scene, near: float) -> Scene:
    """The scene without points that lie nearer than `near` to any training camera's center."""
    distances = _from_cameras(scene.points.detach().cpu().float(), scene)
    return _with(scene, torch.nonzero(distances >= near)[:, 0])


def _from_cameras(points: Tensor, scene: Scene) -> Tensor:
    """Distances [P] of the points [P, 3] to the nearest training camera's center."""
    nearest = points.new_full((len(points),), torch.inf)
    for view in scene.train:
        nearest = torch.minimum(nearest, (points - view.camera.center.to(points)).norm(dim=1))
    return nearest


def _swept(
    scene: Scene, empty: Tensor, near: float, generator: torch.Generator, device: torch.device
) -> tuple[Tensor, Tensor]:
    """Points [P, 3] of what the training views show in their empty cells [V, CELLS, CELLS], and their colors [P, 3]."""
    wanted = [_strongest(view, where, generator) for view, where in zip(scene.train, empty, strict=True)]
    return swept_points(scene.train, wanted, *_depths(scene, near), generator, device)


def _depths(scene: Scene, near: float) -> tuple[float, float]:
    """Between which a plane sweep looks, world units."""
    scale = scene.radius or 1.0
    return max(near, NEAREST * scale), FARTHEST * scale


def _joined(scene: Scene, points: Tensor, colors: Tensor) -> Scene:
    """The scene with the points [P, 3] and their colors [P, 3] beside its own."""
    return replace(
        scene,
        points=torch.cat([scene.points.float(), points]),
        point_colors=torch.cat([scene.point_colors.float(), colors]),
    )


def _with(scene: Scene, rows: Tensor) -> Scene:
    if len(rows) == len(scene.points):
        return scene
    return replace(scene, points=scene.points[rows], point_colors=scene.point_colors[rows])


def _strongest(view: View, empty: Tensor, generator: torch.Generator) -> Tensor:
    """Pixel positions [K, 2] in the empty cells [CELLS, CELLS], where the picture changes most: PER_CELL a cell."""
    where = torch.nonzero(empty)  # [C, 2], rows and columns
    size = torch.tensor([view.camera.height, view.camera.width])
    drawn = torch.rand(len(where), PER_CELL * TRIED, 2, generator=generator)
    pixels = ((where[:, None] + drawn) / CELLS * size).long().minimum(size - 1)
    gray = view.rgb().mean(dim=-1)
    gradient = torch.stack(torch.gradient(gray)).square().sum(dim=0) if min(gray.shape) > 1 else gray
    rows, columns = pixels.unbind(dim=-1)
    best = gradient[rows, columns].topk(PER_CELL, dim=1).indices
    chosen = pixels.gather(1, best[..., None].expand(-1, -1, 2)).reshape(-1, 2).unique(dim=0)
    return chosen.flip(-1).float() + 0.5
