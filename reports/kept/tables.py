"""Tables of a page, from rows of kept runs: scores, differences, costs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from ..numbers.comparison import Comparison
from ..numbers.estimates import Estimate
from ..tables.columns import AGREEMENT, FRAME_MS, OWN_SECONDS, PRIMITIVES, SCORES, TRAIN_SECONDS, Column
from .kept_runs import COSTS, FULL, KeptRuns, TableError, column_of

NOTHING = "–"
MOST_COLUMNS = 6  # of means and deviations, that a page shows without scrolling
PageTable = Callable[..., str]  # of KeptRuns and what else a comment says, by name -> Markdown


def places_of(scenes: tuple[str, ...]) -> list[tuple[str, ...]]:
    """What a column is of: each scene, and all of them where there are several."""
    return [*((scene,) for scene in scenes), *([scenes] if len(scenes) > 1 else [])]


def heading(place: tuple[str, ...]) -> str:
    return f"`{place[0].rpartition('/')[2]}`" if len(place) == 1 else "mean"


def scores(runs: KeptRuns, metric: str = "psnr", region: str = FULL) -> str:
    """A row a method, a column a scene and their mean, or the other way where these are too many to stand in a row.

    The best of each scene is bold.
    """
    column = column_of(metric, region)
    places = places_of(runs.having(column))
    table = arranged(places, printed(runs, column, places), down=len(places) > MOST_COLUMNS)
    what = capital(column.axis)
    if runs.rows["seed"].nunique() > 1:
        what += ", mean over seeds ± their standard deviation"
    return f"{table}\n{runs.caption(what)}\n"


def arranged(places: Sequence[tuple[str, ...]], cells: Mapping[str, Sequence[str]], *, down: bool) -> str:
    """Each method's cells of the places: a row a method, or a row a place where these go down."""
    heads = ["scene" if down else "method", *(heading(place) for place in places)]
    lines = [heads, *([f"`{method}`", *own] for method, own in cells.items())]
    head, *rows = [list(line) for line in zip(*lines, strict=True)] if down else lines
    return as_markdown(head, rows)


def capital(words: str) -> str:
    """Words that begin a caption."""
    return words[:1].upper() + words[1:]


def printed(runs: KeptRuns, column: Column, places: Sequence[tuple[str, ...]]) -> dict[str, list[str]]:
    """Method -> its cell of each place; the best of each place is bold."""
    cells: dict[str, list[str]] = {method: [] for method in runs.methods}
    for place in places:
        found = {each: runs.numbers.estimate(place, each, column.region, column.metric) for each in runs.methods}
        values = {each: column.printed(cell.mean) for each, cell in found.items() if cell.mean and cell.complete}
        best = (max if column.better == "higher" else min)(values.values(), default=None)
        for method, cell in found.items():
            cells[method].append(_cell(column, cell, values.get(method) == best and column.ranked))
    return cells


def gains(runs: KeptRuns, of: str, metric: str = "psnr", region: str = FULL) -> str:
    """A row each other method: how far `of` is ahead of it on each scene and on average, with 95 % intervals."""
    column = column_of(metric, region)
    if of not in runs.methods:
        raise TableError(f"{runs.name} has no method {of!r} here, but {', '.join(runs.methods)}")
    places = places_of(runs.having(column))
    rows = [
        [f"`{other}`", *(difference(column, runs.compared(column, of, other, place)) for place in places)]
        for other in runs.methods
        if other != of
    ]
    heads = [heading(place) for place in places]
    what = f"{capital(column.axis)}, of `{of}` less the row's method, paired by seed"
    what += "; brackets are 95 % intervals, bold where they exclude 0"
    return f"{as_markdown([f'`{of}` less', *heads], rows)}\n{runs.caption(what)}\n"


def difference(column: Column, found: Comparison) -> str:
    """A difference and its interval, bold where it is decided."""
    if found.difference.mean is None:
        return NOTHING
    mean = column.signed(found.difference.mean)
    if found.difference.interval is None:
        return mean
    ends = ", ".join(column.signed(end) for end in found.difference.interval)
    return f"**{mean}** [{ends}]" if found.better() or found.worse() else f"{mean} [{ends}]"


def costs(runs: KeptRuns) -> str:
    """A row a method: PSNR and what a picture costs, as means over the scenes, timed on one device."""
    runs.of_one("device")
    columns = [column_of("psnr"), *COSTS]
    rows = [
        [
            f"`{method}`",
            *(_cell(column, runs.numbers.estimate(runs.scenes, method, FULL, column.metric)) for column in columns),
        ]
        for method in runs.methods
    ]
    heads = [column.title for column in columns]
    return f"{as_markdown(['method', *heads], rows)}\n{runs.caption('Means over scenes')}\n"


def programs(runs: KeptRuns) -> str:
    """A row a method and device on one scene: scores, what it costs, and how a program's pictures agree."""
    runs.of_one("scene")
    costs = (PRIMITIVES, TRAIN_SECONDS, OWN_SECONDS, FRAME_MS, AGREEMENT)
    columns = [*SCORES, *costs]
    rows = []
    for method in runs.methods:
        for device, its in runs.rows[runs.rows["method"] == method].groupby("device"):
            numbers = KeptRuns(runs.name, its).numbers
            cells = (_cell(column, numbers.estimate(runs.scenes, method, FULL, column.metric)) for column in columns)
            rows.append([f"`{method}`", str(device), *cells])
    first = runs.rows.iloc[0]
    what = f"`{first['scene']}`, {first['width']}×{first['height']} pixels"
    heads = ["method", "on", *(column.title for column in columns)]
    return f"{as_markdown(heads, rows)}\n{runs.caption(what)}\n"


def _cell(column: Column, found: Estimate, best: bool = False) -> str:
    """A mean with its spread over seeds, and how many runs finished where not all did."""
    if found.averaged and not found.complete:
        return f"{NOTHING} ({found.done}/{found.expected})"
    if found.mean is None:
        return NOTHING
    text = f"**{column.unsigned(found.mean)}**" if best else column.unsigned(found.mean)
    if found.spread is not None and column.ranked:
        text = f"{text} ± {column.unsigned(found.spread)}"
    return text if found.done == found.expected else f"{text} ({found.done}/{found.expected})"


def as_markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table whose first column is of words.

    Raises:
        TableError: no cell beside has a number.
    """
    if not any(character.isdigit() for row in rows for cell in row[1:] for character in cell):
        raise TableError(f"no run that is chosen has a number for this table, of {', '.join(heads)}")
    lines = [heads, [":--", *["--:"] * (len(heads) - 1)], *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
