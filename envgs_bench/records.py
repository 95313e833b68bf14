"""record.json: what one run was and how it ended. The only interface between running and reporting."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AliasChoices, BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from .parts import MethodCard, MetricCard
from .regular_file import read_regular_text
from .run_folder import CONFIG_NAME, LOG_NAME, RECORD_NAME

SCHEMA_VERSION = 1
MOST_BYTES = 100_000_000  # of a record; thousands of views with their times take one of them
LARGEST = 1e18  # no measurement is larger, and sums and squares of such numbers are finite
RENDERS = "renders"  # the kind of a run that draws nothing itself
EXTERNAL = "external"  # the kind of a run in which another program trains and draws
ELSEWHERE = (RENDERS, EXTERNAL)  # the kinds whose pictures another program draws: no class of ours is behind them

Status = Literal["ok", "failed", "diverged", "out_of_memory", "timeout", "interrupted"]
ScoredOn = Literal["test", "validation"]
RepairKind = Literal["exposures", "poses", "normals"]  # what a run may repair of its scene; normals: mirrored ones
RepairName = Annotated[str, Field(pattern=r"^[a-z_]{1,40}$")]  # a RepairKind, or what an older record has in its place
Finite = Annotated[float, Field(allow_inf_nan=False, ge=-LARGEST, le=LARGEST)]
Count = Annotated[int, Field(ge=0, le=int(LARGEST))]
MetricName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,59}$")]  # a part of files' names
Scores = dict[str, Finite | None]  # metric -> value; None where it could not be computed


class RecordError(ValueError):
    """A record that cannot be read or written; the message names the file and what is wrong with it."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Failure(_Part):
    """Why a run has no status ok."""

    type: str  # the exception's class, or the signal's name
    message: str
    log_tail: str  # the last lines of log.txt

    def __str__(self) -> str:
        """The message, after the class that it is of: an interruption has none that tells a user anything."""
        return self.message if self.type == KeyboardInterrupt.__name__ else f"{self.type}: {self.message}"


class Perturbed(_Part):
    """In what the run differs from its unperturbed partner, whose `config` is the same but for this."""

    kind: str  # as in perturb.kind
    severity: Annotated[int, Field(ge=1, le=int(LARGEST))]
    level: str  # what this severity does, in words


WarningKind = Literal[
    "non_finite",  # a loss or gradient: the step was skipped
    "loss_climbs",
    "learns_nothing",  # the views in one color would be as good
    "alpha_vanishes",  # the pictures are mostly empty
    "beta_saturates",  # nearly all of the picture reflects
    "beta_vanishes",  # nothing reflects any more, after something did
    "set_shrinks",  # in one step: the base to less than a half, the environment to less than a tenth
    "set_doubles",  # to more than twice in one step
    "degenerate",  # a set's primitives run away along one axis
    "budget",  # of memory
    "size_limit",  # a set is as large as settings let it be
    "run_short",  # before any step: too few for its training views
    "near_hides",  # the near plane lies behind much of what the views show
    "views_sparse",  # of the scene, before any step: neighboring views are too far apart
    "views_noisy",
    "views_blurred",  # nothing fine is in them
    "views_blocky",  # blocks of JPEG
    "points_missing",  # the views show much where no point is
    "points_unsupported",  # the points have not the colors of what the views show there
    "exposures_differ",  # what the views show at the points is brighter in some, or of another tint
    "poses_off",  # most views agree with the points' colors only when turned
    "normals_mirrored",  # some views' agree with the others' only when mirrored
    "normals_disagree",  # two views' at the same point
]


OLDER_KINDS = {"needles": "degenerate", "capped": "size_limit"}


class TrainingWarning(_Part):
    """What was noticed while training that a healthy run does not show; one of a kind and part, the first."""

    kind: WarningKind
    step: int
    part: str  # the set or loss that it happened to, "" for the whole
    message: str  # what was seen, with numbers
    times: Annotated[int, Field(ge=1)] = 1  # how often, where it was noticed again

    @field_validator("kind", mode="before")
    @classmethod
    def _renamed(cls, kind: Any) -> Any:
        """Older records have other words for some kinds."""
        return OLDER_KINDS.get(kind, kind) if isinstance(kind, str) else kind


class RepairOutcome(_Part):
    """What became of a repair that the run asked for; see `envgs_bench.diagnosis`."""

    kind: RepairName
    kept: bool  # whether anything was changed
    message: str  # what was changed, or why nothing was
    measured: dict[str, Finite] = Field(  # the numbers that decided it; older records have another word
        default={}, validation_alias=AliasChoices("measured", "evidence")
    )


class WorldPlacement(_Part):
    """Where the world that the run's model is in lies in that of its data: data = shift + scale · world."""

    shift: tuple[Finite, Finite, Finite]
    scale: Annotated[Finite, Field(gt=0)]


class ProtocolName(_Part):
    name: str
    hash: str
    description: str


class ViewScores(BaseModel):
    """Scores of one view: its name, then one key a metric."""

    model_config = ConfigDict(extra="allow", frozen=True)
    __pydantic_extra__: Scores

    view: str

    @property
    def scores(self) -> Scores:
        return dict(self.__pydantic_extra__)


class Metrics(_Part):
    """Scores over the full images of the views in `Record.scored_on`; `mean` is unweighted over views."""

    mean: Scores
    per_view: list[ViewScores]
    not_computed: dict[str, str]  # metric -> why it is None
    cards: dict[MetricName, MetricCard] = {}  # of the protocol's metrics, in its order; older records have none
    weights: str | None = None  # where those of LPIPS's network come from


class MaskedScores(BaseModel):
    """Scores inside one region: one key a metric, unweighted over the views that show the region."""

    model_config = ConfigDict(extra="allow", frozen=True)
    __pydantic_extra__: Scores

    fraction: Finite  # the region's share of the pixels of those views
    per_view: list[ViewScores]

    @property
    def scores(self) -> Scores:
        return dict(self.__pydantic_extra__)


class ViewTimes(_Part):
    view: str
    times_ms: list[Finite]  # every timed frame


class Timing(_Part):
    """Frame time: the mean over views of each view's median. Comparable only on one device and at one size."""

    frame_ms: Finite
    frame_ms_p95: Finite
    fps: Finite  # 1000 / frame_ms
    prepare_ms: Finite  # once a model: acceleration structures
    height: Count
    width: Count
    per_view: list[ViewTimes]
    contract: str  # what was timed and how, in words


class Cost(_Part):
    primitives: dict[str, Count]  # set, one of parts.SETS -> count at the end
    bytes: dict[str, Count]  # set -> size of what rendering needs, as float32 in memory
    model_bytes: Count | None  # the sum of `bytes`: in memory, no file's; None of a program whose model is unknown
    checkpoint_bytes: Count | None = None  # files: what the run wrote of its model, lossless; None in older records
    compact_bytes: Count | None = None  # a file: the model in the layout compact, lossy; None where it has none
    train_seconds: Finite  # without evaluation
    peak_host_bytes: Count | None  # None of a program in a container
    peak_device_bytes: Count | None  # None on a CPU
    skipped_steps: Count | None  # steps whose loss or gradient was not finite; None of another program
    peak_primitives: Count | None  # the most of all sets together, at any step; None of another program


class ProgramRun(_Part):
    """Another program's run: what it was, what it says of itself, and what could not be measured of it."""

    page: str  # the program's own
    commit: str  # that the recipe was written for
    found: str | None = None  # the commit of the folder that it was run from
    licence: str
    tried: str  # what the recipe was really run on; "" where it was written from documentation
    commands: dict[str, list[str]]  # train and draw -> as they were started
    own_seconds: Finite | None = None  # of training, as it says itself
    draw_seconds: Finite | None = None  # of drawing the test views by the clock, start included
    agreement_db: Finite | None = None  # PSNR between its pictures and the shared core's of its model, mean over views
    agreement_per_view: dict[str, Finite] = {}
    not_measured: dict[str, str] = {}  # what of a record is None, or of another meaning -> why


class Provenance(BaseModel):
    """Who computed this, with what, on what."""

    model_config = ConfigDict(extra="allow", frozen=True)

    version: str
    commit: str | None
    dirty: bool | None
    python: str
    packages: dict[str, str]
    machine: dict[str, Any]
    device: dict[str, Any] | str
    threads: Count
    started: str  # ISO 8601, UTC
    finished: str
    command: str


class Record(_Part):
    """One run. Parts that a failed run did not reach are None; what it did compute is kept.

    A run of kind `RENDERS` scores what another program drew: it has no timing, no cost and 0 steps. One of kind
    `EXTERNAL` has no timing where the program's model is none that the core draws.
    """

    schema_version: Literal[1] = 1
    status: Status
    error: Failure | None
    method: str
    kind: str
    card: MethodCard | None = None  # of the kind; None where its class has none, and in older records
    dataset: str
    data: str | None = None  # a hash of the files that were read; None in older records, and where there are none
    placement: WorldPlacement | None = None  # None in older records, and where no data were loaded
    attributes: dict[MetricName, Finite] = {}  # of the scene, computed from its truth where that is known
    seed: Annotated[int, Field(ge=0, lt=2**32)]
    steps: Count
    run_id: str
    overrides: list[str]
    config: dict[str, Any]
    protocol: ProtocolName
    scored_on: ScoredOn = "test"  # which views' scores and times these are
    perturbation: Perturbed | None = None
    repair: tuple[RepairName, ...] = ()  # what the run asked for, of all its methods alike
    repairs: list[RepairOutcome] = []  # what became of it, in the order in which it was done
    warnings: list[TrainingWarning] = []  # in the order of their steps
    notes: list[str] = []  # what was noticed of the data, what the method made of its normals, what pilot runs found
    given: list[str] = []  # what the method used of the data besides photographs, poses and points
    losses: list[str] = []  # the terms that the loss was made of, in some step at least
    dropped_losses: dict[str, str] = {}  # a loss that the settings ask for -> why it could not be computed
    metrics: Metrics | None = None
    masked: dict[str, MaskedScores] = {}
    unseen: dict[MetricName, Metrics] = {}  # of views that nobody took, by how they lie to the training cameras
    timing: Timing | None = None
    cost: Cost | None = None
    program: ProgramRun | None = None  # of kind `EXTERNAL` alone
    provenance: Provenance

    @field_validator("config", mode="after")
    @classmethod
    def _with_parts(cls, config: dict[str, Any]) -> dict[str, Any]:
        """Reports look into these two."""
        for key in ("method", "dataset"):
            if key in config and not isinstance(config[key], dict):
                raise ValueError(f"{key} is no JSON object")
        return config

    @model_validator(mode="after")
    def _complete(self) -> Record:
        if self.status == "ok":
            needed = {RENDERS: ("metrics",), EXTERNAL: ("metrics", "cost", "program")}
            parts = needed.get(self.kind, ("metrics", "timing", "cost"))
            absent = [name for name in parts if getattr(self, name) is None]
            if absent:
                raise ValueError(f"status is ok but {', '.join(absent)} is null")
        elif self.error is None:
            raise ValueError(f"status is {self.status} but error is null")
        return self


def read_record(path: Path) -> Record:
    """The validated record at `path` (record.json itself or the run's folder).

    Raises:
        RecordError: unreadable, truncated, of an unknown schema version, or with missing or wrong keys.
    """
    path = path / RECORD_NAME if path.is_dir() else path
    try:
        text = read_regular_text(path, MOST_BYTES)
    except (OSError, UnicodeDecodeError) as error:
        raise RecordError(f"{path}: cannot be read: {error}") from error
    remedy = "Delete the file, or run the job again with force=true."
    try:
        content = json.loads(text)
    except json.JSONDecodeError as error:
        raise RecordError(f"{path}: not valid JSON (truncated?): {error}. {remedy}") from error
    except (ValueError, RecursionError) as error:  # an integer of thousands of digits, lists in lists in lists
        raise RecordError(f"{path}: not a record: {error}. {remedy}") from error
    if not isinstance(content, dict):
        raise RecordError(f"{path}: expected a JSON object, found {type(content).__name__}. {remedy}")
    version = content.get("schema_version")
    if version != SCHEMA_VERSION:
        raise RecordError(
            f"{path}: schema_version is {_shown(repr(version))}, this version of envgs-bench reads {SCHEMA_VERSION}. "
            "Read it with the version that wrote it, or run the job again with force=true."
        )
    try:
        return Record.model_validate_json(text)
    except ValidationError as error:
        raise RecordError(f"{path}: {_problems(error)}. {remedy}") from error


def write_record(folder: Path, content: Record) -> Path:
    """Write `content` as `<folder>/record.json`: validated, and complete or not there at all.

    Raises:
        RecordError: the content does not validate; nothing is written.
    """
    path = folder / RECORD_NAME
    text = content.model_dump_json(indent=1)
    try:
        Record.model_validate_json(text)
    except ValidationError as error:
        raise RecordError(f"{path}: not written: {_problems(error)}") from error
    write_atomically(path, text + "\n")
    return path


def find_runs(root: Path) -> list[Path]:
    """The folders of all runs under `root`, sorted: those with a record, and those whose run wrote none (yet).

    `root` may be one run's folder itself. Runs do not nest: nothing below a run's folder is taken for another run.

    Raises:
        RecordError: `root` is no folder.
    """
    if not root.is_dir():
        raise RecordError(f"{root}: no such folder; expected the runs_dir of an `envgs-bench run`")
    found = []
    for folder, children, files in os.walk(root):
        if RECORD_NAME in files or (CONFIG_NAME in files and LOG_NAME in files):
            found.append(Path(folder))
            children.clear()
    return sorted(found)


def find_records(root: Path) -> list[Path]:
    """The record.json of every run under `root` that has one, sorted. Raises RecordError as `find_runs`."""
    return [folder / RECORD_NAME for folder in find_runs(root) if (folder / RECORD_NAME).is_file()]


def write_atomically(path: Path, text: str) -> None:
    """Write to a temporary file beside `path`, then rename: a reader sees the old file or the new one, never half."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise


def _problems(error: ValidationError, most: int = 5) -> str:
    problems = [f"{_shown('.'.join(map(str, item['loc'])) or 'record')}: {item['msg']}" for item in error.errors()]
    more = f" and {len(problems) - most} more" if len(problems) > most else ""
    return "; ".join(problems[:most]) + more


def _shown(text: str, most: int = 100) -> str:
    """Text of a file for a message: short, and nothing that a terminal would obey."""
    plain = "".join(character if character.isprintable() else "?" for character in text[:most])
    return plain + ("…" if len(text) > most else "")
