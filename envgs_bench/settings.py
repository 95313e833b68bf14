"""RunSettings: everything that one run was told, after Hydra composed it."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator
from pydantic_core import ErrorDetails

from envgs_bench.records import RepairKind, ScoredOn

from .regular_file import read_regular_text
from .run_folder import CONFIG_NAME

MOST_BYTES = 1_000_000  # of a config.yaml; the settings of a run take a few thousand

# Keys of a method or a data set that name files; made absolute, so that a run does not depend on where it was started.
PATH_KEYS = ("root", "path")


LoggerKind = Literal["tensorboard", "wandb", "mlflow"]


class SettingsError(ValueError):
    """A setting that cannot be used; the message names the key, what was given and what was expected."""


class TimingSettings(BaseModel):
    """How long each view is timed: until either is reached, after one warm-up frame."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    frames: Annotated[int, Field(ge=1)]
    seconds: Annotated[float, Field(gt=0)]


class PerturbationChoice(BaseModel):
    """What is wrong with the run on purpose, and how severely; see `stages.perturbations`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: str
    severity: Annotated[int, Field(ge=0)]


class Gates(BaseModel):
    """What counts as survived, beside status ok: fixed before the runs and stored with each, for reports to judge by.

    All but the last two compare a perturbed run with its unperturbed partner of the same seed.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    psnr_drop_db: Annotated[float, Field(gt=0)]  # a larger drop, of the full image, is a collapse
    region_drop_db: Annotated[float, Field(gt=0)]  # as is a larger one inside the reflective region
    count_factor: Annotated[float, Field(gt=1)]  # more primitives at the peak than so many times are an explosion
    memory_factor: Annotated[float, Field(gt=1)]  # as is more memory at the peak
    time_factor: Annotated[float, Field(gt=1)]  # as is a longer training
    baseline: str  # the method that others have to be as good as, under the same perturbation and of the same seed
    behind_db: Annotated[float, Field(ge=0)]  # a method further behind it has lost its reason


class BudgetChoice(BaseModel):
    """The most that the model may have at any step, or take at the end, whichever the method; None: no such limit."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    primitives: Annotated[int, Field(ge=1)] | None = None
    mb: Annotated[float, Field(gt=0)] | None = None  # 10⁶ bytes as float32
    frame_ms: Annotated[float, Field(gt=0)] | None = None  # a picture's, as it is timed at the end


class LoggerChoice(BaseModel):
    """Who is told how a training goes, and how often; see `stages.training_log`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: LoggerKind
    every: Annotated[int, Field(ge=1)] = 500  # steps between pictures of fixed views, with the mean PSNR of these
    views: Annotated[int, Field(ge=1)] = 3  # pictures of so many


class MethodChoice(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str  # in records and reports: an ablation has its own
    kind: str  # what `create_method` makes: a registered name, or an import path "package.module:Class"
    settings: dict[str, Any] = {}

    @field_validator("settings", mode="after")
    @classmethod
    def _absolute(cls, node: dict[str, Any]) -> dict[str, Any]:
        return _with_absolute_paths(node)


CHOICES: dict[str, type[BaseModel]] = {
    choice.__name__: choice
    for choice in (TimingSettings, PerturbationChoice, Gates, BudgetChoice, LoggerChoice, MethodChoice)
}


class RunSettings(BaseModel):
    """One job, as composed; stored beside the record as config.yaml."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    method: MethodChoice
    score_on: ScoredOn = "test"  # the views that are drawn, scored and timed
    dataset: dict[str, Any]  # name, kind and the data source's own settings: what `load_scene` takes
    perturb: PerturbationChoice | None = None
    repair: tuple[RepairKind, ...] = ()  # of the scene, before the method starts; see `diagnosis.repair`
    budget: BudgetChoice | None = None
    gates: Gates | None = None  # None in runs from before there were any
    protocol: str
    seed: Annotated[int, Field(ge=0, lt=2**32)]
    steps: Annotated[int, Field(ge=1)]
    device: str  # auto, cpu, cuda, or one GPU of several, as cuda:1
    timing: TimingSettings
    timeout_minutes: Annotated[float, Field(gt=0)] | None
    memory_gb: Annotated[float, Field(gt=0)] | None = None
    device_memory_fraction: Annotated[float, Field(gt=0, le=1)] | None = None
    snapshot_minutes: Annotated[float, Field(ge=0)] = 5.0
    logger: LoggerChoice | None = None
    runs_dir: Path
    cache_dir: Path
    force: bool
    # Run again what ended so; failed stands for any status but ok.
    retry: Literal["failed", "diverged", "out_of_memory", "timeout"] | None = None
    overrides: list[str] = []  # what was given on the command line, for the record

    @field_validator("perturb", mode="after")
    @classmethod
    def _if_any(cls, choice: PerturbationChoice | None) -> PerturbationChoice | None:
        """None where nothing is perturbed: partners of all kinds are one run."""
        return None if choice is None or choice.kind == "none" or choice.severity == 0 else choice

    @field_validator("repair", mode="before")
    @classmethod
    def _kinds(cls, chosen: Any) -> Any:
        """A word, `none`, or a list of words; each once, in one order, so that equal choices are one run."""
        words = [chosen] if isinstance(chosen, str) else chosen
        if words is None or words == ["none"]:
            return ()
        known = get_args(RepairKind)
        if not isinstance(words, list | tuple) or not all(word in known for word in words):
            raise ValueError(f"Input should be 'none', or a list of {', '.join(known)}")
        return tuple(word for word in known if word in words)

    @field_validator("budget", mode="after")
    @classmethod
    def _if_limited(cls, choice: BudgetChoice | None) -> BudgetChoice | None:
        """None where nothing is limited: a run without a budget is one run, however that is said."""
        return None if choice == BudgetChoice() else choice

    @field_validator("runs_dir", mode="after")
    @classmethod
    def _absolute(cls, path: Path) -> Path:
        return _resolved(path)

    @field_validator("cache_dir", mode="before")
    @classmethod
    def _default_cache(cls, path: Any) -> Path:
        return _resolved(Path(path)) if path else default_cache_dir()

    @field_validator("dataset", mode="after")
    @classmethod
    def _with_kind(cls, node: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        if not isinstance(node.get("kind"), str):
            raise ValueError("needs a key `kind` that names the data source")
        if info.data.get("score_on") == "validation":
            node = {**node, "validation": True}
        return _with_absolute_paths(node)

    @field_validator("device", mode="after")
    @classmethod
    def _known(cls, device: str) -> str:
        if not re.fullmatch(r"auto|cpu|cuda(:\d+)?", device):
            raise ValueError("Input should be 'auto', 'cpu' or 'cuda', or one GPU of several, as 'cuda:1'")
        return device

    @property
    def method_name(self) -> str:
        return _slug(self.method.name)

    @property
    def dataset_name(self) -> str:
        """The configured name, which may have several parts (toy/chrome_room), or else that of the data's folder."""
        name = self.dataset.get("name") or Path(self.dataset.get("root") or self.dataset["kind"]).name
        return "/".join(_slug(part) for part in str(name).split("/"))


def parse_settings(content: Any) -> RunSettings:
    """The settings in `content`, a mapping as config.yaml holds it.

    Raises:
        SettingsError: a key is missing, unknown or of a wrong value; every such key is named.
    """
    try:
        return RunSettings.model_validate(content)
    except ValidationError as error:
        problems = [(".".join(map(str, item["loc"])), item) for item in error.errors()]
        lines = [f"{key}={item['input']!r}: {_expected(key, item)}" for key, item in problems]
        raise SettingsError("\n".join(lines)) from error


def _expected(key: str, problem: ErrorDetails) -> str:
    """What the key takes, in words."""
    name = problem.get("ctx", {}).get("class_name")
    if problem["type"] != "model_type" or name not in CHOICES:
        return problem["msg"].removeprefix("Value error, ")
    return f"expected its keys: {', '.join(f'{key}.{field}=' for field in CHOICES[name].model_fields)}"


def read_settings(folder: Path) -> RunSettings:
    """The settings that the run in `folder` was given.

    Raises:
        SettingsError: its config.yaml cannot be read, or holds something else.
    """
    path = folder / CONFIG_NAME
    try:
        content = yaml.load(read_regular_text(path, MOST_BYTES), _Loader)
        if isinstance(content, dict):
            content.pop("retry_failed", None)  # of runs from before there was `retry`
        return parse_settings(content)
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        raise SettingsError(f"{path}: cannot be read as YAML ({error}); run the job again") from error
    except ValueError as error:  # settings that are none, and dates that are no days
        raise SettingsError(f"{path}: {error}") from error


class _Loader(yaml.SafeLoader):
    """YAML without aliases, which a few lines can make gigabytes of; `yaml.safe_dump` writes none for settings."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.composer.ComposerError(None, None, "an alias, which no run writes", self.peek_event().start_mark)
        return super().compose_node(parent, index)


def default_cache_dir() -> Path:
    """$ENVGS_BENCH_CACHE, or else ~/.cache/envgs-bench."""
    return _resolved(Path(os.environ.get("ENVGS_BENCH_CACHE") or "~/.cache/envgs-bench"))


def _with_absolute_paths(node: dict[str, Any]) -> dict[str, Any]:
    paths = {key: str(_resolved(Path(node[key]))) for key in PATH_KEYS if isinstance(node.get(key), str)}
    return {**node, **paths}


def _resolved(path: Path) -> Path:
    return Path(os.path.abspath(path.expanduser()))


def _slug(name: str) -> str:
    """`name` as one folder's name: whatever is no letter, digit, dot, dash or underscore becomes a dash."""
    slug = "".join(character if character.isalnum() or character in "._-" else "-" for character in str(name))
    return slug.strip(".") or "unnamed"
