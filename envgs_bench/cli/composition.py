"""Composition: from the overrides of a command line to the settings of a run, by Hydra, with its errors explained."""

from __future__ import annotations

import dataclasses
import difflib
import sys
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.errors import MissingConfigException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, MissingMandatoryValue, OmegaConfBaseException

from envgs_bench.methods.registry import ENTRY_POINT_GROUP
from envgs_bench.settings import RunSettings, parse_settings

CONF = Path(__file__).parents[1] / "conf"


def config_names(group: str) -> list[str]:
    """The options of a configuration group, as they are written behind `<group>=`; files named _… are parts of them."""
    root = CONF / group
    files = (path for path in root.rglob("*.yaml") if not path.name.startswith("_"))
    return sorted(path.relative_to(root).with_suffix("").as_posix() for path in files)


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


def _keys(node: Any) -> list[str]:
    return sorted(str(key) for key in node if key != "hydra") if isinstance(node, DictConfig) else []


def _guess(name: str, options: list[str]) -> str:
    close = difflib.get_close_matches(name, options, n=1)
    return f". Did you mean {close[0]!r}?" if close else ""
