"""Rescoring: finished runs under another protocol, or with masks added since, without training them again.

From the pictures that a run left: quick, and all it takes is the run's folder. They have 8 bits a channel, rounded;
protocols that round to 8 bits themselves get the very numbers that the run would have had, the others take predictions
as floats, or cut instead of rounding: see `Protocol.of_pictures`. Or from its checkpoint, with the views drawn again:
that needs the data, and every protocol gets its own numbers.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from envgs_bench.core import View
from envgs_bench.datasets.errors import listed
from envgs_bench.metrics import Protocol, corrected_metrics, registered_metrics
from envgs_bench.records import (
    EXTERNAL,
    RENDERS,
    MaskedScores,
    Metrics,
    ProtocolName,
    Record,
    Scores,
    ViewScores,
    read_record,
    write_record,
)
from envgs_bench.run_folder import (
    CURVE_NAME,
    PICTURES,
    RECORD_NAME,
    SAMPLES_NAME,
    PictureError,
    is_file_name,
    mask_path,
    read_png,
    read_png_if_any,
    render_path,
    target_path,
)
from envgs_bench.runs.draft import now
from envgs_bench.runs.job import resolve_device
from envgs_bench.settings import read_settings
from envgs_bench.stages.evaluation import evaluate, evaluate_unseen, scored_views
from envgs_bench.stages.pose_alignment import ALIGNED, alignment_of
from envgs_bench.stages.renders import score_renders
from envgs_bench.stages.scoring import FULL, Pair, score_pairs

from .reopening import reopen_scene, reopen_unfinished


def rescore(run: Path, protocol: Protocol, out: Path, device: str = "auto") -> Record:
    """Write the record of the run in the folder `run`, its pictures scored by `protocol`, into the folder `out`.

    All else in it is the run's own, timing, cost and failures too; `provenance.rescored` says where it comes from.
    Pictures are linked, not copied. The run's folder is only read.

    Raises:
        RecordError: the run's record cannot be read.
        PictureError: a picture is missing or unreadable, or the record names a view or a region that names no file.
    """
    record, protocol, device = read_record(run), protocol.of_pictures(), resolve_device(device)
    scores = None if record.metrics is None else pictures_scored(run, record, protocol, device)
    unseen = {
        place: pictures_scored(run, record.model_copy(update={"metrics": metrics, "masked": {}}), protocol, device)[0]
        for place, metrics in record.unseen.items()
    }
    return _write(run, record, protocol, scores, unseen, out, "pictures", (*PICTURES, CURVE_NAME, SAMPLES_NAME))


def pictures_scored(
    run: Path, record: Record, protocol: Protocol, device: str = "cpu"
) -> tuple[Metrics, dict[str, MaskedScores]]:
    """The scores of the pictures that the run left. Raises PictureError as `rescore`."""
    return score_pairs(_pairs(run, record), protocol, device)


def redraw(run: Path, protocol: Protocol, out: Path, device: str = "auto") -> Record:
    """As `rescore`, of the test views drawn again from the run's checkpoint, with the masks that the data have now.

    Raises:
        RecordError, ValueError, FileNotFoundError: as `read_record`, `reopen_unfinished` and `reopen_scene`; or scored
            views are other pictures than those that the run left.
    """
    record = read_record(run)
    scores, unseen = None, {}
    for name in PICTURES:
        if (out / name).is_symlink():  # to the run's own, which are not to be written
            (out / name).unlink()
    if record.metrics is not None:
        settings = read_settings(run)
        scene = reopen_scene(run, settings)
        views = scored_views(scene, settings.score_on)
        _require_same_pictures(run, views)
        if record.kind == EXTERNAL:
            raise ValueError(f"{run}: another program drew its pictures; rescore them as they are, without --redraw")
        if record.kind == RENDERS:
            scores = score_renders(
                settings.method.settings, views, scene.background, protocol, out, _silent, resolve_device(device)
            )
        else:
            _, method = reopen_unfinished(run, device)  # it came as far as to be scored
            method.prepare()
            scores = evaluate(method, views, protocol, out, _silent, alignment_of(settings, scene, protocol))
            if record.unseen:
                unseen = evaluate_unseen(method, scene, protocol, out, _silent)
    return _write(run, record, protocol, scores, unseen, out, "checkpoint", (CURVE_NAME, SAMPLES_NAME))


def _require_same_pictures(run: Path, views: Sequence[View]) -> None:
    """Refuse views whose pictures are other ones than the run was scored on: its model learned of other data."""
    left = {view.name: read_png_if_any(target_path(run, view.name)) for view in views}
    changed = [v.name for v in views if (old := left[v.name]) is not None and not np.array_equal(old, v.image.numpy())]
    if changed:
        raise ValueError(
            f"{run}: {len(changed)} of {len(views)} views are other pictures now than those that the run was scored on "
            f"({listed(changed)}): the data changed; run it again, or rescore its pictures without --redraw"
        )


def _write(
    run: Path,
    record: Record,
    protocol: Protocol,
    scores: tuple[Metrics, dict[str, MaskedScores]] | None,
    unseen: dict[str, Metrics],
    out: Path,
    source: str,
    shared: tuple[str, ...],
) -> Record:
    """The record with these scores, in `out`, beside links to what it shares with the run."""
    origin = {"run": str(run.resolve()), "from": source, "protocol": record.protocol.model_dump(), "at": now()}
    metrics, masked = scores or (None, {})
    rescored = record.model_copy(
        update={
            "protocol": ProtocolName(name=protocol.name, hash=protocol.hash, description=protocol.description),
            "provenance": record.provenance.model_copy(update={"rescored": origin}),
            "metrics": metrics,
            "masked": masked,
            "unseen": unseen,
        }
    )
    out.mkdir(parents=True, exist_ok=True)
    for name in shared:
        if (run / name).exists() and not os.path.lexists(out / name):
            (out / name).symlink_to(os.path.relpath(run / name, out.resolve()))
    write_record(out, rescored)
    return rescored


def _silent(event: dict) -> None:
    pass


def _pairs(run: Path, record: Record) -> Iterator[Pair]:
    assert record.metrics is not None
    regions = {region: {row.view: row for row in scores.per_view} for region, scores in record.masked.items()}
    for name in (*regions, *(row.view for row in record.metrics.per_view)):
        if not is_file_name(name):
            raise PictureError(f"{run / RECORD_NAME}: names a view or region {name[:60]!r}, which no picture is called")
    for row in record.metrics.per_view:
        shown = {region: rows[row.view] for region, rows in regions.items() if row.view in rows}
        yield Pair(
            view=row.view,
            prediction=_picture(render_path(run, row.view)),
            target=_picture(target_path(run, row.view)),
            masks={region: _picture(mask_path(run, row.view, region))[..., 0] > 0.5 for region in shown},
            others={FULL: _others(row)} | {region: _others(scores) for region, scores in shown.items()},
        )


def _others(row: ViewScores) -> Scores:
    """The scores that pictures cannot give again, as the angle between normals."""
    given = {*registered_metrics(), *corrected_metrics(), "fraction", ALIGNED}  # the last by another protocol
    return {name: value for name, value in row.scores.items() if name not in given}


def _picture(path: Path) -> Tensor:
    """[H, W, 3] floats in [0, 1]."""
    return torch.from_numpy(read_png(path)).float() / 255
