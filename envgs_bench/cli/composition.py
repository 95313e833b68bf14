"""Composition: from the overrides of a command line to the settings of a run, by Hydra, with its errors explained."""

from __future__ import annotations

import dataclasses
import difflib
import shlex
import sys
from collections.abc import Collection, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, get_args

import yaml
from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.errors import CompactHydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    MissingMandatoryValue,
    OmegaConfBaseException,
    ValidationError,
)

from envgs_bench.datasets.registry import BUILT_IN as DATASET_KINDS
from envgs_bench.datasets.registry import default_settings as default_dataset_settings
from envgs_bench.datasets.toy.settings import PRESETS
from envgs_bench.methods.registry import method_names, method_paths, settings_type
from envgs_bench.methods.settings import RunGroup, make_settings
from envgs_bench.programs.recipe import RecipeError, parse_choice, read_recipe
from envgs_bench.records import EXTERNAL
from envgs_bench.settings import LoggerChoice, LoggerKind, MethodChoice, RunSettings, SettingsError, parse_settings

CONF = Path(__file__).parents[1] / "conf"
LOGGERS = get_args(LoggerKind)
SETTING = "method.settings."  # what the key of a method's setting begins with


def config_names(group: str) -> list[str]:
    """The options of a configuration group, as they are written behind `<group>=`."""
    root = CONF / group
    files = (path.relative_to(root).with_suffix("").as_posix() for path in root.rglob("*.yaml"))
    registered = {"method": method_names(), "dataset": [*DATASET_KINDS, *_presets()], "logger": list(LOGGERS)}
    return sorted({*_whole(files), *registered.get(group, [])})


def _whole(options: Iterable[str]) -> Iterable[str]:
    """Without files named _…, which others are composed of."""
    return (name for name in options if not name.rpartition("/")[2].startswith("_"))


def composed(overrides: list[str]) -> RunSettings:
    """The settings that one run with these overrides has. Raises SettingsError, explained, where there is none."""
    try:
        register_choices(overrides)
        with initialize_config_dir(str(CONF), version_base="1.3"):
            return settings_of(compose("config", [*map(_forced, overrides)]), overrides)
    except (CompactHydraException, OmegaConfBaseException, SettingsError) as error:
        raise SettingsError(explain(error)) from error


def _forced(override: str) -> str:
    """The same, or what makes Hydra add a rule: a method names only those of its rules that are not its recipe's."""
    return f"++{override}" if override.startswith(f"{SETTING}rules.") else override


def settings_of(config: DictConfig, overrides: list[str]) -> RunSettings:
    """The settings of a composed configuration, those of the method all written out.

    Args:
        overrides: those that it was composed of; a method's setting among them counts before the scene's release.

    Raises:
        SettingsError, OmegaConfBaseException: a key is missing, unknown or of a wrong value.
    """
    content: Any = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    for key in ("data_root", "path", "page"):  # the call's own: two that dataset.root and the method's path are made of
        content.pop(key, None)
    _refuse_lone_severity(content.get("perturb"), overrides)
    release = content.pop("release", None) or {}
    content["method"] = _with_recipe(content["method"])
    settings = parse_settings({**content, "overrides": overrides})
    return settings.model_copy(update={"method": _accepted(settings.method, release, overrides)})


def _refuse_lone_severity(perturb: Any, overrides: Iterable[str]) -> None:
    """Raise a SettingsError where a severity is given and no kind anywhere: the run would not be perturbed."""
    given = {override.lstrip("+").partition("=")[0] for override in overrides}
    lone = "perturb.severity" in given and "perturb.kind" not in given
    if lone and isinstance(perturb, dict) and perturb.get("kind") == "none" and perturb.get("severity"):
        raise SettingsError(
            f"perturb.severity={perturb['severity']}: of nothing, as perturb.kind is none; "
            "give one, as perturb.kind=noise"
        )


def _with_recipe(method: dict[str, Any]) -> dict[str, Any]:
    """The method; of another program, with what its recipe says in place of the recipe's name, and called after it.

    Raises:
        SettingsError: there is no such recipe, or it lacks something.
    """
    if method.get("kind") != EXTERNAL:
        return method
    given = method.pop("recipe")
    try:
        recipe = read_recipe(str(given))
        choice = parse_choice({**method["settings"], "recipe": recipe.model_dump()})
    except RecipeError as error:
        raise SettingsError(str(error)) from error
    return {**method, "name": method.get("name") or recipe.name, "settings": choice.model_dump()}


def register_choices(overrides: Iterable[str] = ()) -> None:
    """Offer every dataset=<kind>, logger=<kind> and method=<name>, with their own defaults, and the project's scenes.

    The methods are the ones built in, those of installed packages, and whatever `overrides` choose by import path, as
    method=package.module:Class.

    Raises:
        SettingsError: one chosen so cannot be loaded. Of those that are not chosen, standard error says so.
    """
    store = ConfigStore.instance()
    for kind in DATASET_KINDS:
        _offer_dataset(kind)
    for preset in _presets():
        _offer_preset(preset)
    for kind in LOGGERS:
        store.store(group="logger", name=kind, node=LoggerChoice(kind=kind).model_dump())
    chosen = [override.partition("=")[2].split(",") for override in overrides if override.startswith("method=")]
    for path in (path for paths in chosen for path in paths if ":" in path):
        _offer_method(path, path)
    for kind, path in method_paths().items():
        try:
            _offer_method(kind, path)
        except SettingsError as error:
            print(error, file=sys.stderr)


@cache  # as below
def _offer_dataset(kind: str) -> None:
    ConfigStore.instance().store(group="dataset", name=kind, node=default_dataset_settings(kind))


@cache
def _presets() -> dict[str, dict[str, Any]]:
    """Scenes without a file of their own, <folder>/<scene> -> the keys of `dataset` that each has for itself.

    They are those that the project describes, and those that a folder's `_scenes.yaml` lists.
    """
    found = {f"{folder}/{scene}": {"scene": scene} for folder, scenes in PRESETS.items() for scene in scenes}
    for file in sorted((CONF / "dataset").glob("*/_scenes.yaml")):
        for scene, own in yaml.safe_load(file.read_text(encoding="utf-8")).items():
            name = f"{file.parent.name}/{scene}"
            found[name] = {"root": f"${{data_root}}/{name}", **own}
    return found


@cache
def _offer_preset(name: str) -> None:
    folder, _, scene = name.partition("/")
    node = {"defaults": [f"{folder}/_base", "_self_"], "dataset": {"name": name, **_presets()[name]}}
    ConfigStore.instance().store(group=f"dataset/{folder}", name=scene, node=node, package="_global_")


def _offer_method(kind: str, path: str) -> None:
    try:
        _offer(kind, settings_type(kind))
    except Exception as error:
        named = kind in str(error)
        raise SettingsError(str(error) if named else f"method {kind} of {path} cannot be loaded: {error}") from error


@cache  # the store lives as long as the process
def _offer(kind: str, settings: type) -> None:
    node = {"name": kind.rpartition(":")[2], "kind": kind, "settings": dataclasses.asdict(settings())}
    ConfigStore.instance().store(group="method", name=kind, node=node)


def _accepted(method: MethodChoice, release: Mapping[str, Any], overrides: Iterable[str]) -> MethodChoice:
    """The method with every setting and every rule written out, whatever a YAML file of somebody's own leaves out.

    Raises:
        SettingsError: a setting that the method does not have, or another value than it takes.
    """
    try:
        found = settings_type(method.kind)
    except Exception:
        return method  # another program's; or what cannot be loaded, as the check before the jobs says
    given = {override.lstrip("+").partition("=")[0] for override in overrides}
    values = _with_release(method.settings, release.get(method.name) or {}, given)
    try:
        settings = make_settings(found, values, SETTING)
    except ValueError as error:
        raise SettingsError(str(error)) from error
    written = dataclasses.asdict(settings)
    if isinstance(settings, RunGroup):
        written["rules"] = dataclasses.asdict(settings.rule)
    return method.model_copy(update={"settings": written})


def _with_release(settings: Mapping[str, Any], release: Mapping[str, Any], given: Collection[str]) -> dict[str, Any]:
    """The settings with what the scene's release sets apart, but for what an override gives."""
    rules = {key: value for key, value in release.get("rules", {}).items() if f"{SETTING}rules.{key}" not in given}
    own = {key: value for key, value in release.items() if key != "rules" and f"{SETTING}{key}" not in given}
    return {**settings, **own, **({"rules": {**settings.get("rules", {}), **rules}} if rules else {})}


def explain(error: Exception) -> str:
    """What the user gave, what was expected, and what to do, of an error in composing the configuration."""
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        group, _, name = str(error.missing_cfg_file).rpartition("/")
        root, _, folder = group.partition("/")
        named = config_names(root)
        options = [option.removeprefix(f"{folder}/") for option in named if option.startswith(f"{folder}/")]
        if folder and not options:  # nor is there such a folder
            group, name = root, f"{folder}/{name}"
        options = sorted(options or {*_whole(error.options or []), *named})
        if options:
            return f"there is no {group} {name!r}; {group} is one of {', '.join(options)}{_guess(name, options)}"
        return f"there is no configuration {error.missing_cfg_file!r}; `envgs-bench list` shows what there is"
    if isinstance(error, OverrideParseException):
        key, _, value = str(error.override).partition("=")
        quoted = shlex.quote(f'{key}="{value}"')
        hint = f". A value with any of ( ) [ ] {{ }} = , in it is quoted, for the shell too: {quoted}" if value else ""
        message = str(error.message).splitlines()[0]
        return f"cannot read the override {error.override!r}, expected KEY=VALUE: {message}{hint}"
    cause = error.__cause__ if isinstance(error.__cause__, OmegaConfBaseException) else error
    if isinstance(cause, MissingMandatoryValue):
        return f"{cause.full_key} is missing: give it as {cause.full_key}=VALUE"
    if isinstance(cause, ValidationError) and cause.full_key:
        return f"{cause.full_key}: {str(cause.msg).splitlines()[0]}"
    if isinstance(cause, ConfigAttributeError | ConfigKeyError) and cause.full_key:
        return _unknown(cause.full_key, _keys(cause.parent_node))
    return str(error) if cause is error else f"{error}\n{cause}"


def _unknown(key: str, known: list[str]) -> str:
    owner, _, name = key.rpartition(".")
    return f"unknown key {key!r}; {owner or 'a run'} has {', '.join(known)}{_guess(name, known)}"


def _keys(node: Any) -> list[str]:
    return sorted(str(key) for key in node if key != "hydra") if isinstance(node, DictConfig) else []


def _guess(name: str, options: list[str]) -> str:
    close = difflib.get_close_matches(name, options, n=1)
    return f". Did you mean {close[0]!r}?" if close else ""
