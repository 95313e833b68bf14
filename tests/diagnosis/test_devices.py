"""What photographs say is the same on a GPU."""

from pathlib import Path

import pytest
import torch
from toy_scenes import coarse_toys

from envgs_bench.datasets import load_scene
from envgs_bench.diagnosis.diagnosis import Diagnosis


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_a_gpu_finds_what_the_cpu_finds(tmp_path: Path) -> None:
    toy = {"kind": "toy", "scene": "chrome_room", "width": 80, "height": 60, "views": 24, "supersampling": 1}
    with coarse_toys():
        scene = load_scene(toy, tmp_path)
    cpu, cuda = Diagnosis(scene), Diagnosis(scene, "cuda")
    for name in ("noise", "detail", "blockiness"):
        assert getattr(cuda.photographs, name) == pytest.approx(getattr(cpu.photographs, name), rel=1e-4, abs=1e-5)
    assert cuda.exposures.deviation == pytest.approx(cpu.exposures.deviation, rel=1e-3, abs=1e-5)
    assert cuda.exposures.disagreement == pytest.approx(cpu.exposures.disagreement, rel=1e-2)
