"""`envgs-bench render`: films, decoded again and compared with what the method renders."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import av
import numpy as np
import pytest
from fakes.runs import set_environment
from PIL import Image, ImageSequence
from trained_runs import trained_run

from envgs_bench.cli.main import main
from envgs_bench.methods.method import Method
from envgs_bench.stages.pictures import as_bytes, depth_unit, layer_pictures
from envgs_bench.testing import HEIGHT, WIDTH, tiny_scene


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Method]:
    folder = tmp_path_factory.mktemp("runs") / "seed0"
    return folder, trained_run(folder, "envgs")


def frames_of(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def render(run: Path, out: Path, *options: str) -> int:
    return main(["render", str(run), "--out", str(out), *options])


def test_a_film_that_cannot_be_written_names_out(
    trained: tuple[Path, Method], capsys: pytest.CaptureFixture[str]
) -> None:
    assert render(trained[0], Path("/proc/none/film.webp"), "--seconds", "0.1") == 1
    assert "render: --out /proc/none/film.webp: cannot be written (No such file or" in capsys.readouterr().err


def test_a_film_from_test_camera_to_test_camera_begins_with_what_the_run_scored(
    tmp_path: Path, trained: tuple[Path, Method], capsys: pytest.CaptureFixture[str]
) -> None:
    run, method = trained
    layers = ["image", "base", "reflection", "beta", "normal", "depth"]
    chosen = ("--path", "interpolate", "--layers", ",".join(layers), "--fps", "5", "--seconds", "1", "--size", "64x48")
    assert render(run, tmp_path / "film.mp4", *chosen) == 0
    frames = frames_of(tmp_path / "film.mp4")
    assert [frame.shape for frame in frames] == 5 * [(48, 64 * len(layers), 3)]
    assert "film.mp4: 5 frames, 1.0 s, of 64×48 pixels a layer" in capsys.readouterr().out
    views = [tiny_scene().test[0].camera, tiny_scene().train[0].camera]
    for frame, camera in ((frames[0], views[0]), (frames[-1], views[1])):
        rendering = method.render(camera.resized(64, 48))
        drawn = {"image": rendering.color, **layer_pictures(rendering, depth_unit(views))}
        for index, layer in enumerate(layers):
            expected = as_bytes(drawn[layer])
            expected = expected if expected.ndim == 3 else np.repeat(expected[..., None], 3, axis=2)
            shown = frame[16:, 64 * index : 64 * (index + 1)]  # below the layer's name
            # Half the resolution in color, and H.264: means are right, pixels about so.
            assert np.abs(shown.mean((0, 1)) - expected[16:].mean((0, 1))).max() < 2.5, layer
            assert np.abs(shown.astype(float) - expected[16:]).mean() < 8, layer


def test_one_layer_of_an_odd_size_is_shown_as_it_is_within_even_borders(
    tmp_path: Path, trained: tuple[Path, Method]
) -> None:
    run, _ = trained
    assert render(run, tmp_path / "film.mp4", "--seconds", "0.2", "--fps", "10", "--size", "33x25") == 0
    frames = frames_of(tmp_path / "film.mp4")
    assert [frame.shape for frame in frames] == 2 * [(26, 34, 3)]
    assert frames[0][:24, :32].mean() > 20
    assert frames[0][25:].mean() < 20  # the row that was added is black


@pytest.mark.parametrize("suffix", [".webp", ".gif"])
def test_moving_pictures_need_no_library(
    tmp_path: Path, trained: tuple[Path, Method], suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    run, _ = trained
    assert render(run, tmp_path / f"film{suffix}", "--path", "spiral", "--seconds", "0.4", "--fps", "10") == 0
    with Image.open(tmp_path / f"film{suffix}") as film:
        sizes = [frame.size for frame in ImageSequence.Iterator(film)]
    assert sizes == 4 * [(WIDTH, HEIGHT)]


def test_a_files_cameras_are_a_frame_each(tmp_path: Path, trained: tuple[Path, Method]) -> None:
    run, method = trained
    poses = [np.linalg.inv(view.camera.world_to_camera.numpy()) * [1, -1, -1, 1] for view in tiny_scene().train[:3]]
    (tmp_path / "path.json").write_text(json.dumps({"frames": [{"transform_matrix": pose.tolist()} for pose in poses]}))
    assert render(run, tmp_path / "film.mp4", "--path", str(tmp_path / "path.json")) == 0
    frames = frames_of(tmp_path / "film.mp4")
    assert len(frames) == 3
    expected = as_bytes(method.render(tiny_scene().train[2].camera).color)
    assert np.abs(frames[2].astype(float) - expected).mean() < 8


@pytest.mark.parametrize(
    ("out", "options", "message"),
    [
        ("film.avi", (), "the film's format is its suffix, one of .mp4, .gif, .webp"),
        ("film.mp4", ("--layers", "image,albedo"), "draws no albedo; its layers are image, base, reflection, beta"),
        ("film.mp4", ("--path", "obrit"), "--path obrit: is no file, and none of orbit, spiral, interpolate"),
    ],
)
def test_what_cannot_be_is_explained_and_leaves_nothing(
    tmp_path: Path,
    trained: tuple[Path, Method],
    capsys: pytest.CaptureFixture[str],
    out: str,
    options: tuple[str, ...],
    message: str,
) -> None:
    assert render(trained[0], tmp_path / out, *options) == 1
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_without_pyav_it_says_what_to_install(
    tmp_path: Path, trained: tuple[Path, Method], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    assert render(trained[0], tmp_path / "film.mp4") == 1
    assert "pip install 'envgs-bench[video]'; .webp and .gif do without" in capsys.readouterr().err


@pytest.mark.parametrize("option", [("--size", "64"), ("--size", "0x48"), ("--fps", "0"), ("--seconds", "long")])
def test_numbers_that_are_none_are_refused(tmp_path: Path, option: tuple[str, str]) -> None:
    with pytest.raises(SystemExit) as caught:
        render(tmp_path, tmp_path / "film.mp4", *option)
    assert caught.value.code == 2
