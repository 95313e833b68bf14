"""What a record says of its origin, against the tools that a person would ask."""

import json
import resource
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import psutil
import pytest
import torch

from envgs_bench.core import cpu
from envgs_bench.runs import provenance
from envgs_bench.runs.provenance import busy, collect
from envgs_bench.stages.cost import peak_device_bytes, peak_host_bytes

REPOSITORY = Path(provenance.__file__).resolve().parents[2]


def git(*arguments):
    return subprocess.run(["git", "-C", str(REPOSITORY), *arguments], capture_output=True, text=True, check=True).stdout


def test_provenance_is_plain_json_and_names_versions_machine_and_threads():
    found = collect("cpu", busy())
    assert json.loads(json.dumps(found)) == found
    assert found["packages"]["torch"] == version("torch")
    assert found["python"] == ".".join(map(str, sys.version_info[:3]))
    assert found["threads"] == torch.get_num_threads()
    assert found["machine"]["memory_bytes"] == psutil.virtual_memory().total
    assert found["machine"]["usable_cores"] >= 1
    assert found["machine"]["cpu_target"] == cpu.target
    assert found["device"] == {"type": "cpu", "name": found["machine"]["cpu"]}
    assert all(word in found["command"] for word in psutil.Process().cmdline()[1:])


@pytest.mark.skipif(not (REPOSITORY / ".git").exists(), reason="not a git checkout")
def test_commit_and_dirty_are_gits():
    found = provenance.checkout.__wrapped__()
    assert found["commit"] == git("rev-parse", "HEAD").strip()
    assert found["dirty"] == bool(git("status", "--porcelain", "--untracked-files=no"))


def test_an_installed_copy_has_no_commit(monkeypatch, tmp_path):
    """Neither outside any checkout nor, untracked, inside somebody else's."""
    monkeypatch.setattr(provenance, "__file__", str(tmp_path / "provenance.py"))
    assert provenance.checkout.__wrapped__() == {"commit": None, "dirty": None}
    monkeypatch.setattr(provenance, "__file__", str(REPOSITORY / "no_such_file.py"))
    assert provenance.checkout.__wrapped__() == {"commit": None, "dirty": None}


def test_missing_slow_and_failing_commands_give_none(monkeypatch):
    assert provenance._output(["no-such-command-anywhere"]) is None
    assert provenance._output([sys.executable, "-c", "raise SystemExit(3)"]) is None
    monkeypatch.setattr(provenance, "COMMAND_SECONDS", 0.05)
    assert provenance._output([sys.executable, "-c", "import time; time.sleep(60)"]) is None


def test_others_are_what_is_left_of_the_machines_work(monkeypatch):
    """5 s of 25 s of work in 10 s were ours: others kept two cores busy."""
    monkeypatch.setattr(provenance, "busy", lambda: (110.0, 1025.0, 55.0))
    assert provenance._others_cores((100.0, 1000.0, 50.0)) == 2.0
    monkeypatch.setattr(provenance, "busy", lambda: (100.1, 1000.1, 50.0))
    assert provenance._others_cores((100.0, 1000.0, 50.0)) is None


def test_peak_memory_is_in_bytes():
    before = peak_host_bytes()
    assert before >= psutil.Process().memory_info().rss // 2
    ballast = torch.ones(64 << 20, dtype=torch.uint8)
    assert peak_host_bytes() >= before
    assert peak_host_bytes() == resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (
        1 if sys.platform == "darwin" else 1024
    )
    assert len(ballast) == 64 << 20
    assert peak_device_bytes("cpu") is None


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_gpu_is_named_with_driver_and_clocks():
    found = collect("cuda", busy())["device"]
    assert found["name"] == torch.cuda.get_device_name()
    assert set(provenance.GPU_FIELDS) < set(found)
    torch.zeros(1 << 20, device="cuda")
    peak = peak_device_bytes("cuda")
    assert peak is not None
    assert peak >= 4 << 20


def test_a_gpus_fields_are_read_in_their_order(monkeypatch):
    """nvidia-smi's output, recorded; two processes mean that the device was shared."""

    class Properties:
        name, total_memory, major, minor, multi_processor_count, uuid = "H", 80 << 30, 9, 0, 132, "u"

    def smi(command):
        assert command[:2] == ["nvidia-smi", "--id=GPU-u"]
        return "11\n12" if command[-1] == "--query-compute-apps=pid" else "570.1, 1980, 1990, 2619, [N/A]"

    monkeypatch.setattr(torch.cuda, "get_device_properties", lambda device: Properties)
    monkeypatch.setattr(provenance, "_output", smi)
    found = provenance._gpu(torch.device("cuda"))
    assert (found["driver"], found["clock_mhz"], found["clock_max_mhz"]) == ("570.1", 1980, 1990)
    assert (found["memory_clock_mhz"], found["power_limit_w"]) == (2619, None)
    assert found["shared"] is True
    monkeypatch.setattr(provenance, "_output", lambda command: None)
    found = provenance._gpu(torch.device("cuda"))
    assert found["driver"] is None
    assert found["shared"] is None
