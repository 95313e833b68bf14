"""Prepared sweeps as `envgs-bench run -m experiment=<name>` reads them, each composed once, as it takes a while."""

from __future__ import annotations

from functools import cache

from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig

from envgs_bench.cli.composition import CONF, register_choices, settings_of
from envgs_bench.settings import RunSettings


@cache
def swept(experiment: str, *overrides: str) -> dict[str, list[str]]:
    """What the experiment takes in turn, by key, with overrides as suite=toys."""
    parameters = _config(f"experiment={experiment}", *overrides, with_hydra=True).hydra.sweeper.params
    parser = OverridesParser.create()
    overrides = {key: parser.parse_override(f"{key}={values}") for key, values in parameters.items()}
    return {
        key: list(override.sweep_string_iterator()) if override.is_sweep_override() else [str(parameters[key])]
        for key, override in overrides.items()
    }


@cache
def one_run(experiment: str, **choices: str) -> RunSettings:
    """The settings of a run of the experiment, with a choice by key, its dots written __."""
    overrides = [f"experiment={experiment}", *(f"{key.replace('__', '.')}={value}" for key, value in choices.items())]
    return settings_of(_config(*overrides), overrides)


def _config(*overrides: str, with_hydra: bool = False) -> DictConfig:
    register_choices()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose("config", list(overrides), return_hydra_config=with_hydra)
