"""The columns of every table: which number, how it prints, and which direction is better."""

from __future__ import annotations

from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Literal

from .decimals import decimal, rounded


@dataclass(frozen=True)
class Column:
    metric: str  # as in table.csv
    region: str
    title: str
    places: int  # decimals printed, and compared when ranking
    better: Literal["higher", "lower"]
    axis: str  # its name on a chart's axis, with the unit
    explanation: str = ""
    ranked: bool = True
    scale: Decimal = Decimal(1)  # printed value = stored value × scale

    @property
    def key(self) -> str:
        return self.metric if self.region == "full" else f"{self.metric}_{self.region}"

    @property
    def arrow(self) -> str:
        return "↑" if self.better == "higher" else "↓"

    def printed(self, value: float | Decimal) -> Decimal:
        """The stored value in the column's unit and decimals."""
        return rounded(decimal(value) * self.scale, self.places)

    def text(self, value: float | Decimal) -> str:
        return f"{self.printed(value):,}"


MAIN_COLUMNS = (
    Column("psnr", "full", "PSNR", 2, "higher", "PSNR, dB", "peak signal-to-noise ratio, dB"),
    Column("ssim", "full", "SSIM", 3, "higher", "SSIM", "structural similarity"),
    Column("flip", "full", "FLIP", 3, "lower", "FLIP", "perceived difference, FLIP"),
    Column("lpips", "full", "LPIPS", 3, "lower", "LPIPS", "learned perceptual distance"),
    Column("psnr", "reflective", "PSNR reflective", 2, "higher", "PSNR of the reflective region, dB"),
    Column("psnr", "near_field", "PSNR near-field", 2, "higher", "PSNR of near-field reflections, dB"),
    Column("psnr", "foreground", "PSNR foreground", 2, "higher", "PSNR of the foreground, dB"),
    Column(
        "normal_degrees", "full", "normal °", 1, "lower", "normal error, degrees", "mean angle to the exact normals"
    ),
    Column("frame_ms", "full", "frame ms", 2, "lower", "frame time, ms", "mean over test views of each view's median"),
    Column("train_seconds", "full", "train s", 0, "lower", "training time, s", "training time without evaluation, s"),
    Column(
        "primitives", "full", "primitives", 0, "lower", "primitives", "Gaussians of all sets together", ranked=False
    ),
    Column(
        "primitives_env", "full", "of them env", 0, "lower", "env primitives", "those that only reflect", ranked=False
    ),
    Column("model_bytes", "full", "MB", 1, "lower", "model size, MB", "10⁶ bytes", ranked=False, scale=Decimal("1e-6")),
)
SCORES = ("psnr", "ssim", "flip", "lpips")
SUMMARY_COLUMNS = tuple(c for c in MAIN_COLUMNS if c.metric in SCORES and c.region == "full")
COST_COLUMNS = tuple(c for c in MAIN_COLUMNS if c.metric in ("frame_ms", "train_seconds", "model_bytes"))
COST_KEYS = ("frame_ms", "train_seconds", "primitives", "primitives_env", "model_bytes")


def region_columns(region: str) -> tuple[Column, ...]:
    """The full image's scores, inside one region."""
    name = region.replace("_", "-")
    return tuple(
        replace(column, region=region, title=f"{column.title} {name}", axis=f"{column.axis}, {name} region")
        for column in SUMMARY_COLUMNS
    )
