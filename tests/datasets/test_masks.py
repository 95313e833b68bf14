"""Masks: in whichever form they are stored, inside is what was inside, or an error says why it cannot be told."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from captures import HEIGHT, NAMES_OF_TEN, WIDTH, write_capture
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy import ndimage

from envgs_bench.core import Scene
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.formats.masks import mask_codings, read_mask

Plane = np.ndarray
Y, X = np.mgrid[:HEIGHT, :WIDTH]


def disk(index: int) -> Plane:
    """[H, W] bool: a disk that moves from view to view."""
    return (X - 20 - 2 * index) ** 2 + (Y - 24) ** 2 < 150


def gray(values: Plane, folder: Path, name: str) -> Path:
    path = folder / f"{name}.png"
    Image.fromarray(values).save(path)
    return path


def two_gray(low: int, high: int, dtype: type) -> Callable[[Plane, Path, str], Path]:
    return lambda inside, folder, name: gray(np.where(inside, high, low).astype(dtype), folder, name)


def bilevel(inside: Plane, folder: Path, name: str) -> Path:
    return gray(inside, folder, name)


def voc(inside: Plane, folder: Path, name: str) -> Path:
    """Object 1 is dark red, as in Pascal VOC."""
    image = Image.fromarray(inside.astype(np.uint8))
    image.putpalette([0, 0, 0, 128, 0, 0] + [0] * 762)
    image.save(folder / f"{name}.png")
    return folder / f"{name}.png"


def adaptive_palette(inside: Plane, folder: Path, name: str) -> Path:
    """Black and white in either order of the palette, as optimizers leave them, another in each file."""
    white_first = hash(name) % 2
    image = Image.fromarray((inside ^ bool(white_first)).astype(np.uint8))
    image.putpalette([255, 255, 255, 0, 0, 0] if white_first else [0, 0, 0, 255, 255, 255])
    image.save(folder / f"{name}.png")
    return folder / f"{name}.png"


def color(inside: Plane, folder: Path, name: str) -> Path:
    return gray(np.where(inside[..., None], [200, 30, 60], [0, 0, 0]).astype(np.uint8), folder, name)


def cut_out(inside: Plane, folder: Path, name: str) -> Path:
    """The photograph, transparent outside."""
    photograph = np.random.default_rng(0).integers(0, 256, (*inside.shape, 4), dtype=np.uint8)
    photograph[..., 3] = np.where(inside, 255, 0)
    return gray(photograph, folder, name)


def black_on_transparent(inside: Plane, folder: Path, name: str) -> Path:
    return gray(np.stack([0 * X, 0 * X, 0 * X, np.where(inside, 255, 0)], axis=-1).astype(np.uint8), folder, name)


def jpeg(inside: Plane, folder: Path, name: str) -> Path:
    Image.fromarray(np.where(inside, 255, 0).astype(np.uint8)).save(folder / f"{name}.jpg", quality=85)
    return folder / f"{name}.jpg"


def decoded_jpeg(inside: Plane, folder: Path, name: str) -> Path:
    return gray(np.asarray(Image.open(jpeg(inside, folder, name))), folder, name)


def feathered(inside: Plane, folder: Path, name: str) -> Path:
    """A soft edge that is cut where the hard one is."""
    distance = ndimage.distance_transform_edt(inside) - ndimage.distance_transform_edt(~inside)
    return gray(np.clip(127.5 + 40 * (distance - np.sign(distance) / 2), 0, 255).round().astype(np.uint8), folder, name)


def array_of(dtype: str) -> Callable[[Plane, Path, str], Path]:
    def write(inside: Plane, folder: Path, name: str) -> Path:
        np.save(folder / f"{name}.npy", inside.astype(dtype))
        return folder / f"{name}.npy"

    return write


def float_tiff(inside: Plane, folder: Path, name: str) -> Path:
    Image.fromarray(inside.astype(np.float32)).save(folder / f"{name}.tiff")
    return folder / f"{name}.tiff"


def probabilities(inside: Plane, folder: Path, name: str) -> Path:
    np.save(folder / f"{name}.npy", np.where(inside, 0.83, 0.21).astype(np.float32))
    return folder / f"{name}.npy"


FORMS = {
    "bilevel": bilevel,
    "ones": two_gray(0, 1, np.uint8),
    "thirty-eight": two_gray(0, 38, np.uint8),
    "one and two": two_gray(1, 2, np.uint8),
    "bytes": two_gray(0, 255, np.uint8),
    "words": two_gray(0, 65535, np.uint16),
    "word labels": two_gray(0, 7, np.uint16),
    "ids": two_gray(0, 1001, np.uint16),
    "voc": voc,
    "adaptive palette": adaptive_palette,
    "color": color,
    "cut out": cut_out,
    "black on transparent": black_on_transparent,
    "jpeg": jpeg,
    "decoded jpeg": decoded_jpeg,
    "feathered": feathered,
    "bool array": array_of("bool"),
    "int array": array_of("int32"),
    "float array": array_of("float32"),
    "float tiff": float_tiff,
    "probabilities": probabilities,
}


def read_back(form: str, truth: list[Plane], folder: Path) -> list[Plane]:
    paths = [FORMS[form](inside, folder, f"{index:03d}") for index, inside in enumerate(truth)]
    coding = mask_codings({"foreground": paths}, ())["foreground"]
    return [read_mask(path, coding) for path in paths]


@pytest.mark.parametrize("form", FORMS)
def test_inside_is_what_was_inside(form: str, tmp_path: Path) -> None:
    """Also where a view shows nothing of the region, and where it shows nothing else."""
    truth = [disk(0), disk(5), 0 * X > 0, 0 * X == 0]
    for mask, inside in zip(read_back(form, truth, tmp_path), truth, strict=True):
        np.testing.assert_array_equal(mask, inside, err_msg=form)


@settings(max_examples=30, deadline=None)
@given(
    st.sampled_from([np.uint8, np.uint16]),
    st.lists(st.integers(0, 255), min_size=1, max_size=4, unique=True),
    st.integers(0, 2**32 - 1),
)
def test_any_values_are_two_or_refused(dtype: type, values: list[int], seed: int) -> None:
    """Blocks of random values: two are outside and inside, one is refused where it is 0, more are refused."""
    import tempfile

    rng = np.random.default_rng(seed)
    picked = rng.integers(0, len(values), (2, 5, 6)) // rng.integers(1, 3)
    planes = np.kron(np.array(sorted(values))[picked], np.ones((8, 9), int)).astype(dtype)
    found = np.unique(planes)
    with tempfile.TemporaryDirectory() as name:
        paths = [gray(plane, Path(name), str(index)) for index, plane in enumerate(planes)]
        if len(found) > 2 or found.tolist() == [0]:
            with pytest.raises(DatasetError, match=r"holds? the labels|nothing inside|hold more than"):
                mask_codings({"r": paths}, ())
            return
        coding = mask_codings({"r": paths}, ())["r"]
        for path, plane in zip(paths, planes, strict=True):
            np.testing.assert_array_equal(read_mask(path, coding), plane == found[-1])


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_capture(tmp_path / "bench", NAMES_OF_TEN)


def load(root: Path, **keys: object) -> Scene:
    return load_scene({"kind": "colmap", "root": str(root), **keys}, root.parent / "cache")


def write_masks(root: Path, folder: str, planes: Callable[[int], Plane]) -> None:
    (root / folder).mkdir()
    for index in range(10):
        gray(planes(index), root / folder, f"{index:03d}")


def labels(index: int) -> Plane:
    return np.where(disk(index), np.where(X < 32, 1, 2), 0).astype(np.uint8)


def test_labels_are_refused_until_some_are_chosen(root: Path) -> None:
    write_masks(root, "masks", labels)
    with pytest.raises(DatasetError, match=r"bench/masks: region foreground: .* the labels \[0,1,2\]; .*mask_labels"):
        load(root)
    with pytest.raises(DatasetError, match=r"no mask holds a label of dataset.mask_labels=\[5\]; found are \[0,1,2\]"):
        load(root, mask_labels=[5])
    for chosen in ([1], [2], [1, 2]):
        scene = load(root, mask_labels=chosen)
        np.testing.assert_array_equal(scene.test[0].masks["foreground"], np.isin(labels(0), chosen))


def test_colors_are_chosen_by_their_names(root: Path) -> None:
    colors = np.array([[0, 0, 0], [128, 0, 0], [0, 128, 64]], np.uint8)
    write_masks(root, "masks", lambda index: colors[labels(index)])
    with pytest.raises(DatasetError, match=r"the labels \['#000000','#008040','#800000'\]"):
        load(root)
    scene = load(root, mask_labels=["#008040"])
    np.testing.assert_array_equal(scene.test[0].masks["foreground"], labels(0) == 2)


def test_a_region_that_is_nowhere_is_refused(root: Path) -> None:
    write_masks(root, "masks_mirror", lambda index: np.zeros((HEIGHT, WIDTH), np.uint8))
    with pytest.raises(DatasetError, match="region mirror has nothing inside in any of 10 masks"):
        load(root)


def test_a_region_that_vanishes_when_reduced_is_refused(root: Path) -> None:
    dot = np.where((X == 10) & (Y == 10), 255, 0).astype(np.uint8)
    write_masks(root, "masks_dot", lambda index: dot)
    assert load(root).test[0].masks["dot"].sum() == 1
    with pytest.raises(DatasetError, match=r"region dot is empty in every view.*dataset.downsample"):
        load(root, downsample=3)


def test_a_region_that_is_everything_is_noted(root: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    write_masks(root, "masks_all", lambda index: np.full((HEIGHT, WIDTH), 255, np.uint8))
    assert load(root).test[0].masks["all"].all()
    assert "region all is the whole picture in all of 10 masks" in caplog.text


def test_photographs_are_no_masks(root: Path) -> None:
    rng = np.random.default_rng(0)
    write_masks(root, "masks", lambda index: rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8))
    with pytest.raises(DatasetError, match="pictures, no masks"):
        load(root)


def test_reduced_copies_are_no_regions(root: Path) -> None:
    for folder, step in (("masks", 1), ("masks_2", 2), ("masks_4", 4), ("masks_tin", 1), ("masks_tin_2", 2)):
        write_masks(root, folder, lambda index, step=step: 255 * disk(index).astype(np.uint8)[::step, ::step])
    write_masks(root, "masks_tin_3", lambda index: 255 * disk(index).astype(np.uint8))  # a third tin
    assert set(load(root).test[0].masks) == {"foreground", "tin", "tin_3"}
    (root / "masks_2").rename(root / "away")
    (root / "masks_tin_3").rename(root / "masks_8")
    with pytest.raises(DatasetError, match=r"masks_8: is called as a copy of masks/ .* and is of its size"):
        load(root)
    (root / "masks").rename(root / "others")
    with pytest.raises(DatasetError, match="masks_4: is called as a reduced copy of masks/, which is not there"):
        load(root)
