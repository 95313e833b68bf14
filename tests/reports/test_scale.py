"""The report of a large benchmark: 40 methods on 25 scenes, five seeds each."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from reports_runs import KINDS, METHODS, record, run_folder, write_failure, write_record, write_runs

BUILD = """
import resource, sys
from pathlib import Path
from envgs_bench.reports import build_report
print(build_report(Path(sys.argv[1]), Path(sys.argv[2])))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


@pytest.mark.slow
def test_5000_records_fit_in_two_gigabytes_and_a_small_page(tmp_path: Path) -> None:
    methods = [*METHODS, *KINDS, *(f"method{number:02d}" for number in range(40 - len(METHODS) - len(KINDS)))]
    random = np.random.default_rng(0)
    views = [f"{number:03d}" for number in range(25)]
    for scene in range(25):
        for method in methods:
            for seed in range(5):
                content = record(f"toy/scene{scene:02d}", method, seed)
                times = np.round(random.normal(20, 1, (len(views), 50)), 4).tolist()
                content["timing"]["per_view"] = [{"view": v, "times_ms": t} for v, t in zip(views, times, strict=True)]
                psnr = random.normal(27, 1, len(views)).tolist()
                scores = [{"view": v, "psnr": p} for v, p in zip(views, psnr, strict=True)]
                content["metrics"]["per_view"] = scores
                run = run_folder(tmp_path / "runs", content["dataset"], method, seed)
                write_record(run, content)
    write_runs(tmp_path / "runs", ("toy/scene00",), tuple(methods[:1]), seeds=(0,))  # with pictures
    write_failure(tmp_path / "runs", "toy/scene01", "method00", 4, "out_of_memory", "tried to allocate 12 GB")
    command = [sys.executable, "-c", BUILD, str(tmp_path / "runs"), str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    said, kilobytes = done.stdout.splitlines()
    assert said.startswith("5000 runs, 1 of them failed")
    assert int(kilobytes) < 2e6
    assert (tmp_path / "out/index.html").stat().st_size < 5e6
    assert (tmp_path / "out/assets/data.js").stat().st_size < 2e6
