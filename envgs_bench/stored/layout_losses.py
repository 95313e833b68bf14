"""`envgs-bench layouts`: what each layout of trained models takes on disk, and what pictures lose by it.

A run's model is taken from its checkpoint, written in each layout and read back; the run's views are drawn from that,
and scored by the run's own protocol. Nothing is trained, and the run's folder is only read.
"""

from __future__ import annotations

import csv
import io
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from envgs_bench.core import View
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.storage.checkpoint import on_device
from envgs_bench.methods.storage.layouts import LAYOUTS, Layout, stored_bytes
from envgs_bench.methods.storage.splats import SPLAT_LAYOUTS, require_library
from envgs_bench.metrics import Protocol, get_protocol
from envgs_bench.records import Scores
from envgs_bench.settings import RunSettings
from envgs_bench.stages.evaluation import scored_views
from envgs_bench.stages.scoring import Pair, score_pairs

from .reopening import reopen, reopen_scene

REFERENCE = "ply-two-scales"  # the layout that sizes are compared with: every parameter as float32 and nothing else


@dataclass(frozen=True)
class LayoutLoss:
    """One run's model in one layout."""

    dataset: str
    method: str
    seed: int
    layout: str
    file_bytes: int
    times_smaller: float  # than the float32 PLY files, and what these have no place for as float32 too
    lacks: tuple[str, ...]  # what the layout has no place for: the model cannot be read back, and has no scores
    write_seconds: float
    read_seconds: float | None
    scores: Scores  # of the full images, means over views
    change: Scores  # these minus those of the checkpoint's model


def require_layouts(names: Sequence[str]) -> dict[str, Layout]:
    """The layouts of these names. Raises ValueError where there is no such layout, or its library is not installed."""
    unknown = [name for name in names if name not in LAYOUTS]
    if unknown:
        raise ValueError(f"unknown layout {', '.join(map(repr, unknown))}: the known ones are {', '.join(LAYOUTS)}")
    if not SPLAT_LAYOUTS.keys().isdisjoint(names):
        require_library()
    return {name: LAYOUTS[name] for name in names}


def layouts_here() -> tuple[dict[str, Layout], str]:
    """All layouts that can be written here, and in words why the others cannot; "" where there are no others."""
    try:
        return require_layouts(list(LAYOUTS)), ""
    except ValueError as error:
        return require_layouts([name for name in LAYOUTS if name not in SPLAT_LAYOUTS]), str(error)


def open_sets(run: Path, device: str = "auto") -> tuple[RunSettings, GaussianMethod]:
    """As `reopen`. Raises also ValueError where the method has no sets of Gaussians."""
    settings, method = reopen(run, device)
    if not isinstance(method, GaussianMethod):
        raise ValueError(f"{run}: method {settings.method.name} has no sets of Gaussians to write")
    return settings, method


def layout_losses(run: Path, layouts: Mapping[str, Layout], device: str = "auto") -> Iterator[LayoutLoss]:
    """What each of the layouts makes of the model of the run in the folder `run`.

    Raises:
        ValueError, FileNotFoundError: as `open_sets`, `reopen_scene` and the layouts' `write`.
    """
    settings, method = open_sets(run, device)
    scene, protocol = reopen_scene(run, settings), get_protocol(settings.protocol)
    views = scored_views(scene, settings.score_on)
    original = method.state()
    own = _scores(method, views, protocol)
    with tempfile.TemporaryDirectory() as folder:
        reference = stored_bytes(LAYOUTS[REFERENCE].write(method, Path(folder)))
    reference += sum(4 * original[name].numel() for name in LAYOUTS[REFERENCE].lacks(method))
    for name, layout in layouts.items():
        with tempfile.TemporaryDirectory() as folder:
            began = perf_counter()
            size = stored_bytes(layout.write(method, Path(folder)))
            written = perf_counter()
            lacks = tuple(layout.lacks(method))
            state = None if lacks else layout.read(method, Path(folder))
            read = perf_counter()
        scores: Scores = {}
        if state is not None:
            method.restore(on_device(state, method.device))
            scores = _scores(method, views, protocol)
            method.restore(original)
        yield LayoutLoss(
            dataset=scene.name,
            method=settings.method.name,
            seed=settings.seed,
            layout=name,
            file_bytes=size,
            times_smaller=reference / size,
            lacks=lacks,
            write_seconds=written - began,
            read_seconds=None if lacks else read - written,
            scores=scores,
            change={metric: _difference(value, own[metric]) for metric, value in scores.items()},
        )


def _scores(method: GaussianMethod, views: Sequence[View], protocol: Protocol) -> Scores:
    method.prepare()
    drawn = ((view, method.render(view.camera.to(method.device)).color.cpu()) for view in views)
    pairs = (Pair(view.name, image, view.rgb(), {}) for view, image in drawn)
    metrics, _ = score_pairs(pairs, protocol, method.device)
    return metrics.mean


def _difference(ours: float | None, theirs: float | None) -> float | None:
    return None if ours is None or theirs is None else ours - theirs


def as_csv(losses: Sequence[LayoutLoss]) -> str:
    """A row a run and layout: bytes, seconds, and each score with its change."""
    metrics = list(dict.fromkeys(metric for loss in losses for metric in loss.scores))
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    names = ["dataset", "method", "seed", "layout", "file_bytes", "times_smaller", "lacks"]
    changes = [name for metric in metrics for name in (metric, f"{metric}_change")]
    writer.writerow([*names, "write_seconds", "read_seconds", *changes])
    for loss in losses:
        values = [getattr(loss, name) for name in names[:-1]] + [" ".join(loss.lacks)]
        scores = [part.get(metric) for metric in metrics for part in (loss.scores, loss.change)]
        writer.writerow([*values, loss.write_seconds, loss.read_seconds, *scores])
    return stream.getvalue()


def as_markdown(losses: Sequence[LayoutLoss]) -> str:
    """The table that a person reads; "—" where a layout cannot hold the model."""
    lines = [
        "| dataset | method | seed | layout | file MB | × smaller than PLY | Δ PSNR, dB | Δ LPIPS | write s | read s |",
        "| :-- | :-- | --: | :-- | --: | --: | --: | --: | --: | --: |",
    ]
    for loss in losses:
        layout = f"{loss.layout} (no place for {', '.join(loss.lacks)})" if loss.lacks else loss.layout
        cells = [
            *(loss.dataset, loss.method, str(loss.seed), layout),
            *(f"{loss.file_bytes / 1e6:.2f}", "—" if loss.lacks else f"{loss.times_smaller:.1f}"),
            *(_shown(loss.change.get("psnr"), "+.3f"), _shown(loss.change.get("lpips"), "+.4f")),
            *(f"{loss.write_seconds:.2f}", _shown(loss.read_seconds, ".2f")),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _shown(value: float | None, form: str) -> str:
    return "—" if value is None else f"{value:{form}}".replace("-", "−")
