"""Layouts: which tables a section has, each after one of the paper's."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from envgs_bench.parts import MethodCard, MetricCard

from ..numbers.estimates import Numbers
from ..numbers.labels import Label
from ..numbers.published import paper_scene, published_source, published_values
from .columns import (
    FILE_MEGABYTES,
    FLIP,
    FRAME_MS,
    LPIPS,
    MEGABYTES,
    NORMALS,
    PAPER_SPEED,
    PSNR,
    SPEED_COLUMNS,
    SSIM,
    TRAIN_SECONDS,
    Column,
    in_region,
    main_columns,
    over,
    score_columns,
)
from .table import Table, build_table

WITHOUT = "_no_"  # <method>_no_<part>: the method without a part, where no card says so
REGIONS_OF_ABLATION = ("near_field", "reflective")


@dataclass(frozen=True)
class Contents:
    """What tables are made of.

    Attributes:
        subjects: name -> data sets: each data set alone, families of several, and all together.
        labels: row -> its method's name, with the settings that set it apart from others of that name; in the tables'
            order.
        cards: row -> its method's card.
        metrics: name -> its card, in the tables' order.
        published: row -> the paper's name of it; None where nobody printed numbers of the protocol.
        protocol: the runs'.
    """

    numbers: Numbers
    subjects: Mapping[str, tuple[str, ...]]
    labels: Mapping[str, Label]
    cards: Mapping[str, MethodCard]
    metrics: Mapping[str, MetricCard]
    published: Mapping[str, str] | None
    protocol: str

    @property
    def methods(self) -> list[str]:
        return list(self.labels)

    @property
    def families(self) -> dict[str, tuple[str, ...]]:
        return {name: members for name, members in self.subjects.items() if len(members) > 1}

    def table(
        self,
        title: str,
        kind: str,
        columns: Sequence[Column],
        methods: Sequence[str] | None = None,
        paper: Callable[[str], bool] = lambda method: published_source(method) != "ablation",
    ) -> Table:
        chosen = self.methods if methods is None else methods
        return build_table(self.numbers, title, kind, columns, chosen, self.published, paper, self.protocol)


def overview(contents: Contents, everything: str) -> list[Table]:
    """Tables 1 and 3: one family beside the other, then what all of them cost."""
    families = {name: members for name, members in contents.families.items() if name != everything}
    within = {dataset for members in families.values() for dataset in members}
    groups = families | {name: m for name, m in contents.subjects.items() if len(m) == 1 and not within.issuperset(m)}
    whole = tuple(dict.fromkeys(dataset for members in groups.values() for dataset in members))
    if len(whole) < 2:
        return []
    columns = [c for name, members in groups.items() for c in over(members, score_columns(contents.metrics), name)]
    columns += over(whole, (FRAME_MS, TRAIN_SECONDS, MEGABYTES, FILE_MEGABYTES, *PAPER_SPEED), everything)
    return [contents.table("Overview", "overview", columns)]


def subjects(contents: Contents, _: str) -> list[Table]:
    """Everything that is known of a data set, or of the mean over a family; of a region, over those that have it."""
    tables = []
    for name, members in contents.subjects.items():
        known = main_columns(contents.metrics)
        columns = [replace(c, datasets=contents.numbers.having(members, c.region)) for c in known]
        tables.append(contents.table(name, "subject", columns))
    return tables


def scenes(contents: Contents, everything: str) -> list[Table]:
    """Tables 7 to 9: a score over the scenes of a family, with their mean."""
    tables = []
    for name, members in contents.families.items():
        if name != everything:
            inside = (in_region(PSNR, "near_field"), in_region(PSNR, "reflective"))
            for score in (*score_columns(contents.metrics), *inside):
                having = contents.numbers.having(members, score.region)
                if len(having) < 2:
                    continue
                columns = [c for d in having for c in over((d,), (score,), _scene(d, name))]
                columns += over(having, (score,), "mean")
                tables.append(contents.table(f"{name}: {score.title}", "scenes", columns))
    return [table for table in tables if any(cell.shown for row in table.rows for cell in row.cells.values())]


def _scene(dataset: str, family: str) -> str:
    """A data set's name within its family."""
    known = paper_scene(dataset)
    return known[1] if known else dataset.removeprefix(f"{family}/")


def regions(contents: Contents, _: str) -> list[Table]:
    """Table 2: every score inside every region."""
    tables = []
    for name, members in contents.subjects.items():
        columns: list[Column] = []
        for region in contents.numbers.regions(members):
            accuracies = (*score_columns(contents.metrics), NORMALS)
            inside = [replace(in_region(score, region), title=score.title) for score in accuracies]
            columns += over(contents.numbers.having(members, region), inside, region.replace("_", "-"))
        tables.append(contents.table(f"{name}: inside the regions", "regions", columns))
    return tables


def ablations(contents: Contents, _: str) -> list[Table]:
    """Table 4: the variants of a method, then the method itself, and by how much they differ over the same seeds."""
    tables = [table for full in _full_methods(contents) for table in _ablation(contents, full)]
    return [table for table in tables if len(table.rows) > 1]


def _ablation(contents: Contents, full: str) -> list[Table]:
    """The variants of one method, those without a part first; the paper's stand below those of its own recipe only."""
    name = contents.labels[full].name
    variants = [m for m in contents.methods if _full_of(contents, m) == name]
    parts = sorted(variants, key=lambda m: WITHOUT not in contents.labels[m].name)
    difference = replace(PSNR, title="Δ PSNR", against=full, explanation=f"minus {full}, seed by seed", ranked=False)
    names = contents.published or {}
    printed = published_source(names.get(full, "")) is not None and published_source(names[full]) != "ablation"
    tables = []
    for subject, members in contents.subjects.items():
        columns = list(over(members, (PSNR, difference, SSIM, LPIPS, FLIP)))
        for region in REGIONS_OF_ABLATION:
            having = contents.numbers.having(members, region)
            columns += over(having, (in_region(PSNR, region), in_region(difference, region))) if having else ()
        columns += over(members, (NORMALS,))
        title = f"{subject}: {full} and what it is without"
        tables.append(
            contents.table(
                title, "ablation", columns, [*parts, full], lambda m: printed and published_source(m) == "ablation"
            )
        )
    return tables


def _full_of(contents: Contents, row: str) -> str:
    """The name of the method of which the row leaves out or replaces a part; "" where it is a whole one itself."""
    name = contents.labels[row].name
    return contents.cards[row].variant_of or (name.partition(WITHOUT)[0] if WITHOUT in name else "")


def _full_methods(contents: Contents) -> list[str]:
    """The methods that some other is without a part; of several rows of one, as of a sweep, that with the most runs."""
    whole = tuple(dict.fromkeys(name for members in contents.subjects.values() for name in members))
    ablated = {_full_of(contents, row) for row in contents.methods if WITHOUT in contents.labels[row].name}
    found: dict[str, str] = {}
    for method in contents.methods:
        name = contents.labels[method].name
        if name in ablated:
            runs = contents.numbers.statuses(whole, method).total()
            if name not in found or runs > contents.numbers.statuses(whole, found[name]).total():
                found[name] = method
    return list(found.values())


def speeds(contents: Contents, _: str) -> list[Table]:
    """Table 6: frames a second, what else they cost, and what the picture pays for it."""
    tables = []
    for name, members in contents.subjects.items():
        printed = contents.published is not None
        timed = set(published_values(members, "full", "fps", contents.protocol)) if printed else set()
        columns = over(members, (*SPEED_COLUMNS, *PAPER_SPEED))
        tables.append(contents.table(f"{name}: speed and memory", "speed", columns, paper=timed.__contains__))
    return [table for table in tables if any(column.key == "frame_ms" for column in table.columns)]


@dataclass(frozen=True)
class Layout:
    """A kind of table: its heading on a page, whether it is unfolded there, and what makes its tables."""

    title: str
    tables: Callable[[Contents, str], list[Table]]
    unfolded: bool = False


LAYOUTS: Mapping[str, Layout] = {  # in the order in which a report shows them
    "overview": Layout("Overview", overview, unfolded=True),
    "subject": Layout("Data set by data set", subjects, unfolded=True),
    "scenes": Layout("Scene by scene", scenes),
    "regions": Layout("Inside the regions", regions),
    "ablation": Layout("What each part is worth", ablations, unfolded=True),
    "speed": Layout("Speed and memory", speeds),
}


def layouts(contents: Contents, everything: str) -> list[Table]:
    """Every table that has a number, in the order in which the report shows them.

    Args:
        everything: the name of the subject that holds all families, where there are several.
    """
    tables = [table for layout in LAYOUTS.values() for table in layout.tables(contents, everything)]
    return [table for table in tables if table.columns or (table.kind == "subject" and table.rows)]
