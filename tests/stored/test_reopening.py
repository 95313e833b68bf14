"""Runs opened again whose files are not what a run left: a message that names the file."""

from __future__ import annotations

import json
import os
import shutil
import time
from pathlib import Path

import pytest
import yaml
from fakes.runs import set_environment
from hypothesis import given, settings
from hypothesis import strategies as st
from reports_runs import record
from trained_runs import trained_run

from envgs_bench.cli.main import main
from envgs_bench.settings import SettingsError, read_settings

# Nine lists of nine, each of the one before: 387 million texts once it is written out.
LAUGHS = "a0: &a0 [lol]\n" + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 10))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("method: {name: [", "cannot be read as YAML"),
        ("a: \t- b", "cannot be read as YAML"),
        ("[" * 5000, "cannot be read as YAML"),
        (LAUGHS, "cannot be read as YAML (an alias, which no run writes"),
        ("!!python/object/apply:os.mkdir [made]", "cannot be read as YAML"),
        ("x" * 2_000_000, "it has 2,000,000 bytes, more than the 1,000,000"),
        ("\x00", "cannot be read as YAML"),
        ("2026-99-99", "config.yaml: "),
        ("", "config.yaml: "),
        ("5", "config.yaml: "),
        ("seed: 1", "config.yaml: "),
    ],
)
def test_a_config_that_is_none_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], content: str, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "config.yaml").write_text(content)
    start = time.perf_counter()
    assert main(["store", str(tmp_path), "--layout", "ply", "--out", str(tmp_path / "out")]) == 1
    assert time.perf_counter() - start < 20
    said = capsys.readouterr().err
    assert f"{tmp_path}/config.yaml: " in said
    assert message in said
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize(
    "command", [["store", "--layout", "ply"], ["render", "--path", "orbit", "--device", "cpu"], ["layouts"]]
)
@pytest.mark.parametrize(
    ("status", "message"),
    [
        ("interrupted", "the run was interrupted; expected one that ended ok. The command that started it goes on"),
        ("failed", "the run ended as failed (MemoryError: too large); expected one that ended ok. Mend the cause and "),
    ],
)
def test_half_a_training_is_refused(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: list[str],
    status: str,
    message: str,
) -> None:
    set_environment(monkeypatch)
    trained_run(tmp_path / "run", "2dgs", steps=2)
    error = {"type": "MemoryError", "message": "too large", "log_tail": ""}
    ended = record("tiny", "2dgs", 0, status=status, error=error, metrics=None, masked={}, timing=None)
    (tmp_path / "run/record.json").write_text(json.dumps(ended))
    name, *options = command
    assert main([name, str(tmp_path / "run"), *options, "--out", str(tmp_path / "out.gif")]) == 1
    assert f"{tmp_path / 'run'}: {message}" in capsys.readouterr().err
    shutil.rmtree(tmp_path / "run/checkpoint")  # that there is none is no news
    assert main([name, str(tmp_path / "run"), *options, "--out", str(tmp_path / "out.gif")]) == 1
    assert f"{tmp_path / 'run'}: {message}" in capsys.readouterr().err


def test_a_config_in_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "config.yaml")
    with pytest.raises(SettingsError, match=r"config\.yaml: cannot be read as YAML \(it is a named pipe"):
        read_settings(tmp_path)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(data=st.data())
def test_damaged_configs_are_read_or_named(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    text = data.draw(st.sampled_from(CONFIGS))
    at, length = data.draw(st.integers(0, len(text))), data.draw(st.integers(0, 30))
    noise = data.draw(st.text(st.sampled_from("[]{}:&*!|>-'\"\n #%@`?,\t0x9e~"), max_size=8))
    (folder / "config.yaml").write_text(text[:at] + noise + text[at + length :])
    try:
        read_settings(folder)
    except SettingsError as error:
        named = str(folder) in str(error)
        assert named


CONFIGS = [
    yaml.safe_dump(
        {
            "method": {"name": "2dgs", "kind": "2dgs", "settings": {"sh_degree": 2}},
            "dataset": {"kind": "toy", "scene": "chrome_room"},
            **{"protocol": "envgs", "seed": 0, "steps": 10, "device": "cpu", "timeout_minutes": None},
            **{"timing": {"frames": 5, "seconds": 1.0}, "runs_dir": "runs", "cache_dir": "cache"},
            **{"force": False, "overrides": ["seed=0"]},
        },
        sort_keys=False,
    )
]
