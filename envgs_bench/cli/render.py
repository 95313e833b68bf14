"""`envgs-bench render`: a film of a trained run along a camera path, its layers side by side."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from .explained import explained

SECONDS = 6.0


def main(arguments: Sequence[str]) -> int:
    """Write the film; the exit status."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench render",
        description="A film of a trained run along a camera path.",
        allow_abbrev=False,
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="one run's folder, with its checkpoint")
    parser.add_argument(
        "--path",
        default="orbit",
        metavar="PATH",
        help="orbit (the default): around what the cameras look at; spiral: about the first test camera; interpolate: "
        "from test camera to test camera; or a file of cameras, nerfstudio's, a transforms.json, 3DGS's cameras.json "
        "or a .chan of Blender's",
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="the film: an .mp4, .webp or .gif")
    parser.add_argument("--cameras", type=Path, metavar="FILE", help="write the path's cameras too, a .json or .chan")
    parser.add_argument(
        "--format",
        default="transforms",
        choices=["transforms", "nerfstudio", "supersplat", "blender"],
        help="of --cameras (default transforms)",
    )
    parser.add_argument(
        "--layers",
        type=lambda text: text.split(","),
        default=["image"],
        metavar="NAMES",
        help="what is shown side by side: image,base,reflection,beta,normal,depth, as far as the method draws it",
    )
    parser.add_argument("--size", type=_size, metavar="WxH", help="pixels of a layer; by default as the test views")
    parser.add_argument("--fps", type=_positive, default=30.0, metavar="N", help="frames a second (default 30)")
    parser.add_argument(
        "--seconds",
        type=_positive,
        metavar="S",
        help=f"how long the film is (default {SECONDS:g}; of a file's cameras: each is a frame)",
    )
    parser.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"])
    options = parser.parse_args(arguments)
    if options.out is None and options.cameras is None:
        parser.error("nothing to write: give --out FILE for a film, --cameras FILE for its path, or both")
    return explained("render", lambda: _render(options), options.out)


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and 0 < int(width) <= 16384 and 0 < int(height) <= 16384):
        raise argparse.ArgumentTypeError(f"{text!r} is no size, expected WIDTHxHEIGHT in pixels, as 640x480")
    return int(width), int(height)


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r}: expected a number above 0")
    return value


def _render(options: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.progress import track

    from envgs_bench.viewing.camera_paths import PATHS
    from envgs_bench.viewing.films import require_writable, write_film
    from envgs_bench.viewing.opened import open_run
    from envgs_bench.viewing.path_writing import write_path
    from envgs_bench.viewing.walk import cameras_along, walk

    if options.out is not None:
        require_writable(options.out)
    run = open_run(options.run, options.device)
    seconds = options.seconds or (SECONDS if options.path in PATHS else None)
    frames = None if seconds is None else max(1, round(options.fps * seconds))
    cameras = cameras_along(run, options.path, frames, options.size)
    if options.cameras is not None:
        write_path(options.cameras, cameras, run.scene.placement, options.format, options.fps)
        print(f"{options.cameras}: {len(cameras)} cameras as {options.format}")
    if options.out is None:
        return 0
    times = []

    def pictures():
        walked = walk(run, cameras, options.layers)
        for frame in track(walked, "drawing", len(cameras), console=Console(stderr=True), transient=True):
            times.append(frame.milliseconds)
            yield frame.picture

    write_film(options.out, pictures(), options.fps)
    camera = cameras[0]
    print(
        f"{options.out}: {len(cameras)} frames, {len(cameras) / options.fps:.1f} s, "
        f"of {camera.width}×{camera.height} pixels a layer; {sum(times) / len(times):.1f} ms to draw one"
    )
    return 0
