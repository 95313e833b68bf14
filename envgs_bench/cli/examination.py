"""What works on this machine, and of what does not, why and what to do: what `envgs-bench doctor` prints."""

from __future__ import annotations

import os
import platform
import shutil
from importlib.metadata import EntryPoint, PackageNotFoundError, version

import torch
from rich.console import Console
from rich.table import Table

from envgs_bench.core import available_backends
from envgs_bench.methods.registry import installed_methods
from envgs_bench.metrics import WeightsUnavailable, find_weights
from envgs_bench.pages import FAILED, help_at
from envgs_bench.settings import default_cache_dir

MEASURING, CORE, DATA, METHOD = "reference/measuring", "explanation/core", "reference/data_sets", "tutorials/own_method"
PACKAGES = {  # and the page on what each is for
    "envgs-bench": FAILED,
    "torch": FAILED,
    "numpy": FAILED,
    "hydra-core": "reference/command_line",
    "embreex": CORE,
    "pycolmap": DATA,
    "flip-evaluator": MEASURING,
    "torchmetrics": MEASURING,
    "kornia": MEASURING,
    "scikit-image": MEASURING,
}


def examine() -> int:
    """Print the state of backends, metrics' weights, methods, folders and versions.

    Returns:
        The exit status: 1 where no backend can draw, else 0.
    """
    backends = available_backends()
    table = Table("what", "state", "remark", show_header=False, box=None)
    pages = [FAILED]

    def add(what: str, problem: str | None, remark: str = "", page: str = FAILED) -> None:
        table.add_row(what, "no" if problem else "yes", problem or remark)
        pages.extend([page] if problem else [])

    for name, reason in backends.items():
        add(f"backend {name}", reason, page=CORE)
    add("VGG-16 weights", *_weights(), page=MEASURING)
    for name, point in installed_methods().items():
        add(f"method {name}", _loading_error(point), page=METHOD)
    add("cache", _cache_error(), str(default_cache_dir()))
    for package, page in PACKAGES.items():
        add(package, *_version(package), page=page)
    add("python", None, f"{platform.python_version()} on {platform.platform()}")
    add("threads", None, f"{torch.get_num_threads()} of {os.cpu_count()} logical processors")
    console = Console(width=160)
    console.print(table, highlight=False)
    for page in dict.fromkeys(pages):
        console.print(help_at(page), highlight=False, soft_wrap=True)
    drawing = [name for name, reason in backends.items() if reason is None and name != "embree"]
    if not drawing:
        console.print("No backend can draw: install again with a C++ compiler at hand (pip install -e .)")
    return 0 if drawing else 1


def _version(package: str) -> tuple[str | None, str]:
    try:
        return None, version(package)
    except PackageNotFoundError:
        return "not installed", ""


def _weights() -> tuple[str | None, str]:
    try:
        weights = find_weights()
    except WeightsUnavailable as error:
        return f"{error}. Without them LPIPS reads n/c, and methods train without their perceptual loss", ""
    return None, f"{weights.path} ({weights.source})"


def _loading_error(point: EntryPoint) -> str | None:
    try:
        point.load()
    except Exception as error:
        return f"{point.value} cannot be loaded: {error}"
    return None


def _cache_error() -> str | None:
    folder = default_cache_dir()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(folder).free
    except OSError as error:
        return f"{error}; set ENVGS_BENCH_CACHE to a folder that can be written"
    if os.access(folder, os.W_OK) and free:
        return None
    return f"{folder} cannot be written: runs find what it holds, and no more; set ENVGS_BENCH_CACHE"
