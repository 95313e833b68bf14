"""A run's folder follows from what determines its result, and from nothing else; its settings are checked."""

from __future__ import annotations

import json
import os
import shutil
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from captures import HEIGHT, WIDTH, gradient, write_capture
from PIL import Image

from envgs_bench.methods import registry
from envgs_bench.records import Failure
from envgs_bench.runs import identity, provenance
from envgs_bench.runs import source_fingerprint as fingerprint_module
from envgs_bench.runs.draft import Draft
from envgs_bench.runs.identity import code_version, run_id
from envgs_bench.runs.source_fingerprint import source_fingerprint, source_fingerprints
from envgs_bench.settings import RunSettings, SettingsError, default_cache_dir, parse_settings


def content(**changes: Any) -> dict[str, Any]:
    given: dict[str, Any] = {
        "method": {"name": "2dgs", "kind": "2dgs", "settings": {"sh_degree": 2}},
        "dataset": {"name": None, "kind": "colmap", "root": "captures/fox"},
        "protocol": "envgs",
        "seed": 0,
        "steps": 10,
        "device": "auto",
        "timing": {"frames": 50, "seconds": 1.0},
        "timeout_minutes": None,
        "runs_dir": "runs",
        "cache_dir": None,
        "force": False,
    }
    return {**given, **changes}


def settings(**changes: Any) -> RunSettings:
    return parse_settings(content(**changes))


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> str:
    """One folder for all that is remembered of files: a new one has to parse all code first, which takes a second."""
    return str(tmp_path_factory.mktemp("cache"))


@pytest.mark.parametrize(
    "changes",
    [
        {"method": {"name": "2dgs", "kind": "2dgs", "settings": {"sh_degree": 3}}},
        {"method": {"name": "2dgs", "kind": "3dgs", "settings": {"sh_degree": 2}}},
        {"dataset": {"name": None, "kind": "colmap", "root": "captures/fox", "width": 10}},
        {"protocol": "strict"},
        {"score_on": "validation"},
        {"budget": {"primitives": 1000, "mb": None}},
        {"repair": "exposures"},
        {"seed": 1},
        {"steps": 11},
        {"timing": {"frames": 51, "seconds": 1.0}},
    ],
)
def test_what_determines_the_result_changes_the_identity(changes: dict[str, Any]) -> None:
    assert run_id(settings(**changes), "cpu") != run_id(settings(), "cpu")


def test_scoring_on_validation_views_takes_them_out_of_the_training_views() -> None:
    chosen = settings(score_on="validation")
    assert chosen.dataset["validation"] is True
    assert "validation" not in settings().dataset
    with pytest.raises(SettingsError, match="score_on='train'"):
        settings(score_on="train")


def test_equal_repairs_are_one_run_however_they_are_written() -> None:
    assert settings(repair="none").repair == settings(repair=None).repair == settings().repair == ()
    assert settings(repair=["normals", "exposures"]).repair == settings(repair=["exposures", "normals"]).repair
    assert settings(repair="normals").repair == settings(repair=["normals"]).repair == ("normals",)
    with pytest.raises(
        SettingsError, match=r"repair=\['windows'\]: Input should be 'none', or a list of exposures, poses, normals"
    ):
        settings(repair=["windows"])


def test_the_device_and_the_code_change_the_identity(monkeypatch: pytest.MonkeyPatch) -> None:
    before = run_id(settings(), "cpu")
    assert run_id(settings(), "cuda") != before
    monkeypatch.setattr(identity, "code_version", lambda cache_dir: "another")
    assert run_id(settings(), "cpu") != before


@pytest.mark.parametrize(
    "changes",
    [
        {"runs_dir": "elsewhere"},
        {"cache_dir": "elsewhere"},
        {"force": True},
        {"retry": "failed"},
        {"timeout_minutes": 3},
        {"memory_gb": 3},
        {"device_memory_fraction": 0.5},
        {"snapshot_minutes": 1},
        {"overrides": ["seed=0"]},
        {"device": "cpu"},
        {"budget": {"primitives": None, "mb": None}},
        {"logger": {"kind": "wandb", "every": 10, "views": 2}},
        {"dataset": {**content()["dataset"], "obtain": "the host", "download": "https://host/fox.zip"}},
    ],
)
def test_what_does_not_determine_the_result_leaves_the_identity(
    changes: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_id(settings(**changes), "cpu") == run_id(settings(), "cpu")


def test_data_count_by_what_lies_there_and_not_by_where(tmp_path: Path, cache: str) -> None:
    def identity_of(root: Path) -> str:
        data = {"kind": "colmap", "root": str(root)}
        return run_id(settings(dataset=data, cache_dir=cache), "cpu")

    for name in ("here", "there"):
        for folder in ("images", "normals"):
            (tmp_path / name / folder).mkdir(parents=True)
        (tmp_path / name / "images" / "a.png").write_bytes(b"1234")
        (tmp_path / name / "normals" / "a.npy").write_bytes(b"1234")
    before = identity_of(tmp_path / "here")
    assert identity_of(tmp_path / "there") == before
    (tmp_path / "here" / "images" / "b.png").touch()
    assert identity_of(tmp_path / "here") != before
    (tmp_path / "there" / "normals" / "a.npy").write_bytes(b"4321")  # other normals have the same size
    assert identity_of(tmp_path / "there") != before


def test_the_code_version_covers_methods_and_kernels(cache: str) -> None:
    assert len(code_version(Path(cache))) == 64
    folders = {part: identity._location(part) for part in identity.RESULT_CODE}
    assert all(path.exists() for path in folders.values())
    assert (folders["methods"] / "registry.py").is_file()


def test_a_method_of_ones_own_counts_by_its_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "mine_alone").mkdir()
    for name in ("__init__.py", "method.py", "losses.py"):
        (tmp_path / "mine_alone" / name).touch()
    points = EntryPoints([EntryPoint("mine", "mine_alone.method:Method", registry.ENTRY_POINT_GROUP)])
    monkeypatch.setattr(registry, "entry_points", lambda group: points)

    def identities() -> list[str]:
        kinds = ("mine", "mine_alone.method:Method")
        return [run_id(settings(method={"name": "mine", "kind": kind}), "cpu") for kind in kinds]

    before = identities()
    assert identities() == before
    (tmp_path / "mine_alone" / "losses.py").write_text("a = 2\n")
    assert all(now != then for now, then in zip(identities(), before, strict=True))


@pytest.mark.parametrize("suffix", [".py", ".cpp"])
def test_code_counts_by_what_it_means(tmp_path: Path, suffix: str) -> None:
    python = (
        'def f(x):\n    """Doc."""\n    return x + 1  # one\n',
        ["def f(x):\n    return (x + 1)\n", '# a\ndef f(x):\n    """Another,\n    longer."""\n\n    return x+1\n'],
        ["def f(x):\n    return x + 2\n", "def f(x):\n    'x'\n    'y'\n    return x + 1\n", "def f(x:\n"],
    )
    native = (
        '#define A 1 // one\nint f(int x) { return x + A; }\nchar* s = "/* no */ //";\n',
        ['#define A 1\nint f(int x)\n{\n  /* long\n  comment */ return x + A; }\nchar* s = "/* no */ //"; // so\n'],
        [
            '#define A 2\nint f(int x) { return x + A; }\nchar* s = "/* no */ //";\n',
            '#define A 1\nint f(int x) { return x + A; }\nchar* s = "/* yes */ //";\n',
            '#define A 1 int f(int x) { return x + A; }\nchar* s = "/* no */ //";\n',
        ],
    )
    text, same, others = python if suffix == ".py" else native

    def fingerprint(content: str) -> bytes:
        (tmp_path / f"a{suffix}").write_text(content)
        return source_fingerprint(tmp_path / f"a{suffix}")

    expected = fingerprint(text)
    assert [fingerprint(other) == expected for other in same] == [True] * len(same)
    assert [fingerprint(other) == expected for other in others] == [False] * len(others)


def test_code_is_parsed_again_only_where_it_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    memory, paths = tmp_path / "memory" / "code.json", [tmp_path / "a.py", tmp_path / "b.py", tmp_path / "c.h"]
    for number, path in enumerate(paths):
        path.write_text(f"x = {number};\n")
    expected = [source_fingerprint(path) for path in paths]
    assert source_fingerprints(paths, memory) == expected
    parsed: list[Path] = []
    monkeypatch.setattr(fingerprint_module, "source_fingerprint", lambda path: parsed.append(path) or b"\1" * 32)
    assert source_fingerprints(paths, memory) == expected
    paths[1].write_text("x = 2;\n")
    assert source_fingerprints(paths, memory) == [expected[0], b"\1" * 32, expected[2]]
    assert parsed == [paths[1]]
    memory.write_text(json.dumps({str(paths[0]): 3, str(paths[2]): ["", None]}))
    assert source_fingerprints(paths, memory) == [b"\1" * 32] * 3


def test_every_file_of_this_code_is_parsed() -> None:
    """The fallback, its bytes, would let comments count."""
    for room in identity.RESULT_CODE:
        for path in identity._location(room).rglob("*.py"):
            compile(path.read_text(), path, "exec")


def test_names_are_the_configured_ones_or_the_folders() -> None:
    assert settings().dataset_name == "fox"
    assert settings(dataset={"name": "red fox", "kind": "colmap", "root": "x"}).dataset_name == "red-fox"
    assert settings(dataset={"name": "toy/../room", "kind": "toy"}).dataset_name == "toy/unnamed/room"
    assert settings(dataset={"kind": "toy"}).dataset_name == "toy"
    assert settings(method={"name": "../up", "kind": "2dgs"}).method_name == "-up"


def test_paths_do_not_depend_on_where_the_run_was_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    given = settings(method={"name": "renders", "kind": "renders", "settings": {"path": "mine"}})
    assert given.runs_dir == tmp_path / "runs"
    assert given.dataset["root"] == str(tmp_path / "captures" / "fox")
    assert given.method.settings["path"] == str(tmp_path / "mine")
    assert settings(dataset={"kind": "colmap", "root": "~/fox"}).dataset["root"] == str(Path.home() / "fox")


def test_the_cache_is_where_the_environment_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ENVGS_BENCH_CACHE", str(tmp_path))
    assert default_cache_dir() == tmp_path == settings().cache_dir
    monkeypatch.delenv("ENVGS_BENCH_CACHE")
    assert default_cache_dir() == Path.home() / ".cache" / "envgs-bench"


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"seed": -1}, "seed=-1"),
        ({"steps": 0}, "steps=0"),
        ({"device": "tpu"}, "device='tpu': Input should be 'auto', 'cpu' or 'cuda'"),
        ({"timeout_minutes": 0}, "timeout_minutes=0"),
        ({"timing": {"frames": 0, "seconds": 1}}, "timing.frames=0"),
        ({"method": {"name": "x"}}, "method.kind"),
        ({"dataset": {}}, "dataset={}: needs a key `kind`"),
        ({"surplus": 1}, "surplus=1"),
    ],
)
def test_a_wrong_setting_is_named(changes: dict[str, Any], complaint: str) -> None:
    with pytest.raises(SettingsError) as caught:
        settings(**changes)
    assert complaint in str(caught.value)


def test_a_record_names_the_commit_that_its_run_began_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The code is read at the start; somebody may commit before the end."""
    begun = {"commit": "a" * 40, "dirty": False}
    monkeypatch.setattr(provenance, "checkout", lambda: begun)
    draft = Draft(tmp_path, settings())
    monkeypatch.setattr(provenance, "checkout", lambda: {"commit": "b" * 40, "dirty": True})
    failure = Failure(type="Error", message="", log_tail="")
    record = draft.write("failed", failure)
    assert (record.provenance.commit, record.provenance.dirty) == ("a" * 40, False)


def write_frames(root: Path, names: list[str]) -> None:
    (root / "images").mkdir(parents=True)
    for name in names:
        Image.fromarray(gradient()).save(root / "images" / name)
    frames = [{"file_path": f"images/{name}", "transform_matrix": np.eye(4).tolist()} for name in names]
    content = {"fl_x": 60.0, "w": WIDTH, "h": HEIGHT, "aabb_scale": 1, "frames": frames}
    (root / "transforms.json").write_text(json.dumps(content))


def write_photos(root: Path, names: list[str]) -> None:
    write_frames(root, names)
    (root / "transforms.json").unlink()


def write_blender(root: Path, names: list[str]) -> None:
    write_frames(root, names)
    content = json.loads((root / "transforms.json").read_text())
    for split in ("train", "test"):
        (root / f"transforms_{split}.json").write_text(json.dumps(content))
    (root / "transforms.json").unlink()


def write_binary(root: Path, names: list[str]) -> None:
    model = pycolmap.Reconstruction(str(write_capture(root, names) / "sparse/0"))
    model.write_binary(str(root / "sparse/0"))
    for path in (root / "sparse/0").glob("*.txt"):
        path.unlink()


WRITERS = {
    "colmap": write_capture,
    "colmap, binary": write_binary,
    "transforms": write_frames,
    "blender": write_blender,
    "photos": write_photos,
}


@pytest.mark.parametrize("source", WRITERS)
def test_a_data_set_counts_by_the_files_that_are_read(tmp_path: Path, source: str, cache: str) -> None:
    root = tmp_path / "capture"
    WRITERS[source](root, ["0.png", "1.png", "2.png", "3.png"])
    masks = root / "masks/images" if source == "blender" else root / "masks"
    masks.mkdir(parents=True)
    for name in ("0.png", "1.png", "2.png", "3.png"):
        Image.fromarray(gradient()).save(masks / name)
    kind = source.partition(",")[0]

    def identity_of(root: Path) -> str:
        given = {"kind": kind, "root": str(root)}
        return run_id(settings(dataset=given, cache_dir=cache), "cpu")

    before = identity_of(root)
    unrelated = [
        "README.md",
        "images/README.md",
        "images/.DS_Store",
        "masks/README.md",
        "notes/plan.pdf",
        "images_4/0.png",
    ]
    unrelated += ["sparse/0/project.ini", "sparse/1/images.txt"]
    if kind != "photos":  # all others name their pictures
        unrelated.append("images/spare.png")
    for name in unrelated:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text("unrelated")
    assert identity_of(root) == before
    shutil.copytree(root, tmp_path / "moved")
    assert identity_of(tmp_path / "moved") == before
    read = [path for path in root.rglob("*") if path.is_file() and path.relative_to(root).as_posix() not in unrelated]
    assert len(read) >= 8
    for path in read:
        content = path.read_bytes()
        if path.suffix == ".png":
            path.write_bytes(content[:-20] + bytes([content[-20] ^ 1]) + content[-19:])  # of the same size
        elif path.suffix == ".bin":
            path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
        else:
            path.write_bytes(content + b"\n")
        assert identity_of(root) != before, path
        path.write_bytes(content)
        assert identity_of(root) == before, path


def test_a_folder_of_renders_counts_by_its_pictures(tmp_path: Path, cache: str) -> None:
    def identity() -> str:
        method = {"name": "mine", "kind": "renders", "settings": {"path": str(tmp_path / "renders")}}
        return run_id(settings(method=method, cache_dir=cache), "cpu")

    (tmp_path / "renders").mkdir()
    (tmp_path / "renders/a.png").write_bytes(b"1234")
    before = identity()
    (tmp_path / "renders/README.md").write_text("how they were drawn")
    os.mkfifo(tmp_path / "renders/b.png")
    assert identity() == before
    (tmp_path / "renders/a.png").write_bytes(b"4321")
    assert identity() != before


def test_a_damaged_capture_counts_by_all_that_lies_there(tmp_path: Path, cache: str) -> None:
    root = write_capture(tmp_path / "capture", ["0.png", "1.png"])
    (root / "sparse/0/images.txt").write_text("no images\n")
    given = settings(dataset={"kind": "colmap", "root": str(root)}, cache_dir=cache)
    before = run_id(given, "cpu")
    (root / "README.md").write_text("why")
    assert run_id(given, "cpu") != before


def test_code_means_the_same_to_every_version_of_python(tmp_path: Path) -> None:
    """f-strings and parameters of types are parsed otherwise since 3.12, and empty fields left out since 3.13."""
    path = tmp_path / "a.py"
    path.write_text(
        "@wraps\nasync def f(a: int = 1, *b, c=None, **d) -> str:\n    return f'{a!r:>{c}} {d[\"x\"]}'\n"
        "class A(B, metaclass=C):\n    x: float = -1e-3j\n    def g(self): return {**self.x, 'y': [...]}\n"
        "match f:\n    case [1, *_] | {'a': b}: pass\ntry: pass\nexcept* E as e: raise\n"
    )
    assert source_fingerprint(path).hex()[:16] == "6b061cde129c5b47"
