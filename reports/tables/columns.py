"""The columns of every table: which number, how it prints, and which direction is better."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Literal

from envgs_bench.parts import ENV, MetricCard

from ..numbers.cards import PLAIN
from ..numbers.decimals import decimal, rounded
from ..numbers.intervals import Interval


@dataclass(frozen=True)
class Column:
    metric: str  # as in table.csv
    region: str  # "full", or a masked one
    title: str
    places: int  # decimals printed, and compared when ranking
    better: Literal["higher", "lower"]
    axis: str  # its name on a chart's axis, with the unit
    explanation: str = ""
    ranked: bool = True
    scale: Decimal = Decimal(1)  # printed value = stored value × scale
    group: str = ""  # the heading above its own
    datasets: tuple[str, ...] = ()  # whose mean it is
    against: str = ""  # the method that is subtracted from each
    with_interval: bool = False  # printed with its interval, others with the spread over seeds
    elsewhere: bool = False  # the paper's alone: taken on another machine than ours

    @property
    def key(self) -> str:
        """Its name within a table."""
        name = self.metric if self.region == "full" else f"{self.metric}_{self.region}"
        name = f"{name} - {self.against}" if self.against else f"paper_{name}" if self.elsewhere else name
        return f"{self.group}: {name}" if self.group else name

    @property
    def heading(self) -> str:
        return f"{self.title} {'↑' if self.better == 'higher' else '↓'}" if self.ranked else self.title

    def printed(self, value: float | Decimal) -> Decimal:
        """The stored value in the column's unit and decimals."""
        return rounded(decimal(value) * self.scale, self.places)

    def signed(self, value: float | Decimal) -> str:
        """The printed number of a difference, with its sign."""
        return f"{self.printed(value):+}".replace("-", "−")

    def text(self, value: float | Decimal) -> str:
        """The printed number; a difference has its sign."""
        return f"{self.printed(value):+,}".replace("-", "−") if self.against else self.unsigned(value)

    def ends(self, interval: Interval) -> str:
        """An interval as it prints."""
        return f"[{self.text(interval.low)}, {self.text(interval.high)}]"

    def unsigned(self, value: float | Decimal) -> str:
        """The printed number without a sign, as of a spread."""
        return f"{self.printed(value):,}"


def over(datasets: Iterable[str], columns: Iterable[Column], group: str = "") -> tuple[Column, ...]:
    """The columns over these data sets, below a heading of their own."""
    return tuple(replace(column, datasets=tuple(datasets), group=group) for column in columns)


def score_column(name: str, card: MetricCard) -> Column:
    """The column of a metric, over the full image."""
    axis = f"{card.title}, {card.unit}" if card.unit else card.title
    column = Column(name, "full", card.title, card.places, card.better, axis, card.explanation)
    if not card.corrected:
        return column
    return replace(
        column,
        title=f"{card.title} cc",
        axis=f"{axis}, color-corrected",
        explanation=f"{card.explanation}, after one affine map of color a view",
    )


# Those that studies ask for by name.
SCORES = PSNR, SSIM, FLIP, LPIPS = tuple(score_column(name, card) for name, card in PLAIN.items())


def in_region(column: Column, region: str) -> Column:
    """The score inside one region."""
    name = region.replace("_", "-")
    return replace(column, region=region, title=f"{column.title} {name}", axis=f"{column.axis}, {name} region")


NORMALS = Column(
    "normal_degrees", "full", "normal error °", 1, "lower", "normal error, degrees", "mean angle to the exact normals"
)
FRAME_MS = Column("frame_ms", "full", "frame ms", 2, "lower", "frame time, ms", "mean over views of each view's median")
TRAIN_SECONDS = Column(
    "train_seconds", "full", "train s", 0, "lower", "training time, s", "training time without evaluation, s"
)
OWN_SECONDS = Column(
    "own_seconds",
    "full",
    "own train s",
    0,
    "lower",
    "training time by its own account, s",
    "what another program says of its training alone",
    ranked=False,
)
PRIMITIVES = Column(
    "primitives", "full", "primitives", 0, "lower", "primitives", "Gaussians of all sets together", ranked=False
)
ENV_PRIMITIVES = Column(
    f"primitives_{ENV}",
    "full",
    "environment primitives",
    0,
    "lower",
    "environment primitives",
    "of the primitives, those that only reflected rays meet",
    ranked=False,
)
AGREEMENT = Column(
    "agreement_db",
    "full",
    "agreement dB",
    1,
    "higher",
    "agreement, dB",
    "another program's pictures against the core's of its model",
    ranked=False,
)
MEGA = Decimal("1e-6")
MEGABYTES = Column(
    "model_bytes", "full", "memory MB", 1, "lower", "memory, MB", "the model as float32", ranked=False, scale=MEGA
)
FILE_MEGABYTES = Column(
    "compact_bytes", "full", "file MB", 2, "lower", "file, MB", "in the layout compact, lossy", ranked=False, scale=MEGA
)
CHECKPOINT_MEGABYTES = Column(
    "checkpoint_bytes", "full", "checkpoint MB", 1, "lower", "checkpoint, MB", "lossless", ranked=False, scale=MEGA
)
# those whose PSNR stands beside the full image's
REGIONS = ("covisible", "reflective", "near_field", "transmissive", "foreground")
# and those of views that nobody took
UNSEEN = tuple(
    replace(PSNR, region=place, title=f"PSNR {place}", axis=f"{PSNR.axis}, {place} cameras")
    for place in ("between", "beyond")
)
COSTS = (FRAME_MS, TRAIN_SECONDS, MEGABYTES, PRIMITIVES)  # the axes of the charts


def score_columns(metrics: Mapping[str, MetricCard]) -> tuple[Column, ...]:
    """The columns of the metrics that are taken of pictures as they are."""
    return tuple(score_column(name, card) for name, card in metrics.items() if not card.corrected)


def accuracy_columns(metrics: Mapping[str, MetricCard]) -> tuple[Column, ...]:
    """The columns that say how near pictures and normals are to the data."""
    corrected = (score_column(name, card) for name, card in metrics.items() if card.corrected)
    return (*score_columns(metrics), *corrected, *(in_region(PSNR, region) for region in REGIONS), *UNSEEN, NORMALS)


def main_columns(metrics: Mapping[str, MetricCard]) -> tuple[Column, ...]:
    """Everything that is known of a data set."""
    costs = (FRAME_MS, TRAIN_SECONDS, OWN_SECONDS, PRIMITIVES, ENV_PRIMITIVES, MEGABYTES, FILE_MEGABYTES)
    return (*accuracy_columns(metrics), *costs, AGREEMENT)


SPEED_COLUMNS = (
    PSNR,
    SSIM,
    LPIPS,
    FLIP,
    Column("fps", "full", "FPS", 1, "higher", "frames a second", "1000 / frame ms"),
    FRAME_MS,
    Column("frame_ms_p95", "full", "p95 ms", 2, "lower", "95th percentile, ms", "of all frames of all views"),
    Column("prepare_ms", "full", "prepare ms", 2, "lower", "preparation, ms", "acceleration structures, once a model"),
    TRAIN_SECONDS,
    Column("peak_primitives", "full", "peak primitives", 0, "lower", "peak primitives", "at any step", ranked=False),
    MEGABYTES,
    FILE_MEGABYTES,
    CHECKPOINT_MEGABYTES,
    Column(
        "peak_host_bytes",
        "full",
        "host MB",
        0,
        "lower",
        "host memory, MB",
        "peak of the training",
        ranked=False,
        scale=MEGA,
    ),
    Column(
        "peak_device_bytes",
        "full",
        "device MB",
        0,
        "lower",
        "device memory, MB",
        "peak of the training",
        ranked=False,
        scale=MEGA,
    ),
)
PAPER_SPEED = (
    Column("fps", "full", "paper FPS", 3, "higher", "frames a second", "on an RTX 4090", ranked=False, elsewhere=True),
    Column("train_hours", "full", "paper train h", 1, "lower", "hours", "on an RTX 4090", ranked=False, elsewhere=True),
)
