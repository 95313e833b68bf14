"""Operations: the calls that a case times, and what is known of the work that they do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, Rendering, build_bvh, rasterize, rasterize_color, trace, trace_color
from envgs_bench.core.ssim import ssim
from envgs_bench.methods.lighting.cubemap import CubemapLayout, layout_of, sample_cubemap
from envgs_bench.methods.lighting.prefiltered_cubemap import prefilter_of, rough_map
from envgs_bench.methods.training.frame_graphs import FrameGraphs, color_drawing
from envgs_bench.parts import ALPHA

from .cases import LOOKUPS, PEERS, PICTURED, RASTERIZED, Case
from .peers import PeerImage, gsplat_drawing, higs_drawing
from .tile_lists import tile_list_lengths
from .workload import Workload

OUTPUTS = ("color", "alpha", "depth", "normal", "extras")

Call = Callable[[], object]


@dataclass(frozen=True)
class Work:
    """What a case times: inputs are there, nothing has been called yet."""

    calls: Sequence[Call]  # one a view: each is timed by itself
    primitives: int = 0  # of all sets that are worked on
    hits: Tensor | None = None  # [R] of each pixel or ray of all views
    alpha: float | None = None  # their mean
    lists: Tensor | None = None  # [tiles] lengths of the tiles' lists, of all views


def work_of(case: Case, workload: Workload) -> Work:
    """The case's calls on the workload. Whatever is kept between calls (a BVH, prepared sets) is made here."""
    if case.op in RASTERIZED:
        return _rasterizing(case, workload)
    if case.op in PICTURED:
        return _picturing(case, workload)
    if case.op in LOOKUPS:
        return _looking_up(case, workload)
    match case.op:
        case "trace" | "trace_color":
            return _tracing(case, workload)
        case "build":
            gaussians = workload.traced()
            return Work([partial(build_bvh, gaussians, backend=case.backend)], len(gaussians))
        case "adam":
            return _moving(workload)
        case "ssim":
            return _comparing(case, workload)
    return _training(workload) if case.direction == "forward_backward" else _rendering(workload)


def _rasterizing(case: Case, workload: Workload) -> Work:
    calls, hits, alphas, lists = [], [], [], []
    count = 0
    for view in workload.views:
        plain = workload.rasterized(view)
        count = len(plain)
        if case.backend in PEERS:
            leaves = _leaves(replace(plain, extras=None))
            draw: Callable[[], Rendering | PeerImage] = gsplat_drawing(leaves, view.camera, workload.near)
        else:
            leaves = _leaves(plain)
            draw = partial(rasterize, leaves, view.camera, near=workload.near, backend=case.backend)
        with torch.no_grad():
            drawn = draw()
        alphas.append(drawn.alpha)
        hits += [] if drawn.hits is None else [drawn.hits.reshape(-1)]
        if case.backend in ("cpu", "cuda"):
            lists.append(tile_list_lengths(plain, view.camera, workload.near, case.backend))
        calls.append(_timed(case, partial(_outputs, draw), _fields(leaves)))
    return Work(calls, count, torch.cat(hits) if hits else None, _mean(alphas), torch.cat(lists) if lists else None)


@torch.no_grad()
def _picturing(case: Case, workload: Workload) -> Work:
    """Color and alpha alone: ours as a method's picture is drawn, from the second on replayed from a graph."""
    calls: list[Call] = []
    alphas, lists = [], []
    count = 0
    for view in workload.views:
        plain, camera = replace(workload.rasterized(view), extras=None), view.camera
        count = len(plain)
        if case.backend in PEERS:
            draw = higs_drawing(plain, camera, workload.near)
            alphas.append(draw().alpha)
            calls.append(draw)
        else:
            options: dict[str, Any] = {"near": workload.near, "backend": case.backend}
            alphas.append(rasterize_color(plain, camera, **options)[1])
            lists.append(tile_list_lengths(plain, camera, workload.near, case.backend))
            frames = FrameGraphs(color_drawing(partial(_color, plain, **options)), camera.device)
            calls.append(torch.no_grad()(partial(frames.draw, camera)))
    return Work(calls, count, alpha=_mean(alphas), lists=torch.cat(lists) if lists else None)


def _color(gaussians: GaussianSet, camera: Camera, **options: Any) -> Tensor:
    return rasterize_color(gaussians, camera, **options)[0]


def _tracing(case: Case, workload: Workload) -> Work:
    leaves = _leaves(workload.traced())
    bvh = build_bvh(leaves, backend=case.backend)
    hits, alphas = [], []
    calls: list[Call] = []
    for view in workload.views:
        rays = [x.requires_grad_() for x in workload.rays(view)]
        draw = partial(trace, leaves, *rays, bvh=bvh, backend=case.backend)
        with torch.no_grad():
            drawn = draw()
        hits.append(drawn.hits.reshape(-1))
        alphas.append(drawn.alpha)
        if case.op == "trace_color":
            calls.append(torch.no_grad()(partial(trace_color, leaves, *rays, bvh=bvh, backend=case.backend)))
        else:
            calls.append(_timed(case, partial(_outputs, draw), [*_fields(leaves), *rays]))
    return Work(calls, len(leaves), torch.cat(hits), _mean(alphas))


def _looking_up(case: Case, workload: Workload) -> Work:
    """A map in the directions of reflected rays: bilinear, or filtered first and then for a roughness a ray."""
    texels = workload.texels().requires_grad_()
    size = texels.shape[1]
    calls = []
    for view in workload.views:
        directions = workload.rays(view)[1].reshape(-1, 3).requires_grad_()
        if case.op == "cubemap":
            layout = layout_of(size, texels.device)
            look = partial(_looked_up, texels, directions, layout)
        else:
            roughness = torch.rand(len(directions), generator=torch.Generator().manual_seed(0)).to(texels.device)
            look = partial(_looked_up_roughly, texels, directions, roughness)
        calls.append(_timed(case, look, [texels, directions]))
    return Work(calls)


def _looked_up(texels: Tensor, directions: Tensor, layout: CubemapLayout) -> list[Tensor]:
    return [sample_cubemap(texels, directions, layout).sigmoid()]


def _looked_up_roughly(texels: Tensor, directions: Tensor, roughness: Tensor) -> list[Tensor]:
    levels = rough_map(texels.sigmoid(), prefilter_of(texels.shape[1], texels.device))
    return [levels.specular(directions, roughness)]


def _comparing(case: Case, workload: Workload) -> Work:
    """SSIM of a view's photograph and a random picture."""
    calls = []
    for view in workload.views:
        target = view.rgb(view.image.device)
        image = torch.rand(target.shape, generator=torch.Generator().manual_seed(0)).to(target).requires_grad_()
        calls.append(_timed(case, partial(_similarity, image, target, case.backend), [image]))
    return Work(calls)


def _similarity(image: Tensor, target: Tensor, backend: str) -> list[Tensor]:
    return [ssim(image, target, backend=backend)]


def _moving(workload: Workload) -> Work:
    """Adam's step on all parameters of the workload's model, whose gradients are random, as a training takes it."""
    method = workload.model().method
    optimizers = method.model.optimizers()
    for parameter in (p for optimizer in optimizers for group in optimizer.param_groups for p in group["params"]):
        parameter.grad = torch.randn_like(parameter)
    finite = torch.zeros((), device=method.device)

    def step() -> None:
        for optimizer in optimizers:
            optimizer.found_inf = finite  # type: ignore[attr-defined]
            optimizer.step()

    return Work([step], sum(method.primitives().values()))


def _rendering(workload: Workload) -> Work:
    method = workload.model().method
    method.prepare()
    alphas = [method.render(view.camera).alpha for view in workload.views]
    calls = [partial(method.picture, view.camera) for view in workload.views]
    return Work(calls, sum(method.primitives().values()), alpha=_mean(alphas))


def _training(workload: Workload) -> Work:
    model = workload.model()
    method = model.method
    alphas = []
    for view in model.views:
        method.training_step(view, model.step)
        alphas.append(method.runner.maps[ALPHA])
    calls = [partial(method.training_step, view, model.step) for view in model.views]
    return Work(calls, sum(method.primitives().values()), alpha=_mean(alphas))


def _leaves(gaussians: GaussianSet) -> GaussianSet:
    """The set with every field to be differentiated in."""
    return gaussians.map(lambda x: x.detach().requires_grad_())


def _fields(gaussians: GaussianSet) -> list[Tensor]:
    return [value for value in vars(gaussians).values() if value is not None]


def _outputs(draw: Callable[[], Rendering | PeerImage]) -> list[Tensor]:
    """All that is drawn and can be differentiated."""
    drawn = draw()
    found = [getattr(drawn, name, None) for name in OUTPUTS]
    return [values for values in found if values is not None and values.numel()]


def _timed(case: Case, draw: Callable[[], list[Tensor]], inputs: list[Tensor]) -> Call:
    """Draw without gradients; or draw, and differentiate a random combination of all outputs in all inputs."""
    if case.direction == "forward":
        return torch.no_grad()(draw)
    with torch.no_grad():
        drawn = draw()
    generator = torch.Generator().manual_seed(0)
    upstream = [torch.randn(values.shape, generator=generator).to(values) for values in drawn]
    return lambda: torch.autograd.grad(draw(), inputs, upstream)


def _mean(alphas: Sequence[Tensor]) -> float:
    return float(torch.stack([alpha.detach().double().mean() for alpha in alphas]).mean())
