"""Masks: what the files of one region mean together, and each as inside and outside.

Two values are outside and inside, whatever they are. A soft edge between black and white, as reduction, feathering and
lossy compression leave it, is cut at half. More values are labels, of which somebody has to choose.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import DatasetError
from ..notes import note
from ..progress import mapped
from .mask_file import MaskFile, read_mask_file

Mask = NDArray[np.bool_]
How = Literal["gray", "index", "color", "alpha"]

MOST_LABELS = 256  # of one file; a picture has more colors
NEAR = 1 / 16  # of the gray scale: what is this near to black or white may be noise of it
SLOPES = 0.9  # share of the gray pixels that lie between darker and brighter ones where an edge is soft
FLAT = 0.1  # share of them that lie amid their like, at most, where noise of compression is on them
CONTINUOUS = 8  # shades from which on they are a ramp's or noise, and no labels
LISTED = 12


@dataclass(frozen=True)
class Coding:
    """What the values of a region's files mean.

    Attributes:
        how: values are gray values, indices of palettes, colors 0xRRGGBB, or what is opaque alone counts.
        inside: the values inside; None where those above half of white are.
    """

    how: How
    inside: frozenset[int] | None


@dataclass
class Survey:
    """What one file holds, or several together: enough to tell what its values mean."""

    values: set[int] = field(default_factory=set)  # gray values, indices or colors that are not transparent
    many: bool = False  # more than MOST_LABELS of them in a file
    colored: bool = False
    lossy: bool = False
    palette: dict[int, set[int]] = field(default_factory=dict)  # the colors of each index used
    gray_files: set[int] = field(default_factory=set)  # the values of files without a palette
    with_alpha: int = 0  # files that can be transparent,
    see_through: int = 0  # and those that are somewhere
    files: int = 0
    grays: int = 0  # pixels that are near neither black nor white,
    slopes: int = 0  # those of them between darker and brighter ones,
    flat: int = 0  # and those amid their like;
    shades: set[int] = field(default_factory=set)  # their values
    near: int = 0  # pixels near black or white, and neither,
    flat_near: int = 0  # and those of them amid their like;
    near_shades: set[int] = field(default_factory=set)  # their values
    fractions: bool = False  # of floats


def mask_codings(regions: Mapping[str, Sequence[Path]], labels: Sequence[int | str]) -> dict[str, Coding]:
    """What the masks of each region mean.

    Args:
        regions: by their names, their files, one a view; a file may serve several.
        labels: the setting `mask_labels`: those that are inside where masks hold more than two values.

    Raises:
        DatasetError: a file cannot be read, its region's files hold several labels of which none is chosen, or nothing
            is inside in any of them.
    """
    chosen = frozenset(_as_value(label) for label in labels)
    return {region: _coding(region, sorted(set(paths)), chosen) for region, paths in regions.items()}


def read_mask(path: Path, coding: Coding) -> Mask:
    """The mask [H, W], true inside.

    Raises:
        DatasetError: as `read_mask_file`.
    """
    file = read_mask_file(path)
    if coding.how == "alpha":
        return np.ones(file.values.shape, np.bool_) if file.opaque is None else file.opaque >= 0.5
    values = _values(file, coding.how)
    inside = values >= (file.full or 1) / 2 if coding.inside is None else np.isin(values, list(coding.inside))
    return inside if file.opaque is None else inside & (file.opaque >= 0.5)


def _coding(region: str, paths: Sequence[Path], chosen: Collection[int]) -> Coding:
    found = Survey()
    for survey in mapped(f"checking masks of {region}", _survey, paths):
        _add(found, survey)
    place = f"{_folder(paths)}: region {region}"
    coding = _meaning(found, place, frozenset(chosen))
    if coding.how != "alpha" and coding.inside is not None and found.see_through == 0:
        values = _all_values(found, coding.how)
        if values and values <= coding.inside:
            note(f"{place} is the whole picture in all of {found.files} masks")
    return coding


def _meaning(found: Survey, place: str, chosen: frozenset[int]) -> Coding:
    if found.see_through and (found.many or len(found.values) <= 1):
        if found.with_alpha < found.files:
            raise DatasetError(
                f"{place}: {found.with_alpha} of {found.files} masks are cut out of a transparent ground, the others "
                "are not; save all of them in one way"
            )
        return Coding("alpha", None)
    if found.fractions and not found.palette and not found.colored:
        return Coding("gray", None)
    how = _how(found)
    values = _all_values(found, how) | ({0} if found.see_through else set())
    if how == "gray" and _is_soft(found, values):
        if max(values, default=0) < 128:
            raise _empty(found, place, values, how)
        return Coding("gray", None)
    if found.many or found.lossy or (len(values) > MOST_LABELS and not chosen):
        raise DatasetError(
            f"{place}: its masks hold more than {MOST_LABELS} values, or a lossy format's grays that are no edges: "
            "pictures, no masks; save black outside and white inside as PNG, or move the folder away"
        )
    if chosen and not values <= {0, 255}:
        if not values & chosen:
            raise DatasetError(
                f"{place}: no mask holds a label of dataset.mask_labels={_listed(chosen, how)}; found are "
                f"{_listed(values, how)}"
            )
        return Coding(how, chosen)
    if len(values) > 2:
        raise DatasetError(
            f"{place}: its masks hold the labels {_listed(values, how)}; say which are inside, as "
            f"dataset.mask_labels={_listed(values - {min(values)}, how)}, or save masks of two values"
        )
    low, *rest = sorted(values, key=lambda value: (_brightness(value, how, found), value))
    if not rest and not low:
        raise _empty(found, place, values, how)
    if rest and _brightness(low, how, found) > 0:
        note(f"{place}: of the values {_listed(values, how)} the brighter one is taken for inside")
    return Coding(how, frozenset(rest or [low]))


def _empty(found: Survey, place: str, values: Collection[int], how: How) -> DatasetError:
    return DatasetError(
        f"{place} has nothing inside in any of {found.files} masks, which hold only {_listed(values, how)}; paint what "
        "is inside white, or move the folder away"
    )


def _is_soft(found: Survey, values: Collection[int]) -> bool:
    """Whether black and white, and edges between them, are all that there is."""
    if len(values) <= 2 and not found.lossy:
        return False
    noisy = len(found.shades) + len(found.near_shades) >= CONTINUOUS or found.lossy
    edges = found.slopes >= SLOPES * found.grays or (noisy and found.flat <= FLAT * found.grays)
    noise = noisy and found.flat_near <= 0.5 * found.near
    return edges and (found.lossy or noise or len(found.shades) >= CONTINUOUS or found.near == 0)


def _how(found: Survey) -> How:
    """As what all files can be compared."""
    if not found.palette:
        return "color" if found.colored else "gray"
    colors = [color for colors in found.palette.values() for color in colors]
    if not found.colored and all(_is_gray(color) for color in colors) and len(set(colors)) == len(colors):
        return "gray"
    one_color_each = all(len(colors) == 1 for colors in found.palette.values())
    return "color" if found.colored or not one_color_each else "index"


def _all_values(found: Survey, how: How) -> set[int]:
    """The values in the files, each in the form `how`."""
    if not found.palette:
        gray = how == "color" and not found.colored
        return {value * 0x010101 for value in found.values} if gray else set(found.values)
    colors = {color for colors in found.palette.values() for color in colors}
    if how == "index":
        return set(found.palette) | found.gray_files
    if how == "gray":
        return {color & 255 for color in colors} | found.gray_files
    return colors | found.gray_files


def _values(file: MaskFile, how: How) -> NDArray:
    """The file's values in the form `how`."""
    if file.palette is not None:
        if how == "index":
            return file.values
        colors = np.array([file.palette.get(index, 0) for index in range(int(file.values.max()) + 1)])[file.values]
        return colors & 255 if how == "gray" else colors
    return file.values * 0x010101 if how == "color" and not file.colored else file.values


def _brightness(value: int, how: How, found: Survey) -> float:
    """Of a value, as a viewer shows it: what orders two of them."""
    if how == "gray":
        return value
    color = next(iter(found.palette.get(value, {value * 0x010101}))) if how == "index" else value
    return 0.299 * (color >> 16) + 0.587 * (color >> 8 & 255) + 0.114 * (color & 255)


def _survey(path: Path) -> Survey:
    file = read_mask_file(path)
    shown = file.values if file.opaque is None else file.values[file.opaque >= 0.5]
    fractions = file.values.dtype.kind == "f"
    values = set() if fractions else {int(value) for value in _unique(shown)}
    survey = Survey(values, False, file.colored, file.lossy, files=1, fractions=fractions)
    if file.opaque is not None:
        survey.with_alpha, survey.see_through = 1, int((file.opaque < 1).any())
    if len(values) > MOST_LABELS and (file.colored or survey.see_through):
        survey.many, survey.values = True, set(sorted(values)[:MOST_LABELS])
    if file.palette is not None:
        survey.palette = {value: {file.palette.get(value, 0)} for value in values}
    elif not file.colored:
        survey.gray_files = values
    if fractions and (file.values.min() < 0 or file.values.max() > 1):
        raise DatasetError(f"{path}: has values from {file.values.min():g} to {file.values.max():g}, expected 0 to 1")
    if not fractions and file.full and not file.colored and (file.lossy or not values <= {0, file.full}):
        _add_edges(survey, _values(file, "gray"), file.full)
    return survey


def _add_edges(survey: Survey, gray: NDArray, full: int) -> None:
    """What lies between black and white, and how."""
    from scipy import ndimage

    middle = (gray > NEAR * full) & (gray < (1 - NEAR) * full)
    near = ~middle & (gray != 0) & (gray != full)
    slope = (ndimage.minimum_filter(gray, 5) < gray) & (gray < ndimage.maximum_filter(gray, 5))
    flat = ndimage.minimum_filter(gray, 3) == ndimage.maximum_filter(gray, 3)
    survey.grays, survey.near = int(middle.sum()), int(near.sum())
    survey.slopes, survey.flat = int((slope & middle).sum()), int((flat & middle).sum())
    survey.flat_near = int((flat & near).sum())
    survey.shades, survey.near_shades = (({int(value) for value in _unique(gray[where])}) for where in (middle, near))


def _add(found: Survey, other: Survey) -> None:
    found.values |= other.values
    found.gray_files |= other.gray_files
    found.shades |= other.shades
    found.near_shades |= other.near_shades
    for index, colors in other.palette.items():
        found.palette.setdefault(index, set()).update(colors)
    for name in ("many", "colored", "lossy", "fractions"):
        setattr(found, name, getattr(found, name) or getattr(other, name))
    for name in ("with_alpha", "see_through", "files", "grays", "slopes", "flat", "near", "flat_near"):
        setattr(found, name, getattr(found, name) + getattr(other, name))


def _unique(values: NDArray) -> NDArray:
    small = values.size and values.dtype.kind in "iu" and values.min() >= 0 and values.max() < 1 << 16
    return np.flatnonzero(np.bincount(values.ravel())) if small else np.unique(values)


def _is_gray(color: int) -> bool:
    return color == (color & 255) * 0x010101


def _as_value(label: int | str) -> int:
    """A number as it is, "#rrggbb" as a color's."""
    return int(label.removeprefix("#"), 16) if isinstance(label, str) else label


def _listed(values: Collection[int], how: How) -> str:
    texts = [f"'#{value:06x}'" if how == "color" else str(value) for value in sorted(values)]
    return f"[{','.join(texts[:LISTED])}{',…' if len(texts) > LISTED else ''}]"


def _folder(paths: Sequence[Path]) -> Path:
    return paths[0].parent if len({path.parent for path in paths}) == 1 else paths[0].parents[1]
