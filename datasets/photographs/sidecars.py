"""Masks and normals for photographs, from the folders that lie beside the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..formats.normal_maps import NormalMap
from ..formats.photograph import Photograph
from ..formats.sidecars import Sidecars, region_folders
from ..settings import Frame


def with_sidecars(photographs: Sequence[Photograph], root: Path, frame: Frame) -> list[Photograph]:
    """The photographs with the masks and normals that lie in folders below `root`, where there are such folders.

    Raises as `with_masks`.
    """
    result = with_masks(photographs, root)
    if (root / "normals").is_dir():
        paths = Sidecars(root / "normals").find_all(photograph.name for photograph in photographs)
        result = [replace(p, normal=NormalMap(path, frame)) for p, path in zip(result, paths, strict=True)]
    return result


def with_masks(photographs: Sequence[Photograph], root: Path) -> list[Photograph]:
    """The photographs with the masks below `root`, of regions that their own data name no masks of.

    Raises:
        DatasetError: a folder lacks a file for some of them, or holds several for one.
    """
    result = list(photographs)
    for region, folder in region_folders(root).items():
        lacking = [photograph.name for photograph in result if region not in photograph.masks]
        if lacking:
            paths = dict(zip(lacking, Sidecars(folder).find_all(lacking), strict=True))
            result = [p if region in p.masks else replace(p, masks={**p.masks, region: paths[p.name]}) for p in result]
    return result


def sidecar_files(names: Sequence[str], root: Path) -> list[Path]:
    """The files of masks and normals below `root` that belong to the photographs of these names."""
    folders = [Sidecars(folder) for folder in (*region_folders(root).values(), root / "normals")]
    return [path for folder in folders for name in names for path in folder.candidates(name)]
