"""Pictures of every kind that cameras and programs leave: what they hold, which way up, and at another size."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from captures import HEIGHT, NAMES_OF_TEN, WIDTH, gradient, write_capture
from PIL import ExifTags, Image
from scipy import ndimage
from skimage.transform import resize_local_mean

from envgs_bench.core import View
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.formats.pictures import read_header, read_picture
from envgs_bench.datasets.photographs.resampling import resample
from envgs_bench.datasets.photographs.undistortion import undistort, undistorted_camera

BLACK = (0.0, 0.0, 0.0)


def save(path: Path, pixels: np.ndarray, mode: str | None = None, **options: object) -> Path:
    image = Image.fromarray(pixels)
    (image.convert(mode) if mode else image).save(path, **options)
    return path


def pixels_of(path: Path) -> np.ndarray:
    return read_picture(path, BLACK)[0]


def test_palettes_with_and_without_transparency(tmp_path: Path) -> None:
    flat = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    flat[:, 20:] = [204, 0, 51]  # a color of the web palette, which Pillow takes
    path = save(tmp_path / "p.png", flat, "P")
    assert Image.open(path).mode == "P"
    np.testing.assert_array_equal(pixels_of(path), flat)
    palette = Image.fromarray((flat[..., 0] > 0).astype(np.uint8), mode="P")
    palette.putpalette([1, 2, 3, 200, 10, 60])
    palette.save(tmp_path / "t.png", transparency=0)
    picture, opaque = read_picture(tmp_path / "t.png", (1.0, 0.0, 0.2))
    assert opaque is not None
    np.testing.assert_array_equal(opaque, flat[..., 0] > 0)
    np.testing.assert_array_equal(picture[0, 0], [255, 0, 51])
    np.testing.assert_array_equal(picture[0, 30], [200, 10, 60])


@pytest.mark.parametrize("ending", ["png", "tiff"])
def test_sixteen_bits_of_gray_are_rounded_to_eight(tmp_path: Path, ending: str) -> None:
    values = np.arange(HEIGHT * WIDTH, dtype=np.uint16).reshape(HEIGHT, WIDTH) * 21
    picture = pixels_of(save(tmp_path / f"g.{ending}", values))
    np.testing.assert_array_equal(picture, np.round(values / 65535 * 255)[..., None].repeat(3, axis=-1))


def test_sixteen_bits_of_color(tmp_path: Path) -> None:
    """Written byte by byte after the PNG specification, since Pillow writes none."""
    import struct
    import zlib

    values = (gradient().astype(np.uint16) * 257).astype(">u2")
    lines = b"".join(b"\0" + row.tobytes() for row in values)

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    header = struct.pack(">IIBBBBB", WIDTH, HEIGHT, 16, 2, 0, 0, 0)
    parts = [chunk(b"IHDR", header), chunk(b"IDAT", zlib.compress(lines)), chunk(b"IEND", b"")]
    (tmp_path / "c.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))
    np.testing.assert_array_equal(pixels_of(tmp_path / "c.png"), gradient())


def cmyk(path: Path) -> None:
    Image.fromarray(gradient()).convert("CMYK").save(path)


def cut_short(path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    Image.fromarray(noise).save(path)
    path.write_bytes(path.read_bytes()[:2000])


def floats(path: Path) -> None:
    Image.fromarray(gradient()[..., 0].astype(np.float32)).save(path, format="TIFF")


def many_bits(path: Path) -> None:
    Image.fromarray(gradient()[..., 0].astype(np.int32) * 100_000).save(path, format="TIFF")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (cmyk, "is CMYK, .*convert it to sRGB"),
        (cut_short, r"cannot be decoded \(.*truncated.*\); replace it"),
        (lambda path: path.write_bytes(b""), "cannot be decoded"),
        (floats, "has pixels of mode F, expected 8 or 16 bits"),
        (many_bits, "has values from 200000 to 25300000, expected 8 or 16 bits"),
    ],
)
def test_pictures_that_cannot_be_used_are_named(tmp_path: Path, spoil: Callable[[Path], None], message: str) -> None:
    root = write_capture(tmp_path / "bench", [name.replace(".png", ".jpg") for name in NAMES_OF_TEN])
    spoil(root / "images/003.jpg")
    with pytest.raises(DatasetError, match=rf"images/003\.jpg: {message}"):
        load_scene({"kind": "colmap", "root": str(root)}, tmp_path / "cache")


def with_orientation(path: Path, pixels: np.ndarray, orientation: int) -> Path:
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    return save(path, pixels, exif=exif)


def view_of(root: Path) -> View:
    return load_scene({"kind": "colmap", "root": str(root)}, root.parent / "cache").train[0]


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_pixels_are_taken_as_they_lie_in_the_file_as_colmap_takes_them(tmp_path: Path, orientation: int) -> None:
    root = write_capture(tmp_path / "bench", NAMES_OF_TEN)
    for name in NAMES_OF_TEN:
        path = with_orientation(root / "images" / name, gradient(), orientation)
    np.testing.assert_array_equal(pycolmap.Bitmap.read(str(path), as_rgb=True).to_array(), gradient())
    np.testing.assert_array_equal(view_of(root).image, gradient())


@pytest.mark.parametrize(("orientation", "turns"), [(6, 1), (8, -1)])
def test_pixels_are_turned_where_only_that_fits_the_camera(tmp_path: Path, orientation: int, turns: int) -> None:
    """A program that does apply orientations made the model: its camera has the turned picture's size."""
    root = write_capture(tmp_path / "bench", NAMES_OF_TEN)
    for name in NAMES_OF_TEN:
        path = with_orientation(root / "images" / name, np.rot90(gradient(), turns), orientation)
    header = read_header(path)
    assert (header.width, header.height, header.turned) == (HEIGHT, WIDTH, True)
    np.testing.assert_array_equal(view_of(root).image, gradient())


def test_resampling_is_the_area_mean() -> None:
    """Against the mean over every pixel cut into equal parts."""
    picture = np.random.default_rng(0).uniform(0, 255, (12, 10, 2)).astype(np.float32)
    for width, height in ((5, 6), (7, 5), (10, 12), (15, 16)):
        parts = picture.repeat(height, axis=0).repeat(width, axis=1)
        expected = parts.reshape(height, 12, width, 10, 2).mean(axis=(1, 3))
        np.testing.assert_allclose(resample(picture, width, height), expected, rtol=1e-5)


def test_resampling_is_scikit_image_s_local_mean() -> None:
    picture = np.random.default_rng(1).integers(0, 256, (91, 67, 3)).astype(np.uint8)
    for width, height in ((17, 23), (50, 40), (67, 30)):
        expected = resize_local_mean(picture.astype(np.float64), (height, width), preserve_range=True, channel_axis=-1)
        np.testing.assert_allclose(resample(picture, width, height), expected, atol=1e-4)


@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("OPENCV", [60, 62, 30.5, 25, 0.06, -0.03, 0.002, -0.001]),
        ("OPENCV_FISHEYE", [60, 62, 30.5, 25, 0.02, 0.01, 0, 0]),
    ],
)
def test_undistortion_gives_colmap_s_pictures(model: str, params: list[float]) -> None:
    noise = np.random.default_rng(0).uniform(0, 255, (HEIGHT, WIDTH, 3))
    picture = np.round(ndimage.gaussian_filter(noise, (2, 2, 0)) * 4 - 382).clip(0, 255).astype(np.uint8)
    camera = pycolmap.Camera(model=model, width=WIDTH, height=HEIGHT, params=params)
    theirs, pinhole = pycolmap.undistort_image(
        pycolmap.UndistortCameraOptions(), pycolmap.Bitmap.from_array(picture), camera
    )
    np.testing.assert_allclose(undistorted_camera(camera).params, pinhole.params)
    np.testing.assert_allclose(undistort(picture, camera), theirs.to_array(), atol=0.51)


def test_a_panorama_is_refused(tmp_path: Path) -> None:
    root = write_capture(tmp_path / "bench", NAMES_OF_TEN, "EQUIRECTANGULAR 64 48 64 48")
    with pytest.raises(DatasetError, match=r"000\.png: a camera of model EQUIRECTANGULAR cannot be undistorted"):
        view_of(root)
