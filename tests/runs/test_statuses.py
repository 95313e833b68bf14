"""However a run's process ends, there is a record that says so, and the sweep goes on. Real processes."""

from __future__ import annotations

import csv
import os
from pathlib import Path

import pytest
from fakes.runs import run, set_environment

from envgs_bench.metrics import registered_metrics
from envgs_bench.records import find_records, read_record
from envgs_bench.run_folder import LOG_NAME
from envgs_bench.runs import process

KINDS = (
    "Raises",
    "IsKilled",
    "RunsOutOfMemory",
    "LosesItsLoss",
    "DiesAfterAWarning",
    "RendersNaN",
)
IN_PARALLEL = ("Segfaults", "MeanColor")  # in processes that are started anew
SLOW_KINDS = ("Hangs", "IsSlow")
LIMITED = "TakesMemory"


class Sweep:
    """What sweeps left: of failures, in parallel, of what does not end under a time limit, under a limit of memory."""

    def __init__(self, root: Path, exit_statuses: tuple[int, ...]) -> None:
        self.root = root
        self.exit_statuses = exit_statuses
        paths = [path for folder in ("swept", "parallel", "slow", "limited") for path in find_records(root / folder)]
        self.records = {read_record(path).kind.split(":")[1]: read_record(path) for path in paths}
        self.folders = {read_record(path).kind.split(":")[1]: path.parent for path in paths}


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Sweep:
    root = tmp_path_factory.mktemp("sweep")
    common = ("method.settings.crash_at=5", "steps=200")
    with pytest.MonkeyPatch.context() as patch:
        set_environment(patch)
        first = run(root / "swept", *common, _swept(KINDS), flags=("-m",))
        parallel = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
        second = run(root / "parallel", *common, *parallel, _swept(IN_PARALLEL), flags=("-m",))
        third = run(root / "slow", *common, "timeout_minutes=0.02", _swept(("IsSlow",)))
        fourth = run(root / "limited", *common, "memory_gb=0.5", _swept((LIMITED,)))
        patch.setattr(process, "GRACE_SECONDS", 4.0)
        fifth = run(root / "slow", *common, "timeout_minutes=0.02", _swept(("Hangs",)))
    return Sweep(root, (first, second, third, fourth, fifth))


def _swept(kinds: tuple[str, ...]) -> str:
    return "method.kind=" + ",".join(f"fakes.methods:{kind}" for kind in kinds)


def test_every_job_has_a_record_and_the_exit_status_says_that_some_failed(sweep: Sweep) -> None:
    assert sorted(sweep.records) == sorted((*KINDS, *IN_PARALLEL, *SLOW_KINDS, LIMITED))
    assert sweep.exit_statuses == (1, 1, 1, 1, 1)


@pytest.mark.parametrize(
    ("kind", "status", "error", "message"),
    [
        ("Raises", "failed", "RuntimeError", "the surfels are in a bad mood"),
        ("Segfaults", "failed", "SIGSEGV", "the process died of SIGSEGV"),
        ("IsKilled", "out_of_memory", "SIGKILL", "ran out of memory"),
        ("DiesAfterAWarning", "failed", "ProcessError", "exit code 3"),
        ("RunsOutOfMemory", "out_of_memory", "RuntimeError", "can't allocate memory"),
        ("TakesMemory", "out_of_memory", "RuntimeError", "can't allocate memory"),
        ("IsSlow", "timeout", "TimeUp", "timeout_minutes=0.02"),
        ("Hangs", "timeout", "TimeUp", "timeout_minutes=0.02 and was killed"),
        ("LosesItsLoss", "diverged", "Diverged", "not finite in 20 steps in a row, up to step 24"),
        ("RendersNaN", "diverged", "Diverged", "the render of view view0 is not finite"),
    ],
)
def test_a_failure_has_its_status(sweep: Sweep, kind: str, status: str, error: str, message: str) -> None:
    record = sweep.records[kind]
    assert record.status == status
    assert record.error is not None
    assert record.error.type == error
    assert message in record.error.message
    assert record.metrics is None
    assert record.protocol.name == "envgs"
    assert record.provenance.started <= record.provenance.finished
    assert record.config["method"]["kind"] == f"fakes.methods:{kind}"


def test_the_log_is_kept_and_quoted(sweep: Sweep) -> None:
    error = sweep.records["Raises"].error
    assert error is not None
    log = (sweep.folders["Raises"] / LOG_NAME).read_text()
    assert "learning the mean color of tiny" in log
    assert "in fail" in log  # the traceback
    assert error.log_tail == log
    crash = sweep.records["Segfaults"].error
    assert crash is not None
    assert "Segmentation fault" in crash.log_tail  # faulthandler


@pytest.mark.parametrize("kind", ["Raises", "IsSlow", "LosesItsLoss", "RunsOutOfMemory", "TakesMemory"])
def test_what_was_learned_is_kept(sweep: Sweep, kind: str) -> None:
    assert (sweep.folders[kind] / "checkpoint" / "color.pt").is_file()
    cost = sweep.records[kind].cost
    assert cost is not None
    assert cost.primitives == {"base": 1, "env": 0}


def test_what_was_trained_without_is_recorded_even_of_a_process_that_died(sweep: Sweep) -> None:
    dropped = {kind: record.dropped_losses for kind, record in sweep.records.items()}
    failing = sorted(kind for kind, losses in dropped.items() if losses)
    assert failing == sorted({*KINDS, *IN_PARALLEL, *SLOW_KINDS, LIMITED} - {"RendersNaN", "MeanColor"})
    assert all(dropped[kind] == {"gloss": "tiny has no varnish"} for kind in failing)


def test_what_was_warned_of_is_recorded_even_of_a_process_that_died(sweep: Sweep) -> None:
    for kind in ("LosesItsLoss", "DiesAfterAWarning"):
        of_scene, warning = sweep.records[kind].warnings
        assert (of_scene.kind, of_scene.step) == ("points_unsupported", 0)  # the tiny scene's have colors at random
        assert (warning.kind, warning.step, warning.part) == ("non_finite", 5, "loss")
    assert all(len(sweep.records[kind].warnings) == 1 for kind in ("Raises", "Segfaults", "IsSlow"))


def test_skipped_steps_are_counted(sweep: Sweep) -> None:
    cost = sweep.records["LosesItsLoss"].cost
    assert cost is not None
    assert cost.skipped_steps == 20


def test_a_successful_run_has_a_complete_record_and_all_files(sweep: Sweep) -> None:
    record, folder = sweep.records["MeanColor"], sweep.folders["MeanColor"]
    assert record.status == "ok"
    assert record.error is None
    assert (record.method, record.dataset, record.seed, record.steps) == ("fake", "tiny", 0, 200)
    assert record.run_id == folder.name
    assert folder.parts[-3:-1] == ("tiny", "fake")
    assert "steps=200" in record.overrides
    assert record.metrics is not None
    assert [view.view for view in record.metrics.per_view] == ["view0", "view1"]
    taken = {name for name, metric in registered_metrics().items() if not metric.asked_for}
    assert set(record.metrics.mean) == {*taken, "normal_degrees"}
    assert record.metrics.mean["lpips"] is None
    assert "lpips" in record.metrics.not_computed
    assert record.metrics.weights is None
    assert record.masked["reflective"].fraction == 0.5
    assert [view.view for view in record.masked["reflective"].per_view] == ["view0"]
    assert record.timing is not None
    assert (record.timing.height, record.timing.width) == (24, 32)
    assert record.cost is not None
    assert record.cost.model_bytes == 12
    assert record.cost.peak_primitives == 1
    assert record.cost.peak_host_bytes > 1e6
    pictures = {str(path.relative_to(folder)) for path in folder.rglob("*.png")}
    assert pictures == {
        f"{folder}/{view}.png"
        for view in ("view0", "view1")
        for folder in (
            *("renders", "targets", "targets/normal"),
            *("layers/beta", "layers/normal", "layers/depth", "layers/error"),
        )
    } | {"masks/reflective/view0.png"}
    with (folder / "curve.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["step", "seconds", "loss", "psnr", "skipped_steps", "primitives_base", "primitives_env"]
    assert [int(row["step"]) for row in rows] == list(range(1, 201))


def test_nothing_else_is_left_behind(sweep: Sweep) -> None:
    assert sorted(os.listdir(sweep.root / "parallel")) == ["multirun.yaml", "tiny"]
