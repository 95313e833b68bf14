"""The Hydra application behind `envgs-bench run`: composes the jobs of a call, runs each, and sums them up."""

from __future__ import annotations

import dataclasses
import difflib
import os
import signal
import sys
from importlib.metadata import entry_points
from typing import Any

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from hydra.errors import CompactHydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, MissingMandatoryValue, OmegaConfBaseException
from rich.console import Console

from .display import make_display
from .job import run_job
from .listing import CONF, config_names
from .methods.registry import ENTRY_POINT_GROUP
from .metrics import get_protocol
from .outcomes import close_ledger, enter, print_outcomes
from .settings import RunSettings, SettingsError, parse_settings

INTERRUPTED = 130  # a shell's exit code for Ctrl-C


def run(arguments: list[str]) -> int:
    """Run the jobs that `arguments` (Hydra's: overrides, -m, --cfg …) describe.

    Returns:
        The exit code: 0 where every job has a run with status ok, 1 where one has not, 2 where nothing could be
        started because of the arguments, 130 after Ctrl-C or SIGTERM.
    """
    register_methods()
    program, sys.argv = sys.argv, ["envgs-bench run", *_flags_first(arguments)]
    full_error = os.environ.get("HYDRA_FULL_ERROR")
    os.environ["HYDRA_FULL_ERROR"] = "1"  # errors come here, to be explained
    code = 0
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)  # `timeout` ends a sweep as Ctrl-C does
    try:
        _application()
    except (CompactHydraException, OmegaConfBaseException, SettingsError) as error:
        print(f"envgs-bench run: {explain(error)}", file=sys.stderr)
        code = 2
    except OSError as error:
        print(f"envgs-bench run: {error}; give a folder that can be written as runs_dir=", file=sys.stderr)
        code = 2
    except KeyboardInterrupt:
        code = INTERRUPTED
    finally:
        signal.signal(signal.SIGTERM, before)
        sys.argv = program
        _restore("HYDRA_FULL_ERROR", full_error)
    outcomes = close_ledger()
    if outcomes is None:  # nothing was to run: --cfg and the like, or wrong arguments
        return code
    if outcomes:
        print_outcomes(outcomes, Console(width=None if sys.stdout.isatty() else 160))
    elif not code:
        print("envgs-bench run: no job reported back; `envgs-bench report` shows what is there", file=sys.stderr)
    return code or int(not outcomes or not all(outcome.ok for outcome in outcomes))


@hydra.main(config_path=str(CONF), config_name="config", version_base="1.3")
def _application(config: DictConfig) -> None:
    settings = settings_of(config, list(HydraConfig.get().overrides.task))
    try:
        get_protocol(settings.protocol)
    except ValueError as error:
        raise SettingsError(f"protocol={settings.protocol}: {error}") from error
    alone = HydraConfig.get().launcher._target_.endswith("BasicLauncher")
    outcome = run_job(settings, make_display(alone))
    enter(outcome)
    print(outcome, file=sys.stderr)
    if outcome.action == "ran" and outcome.status == "interrupted":
        raise KeyboardInterrupt  # no further job


def settings_of(config: DictConfig, overrides: list[str]) -> RunSettings:
    """The settings of a composed configuration.

    Raises:
        SettingsError, OmegaConfBaseException: a key is missing, unknown or of a wrong value.
    """
    content: Any = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    for shorthand in ("data_root", "path"):  # they have done their work, in dataset.root and method.settings.path
        content.pop(shorthand, None)
    return parse_settings({**content, "overrides": overrides})


def register_methods() -> None:
    """Offer the methods of installed packages (entry points) as method=<name>, with their settings' defaults."""
    store = ConfigStore.instance()
    for point in entry_points(group=ENTRY_POINT_GROUP):
        try:
            defaults = dataclasses.asdict(point.load().Settings())
        except Exception as error:
            print(f"method {point.name} of {point.value} cannot be loaded: {error}", file=sys.stderr)
            continue
        store.store(
            group="method", name=point.name, node={"name": point.name, "kind": point.name, "settings": defaults}
        )


def explain(error: Exception) -> str:
    """What the user gave, what was expected, and what to do, of an error in composing the configuration."""
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        group, _, name = str(error.missing_cfg_file).rpartition("/")
        options = sorted({*(error.options or []), *config_names(group)})
        if options:
            return f"there is no {group} {name!r}; {group} is one of {', '.join(options)}{_guess(name, options)}"
        return f"there is no configuration {error.missing_cfg_file!r}; `envgs-bench list` shows what there is"
    if isinstance(error, OverrideParseException):
        return f"cannot read the override {error.override!r}, expected KEY=VALUE: {error.message}"
    cause = error.__cause__ if isinstance(error.__cause__, OmegaConfBaseException) else error
    if isinstance(cause, MissingMandatoryValue):
        return f"{cause.full_key} is missing: give it as {cause.full_key}=VALUE"
    if isinstance(cause, ConfigAttributeError | ConfigKeyError) and cause.full_key:
        known = _keys(cause.parent_node)
        owner = cause.full_key.rpartition(".")[0] or "a run"
        name = cause.full_key.rpartition(".")[2]
        return f"unknown key {cause.full_key!r}; {owner} has {', '.join(known)}{_guess(name, known)}"
    return str(error) if cause is error else f"{error}\n{cause}"


def _flags_first(arguments: list[str]) -> list[str]:
    """Overrides behind the flags: Hydra's parser takes overrides from one place only."""

    def is_override(argument: str) -> bool:
        return not argument.startswith("-") and ("=" in argument or argument.startswith("~"))

    return sorted(arguments, key=is_override)


def _keys(node: Any) -> list[str]:
    return sorted(str(key) for key in node if key != "hydra") if isinstance(node, DictConfig) else []


def _guess(name: str, options: list[str]) -> str:
    close = difflib.get_close_matches(name, options, n=1)
    return f". Did you mean {close[0]!r}?" if close else ""


def _restore(variable: str, value: str | None) -> None:
    if value is None:
        os.environ.pop(variable, None)
    else:
        os.environ[variable] = value
