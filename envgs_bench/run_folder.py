"""A run's folder: what lies where in it, and how its pictures are read. `stages/pictures.py` draws them."""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from .regular_file import require_regular

CONFIG_NAME = "config.yaml"  # the run's settings
LOG_NAME = "log.txt"  # what the run printed
RECORD_NAME = "record.json"  # what it was and how it ended
CURVE_NAME = "curve.csv"  # how its training went
CHECKPOINT = "checkpoint"  # the folder with what it learned
PICTURES = ("renders", "targets", "masks", "layers")  # the folders with its test views
REPLACEMENT = "replacement"  # the folder of a run that is done again, while the earlier result is still in place
SAMPLES_NAME = "fixed_rays.safetensors"  # what the finished model is along fixed rays
SNAPSHOT_NAME = "snapshot.safetensors"  # what an interrupted training goes on from
LOGGED = "logs"  # the folder of what a logger was told while it trained
PROGRAM = "program"  # the folder that another program reads from and writes into
OWN_NAMES = (
    *(RECORD_NAME, CONFIG_NAME, LOG_NAME, CURVE_NAME, SAMPLES_NAME, SNAPSHOT_NAME, CHECKPOINT, LOGGED, PROGRAM),
    *PICTURES,
)


PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
LONGEST_NAME = 200  # bytes of a view's name that is to begin a file's: file systems end a name at 255


class PictureError(ValueError):
    """A run's picture that is missing or cannot be decoded; the message names the file."""


def goes_on(run: Path) -> bool:
    """Whether the run, if it has not ended, left what it can go on from."""
    return (run / SNAPSHOT_NAME).is_file() or (run / PROGRAM).is_dir()


def render_path(run: Path, view: str) -> Path:
    """The test view as the method drew it."""
    return run / "renders" / f"{view}.png"


def target_path(run: Path, view: str) -> Path:
    """The photograph that the render is scored against."""
    return run / "targets" / f"{view}.png"


def exact_normal_path(run: Path, view: str) -> Path:
    """What the layer "normal" is compared with, where the data set knows it."""
    return run / "targets/normal" / f"{view}.png"


def mask_path(run: Path, view: str, region: str) -> Path:
    """The region's pixels in the view: white."""
    return run / "masks" / region / f"{view}.png"


def layer_path(run: Path, view: str, layer: str) -> Path:
    """What explains a render: one of the method's own layers, or normal, depth or error."""
    return run / "layers" / layer / f"{view}.png"


def layers_of(run: Path, view: str) -> dict[str, Path]:
    """The layers that the run left of the view, by name."""
    return {
        folder.name: path for folder in sorted((run / "layers").glob("*")) if (path := folder / f"{view}.png").exists()
    }


def is_file_name(view: str) -> bool:
    """Whether files can be called after the view: one that leads out of its folder, or is too long, names none."""
    return Path(view).name == view and len(view.encode(errors="replace")) <= LONGEST_NAME and "\0" not in view


def run_id_of(run: Path) -> str:
    """The run's identity, which is its folder's name."""
    return run.parent.name if run.name == REPLACEMENT else run.name


def clear(run: Path, keep: Collection[str] = ()) -> None:
    """Remove what a run wrote into its folder, but for `keep`; what is not its own stays, as do targets of links.

    Files that a killed process had half written go with it, of `keep` too: they lie beside their place as .<name>.<…>.
    """
    for half in (path for name in OWN_NAMES for path in run.glob(f".{name}.*")):
        half.unlink()
    for name in OWN_NAMES:
        path = run / name
        if name in keep:
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def replace(run: Path) -> None:
    """Put what lies in the run's REPLACEMENT in its place: the record last, so that whoever is killed can go on."""
    new = run / REPLACEMENT
    for name in sorted(OWN_NAMES, key=lambda name: name == RECORD_NAME):
        path, place = new / name, run / name
        if not path.exists():
            continue
        if place.is_dir() and not place.is_symlink():
            shutil.rmtree(place)
        os.replace(path, place)
    shutil.rmtree(new)


def has_renders(run: Path) -> bool:
    """Whether the run came as far as to draw test views."""
    return (run / "renders").is_dir()


def is_png(path: Path) -> bool:
    """Whether the file begins as a PNG does: a link in a run's folder may lead to any file of the reader's."""
    try:
        require_regular(path)
        with path.open("rb") as stream:
            return stream.read(len(PNG_SIGNATURE)) == PNG_SIGNATURE
    except OSError:
        return False


def read_png(path: Path) -> NDArray[np.uint8]:
    """[H, W, 3] bytes, sRGB; a gray picture three times the same.

    Raises:
        PictureError: it is missing, truncated, too large or no PNG.
    """
    try:
        require_regular(path)
        with Image.open(path, formats=["PNG"]) as image:
            return np.array(image.convert("RGB"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise PictureError(f"{path}: cannot be read ({error}); run its run again with force=true") from error


def read_png_if_any(path: Path) -> NDArray[np.uint8] | None:
    """As `read_png`; None where there is no readable picture."""
    try:
        return read_png(path)
    except PictureError:
        return None
