"""A run's pictures and scores as nerfbaselines has them: an archive of predictions, and results beside it.

predictions.tar.gz holds `info.json`, `color/<view>.png` and `gt-color/<view>.png`. results.json has the means, each
view's numbers as base64 of float32, and the hashes of both folders, by the protocol "nerf" (ours: `nerfbaselines`).
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import struct
import tarfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from envgs_bench.metrics import get_protocol
from envgs_bench.records import Metrics, Record, read_record, write_atomically
from envgs_bench.run_folder import render_path, target_path

from .rescoring import pictures_scored

PROTOCOL = "nerf"  # theirs; ours of the same choices is called "nerfbaselines"
NAMES = {"psnr": "psnr", "ssim": "ssim", "lpips": "lpips_vgg"}  # our metrics -> theirs


def write_predictions(run: Path, out: Path) -> list[Path]:
    """Write predictions.tar.gz and results.json of the run into the folder `out`; both paths.

    Raises:
        RecordError, PictureError: the run's record or a picture cannot be read.
        ValueError: the run has no scored pictures, or was scored on validation views.
    """
    record = read_record(run)
    if record.metrics is None or record.scored_on != "test":
        raise ValueError(f"{run}: has no scores of test views that could be shared; take a finished run")
    metrics = pictures_scored(run, record, get_protocol("nerfbaselines").of_pictures())[0]
    out.mkdir(parents=True, exist_ok=True)
    archive, results = out / "predictions.tar.gz", out / "results.json"
    views = sorted(view.view for view in record.metrics.per_view)
    info = _info(record)
    part = archive.with_name(f".{archive.name}.part")
    try:
        hashes = _write_archive(part, run, views, info)
        part.replace(archive)
    finally:
        part.unlink(missing_ok=True)
    write_atomically(results, json.dumps(_results(metrics, views, info, hashes), indent=2) + "\n")
    return [archive, results]


def _info(record: Record) -> dict[str, Any]:
    cost = record.cost
    background = (record.config.get("dataset") or {}).get("background") or [0, 0, 0]
    metadata = {
        **{"id": record.dataset.partition("/")[0], "scene": record.dataset.rpartition("/")[2]},
        **{"color_space": "srgb", "evaluation_protocol": PROTOCOL},
        **{"background_color": [round(255 * float(channel)) for channel in background]},
    }
    return {
        **{"method": record.method, "num_iterations": record.steps, "evaluation_protocol": PROTOCOL},
        **{"total_train_time": cost.train_seconds if cost else None, "color_space": "srgb"},
        **{"dataset_metadata": metadata, "render_version": f"envgs-bench {record.provenance.version}"},
        **{"render_datetime": record.provenance.finished},
    }


def _write_archive(path: Path, run: Path, views: Iterable[str], info: Mapping[str, Any]) -> tuple[str, str]:
    """The SHA-256 of all predictions, and of all photographs, in the order of their names."""
    hashes = hashlib.sha256(), hashlib.sha256()
    with tarfile.open(path, "w:gz") as archive:
        _add(archive, "info.json", json.dumps(info, indent=2).encode())
        for view in views:
            for digest, folder, picture in zip(
                hashes, ("color", "gt-color"), (render_path(run, view), target_path(run, view)), strict=True
            ):
                content = picture.read_bytes()
                digest.update(content)
                _add(archive, f"{folder}/{view}.png", content)
    return hashes[0].hexdigest(), hashes[1].hexdigest()


def _add(archive: tarfile.TarFile, name: str, content: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size = len(content)
    archive.addfile(member, io.BytesIO(content))


def _results(metrics: Metrics, views: list[str], info: dict[str, Any], hashes: tuple[str, str]) -> dict[str, Any]:
    by_view = {row.view: row.scores for row in metrics.per_view}
    lists: dict[str, list[float]] = {}
    for ours, theirs in NAMES.items():
        values = [by_view[view].get(ours) for view in views]
        known = [value for value in values if value is not None]
        if len(known) == len(views):
            lists[theirs] = known
    raw = {name: _encoded(values) for name, values in lists.items()}
    digest = hashlib.sha256()
    for name in sorted(lists):
        digest.update(name.lower().encode() + _encoded(sorted(lists[name])).encode() + b"\n")
    return {
        **{"nb_info": info, "evaluation_protocol": PROTOCOL},
        **{"metrics": {name: sum(values) / len(values) for name, values in lists.items()}, "metrics_raw": raw},
        **{"metrics_sha256": digest.hexdigest(), "predictions_sha256": hashes[0], "ground_truth_sha256": hashes[1]},
    }


def _encoded(values: Iterable[float]) -> str:
    """float32, little-endian, as base64."""
    return base64.b64encode(b"".join(struct.pack("<f", value) for value in values)).decode("ascii")
