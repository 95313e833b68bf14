"""The Hydra application behind `envgs-bench run`: composes the jobs of a call, runs each, and sums them up."""

from __future__ import annotations

import os
import signal
import sys

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import CompactHydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console

from envgs_bench.metrics import get_protocol
from envgs_bench.runs.display import make_display
from envgs_bench.runs.job import run_job
from envgs_bench.settings import SettingsError
from envgs_bench.stages.perturbations import perturbation_of, perturbed_settings

from .composition import CONF, explain, register_methods, settings_of
from .ledger import close_ledger, enter, print_outcomes

INTERRUPTED = 130  # a shell's exit code for Ctrl-C


def run(arguments: list[str]) -> int:
    """Run the jobs that `arguments` (Hydra's: overrides, -m, --cfg …) describe.

    Returns:
        The exit code: 0 where every job has a run with status ok, 1 where one has not, 2 where nothing could be
        started because of the arguments, 130 after Ctrl-C or SIGTERM.
    """
    register_methods(arguments)
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
    perturbation_of(settings)  # refuses a kind or a severity that there is not,
    perturbed_settings(settings)  # and one that changes what the method does not have
    alone = HydraConfig.get().launcher._target_.endswith("BasicLauncher")
    outcome = run_job(settings, make_display(alone))
    enter(outcome)
    print(outcome, file=sys.stderr)
    if outcome.action == "ran" and outcome.status == "interrupted":
        raise KeyboardInterrupt  # no further job


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
