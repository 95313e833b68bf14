"""The Hydra application behind `envgs-bench run`: composes the jobs of a call, runs each, and sums them up."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import CompactHydraException, HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console

from envgs_bench.datasets import DatasetError
from envgs_bench.pages import FAILED, OF_ERRORS
from envgs_bench.plain_text import plain
from envgs_bench.runs.display import make_display
from envgs_bench.runs.interruption import INTERRUPTION
from envgs_bench.runs.output import unbreakable_output
from envgs_bench.settings import SettingsError
from envgs_bench.stages.stop import INTERRUPTED

from .checks import checked
from .composition import CONF, explain, register_choices, settings_of
from .explained import complain
from .live_page import end_page, renew_page
from .sweep_summary import (
    SWEEP_VARIABLE,
    Sweep,
    close_summary,
    enter,
    of_runs_dir,
    position,
    print_next,
    print_outcomes,
    runs_here,
    shown_runs_dir,
    stop_file,
    time_left,
    under_way,
)

if TYPE_CHECKING:  # with torch, which a composition is shown without
    from .plan import Plan

_plan: Plan | None = None  # of a dry run


def run(arguments: list[str], dry: bool = False) -> int:
    """Run the jobs that `arguments` (Hydra's: overrides, -m, --cfg …) describe; print what would run where `dry`.

    Returns:
        The exit code: 0 where every job has a run with status ok, 1 where one has not, 2 where nothing could be
        started because of the arguments, 130 after Ctrl-C or SIGTERM.
    """
    global _plan
    with unbreakable_output():
        if not dry:
            return _run(arguments)
        from .plan import Plan

        _plan = Plan()
        try:
            code = _run(
                [one for one in arguments if not one.startswith(("hydra/launcher=", "hydra.launcher.", "page="))]
            )
            if not code:
                _plan.print()
            return code
        finally:
            _plan = None


def _run(arguments: list[str]) -> int:
    try:
        register_choices(arguments)
        arguments = checked(arguments)
    except (CompactHydraException, HydraException, OmegaConfBaseException, DatasetError, SettingsError) as error:
        complain("run", explain(error), see=OF_ERRORS.get(type(error).__name__, FAILED))
        return 2
    program, sys.argv = sys.argv, ["envgs-bench run", *_flags_first(arguments)]
    variables = {name: os.environ.get(name) for name in ("HYDRA_FULL_ERROR", SWEEP_VARIABLE)}
    os.environ["HYDRA_FULL_ERROR"] = "1"  # errors come here, to be explained
    Sweep(os.getpid(), time.time()).announce()
    INTERRUPTION.reset()
    code = 0
    with INTERRUPTION.handled():
        try:
            _application()
        except (CompactHydraException, OmegaConfBaseException, SettingsError) as error:
            complain("run", explain(error), see=OF_ERRORS.get(type(error).__name__, FAILED))
            code = 2
        except OSError as error:
            complain("run", f"{error}; give a folder that can be written as runs_dir=" if of_runs_dir(error) else error)
            code = 2
        except KeyboardInterrupt:
            code = INTERRUPTED
        except Exception:
            if not INTERRUPTION.requested:
                raise
            code = INTERRUPTED  # of a launcher whose processes were ended
        finally:
            sys.argv = program
            for name, value in variables.items():
                _restore(name, value)
        if INTERRUPTION.requested:
            code = INTERRUPTED
        runs_dir, outcomes = shown_runs_dir(), close_summary()
        page = end_page(Path(runs_dir))
        if outcomes is None or _plan is not None:  # nothing was to run: --cfg and the like, or wrong arguments
            return code
        if outcomes:
            console = Console(width=None if sys.stdout.isatty() else 160)
            print_outcomes(outcomes, console)
            print_next(runs_dir, page)
        elif not code:
            complain("run", "no job reported back; `envgs-bench report` shows what is there")
        return code or int(not outcomes or not all(outcome.ok for outcome in outcomes))


@hydra.main(config_path=str(CONF), config_name="config", version_base="1.3")
def _application(config: DictConfig) -> None:
    _run_composed(config)  # a launcher's process gets a copy of this function, and of all that it names but functions


def _run_composed(config: DictConfig) -> None:
    """The job of this configuration: its run, its outcome in the summary."""
    from envgs_bench.runs.job import located, run_job

    from .choices import check_choices

    settings = settings_of(config, list(HydraConfig.get().overrides.task))
    check_choices(settings)
    alone = runs_here(DictConfig({"hydra": HydraConfig.get()}))
    if not alone:
        INTERRUPTION.follow(stop_file(), Sweep.current().pid)
        if INTERRUPTION.requested:
            return
    settings, folder = located(settings)
    if _plan is not None:
        _plan.add(settings, folder)
        return
    display = make_display(
        alone, position(OmegaConf.select(DictConfig({"hydra": HydraConfig.get()}), "hydra.job.num") or 0)
    )
    with unbreakable_output(), INTERRUPTION.held():
        outcome = run_job(settings, folder, display, INTERRUPTION)
        enter(outcome)
        print(plain(str(outcome)), file=sys.stderr)
        if left := time_left():
            print(left, file=sys.stderr)
        if outcome.action == "ran" or not under_way():
            renew_page(settings.runs_dir, under_way)


def _flags_first(arguments: list[str]) -> list[str]:
    """Overrides behind the flags: Hydra's parser takes overrides from one place only."""

    def is_override(argument: str) -> bool:
        return not argument.startswith("-") and ("=" in argument or argument.startswith("~"))

    return sorted(arguments, key=is_override)


def _restore(variable: str, value: str | None) -> None:
    if value is None:
        os.environ.pop(variable, None)
    else:
        os.environ[variable] = value
