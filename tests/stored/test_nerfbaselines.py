"""nerfbaselines' predictions: what is written for it is what it reads, and its archives are scored as renders."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import shutil
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fakes.runs import only_folder, records, run_job_here, set_environment
from PIL import Image
from skimage.metrics import peak_signal_noise_ratio

from envgs_bench.cli.main import main
from envgs_bench.records import read_record
from envgs_bench.stages.predictions import PredictionsError, rendered_folder


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


@pytest.fixture
def shared(tmp_path: Path) -> Path:
    """The folder with predictions.tar.gz and results.json of a run."""
    assert run_job_here(tmp_path / "runs", "protocol=strict") == 0
    assert main(["predictions", str(only_folder(tmp_path / "runs")), "--out", str(tmp_path / "shared")]) == 0
    return tmp_path / "shared"


def content(archive: Path) -> dict[str, bytes]:
    with tarfile.open(archive) as members:
        return {member.name: members.extractfile(member).read() for member in members}  # type: ignore[union-attr]


def picture(data: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(data)))


def test_what_is_written_is_the_runs_pictures_and_their_numbers(shared: Path) -> None:
    files = content(shared / "predictions.tar.gz")
    assert set(files) == {"info.json", *(f"{kind}/view{i}.png" for kind in ("color", "gt-color") for i in (0, 1))}
    info, results = json.loads(files["info.json"]), json.loads((shared / "results.json").read_text())
    assert (info["method"], info["dataset_metadata"]["scene"], info["evaluation_protocol"]) == ("fake", "tiny", "nerf")
    views = [f"view{i}.png" for i in (0, 1)]
    expected = [
        peak_signal_noise_ratio(picture(files[f"gt-color/{view}"]), picture(files[f"color/{view}"])) for view in views
    ]
    raw = np.frombuffer(base64.b64decode(results["metrics_raw"]["psnr"]), "<f4")
    assert raw == pytest.approx(expected, abs=1e-4)
    assert results["metrics"]["psnr"] == pytest.approx(np.mean(expected), abs=1e-4)
    assert "lpips_vgg" not in results["metrics"]  # there are no weights here
    for name, kind in (("predictions_sha256", "color"), ("ground_truth_sha256", "gt-color")):
        assert results[name] == hashlib.sha256(b"".join(files[f"{kind}/{view}"] for view in views)).hexdigest()


@pytest.mark.parametrize("form", ["tar", "zip", "folder"])
def test_an_archive_is_scored_as_the_run_that_it_was_made_of(tmp_path: Path, shared: Path, form: str) -> None:
    path = shared / "predictions.tar.gz"
    files = content(path)
    if form == "zip":
        path = tmp_path / "predictions.zip"
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in files.items():
                archive.writestr(name, data)
    if form == "folder":
        path = tmp_path / "predictions"
        with tarfile.open(shared / "predictions.tar.gz") as archive:
            archive.extractall(path, filter="data")
    assert (
        run_job_here(tmp_path / "others", "method=renders", f"path={path}", "method.name=theirs", "protocol=strict")
        == 0
    )
    (theirs,), ours = records(tmp_path / "others"), read_record(only_folder(tmp_path / "runs"))
    assert theirs.metrics is not None
    assert ours.metrics is not None
    assert theirs.metrics.mean["psnr"] == ours.metrics.mean["psnr"]


def test_another_archive_is_another_run_and_the_same_one_is_reused(tmp_path: Path, shared: Path) -> None:
    options = ("method=renders", f"path={shared / 'predictions.tar.gz'}", "method.name=theirs")
    for _ in range(2):
        assert run_job_here(tmp_path / "others", *options) == 0
    assert len(records(tmp_path / "others")) == 1


def test_damaged_archives_are_named_and_nothing_is_written_outside(tmp_path: Path) -> None:
    path = tmp_path / "a.tar.gz"
    path.write_bytes(b"no archive")
    with pytest.raises(PredictionsError, match=r"a\.tar\.gz: is no readable archive"), rendered_folder(path):
        pass
    with tarfile.open(path, "w:gz") as archive:
        for name in ("info.json", "color/../../outside.png", "/color/b.png"):
            archive.addfile(tarfile.TarInfo(name))
    with pytest.raises(PredictionsError, match="has no pictures in color/"), rendered_folder(path):
        pass
    assert not list(tmp_path.rglob("outside.png"))


def test_a_run_without_scores_has_nothing_to_share(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_job_here(tmp_path / "runs", "method.kind=fakes.methods:Raises", "method.settings.crash_at=1") == 1
    assert main(["predictions", str(only_folder(tmp_path / "runs")), "--out", str(tmp_path / "shared")]) != 0
    assert "has no scores of test views" in capsys.readouterr().err
    shutil.rmtree(tmp_path / "runs")
