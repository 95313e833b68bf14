"""Isolation: a program's command as it is started where the program is installed."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from .recipe import Isolation

STOP_SECONDS = 30.0


@dataclass(frozen=True)
class Started:
    """What is started, and how it is ended.

    Attributes:
        words: the whole command.
        environment: variables beside this process's own.
        container: (runner, name) of a container, whose processes are not this one's children.
    """

    words: list[str]
    environment: dict[str, str] = field(default_factory=dict)
    container: tuple[str, str] | None = None

    def remove_container(self) -> None:
        """End the container, where there is one; its runner's end does not."""
        if self.container:
            runner, name = self.container
            subprocess.run([runner, "rm", "-f", name], capture_output=True, timeout=STOP_SECONDS, check=False)


def isolated(
    words: Sequence[str], isolation: Isolation, environment: Mapping[str, str], folders: Sequence[Path], name: str
) -> Started:
    """The command, where the program is installed.

    Args:
        environment: variables for the program.
        folders: what a container sees of this machine, at the same paths.
        name: a new container's.
    """
    given = dict(environment)
    if isolation.kind == "none":
        return Started(list(words), given)
    if isolation.kind == "venv":
        folder = Path(isolation.name).expanduser().absolute()
        search = f"{folder / 'bin'}{os.pathsep}{os.environ.get('PATH', os.defpath)}"
        return Started(list(words), {"PATH": search, "VIRTUAL_ENV": str(folder), **given})
    if isolation.kind == "conda":
        return Started(["conda", "run", "--no-capture-output", "-n", isolation.name, *words], given)
    options = shlex.split(isolation.options)
    if isolation.kind == "apptainer":
        binds = ["--bind", ",".join(map(str, folders))] if folders else []
        return Started(["apptainer", "exec", *binds, *options, isolation.name, *words], given)
    mounts = [word for folder in folders for word in ("-v", f"{folder}:{folder}")]
    variables = [word for key, value in given.items() for word in ("-e", f"{key}={value}")]
    runner = [isolation.kind, "run", "--rm", "--init", "--name", name, *mounts, *variables, *options]
    return Started([*runner, isolation.name, *words], {}, (isolation.kind, name))


def executable(started: Started) -> str | None:
    """The program's file that would be started; None where there is none."""
    search = started.environment.get("PATH", os.environ.get("PATH"))
    return shutil.which(started.words[0], path=search)
