"""Recipe: how another program is told to train on a data set and to draw its test views. A YAML file.

    name: other                   # in tables
    page: https://…               # how it is installed
    layout: colmap                # that it reads
    train: python {home}/train.py --data {data} --out {output} --iterations {steps}
    pictures: {files: "{output}/test/*.png"}

Commands are split into words as a shell would, then PLACEHOLDERS are filled in; there is no shell, so that neither
pipes nor variables mean anything. `{arguments}` and `{on_white}` become as many words as they hold.
"""

from __future__ import annotations

import itertools
import os
import re
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, field_validator, model_validator

from envgs_bench.regular_file import read_regular_text

SHIPPED = Path(__file__).parent / "recipes"
MOST_BYTES = 100_000  # of a recipe

PLACEHOLDERS = {
    "data": "the folder with the exported data set",
    "output": "the folder that the program writes into, empty when the training starts",
    "home": "the program's own folder, as given: method.settings.home",
    "python": "the interpreter: method.settings.python",
    "steps": "of the training",
    "last_step": "steps − 1, for programs that count from 0",
    "share": "steps / 30,000, for programs whose schedule is written for so many and can be scaled",
    "seed": "of the run",
    "device": "cpu or cuda",
    "test_every": "every so many-th view tests, from the first by name",
    "on_white": "the recipe's own words where the background is white, nothing elsewhere",
    "arguments": "the user's own words: method.settings.arguments",
}
SPLICED = ("{arguments}", "{on_white}")  # words that become any number of words
_PLACEHOLDER = re.compile(r"\{(\w+)\}")


class RecipeError(ValueError):
    """A recipe that cannot be used; the message names the file, the key and what was expected."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


def _as_list(value: Any) -> Any:
    return [value] if isinstance(value, str) else value


def _known(text: str) -> str:
    """Refuse a placeholder that there is not."""
    unknown = sorted({name for name in _PLACEHOLDER.findall(text) if name not in PLACEHOLDERS})
    if unknown:
        raise ValueError(f"{{{unknown[0]}}} is no placeholder; there are {', '.join(PLACEHOLDERS)}")
    return text


def _command(text: str) -> str:
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise ValueError(f"cannot be split into words ({error})") from error
    if not words:
        raise ValueError("is empty, expected a command")
    for word in words:
        if word not in SPLICED and any(part in word for part in SPLICED):
            raise ValueError(f"{word!r}: {' and '.join(SPLICED)} stand as words of their own")
    return _known(text)


def _pattern(text: str) -> str:
    try:
        if re.compile(text).groups != 1:
            raise ValueError("expected one group ( ) around the number")
    except re.error as error:
        raise ValueError(f"is no regular expression ({error})") from error
    return text


class Isolation(_Part):
    """Where the program is installed.

    Attributes:
        kind: none: on the PATH; venv, conda: an environment; docker, podman, apptainer: an image of a container.
        name: the environment's folder (venv) or name (conda), or the image; "" of none.
        options: further words of the container's runner.
    """

    kind: Literal["none", "venv", "conda", "docker", "podman", "apptainer"] = "none"
    name: str = ""
    options: str = ""

    @model_validator(mode="after")
    def _named(self) -> Isolation:
        if (self.kind == "none") != (not self.name):
            raise ValueError(f"kind {self.kind} " + ("takes no name" if self.kind == "none" else "needs a name"))
        return self


class Pictures(_Part):
    """Where the drawn test views land, and which is which.

    Attributes:
        files: a pattern of paths with * and **.
        match: order: sorted by their numbers, they are the views in the order of their names; name: each is called
            after its view.
        crop: the part of each file that is the picture.
    """

    files: str
    match: Literal["order", "name"] = "order"
    crop: Literal["whole", "left half", "right half"] = "whole"

    _check = field_validator("files")(_known)


class Model(_Part):
    """The Gaussians that it writes, in the coordinates of the data.

    Attributes:
        file: a pattern of one path: a PLY of 3DGS or 2DGS, an SPZ or a SOG.
        near: what the program draws nothing nearer than, in the data's units.
        centered: whether it takes the principal point to be in the middle of the picture, wherever it is.
    """

    file: str
    near: Annotated[float, Field(gt=0)] = 0.2
    centered: bool = False

    _check = field_validator("file")(_known)


class Reading(_Part):
    """A number that the program tells.

    Attributes:
        pattern: a regular expression with one group, the number's; the last match counts.
        file: a pattern of paths of text files; what the training prints where empty.
        unit: what a number of 1 means, in seconds.
    """

    pattern: str
    file: str = ""
    unit: Annotated[float, Field(gt=0)] = 1.0

    _check_pattern = field_validator("pattern")(_pattern)
    _check_file = field_validator("file")(_known)


class Recipe(_Part):
    """One program, as it is told to train.

    Attributes:
        name: in tables.
        page: its own page, which says how it is installed.
        commit, licence: of the program that the recipe was written for.
        tried: what the recipe was really run on; "" where it was only written from the program's documentation.
        layout: what `envgs-bench export --format` writes for it.
        train: the commands, one after the other.
        resume: those that go on from an interrupted training; none: it starts again.
        draw: those that draw the test views; none: training does.
        sees_test_views: whether the data have them; false for a program that would train on all that it is given.
        pictures: of the test views; none: the shared core draws them, of the Gaussians that the program writes.
        on_white: words for commands where the scene's background is white.
        environment: variables for all of its commands.
        seconds: how long it says that it trained.
        step: a regular expression with one group: the step that a line of its output tells.
    """

    name: Annotated[str, Field(min_length=1)]
    page: Annotated[str, Field(pattern=r"^https?://")]
    commit: str = ""
    licence: str = ""
    tried: str = ""
    layout: Literal["colmap", "colmap-text", "blender"]
    train: Annotated[list[str], BeforeValidator(_as_list), Field(min_length=1)]
    resume: Annotated[list[str], BeforeValidator(_as_list)] = []
    draw: Annotated[list[str], BeforeValidator(_as_list)] = []
    on_white: str = ""
    isolation: Isolation = Isolation()
    environment: dict[str, str] = {}
    sees_test_views: bool = True
    pictures: Pictures | None = None
    model: Model | None = None
    seconds: Reading | None = None
    step: str | None = None

    @field_validator("train", "resume", "draw")
    @classmethod
    def _commands(cls, commands: list[str]) -> list[str]:
        return [_command(text) for text in commands]

    @field_validator("step")
    @classmethod
    def _step(cls, text: str | None) -> str | None:
        return None if text is None else _pattern(text)

    @model_validator(mode="after")
    def _draws(self) -> Recipe:
        if self.pictures is None and self.model is None:
            raise ValueError("needs pictures, or a model that the shared core can draw them of")
        if self.pictures is not None and not self.sees_test_views:
            raise ValueError("pictures of test views need sees_test_views: true")
        return self

    @property
    def needs_home(self) -> bool:
        return any("{home}" in text for text in (*self.train, *self.resume, *self.draw))


def _absolute(path: Any) -> Any:
    return os.path.abspath(os.path.expanduser(path)) if isinstance(path, str) and path else None


class ProgramChoice(_Part):
    """What a run of another program was told: `method.settings`.

    Attributes:
        recipe: of the program.
        home: its own folder, {home} of the recipe.
        python: the interpreter, {python} of the recipe.
        isolation: in place of the recipe's.
        arguments: {arguments} of the recipe.
    """

    recipe: Recipe
    home: Annotated[str | None, BeforeValidator(_absolute)] = None
    python: str = "python"
    isolation: Isolation | None = None
    arguments: str = ""

    @model_validator(mode="after")
    def _complete(self) -> ProgramChoice:
        if self.recipe.needs_home and not self.home:
            raise ValueError(
                f"the recipe of {self.recipe.name} needs the folder that the program lies in: give "
                f"method.settings.home=FOLDER ({self.recipe.page} says how it is installed)"
            )
        if self.home and not Path(self.home).is_dir():
            raise ValueError(f"home={self.home}: there is no such folder")
        try:
            shlex.split(self.arguments)
        except ValueError as error:
            raise ValueError(f"arguments={self.arguments!r} cannot be split into words ({error})") from error
        return self


def shipped_recipes() -> list[str]:
    """The names that `read_recipe` takes beside files."""
    return sorted(path.stem for path in SHIPPED.glob("*.yaml"))


def read_recipe(given: str) -> Recipe:
    """The recipe of a program: one of `shipped_recipes()` by name, or a YAML file.

    Raises:
        RecipeError: there is no such recipe, or a key is missing, unknown or of a wrong value; every such key is named.
    """
    path = SHIPPED / f"{given}.yaml" if given in shipped_recipes() else Path(given).expanduser()
    try:
        content = yaml.safe_load(read_regular_text(path, MOST_BYTES))
    except OSError as error:
        raise RecipeError(
            f"method.recipe={given}: cannot be read ({error.strerror or error}); expected a YAML file, or one of "
            f"{', '.join(shipped_recipes())}"
        ) from error
    except (UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        raise RecipeError(f"{path}: is no YAML ({' '.join(str(error).split())})") from error
    if not isinstance(content, dict):
        raise RecipeError(f"{path}: holds {type(content).__name__}, expected keys as name, layout and train")
    try:
        return Recipe.model_validate(content)
    except ValidationError as error:
        raise RecipeError(f"{path}: {problems(error)}") from error


def parse_choice(settings: Mapping[str, Any]) -> ProgramChoice:
    """`method.settings` of a run. Raises RecipeError, naming every key that is wrong."""
    try:
        return ProgramChoice.model_validate(dict(settings))
    except ValidationError as error:
        raise RecipeError(f"method.settings: {problems(error)}") from error


def problems(error: ValidationError) -> str:
    """Each wrong key with what was expected."""
    found = []
    for item in error.errors():
        key = ".".join(str(part) for part in item["loc"])
        found.append(f"{key}: {item['msg'].removeprefix('Value error, ')}" if key else str(item["msg"])[13:])
    return "; ".join(found)


def filled(text: str, values: Mapping[str, str]) -> str:
    """The text with its placeholders filled in."""
    return _PLACEHOLDER.sub(lambda match: values[match[1]], text)


def words_of(command: str, values: Mapping[str, str]) -> list[str]:
    """The command's words with placeholders filled in."""
    words: list[str] = []
    for word in shlex.split(command):
        words += shlex.split(values[word[1:-1]]) if word in SPLICED else [filled(word, values)]
    return words


def files_of(pattern: str, values: Mapping[str, str]) -> list[Path]:
    """The files that a pattern of absolute paths means, sorted; folders are left out."""
    path = Path(filled(pattern, values))
    parts: Iterable[str] = path.parts[1:]
    return sorted(found for found in Path(path.anchor).glob("/".join(parts)) if found.is_file())


def folder_of(pattern: str, values: Mapping[str, str]) -> Path:
    """The folder that all of these files lie below: the pattern up to the first part that has a wildcard."""
    parts = Path(filled(pattern, values)).parent.parts
    return Path(*itertools.takewhile(lambda part: not set(part) & set("*?["), parts))
