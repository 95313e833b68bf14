"""OpenSplat for real, where it is installed: it trains by its recipe, and the shared core draws its model."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from fakes.runs import records, run_here, set_environment


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("opensplat") is None, reason="opensplat is not on the PATH")
def test_opensplat_learns_a_toy_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)
    scene = ("dataset=toy/chrome_room", "size=tiny", f"cache_dir={tmp_path / 'cache'}")
    program = ("method=external", "method.recipe=opensplat", 'method.settings.arguments="--num-downscales 0"')
    for steps in (20, 200):
        assert run_here(tmp_path / "runs", *program, *scene, f"steps={steps}") == 0
    early, late = sorted(records(tmp_path / "runs"), key=lambda record: record.steps)
    for record in (early, late):
        assert record.cost is not None
        assert record.cost.primitives["base"] > 1000
        assert record.timing is not None
        assert record.program is not None
        assert "draws no test views" in record.program.not_measured["agreement_db"]
    assert early.metrics is not None
    assert late.metrics is not None
    assert late.metrics.mean["psnr"] > early.metrics.mean["psnr"] > 8  # type: ignore[operator]
