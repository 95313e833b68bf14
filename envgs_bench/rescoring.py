"""Rescoring: finished runs under another protocol, from the pictures they left. Nothing is trained or drawn again.

The pictures have 8 bits a channel, rounded. Protocols that round to 8 bits themselves get the very numbers that the
runs would have had; the others take predictions as floats, or cut instead of rounding: see `Protocol.of_pictures`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from .draft import now
from .metrics import METRICS, Protocol
from .records import ProtocolName, Record, RecordError, Scores, ViewScores, read_record, write_record
from .scoring import FULL, Pair, score_pairs

SHARED = ("renders", "targets", "masks", "layers", "curve.csv")  # what a report looks for beside a record


def rescore(run: Path, protocol: Protocol, out: Path) -> Record:
    """Write the record of the run in the folder `run`, scored by `protocol`, into the folder `out`.

    All else in it is the run's own, timing, cost and failures too; `provenance.rescored` says where it comes from.
    Pictures are linked, not copied. The run's folder is only read.

    Raises:
        RecordError: the run's record cannot be read, or a picture is missing or unreadable.
    """
    record = read_record(run)
    protocol = protocol.of_pictures()
    name = ProtocolName(name=protocol.name, hash=protocol.hash, description=protocol.description)
    origin = {"run": str(run.resolve()), "protocol": record.protocol.model_dump(), "at": now()}
    provenance = record.provenance.model_copy(update={"rescored": origin})
    changes: dict[str, Any] = {"protocol": name, "provenance": provenance}
    if record.metrics is not None:
        metrics, masked = score_pairs(_pairs(run, record), protocol)
        changes |= {"metrics": metrics, "masked": masked}
    rescored = record.model_copy(update=changes)
    out.mkdir(parents=True, exist_ok=True)
    for shared in SHARED:
        if (run / shared).exists() and not os.path.lexists(out / shared):
            (out / shared).symlink_to(os.path.relpath(run / shared, out.resolve()))
    write_record(out, rescored)
    return rescored


def _pairs(run: Path, record: Record) -> Iterator[Pair]:
    assert record.metrics is not None
    regions = {region: {row.view: row for row in scores.per_view} for region, scores in record.masked.items()}
    for row in record.metrics.per_view:
        shown = {region: rows[row.view] for region, rows in regions.items() if row.view in rows}
        yield Pair(
            view=row.view,
            prediction=read_picture(run / "renders" / f"{row.view}.png"),
            target=read_picture(run / "targets" / f"{row.view}.png"),
            masks={region: read_picture(run / "masks" / f"{row.view}-{region}.png")[..., 0] > 0.5 for region in shown},
            others={FULL: _others(row)} | {region: _others(scores) for region, scores in shown.items()},
        )


def _others(row: ViewScores) -> Scores:
    """The scores that pictures cannot give again, as the angle between normals."""
    return {name: value for name, value in row.scores.items() if name not in (*METRICS, "fraction")}


def read_picture(path: Path) -> Tensor:
    """[H, W, 3] floats in [0, 1]."""
    try:
        with Image.open(path) as image:
            return torch.from_numpy(np.array(image.convert("RGB"))).float() / 255
    except (OSError, SyntaxError, ValueError) as error:
        raise RecordError(f"{path}: cannot be read ({error}); its run has to be run again with force=true") from error
