"""Resolution: how many pixels are drawn while a camera moves, and how they become all of them once it stands still."""

from __future__ import annotations

MOVING_SECONDS = 0.1  # a frame's while the camera moves
LEAST_PIXELS = 4_000  # 73×55: less shows nothing
MOST_SHRUNK = 8  # times, along an edge
SMOOTHING = 0.5  # how much the last frame's time counts

Size = tuple[int, int]  # width, height, pixels


class Resolution:
    """Learns what a pixel costs from the frames that were drawn.

    While the camera moves, frames have as many pixels as take MOVING_SECONDS. Once it stands still each frame has twice
    the width and height of the one before, until nothing is missing: whoever moves on waits for one of them at most.
    """

    def __init__(self) -> None:
        self._seconds_a_pixel: float | None = None

    def drew(self, size: Size, seconds: float) -> None:
        """A frame of that size took so long."""
        now = seconds / (size[0] * size[1])
        before = self._seconds_a_pixel
        self._seconds_a_pixel = now if before is None else SMOOTHING * now + (1 - SMOOTHING) * before

    def moving(self, full: Size) -> Size:
        """The size of a frame while the camera moves; a small one as long as nothing is known."""
        pixels = full[0] * full[1]
        affordable = MOVING_SECONDS / self._seconds_a_pixel if self._seconds_a_pixel else 0.0
        share = min(1.0, max(affordable, LEAST_PIXELS) / pixels)
        return _scaled(full, max(share**0.5, 1 / MOST_SHRUNK))

    @staticmethod
    def still(full: Size, shown: Size) -> Size | None:
        """The size of the frame after one of size `shown`, while the camera stands still; None: that was the last."""
        return None if shown == full else _scaled(full, min(1.0, 2 * shown[0] / full[0]))


def _scaled(size: Size, factor: float) -> Size:
    return max(1, round(factor * size[0])), max(1, round(factor * size[1]))
