"""Planes proposed from views: rectangles of flat mirrors and panes, of regions and of the normals that views have.

Photographs have no depth of a mirror: what shows in it lies behind. A plane's direction comes from the normals, and its
distance from the views together: where the plane lies, the region of one view is that of all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, Scene, View
from envgs_bench.core.normal_prior import pixels_in
from envgs_bench.core.torch.rotation import rotation_matrices
from envgs_bench.core.vectors import unit
from envgs_bench.parts import REFLECTIVE, TRANSMISSIVE

REGIONS = (REFLECTIVE, TRANSMISSIVE)  # masks of mirrors and glass
VIEWS, COLUMNS = 16, 64  # that are looked at, at most; pixels across, at least if there are so many
PARTNERS = (1, 5)  # views further on that each is compared with
MOST = 8  # planes
ALIKE, APART = 0.94, 0.87  # cosines: of normals that count as one plane's, and of those of another
FLAT = 0.2  # radians that normals of a plane may turn by, from its middle to its edges
LEAST = 0.02  # share of the views' pixels that a plane must have
CANDIDATES = 400  # directions that normals are counted around
DISTANCES, FINER = 40, 17  # from the cameras to a plane: in geometric progression, and around the best
NEAREST, FARTHEST = 0.02, 4.0  # of these, × scene radius
AGREEMENT = 0.35  # of what either of two views has in the plane, the part that both must have
FEW = 0.1  # as many of a plane's pixels count as if one view alone had them
CELLS, MOSTLY = 32, 0.7  # along each side of a plane's region; share of the views of a cell that have it in theirs
PIXELS, FITTED, RATE = 40_000, 150, 5e-3  # of the fit to regions: pixels, steps, and × scene radius what moves in one
TURN = 0.1  # what a radian away from the normals costs, squared, in shares of the pixels
AROUND = 1.4  # × the rectangle's size, in which regions are the rectangle's
SOFT = 0.02  # width of the fitted edge, × scene radius


@dataclass(frozen=True)
class Rectangle:
    """A plane's part. `axes` [3, 3] are its rows: along, across, and the normal that faces the cameras."""

    center: Tensor  # [3]
    axes: Tensor
    half: Tensor  # [2] half its length and width, world units


@dataclass(frozen=True)
class _Seen:
    """A reduced view: its camera, which pixels [h, w] may show a plane, and its normals [h, w, 3], 0 elsewhere."""

    camera: Camera
    region: Tensor
    normals: Tensor


def proposed(scene: Scene, by: str) -> list[Rectangle]:
    """Rectangles of the scene's training views, by their "masks" or by "photographs" that show what lies behind.

    None of a scene whose views have no such regions, or no normals there.
    """
    views = scene.train[:: max(1, -(-len(scene.train) // VIEWS))]
    seen = [each for view in views if (each := _reduced(scene, view, by)) is not None]
    if len(seen) < 2:
        return []
    radius, found = scene.radius, list[Rectangle]()
    pixels = sum(each.region.numel() for each in seen)
    while len(found) < MOST:
        direction, count = _commonest([each.normals[each.region] for each in seen])
        if count < LEAST * pixels:
            break
        members = [each.region & (each.normals @ direction > ALIKE) for each in seen]
        rectangle = _rectangle(seen, members, direction, radius)
        if rectangle is not None:
            found.append(_fitted(rectangle, seen, members, radius))
        for each, own in zip(seen, members, strict=True):
            gone = own if rectangle is None else _inside(found[-1], each.camera) | (each.normals @ direction > APART)
            each.region[gone] = False
    return found


def _reduced(scene: Scene, view: View, by: str) -> _Seen | None:
    if scene.normals is not None:
        view = scene.normals.agreed(view)
    if view.normal is None:
        return None
    camera = view.camera
    if by == "masks":
        masks = [view.masks[name] for name in REGIONS if name in view.masks]
        region = torch.stack(masks).any(0) if masks else None
    else:
        cells = None if scene.normals is None else scene.normals.maybe_seen_through.get(view.name)
        region = None if cells is None else pixels_in(cells, camera.height, camera.width)
    if region is None or not region.any():
        return None
    factor = max(1, camera.width // COLUMNS)
    size = (camera.height // factor, camera.width // factor)
    rows, columns = ((torch.arange(n) + 0.5).mul(m / n).long() for n, m in zip(size, region.shape, strict=True))
    region, normals = (values[rows[:, None], columns] for values in (region, view.normal))
    return _Seen(camera.resized(size[1], size[0]), region.clone(), torch.where(region[..., None], normals.float(), 0.0))


def _commonest(normals: Sequence[Tensor]) -> tuple[Tensor, int]:
    """The direction around which most normals lie, and how many."""
    every = torch.cat([*normals])
    if not len(every):
        return torch.zeros(3), 0
    rows = torch.arange(CANDIDATES)
    height, angle = 1 - (2 * rows + 1) / CANDIDATES, rows * (torch.pi * (3 - 5**0.5))
    ring = (1 - height.square()).sqrt()
    candidates = torch.stack([ring * angle.cos(), ring * angle.sin(), height], dim=1)
    direction = candidates[(every @ candidates.T > ALIKE).sum(0).argmax()]
    for _ in range(5):
        direction = unit(every[every @ direction > ALIKE].sum(0))
    return direction, int((every @ direction > ALIKE).sum())


def _rectangle(seen: Sequence[_Seen], members: Sequence[Tensor], direction: Tensor, radius: float) -> Rectangle | None:
    """Where a plane of that direction lies and how far it reaches; None where the views agree on none."""
    ahead = [each.camera.center @ direction for each, own in zip(seen, members, strict=True) if own.any()]
    front = float(max(ahead))  # a plane may stand between cameras: those behind it see another one
    distances = radius * torch.logspace(np.log10(NEAREST), np.log10(FARTHEST), DISTANCES)
    agreements = _agreements(seen, members, direction, front - distances)
    best = int(agreements.argmax())
    around = distances[max(0, best - 1)], distances[min(DISTANCES - 1, best + 1)]
    finer = torch.linspace(float(around[0]), float(around[1]), FINER)
    height = front - finer[int(_agreements(seen, members, direction, front - finer).argmax())]
    rectangle = _bounds(seen, members, direction, float(height))
    if rectangle is None:
        return None
    # Views agree inside the rectangle: parallel planes, and what else is turned alike, are left to themselves.
    own = [each & _inside(rectangle, view.camera) for view, each in zip(seen, members, strict=True)]
    agrees = bool(_agreements(seen, own, direction, height[None]) > AGREEMENT)
    return rectangle if agrees and _bend(rectangle, seen, own) < FLAT else None


def _bend(rectangle: Rectangle, seen: Sequence[_Seen], members: Sequence[Tensor]) -> float:
    """By how much normals turn between a rectangle's middle and its edges, radians: of a ball's part they do."""
    places, turns = [], []
    for each, own in zip(seen, members, strict=True):
        origins, rays = each.camera.rays()
        distance = inside_of(rectangle, origins, rays, 1e-6)[1][own]
        points = origins.expand_as(rays)[own] + distance[:, None] * rays[own]
        places.append((points - rectangle.center) @ rectangle.axes[:2].T / rectangle.half)
        turns.append(each.normals[own] @ rectangle.axes[:2].T)
    place, turn = torch.cat(places), torch.cat(turns)
    place = place - place.mean(0)
    return float((turn.T @ place / place.square().sum(0).clamp_min(1e-9)).norm())


def _hits(camera: Camera, direction: Tensor, heights: Tensor) -> tuple[Tensor, Tensor]:
    """Where the pixels' rays meet the planes x·direction = height from the front, [D, h, w, 3]; whether they do."""
    origins, rays = camera.rays()
    falls = rays @ direction
    along = (heights[:, None, None] - origins @ direction) / falls
    return origins + along.clamp(0, 1e4)[..., None] * rays, (along > 0) & along.isfinite() & (falls < 0)


def _agreements(seen: Sequence[_Seen], members: Sequence[Tensor], direction: Tensor, heights: Tensor) -> Tensor:
    """Of what either of two views shows of a plane, in the picture of both, the share that both do, [D].

    A share of few pixels counts less: of a plane close to the cameras two views show the same hardly anywhere, but
    agree there.
    """
    both, either = torch.zeros(len(heights)), torch.zeros(len(heights))
    for index, (each, own) in enumerate(zip(seen, members, strict=True)):
        points, met = _hits(each.camera, direction, heights)
        for step in PARTNERS:
            other = (index + step) % len(seen)
            pixels, depth = seen[other].camera.project(points)
            column, row = pixels.nan_to_num(-1).clamp(-1, 1e6).floor().long().unbind(-1)
            rows, columns = members[other].shape
            before = (seen[other].camera.center @ direction > heights)[:, None, None]  # else they see its back
            shown = met & before & (depth > 0) & (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
            theirs = members[other][row.clamp(0, rows - 1), column.clamp(0, columns - 1)]
            both += (own & theirs & shown).sum((1, 2))
            either += ((own | theirs) & shown).sum((1, 2))
    few = FEW * sum(int(own.sum()) for own in members)
    return both / (either + few).clamp_min(1)


def _bounds(seen: Sequence[_Seen], members: Sequence[Tensor], direction: Tensor, height: float) -> Rectangle | None:
    """The smallest rectangle in the plane around what most views that show it have in it."""
    from scipy import ndimage  # takes half a second: where there are planes

    helper = torch.tensor([0.0, 0, 1]) if abs(direction[2]) < 0.9 else torch.tensor([1.0, 0, 0])
    along = unit(torch.linalg.cross(helper, direction))
    frame = torch.stack([along, torch.linalg.cross(direction, along), direction])
    places, belongs = [], []
    for each, own in zip(seen, members, strict=True):
        points, met = (values[0] for values in _hits(each.camera, direction, torch.tensor([height])))
        places.append((points[met] @ frame.T)[:, :2])
        belongs.append(own[met])
    place, member = torch.cat(places), torch.cat(belongs)
    if int(member.sum()) < CELLS:
        return None
    low, high = (
        torch.quantile(place[member][:: max(1, len(place[member]) // 100_000)], q, dim=0) for q in (0.005, 0.995)
    )
    cell = ((place - low) / (high - low).clamp_min(1e-6) * CELLS).floor().long()
    within = ((cell >= 0) & (cell < CELLS)).all(1)
    number = (cell[:, 1] * CELLS + cell[:, 0])[within]
    counts = torch.bincount(number, minlength=CELLS**2), torch.bincount(number, member[within].double(), CELLS**2)
    shown, own = (ndimage.gaussian_filter(each.reshape(CELLS, CELLS).double().numpy(), 1.0) for each in counts)
    labels, count = ndimage.label((own > MOSTLY * shown) & (shown > 0))
    if not count:
        return None
    largest = 1 + np.argmax(np.bincount(labels.ravel())[1:])
    rows, columns = (torch.from_numpy(each).float() for each in np.nonzero(labels == largest))
    inside = low + (torch.stack([columns, rows], dim=1) + 0.5) / CELLS * (high - low)
    turned = [_turned(inside, frame, height, angle) for angle in torch.linspace(0, torch.pi / 2, 31)[:-1]]
    return min(turned, key=lambda each: float(each.half.prod()))


def _turned(inside: Tensor, frame: Tensor, height: float, angle: Tensor) -> Rectangle:
    """The rectangle around points [K, 2] of the plane, with sides at that angle to the frame's."""
    turn = torch.stack([torch.stack([angle.cos(), angle.sin()]), torch.stack([-angle.sin(), angle.cos()])])
    places = inside @ turn.T
    low, high = places.amin(0), places.amax(0)
    axes = torch.cat([turn @ frame[:2], frame[2:]])
    return Rectangle(((low + high) / 2) @ axes[:2] + height * axes[2], axes, (high - low) / 2)


def _fitted(rectangle: Rectangle, seen: Sequence[_Seen], members: Sequence[Tensor], radius: float) -> Rectangle:
    """The rectangle moved, turned and resized until it shows as each view's region does.

    What the region has and the rectangle has not counts fully, the other way half: something may stand before it. What
    lies apart from the rectangle is another's, and views from behind do not count.
    """
    rays = [each.camera.rays() for each in seen]
    origins, directions = (torch.cat([ray[part].reshape(-1, 3) for ray in rays]) for part in (0, 1))
    own = torch.cat([each.flatten() for each in members])
    around = Rectangle(rectangle.center, rectangle.axes, AROUND * rectangle.half)
    near = inside_of(around, origins, directions, 1e-6)[0] > 0
    counts = (directions @ rectangle.axes[2] < 0) & (near | ~own)
    origins, directions, own = origins[counts], directions[counts], own[counts]
    some = torch.randperm(len(own), generator=torch.Generator().manual_seed(0))[:PIXELS]
    origins, directions, own = origins[some], directions[some], own[some]
    moved = torch.zeros(8, requires_grad=True)  # center, rotation vector, half sizes
    optimizer = torch.optim.Adam([moved], lr=RATE)
    for step in range(FITTED):
        optimizer.param_groups[0]["lr"] = RATE * (1 - step / FITTED)
        shown = inside_of(_moved(rectangle, moved, radius), origins, directions, SOFT * radius)[0]
        optimizer.zero_grad()
        error = torch.where(own, 1 - shown, 0.5 * shown).mean() + TURN * moved[3:6].square().sum()
        error.backward()
        optimizer.step()
    return _moved(rectangle, moved.detach(), radius)


def _moved(rectangle: Rectangle, by: Tensor, radius: float) -> Rectangle:
    axes = turned(rectangle.axes, by[3:6])
    return Rectangle(rectangle.center + radius * by[:3], axes, rectangle.half * by[6:].exp())


def turned(axes: Tensor, by: Tensor) -> Tensor:
    """Rows `axes` [..., 3, 3] turned by about `by` [..., 3], a rotation vector in radians; smooth where that is 0."""
    return axes @ rotation_matrices(functional.pad(by / 2, (1, 0), value=1.0)).mT


def inside_of(rectangle: Rectangle, origins: Tensor, directions: Tensor, soft: float) -> tuple[Tensor, Tensor]:
    """How far inside the rectangle rays [..., 3] meet its plane, 0 to 1 over a width `soft`, and at which distance."""
    normal = rectangle.axes[2]
    falls = directions @ normal
    distance = ((rectangle.center - origins) @ normal) / torch.where(falls.abs() < 1e-9, 1e-9, falls)
    places = (origins + distance[..., None] * directions - rectangle.center) @ rectangle.axes[:2].T
    along, across = ((rectangle.half - places.abs()) / soft + 0.5).clamp(0, 1).unbind(-1)
    within = along * across  # prod's gradient waits for the device
    return torch.where(distance > 0, within, 0.0), distance


def _inside(rectangle: Rectangle, camera: Camera) -> Tensor:
    return inside_of(rectangle, *camera.rays(), 1e-6)[0] > 0
