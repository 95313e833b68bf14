"""Checks before the first job: what can be known to be wrong with a call of `envgs-bench run`, said once."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf

from envgs_bench.settings import SettingsError

from .composition import CONF, SETTING, settings_of


def checked(arguments: list[str]) -> list[str]:
    """Hydra's arguments, with -m where they choose an experiment or a suite that is a sweep.

    Every choice of a sweep is composed once, beside the first of all others, and its input is looked at, so that what
    is wrong ends the call before it leaves a record. Arguments that ask Hydra for something else pass as they are.

    Raises:
        DatasetError, SettingsError, CompactHydraException, OmegaConfBaseException: a job of the call cannot be run.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("-m", "--multirun", action="store_true")
    parser.add_argument("-c", "--cfg")
    parser.add_argument("-cd", "--config-dir", type=Path)
    options, given = parser.parse_known_args(arguments)
    if options.cfg and options.multirun:
        raise SettingsError(
            "--cfg shows the configuration of one job and -m asks for many: leave -m out, "
            "or list the jobs of a sweep with --dry-run"
        )
    if options.cfg or any(argument.startswith("-") for argument in given):
        return arguments
    from .choices import check_page, check_run, tell_of_weights  # with torch, which a composition is shown without

    overrides = OverridesParser.create().parse_overrides(given)
    swept = [override for override in overrides if override.is_sweep_override()]
    if swept and not options.multirun:
        raise SettingsError(_several(swept[0]))
    search = [f"hydra.searchpath=[file://{options.config_dir.absolute()}]"] if options.config_dir else []
    composed = cache(lambda *lines: compose("config", [*lines], return_hydra_config=True))
    with initialize_config_dir(str(CONF), version_base="1.3"):
        axes = _axes(_parameters(overrides, search, composed), overrides)
        renamed = _with_new_settings(overrides, axes, search)
        arguments = [renamed.get(argument, argument) for argument in arguments]
        overrides = OverridesParser.create().parse_overrides([renamed.get(argument, argument) for argument in given])
        axes = _axes(_parameters(overrides, search, composed), overrides) if renamed else axes
        fixed = [*_fixed(overrides), *search]
        if axes and not options.multirun:
            print(f"{_chosen_sweep(overrides)} is a sweep: running all its jobs, as with -m", file=sys.stderr)
            arguments = ["-m", *arguments]
        for choices in _each_choice(axes):
            lines = [*fixed, *choices]
            config = composed(*lines)
            check_run(settings_of(_without_hydra(config), lines))
            if config.page:
                check_page(Path(config.page).expanduser())
    tell_of_weights()
    return arguments


def _parameters(overrides: list[Override], search: list[str], composed: Callable[..., DictConfig]) -> dict[str, str]:
    """What the chosen experiment takes in turn: key -> override."""
    lines = [*_fixed(one for one in overrides if SETTING not in str(one.key_or_group)), *search]
    found = composed(*lines).hydra.sweeper.get("params") or {}
    return {str(key): f"{key}={values}" for key, values in found.items()}


def _without_hydra(config: DictConfig) -> DictConfig:
    return OmegaConf.masked_copy(config, [str(key) for key in config if key != "hydra"])


def _axes(parameters: dict[str, str], overrides: list[Override]) -> dict[str, list[str]]:
    """What is taken in turn, on the command line or else in the experiment: key -> overrides, one a choice."""
    given = {override.get_key_element() for override in overrides}
    parser = OverridesParser.create()
    found = [parser.parse_override(line) for key, line in parameters.items() if key not in given]
    found += [override for override in overrides if override.is_sweep_override()]
    return {override.get_key_element(): _choices(override) for override in found}


def _with_new_settings(overrides: list[Override], axes: dict[str, list[str]], search: list[str]) -> dict[str, str]:
    """Overrides of settings that the YAML file of somebody's own method does not name -> what makes Hydra add them."""
    changes = {str(one.key_or_group): f"{one.input_line}" for one in overrides if one.type == OverrideType.CHANGE}
    own = {key: line for key, line in changes.items() if key.startswith(SETTING)}
    if not own:
        return {}
    firsts = [choices[0] for key, choices in axes.items() if choices and SETTING not in key]
    lines = [*_fixed(one for one in overrides if SETTING not in str(one.key_or_group)), *firsts, *search]
    known = {f"{SETTING}{key}" for key in compose("config", lines).method.get("settings") or {}}
    return {line: f"++{line}" for key, line in own.items() if key not in known}


def _fixed(overrides: Iterable[Override]) -> list[str]:
    """The overrides that say one thing."""
    return [f"{override.input_line}" for override in overrides if not override.is_sweep_override()]


def _choices(override: Override) -> list[str]:
    if not override.is_sweep_override():
        return [override.input_line or ""]
    try:
        return [f"{override.get_key_element()}={value}" for value in override.sweep_string_iterator()]
    except (HydraException, ValueError):  # a glob, which Hydra resolves later
        return []


def _each_choice(axes: dict[str, list[str]]) -> Iterator[list[str]]:
    """The first choices of all axes, then each other one of an axis beside the first of the others."""
    first = {key: choices[0] for key, choices in axes.items() if choices}
    yield list(first.values())
    for key, choices in axes.items():
        for choice in choices[1:] if key != "seed" else []:
            yield list({**first, key: choice}.values())


def _several(override: Override) -> str:
    line = f"{override.input_line}"
    key, _, value = line.partition("=")
    return f"{line} is several values: add -m to run each, or quote one value with a comma in it: '{key}=\"{value}\"'"


def _chosen_sweep(overrides: list[Override]) -> str:
    """What chose the sweep, as it was given: an experiment, a suite, or a configuration of somebody's own."""
    lines = (f"{one.input_line}" for one in overrides if one.get_key_element() in ("experiment", "suite"))
    return next(lines, "what is configured")
