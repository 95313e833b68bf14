"""Films: pictures one after the other, as a file that plays anywhere."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np
from PIL import Image

from .opened import Picture

MP4 = ".mp4"
ANIMATED = (".gif", ".webp")  # pictures that move, for pages that play no video
QUALITY = 18  # H.264's constant rate factor: artifacts that are hard to see; 0 is lossless, 51 the worst


def require_writable(path: Path) -> None:
    """Find out before anything is drawn whether a film can be written there.

    Raises:
        ValueError: another suffix than .mp4, .gif or .webp, or .mp4 without PyAV.
    """
    if path.suffix.lower() not in (MP4, *ANIMATED):
        raise ValueError(f"--out {path}: the film's format is its suffix, one of {', '.join((MP4, *ANIMATED))}")
    if path.suffix.lower() == MP4:
        try:
            import av  # noqa: F401
        except ImportError as error:
            raise ValueError(
                f"--out {path}: MP4 needs PyAV: pip install 'envgs-bench[video]'; .webp and .gif do without"
            ) from error


def write_film(path: Path, pictures: Iterable[Picture], fps: float) -> None:
    """Write the pictures, [H, W, 3] of one size, `fps` a second; the folder is made where missing.

    As MP4 they are H.264 with half the resolution in color, which every browser plays (BT.709, limited range), and get
    a black row or column where their height or width is odd. Nothing is left of a film that was interrupted.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        (_write_mp4 if path.suffix.lower() == MP4 else _write_animated)(part, pictures, fps)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _write_mp4(path: Path, pictures: Iterable[Picture], fps: float) -> None:
    import av
    from av.video.reformatter import ColorRange, Colorspace

    with av.open(str(path), "w", options={"movflags": "+faststart"}) as container:
        stream = container.add_stream("libx264", Fraction(fps).limit_denominator(1001), {"crf": str(QUALITY)})
        stream.pix_fmt = "yuv420p"
        started = False
        for picture in pictures:
            height, width = picture.shape[:2]
            even = np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)))
            if not started:
                stream.height, stream.width = even.shape[:2]
                stream.codec_context.colorspace = Colorspace.ITU709
                stream.codec_context.color_range = ColorRange.MPEG
                started = True
            frame = av.VideoFrame.from_ndarray(even, format="rgb24").reformat(
                format="yuv420p", dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG
            )
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def _write_animated(path: Path, pictures: Iterable[Picture], fps: float) -> None:
    first, *others = (Image.fromarray(picture) for picture in pictures)
    first.save(path, save_all=True, append_images=others, duration=1000 / fps, loop=0, quality=80)
