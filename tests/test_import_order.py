"""What the first import of a process leaves behind: pycolmap's signal handlers, and a zlib that calls pycolmap's."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

PNG = "from PIL import Image; Image.new('RGB', (64, 48)).save('picture.png'); print('saved')"


def run(script: str, folder: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", script], cwd=folder, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("first", ["import pycolmap, envgs_bench", "import envgs_bench, pycolmap"])
def test_pictures_are_written_whatever_was_imported_first(first: str, tmp_path: object) -> None:
    done = run(f"{first}; {PNG}", tmp_path)
    assert (done.returncode, done.stdout) == (0, "saved\n"), done.stderr


def test_sigterm_ends_a_process_that_knows_data_sources_quietly(tmp_path: object) -> None:
    script = (
        "import contextlib, os, signal\n"
        "from envgs_bench.datasets.registry import check_source\n"
        "with contextlib.suppress(ValueError):\n"
        "    check_source({'kind': 'colmap', 'root': '.'})\n"
        "os.kill(os.getpid(), signal.SIGTERM)\n"
    )
    done = run(script, tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGTERM, "", "")
