"""`envgs-bench completion`: what a shell completes commands, keys and names by."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

SCRIPT = """\
# envgs-bench: commands, and the names behind method=, dataset=, experiment= and protocol=. Written for bash and zsh by
# `envgs-bench completion`; write it again when methods or data sets are added.
if [ -n "$ZSH_VERSION" ]; then autoload -Uz bashcompinit compinit && compinit -u && bashcompinit; fi
_envgs_bench() {{
    local line word words
    line="${{COMP_LINE:0:COMP_POINT}}"
    word="${{line##*[[:space:]]}}"
    if [[ "$line" != *" "*" "* ]]; then words="{commands}"
    else case "$word" in
{cases}
        *) words="{keys}" ;;
    esac; fi
    word="${{word##*=}}"; word="${{word##*,}}"
    COMPREPLY=($(compgen -W "$words" -- "$word"))
    if [[ "${{COMPREPLY[0]}}" == *= ]]; then compopt -o nospace 2>/dev/null; fi
}}
complete -o default -F _envgs_bench envgs-bench
"""


def main(arguments: Sequence[str]) -> int:
    """Print the script; the exit status."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench completion",
        description="What bash and zsh complete by: put `source <(envgs-bench completion)` into ~/.bashrc or ~/.zshrc.",
    )
    parser.parse_args(arguments)
    print(_script(), end="")
    return 0


def _script() -> str:
    from envgs_bench.metrics import PROTOCOLS
    from envgs_bench.settings import RunSettings

    from .composition import config_names
    from .main import COMMANDS

    groups = {group: config_names(group) for group in ("method", "dataset", "experiment", "suite", "size")}
    groups |= {"protocol": list(PROTOCOLS), "device": ["auto", "cpu", "cuda"]}
    cases = [f'        {group}=*) words="{" ".join(names)}" ;;' for group, names in groups.items()]
    keys = sorted({f"{key}=" for key in (*RunSettings.model_fields, "experiment", "suite", "size")} - {"overrides="})
    return SCRIPT.format(commands=" ".join(COMMANDS), cases="\n".join(cases), keys=" ".join(["-m", "--dry-run", *keys]))
