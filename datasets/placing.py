"""Placing: a scene's world is moved near its origin, and given a usual size, where float32 or near planes ask for it.

Cameras and points are float32 from here on, and methods' lengths, as their near plane of 0.2, are for worlds of usual
sizes. A world that lies and measures as usual stays as it is, to the last bit. Any other keeps what was done to it in
`Scene.placement`, and the run's notes say so.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from envgs_bench.core import Camera, Placement, Scene, View

from .notes import note
from .sights import Sights

Array = NDArray[np.float64]

SURE = (
    0.01  # pixels: float32's spacing at the cameras' middle, seen from the nearest things' distance, that is harmless
)
SEEN = 0.1  # pixels: one that shows
FAR_OUT = 4  # times their spread that the cameras' middle must be from the origin: nearer, moving them gains no digits
FARTHEST = 1e15  # units from the origin
NEAR_PLANE = 0.2  # methods' own: what is nearer is not drawn
LEAST = 1.5 * NEAR_PLANE  # distance of the nearest things that cameras see
LARGEST = 2000.0  # usual distance of what cameras see: ten thousand near planes
USUAL = 4.0  # that distance, or up to twice as much, once a world has been given a usual size
DIGITS = (6, 7)  # that programs print of float32 numbers
LEAST_ROUNDED, ROUNDING = 8, 1e-3  # so many numbers all this close to multiples of a step were rounded to it


def placement_of(sights: Sights, source: object) -> Placement:
    """Where the world of these cameras and points should lie.

    Notes say what is done, and which digits are lost; there, `source` names the data.
    """
    with np.errstate(all="ignore"):  # of numbers that no camera can have, as its own check will say
        return _placement(sights, source) if np.abs(sights.centers).max() < FARTHEST else Placement()


def _placement(sights: Sights, source: object) -> Placement:
    depths = sights.depths()
    shift = _shift(sights, depths)
    scale = 1.0 if depths is None else _scale(*depths)
    _note_lost_digits(sights, depths, shift, source)
    if any(shift):
        out = float(np.abs(sights.middle).max())
        note(
            f"{source}: the cameras are {_count(out)} units from the origin, where float32 costs digits: the world is "
            f"moved, its origin is at ({', '.join(f'{x:.15g}' for x in shift)}) of the "
            "data; exports give the data's own coordinates"
        )
    if scale != 1 and depths is not None:
        size = f"1/{1 / scale:g}" if scale < 1 else f"{scale:g}"
        note(
            f"{source}: cameras see the nearest things at {depths[0]:.3g} units and most at {depths[1]:.3g}, unlike "
            f"what methods' lengths are for (they draw nothing nearer than {NEAR_PLANE:g}): the world's unit is {size} "
            "of the data's; exports give the data's own lengths"
        )
    return Placement(shift, scale)


def placed_scene(scene: Scene) -> Scene:
    """The scene of a source that placed nothing itself: of one's own, whose tensors may be float64."""
    views = [*scene.train, *scene.test]
    if not views or not scene.placement.unmoved:
        return scene
    cameras = [view.camera for view in views]
    sights = Sights(
        np.stack([camera.world_to_camera.double().numpy() for camera in cameras]),
        np.array([float(camera.intrinsics.diagonal()[:2].mean()) for camera in cameras]),
        np.array([[camera.width, camera.height] for camera in cameras], np.float64),
        scene.points.double().numpy().reshape(-1, 3),
    )
    placement = placement_of(sights, scene.name)
    if placement.unmoved:
        return scene
    points = torch.from_numpy(placement.points_from_data(scene.points.double().numpy())).float()
    train, test, val = ([_placed_view(v, placement) for v in part] for part in (scene.train, scene.test, scene.val))
    unseen = {place: [_placed_view(view, placement) for view in views] for place, views in scene.unseen.items()}
    free_space, bounds = scene.free_space / placement.scale, scene.bounds / placement.scale
    return replace(
        scene,
        train=train,
        test=test,
        val=val,
        unseen=unseen,
        points=points,
        free_space=free_space,
        bounds=bounds,
        placement=placement,
    )


def _placed_view(view: View, placement: Placement) -> View:
    camera = view.camera
    pose = torch.from_numpy(placement.pose_from_data(camera.world_to_camera.double().numpy())).float()
    depth = None if view.depth is None else (view.depth / placement.scale).float()
    return replace(view, camera=Camera(pose, camera.intrinsics.float(), camera.width, camera.height), depth=depth)


def _count(length: float) -> str:
    return f"{length:,.0f}" if length >= 1000 else f"{length:.3g}"


def origin_near(sights: Sights) -> Placement:
    """The world moved as `placement_of` moves it, in the data's units; nothing is noted."""
    return Placement(_shift(sights, sights.depths()))


def _shift(sights: Sights, depths: tuple[float, float] | None) -> tuple[float, float, float]:
    """What is to be the origin: (0, 0, 0) unless cameras are far from it and float32's spacing there may show."""
    middle, spread = sights.middle, sights.spread
    nearest = depths[0] if depths else spread or 1.0
    out = float(np.abs(middle).max())
    if out <= FAR_OUT * spread or _pixels(out, sights, nearest) <= SURE:
        return 0.0, 0.0, 0.0
    step = 2.0 ** math.floor(math.log2(spread or nearest))  # short numbers, to which float64 loses nothing
    x, y, z = (float(value) for value in np.round(middle / step) * step + 0.0)
    return x, y, z


def _scale(nearest: float, usual: float) -> float:
    """The power of two that is to be the world's unit: 1 unless near planes hide what is seen, or all is far off."""
    if nearest >= LEAST and usual <= LARGEST:
        return 1.0
    unit = 2.0 ** math.floor(math.log2(min(usual / USUAL, nearest / LEAST)))
    return unit if nearest < LEAST else max(unit, 1.0)


def _pixels(distance: float, sights: Sights, depth: float) -> float:
    """The spacing of float32's numbers at `distance` from the origin, as seen from `depth` away."""
    return float(np.spacing(np.float32(distance))) * sights.focal / depth


def _note_lost_digits(
    sights: Sights, depths: tuple[float, float] | None, shift: tuple[float, float, float], source: object
) -> None:
    """Note digits that were lost before, or that no place of the world can keep."""
    nearest = depths[0] if depths else sights.spread or 1.0
    for name, places in (("cameras", sights.centers), ("points", sights.points)):
        step = max((_rounded_to(axis) for axis in places.T), default=0.0) if any(shift) else 0.0
        if step * sights.focal / nearest > SEEN:
            note(
                f"{source}: the {name} are rounded to {step:.3g} units, {step * sights.focal / nearest:.2g} pixels: so "
                "far from the origin float32, or few digits, hold no more; export them in double precision with all "
                "digits, or nearer to their origin"
            )
    reach = float(np.quantile(np.abs(sights.centers - shift).max(axis=1), 0.9))
    held = max(float(np.spacing(np.float32(reach))), float(np.spacing(np.abs(sights.middle).max())))
    if held * sights.focal / nearest > SEEN:
        note(
            f"{source}: the cameras are too far apart, or too far out, for what they see at {nearest:.3g} units: "
            f"positions are rounded to {held * sights.focal / nearest:.2g} pixels; take a part of the data, or give "
            "them an origin nearby"
        )


def _rounded_to(values: Array) -> float:
    """What the coordinates [N] were rounded to: float32's spacing there, or so many decimal digits; 0: to neither."""
    least, most = np.abs(values).min(initial=np.inf), np.abs(values).max(initial=0)
    if len(values) < LEAST_ROUNDED or not 0 < least < np.inf:
        return 0.0
    place = math.floor(math.log10(most)) + 1
    for step in (*(10.0 ** (place - digits) for digits in DIGITS), float(np.spacing(np.float32(least)))):
        multiples = values / step
        exact = bool((np.abs(multiples - np.round(multiples)) < ROUNDING).all())
        if exact and np.ptp(values) > step / 2:
            return step
    return 0.0
