"""The paper's numbers beside ours: its averages from its own scenes, its layouts, its names for our methods."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path

import pandas as pd
import pytest
from reports_runs import METHODS, record, row_of, sections_of, titled, titles, write_record, write_runs

from envgs_bench.parts import MethodCard
from envgs_bench.records import RENDERS
from envgs_bench.reports.numbers.decimals import rounded
from envgs_bench.reports.numbers.estimates import Numbers
from envgs_bench.reports.numbers.published import (
    paper_method,
    paper_scene,
    paper_tables,
    printed_by,
    published_source,
    published_values,
)
from envgs_bench.reports.tables.columns import PSNR, over
from envgs_bench.reports.tables.entries import entries, headings
from envgs_bench.reports.tables.notes import notes
from envgs_bench.reports.tables.table import build_table


def other_protocol() -> dict[str, str]:
    return {"name": "strict", "hash": "0123", "description": "8 bits"}


def test_table_7_averages_to_every_psnr_of_tables_1_and_5() -> None:
    """The builder over the per-scene table gives the printed means exactly: decimals, halves up."""
    rows = paper_tables().query("table == '7' and metric == 'psnr' and value != ''")
    tidy = pd.DataFrame(
        {
            "dataset": rows["dataset"] + "/" + rows["scene"],
            "method": rows["method"],
            "seed": 0,
            "region": "full",
            "metric": "psnr",
            "value": rows["value"].astype(float),
        }
    )
    numbers = Numbers(tidy, tidy.assign(status="ok")[["dataset", "method", "seed", "status"]])
    printed = paper_tables().query("metric == 'psnr' and table in ('1', '5') and value != ''")
    checked = 0
    for table, dataset, method, value in printed[["table", "dataset", "method", "value"]].to_numpy():
        members = [name for name in tidy["dataset"].unique() if name.split("/")[0] in dataset.split("+")]
        if method in ("ENVIDR", "NDE"):  # Table 7 does not have them
            continue
        average = build_table(numbers, dataset, "subject", over(members, [PSNR]), [method]).rows[0].cells["psnr"]
        assert average.complete
        assert str(rounded(average.mean, 3)) == value, (table, dataset, method)
        checked += 1
    assert checked == 19  # 9 methods on 2 data sets, and EnvGS on all 7 scenes


def test_unreadable_cells_of_the_paper_are_empty() -> None:
    rows = paper_tables()
    unreadable = rows[rows["note"].str.startswith("unreadable")]
    assert len(unreadable) == 9
    assert (unreadable["value"] == "").all()
    assert "EnvGS" not in published_values(("Ref-Real/sedan",), "full", "lpips")


@pytest.mark.parametrize(
    ("name", "scene"),
    [
        ("Ref-Real/sedan", ("Ref-Real", "sedan")),
        ("ref_real-gardenspheres", ("Ref-Real", "spheres")),
        ("nerf_casting-toaster", ("NeRF-Casting", "toaster")),
        ("shiny_blender-toaster", ("Shiny-Blender", "toaster")),
        ("mipnerf360/garden", ("Mip-NeRF-360", "garden")),
        ("ref_real_8/sedan", ("Ref-Real ÷8", "sedan")),
        ("garden", None),  # anybody's garden
        ("toy/chrome_room", None),
    ],
)
def test_a_paper_scene_needs_its_family(name: str, scene: tuple[str, str] | None) -> None:
    assert paper_scene(name) == scene


def test_each_protocol_of_ref_real_has_its_own_numbers() -> None:
    """EnvGS's paper prints the car at a quarter; the numbers of the car at an eighth are others'."""
    others = ("ref_real/spheres", "ref_real/toycar")
    quarter, eighth = (
        published_values((sedan, *others), "full", "psnr") for sedan in ("ref_real/sedan", "ref_real_8/sedan")
    )
    assert (quarter["3DGS"], eighth["3DGS"]) == (Decimal("23.700"), Decimal("23.85"))
    assert "EnvGS" in quarter
    assert "EnvGS" not in eighth
    assert (eighth["SV"], eighth["Ref-GS"]) == (Decimal("23.91"), Decimal("23.81"))
    assert not published_values(("ref_real_8/sedan", "ref_real/sedan", *others), "full", "psnr")
    assert "ZipNeRF" in published_values(others, "full", "psnr")
    assert "retrained" in printed_by(("ref_real_8/sedan",))
    assert printed_by(("ref_real/sedan",)) == "in the EnvGS paper"


def test_published_psnr_stands_beside_ours(tmp_path: Path) -> None:
    write_runs(tmp_path, ("Ref-Real/sedan",), (*METHODS, "envgs_paper"), seeds=(0,), pictures=False)
    table = titled(sections_of(tmp_path)[0], "Ref-Real/sedan")
    column = titles(table).index("PSNR paper (Δ)")
    printed = (
        paper_tables().query("table == '7' and scene == 'sedan' and metric == 'psnr'").set_index("method")["value"]
    )
    ours = row_of(table, "envgs_paper").cells["psnr"].mean
    assert ours is not None
    expected = f"{printed['EnvGS']} ({rounded(ours, 3) - Decimal(printed['EnvGS']):+})".replace("-", "−")
    assert entries(table, row_of(table, "envgs_paper"))[column].text == expected
    assert not row_of(table, "envgs").published  # as this project configures it
    assert not row_of(table, "envmap").published
    assert entries(table, row_of(table, "ZipNeRF"))[column].text == printed["ZipNeRF"]
    assert row_of(table, "ZipNeRF").runs_text == "published, not real-time"
    assert row_of(table, "3DGS-DR").runs_text == "published"
    assert {"SSIM paper (Δ)", "LPIPS paper (Δ)"} <= set(titles(table))
    write_runs(tmp_path / "strict", ("Ref-Real/sedan",), seeds=(0,), pictures=False, protocol=other_protocol())
    strict = next(s for s in sections_of(tmp_path) if s.protocol.name == "strict")
    assert not strict.tables[0].published


def test_printed_means_stand_beside_ours_where_the_paper_prints_them(tmp_path: Path) -> None:
    """Tables 1, 2, 4 and 5: means over just these scenes, whatever the scenes' own cells say."""
    real = tuple(f"ref_real/{scene}" for scene in ("sedan", "toycar", "spheres"))
    casting = tuple(f"nerf_casting/{scene}" for scene in ("compact", "grinder", "hatchback", "toaster"))
    methods = ("3dgs", "envmap_paper", "envgs_paper", "envgs_paper_no_joint")
    write_runs(tmp_path, real + casting, methods, seeds=(0,), pictures=False)
    (section,) = sections_of(tmp_path)
    overview = titled(section, "Overview")
    names = titles(overview)
    assert {"Ref-Real PSNR ↑", "NeRF-Casting PSNR ↑", "all data sets paper FPS", "all data sets paper train h"} <= set(
        names
    )
    line = [entry.text for entry in entries(overview, row_of(overview, "envgs_paper"))]
    assert line[names.index("Ref-Real LPIPS paper (Δ)")] == "0.241"  # its scenes' cells cannot be read
    assert line[names.index("all data sets paper FPS")] == "26.221"
    published_only = [row.method for row in overview.rows if not row.attempts]
    assert {"Ref-NeRF*", "UniSDF", "ZipNeRF", "NeRF-Casting", "GaussianShader", "3DGS-DR"} <= set(published_only)
    assert not any(published_source(name) == "ablation" for name in published_only)
    everything = titled(section, "all data sets")
    assert {"ENVIDR", "NDE"} <= {row.method for row in everything.rows}
    regions = titled(section, "all data sets: inside the regions")
    assert row_of(regions, "envgs_paper").published["near-field: psnr_near_field"] == Decimal("46.392")
    assert row_of(regions, "envgs_paper").published["reflective: psnr_reflective"] == Decimal("33.295")
    ablation = titled(section, "Ref-Real: envgs_paper and what it is without")
    assert [row.method for row in ablation.rows][:3] == ["envgs_paper_no_joint", "envmap_paper", "envgs_paper"]
    assert row_of(ablation, "envgs_paper_no_joint").published["psnr"] == Decimal("24.034")
    assert row_of(ablation, "envmap_paper").published["psnr"] == Decimal("24.145")
    assert "w/o color sabotage" in {row.method for row in ablation.rows}


@pytest.mark.parametrize("region", ["reflective", "foreground"])
def test_the_papers_foreground_is_what_of_it_reflects(region: str) -> None:
    """Table 2: its mask is rendered from the primitives of the reflecting foreground (App. A.1)."""
    scenes = {
        "ref_real": ("sedan", "toycar", "spheres"),
        "nerf_casting": ("compact", "grinder", "hatchback", "toaster"),
    }
    datasets = tuple(f"{family}/{scene}" for family, names in scenes.items() for scene in names)
    values = published_values(datasets, region, "psnr")
    assert values["3DGS"] == Decimal("31.681")
    assert values["3DGS-DR"] == Decimal("31.814")
    assert not published_values(datasets[:1], region, "psnr")  # printed as a mean alone


def test_our_own_methods_have_no_row_of_the_paper_below_them(tmp_path: Path) -> None:
    """What its recipe is without, the paper printed of its recipe."""
    scenes = tuple(f"ref_real/{scene}" for scene in ("sedan", "toycar", "spheres"))
    write_runs(tmp_path, scenes, ("envgs", "envgs_no_joint", "envgs_paper"), seeds=(0,), pictures=False)
    (section,) = sections_of(tmp_path)
    ablation = titled(section, "Ref-Real: envgs and what it is without")
    assert [row.method for row in ablation.rows] == ["envgs_no_joint", "envgs"]
    assert not ablation.published
    with pytest.raises(StopIteration):
        titled(section, "Ref-Real: envgs_paper and what it is without")
    assert any("as its authors have it" in line for line in notes(section, titled(section, "Ref-Real")))


def test_scenes_stand_side_by_side_as_in_tables_7_to_9(tmp_path: Path) -> None:
    blender = tuple(f"shiny_blender/{scene}" for scene in ("ball", "car", "coffee", "helmet", "teapot", "toaster"))
    write_runs(tmp_path, blender, ("3dgs", "envgs_paper"), seeds=(0,), pictures=False)
    table = titled(sections_of(tmp_path)[0], "Shiny-Blender: PSNR")
    groups = [heading.group for heading in headings(table)[2::2]]
    assert groups == [name.split("/")[1] for name in blender] + ["mean"]
    assert row_of(table, "3iGS").published["ball: psnr"] == Decimal("27.640")
    assert rounded(row_of(table, "envgs_paper").published["mean: psnr"], 3) == Decimal("33.826")


def test_the_filters_rows_are_those_of_table_6(tmp_path: Path) -> None:
    for share in (0.0, 0.5, 0.9):
        for name, loss in (("envgs", "l1_cos"), ("envgs_paper", "cos")):
            settings = {"beta_filter": share, "mono_loss": loss}
            config = {"method": {"name": name, "settings": settings}, "dataset": {"kind": "toy"}}
            write_record(tmp_path / f"{name}-{share}", record("nerf_casting/hatchback", name, 0, config=config))
    (section,) = sections_of(tmp_path)
    assert sorted(section.sweeps) == [
        [f"{name} [beta_filter={share}]" for share in (0.0, 0.5, 0.9)] for name in ("envgs", "envgs_paper")
    ]
    table = titled(section, "nerf_casting/hatchback: speed and memory")
    names = titles(table)
    column = names.index("PSNR paper (Δ)"), names.index("paper FPS")
    printed = {row.method: [entries(table, row)[i].text for i in column] for row in table.rows}
    assert printed["envgs_paper [beta_filter=0.5]"][0].startswith("27.137 (")
    assert printed["envgs_paper [beta_filter=0.0]"][1] == "32.259"
    assert printed["envgs [beta_filter=0.5]"] == printed["envgs [beta_filter=0.0]"] == ["", ""]
    assert printed["w/ PyTorch"][1] == "1/6,158"
    assert "w/ 75% weight filtering" in printed
    assert "Ref-NeRF*" not in printed  # the paper has no frame rate of it on this scene


@pytest.mark.parametrize(
    "row",
    [
        "envgs_paper [beta_filter=0.5, steps=800]",
        "envgs_paper [beta_filter=unset]",
        "envgs [beta_filter=0.5]",
        "envgs [beta_filter=0.0]",
        "envmap_paper [beta_filter=0.5]",
        "2dgs [beta_filter=0.5]",
    ],
)
def test_filters_that_the_paper_did_not_test_are_no_rows_of_its_table_6(row: str) -> None:
    assert named(row) == row


def named(row: str, kind: str = "") -> str:
    name = row.split(" [", maxsplit=1)[0]
    return paper_method(row, MethodCard(name, name, 0, "", **CARDS.get(name, {})), kind)


CARDS = {"envgs_paper": {"published": "EnvGS"}, "envmap_paper": {"published": "w/ environment map"}}


def test_every_method_of_the_paper_has_one_name() -> None:
    assert named("envgs_paper [beta_filter=0.75]") == "w/ 75% weight filtering"
    assert named("envgs_paper") == named("EnvGS", RENDERS) == "EnvGS"
    assert named("envgs") == "envgs"
    assert named("zip-nerf", RENDERS) == "ZipNeRF"
    assert named("zip-nerf") == "zip-nerf"
    assert named("my method", RENDERS) == "my method"
    assert published_source("NDE") == "non_realtime"
    assert published_source("my method") is None
    assert published_source("3iGS") == "realtime"


def test_a_table_says_what_methods_were_given(tmp_path: Path) -> None:
    given = {"2dgs": [], "envgs": ["normals"], "envmap": ["normals", "masks of mirrors and glass"]}
    for method, words in given.items():
        content = record("toy/glass", method, 0, given=words)
        write_record(tmp_path / "runs" / "toy-glass" / method / "seed0-0000", content)
    (section,) = sections_of(tmp_path)
    said = [line for line in notes(section, titled(section, "toy/glass")) if line.startswith("Given")]
    assert said == [
        "Given besides photographs, poses and points: envmap: normals, masks of mirrors and glass; envgs: normals."
    ]


SCENES = ("bicycle", "bonsai", "counter", "flowers", "garden", "kitchen", "room", "stump", "treehill")


@pytest.mark.parametrize(("metric", "places"), [("psnr", 2), ("ssim", 3), ("lpips", 3)])
def test_scenes_of_nerfbaselines_average_to_its_means(metric: str, places: int) -> None:
    """Which are of unrounded numbers: off by a last digit at most."""
    each = [published_values((f"mipnerf360/{scene}",), "full", metric, "nerfbaselines") for scene in SCENES]
    printed = published_values(tuple(f"mipnerf360/{scene}" for scene in SCENES), "full", metric, "nerfbaselines")
    assert len(printed) == 17
    for method, value in printed.items():
        assert abs(sum(values[method] for values in each) / len(each) - value) < Decimal(10) ** -places


def test_numbers_of_nerfbaselines_stand_beside_runs_of_its_protocol_alone(tmp_path: Path) -> None:
    for protocol in ("nerfbaselines", "nerfbaselines-8bit", "strict"):
        own = {"name": protocol, "hash": protocol, "description": protocol}
        methods = ("3dgs", "3dgs_tuned")
        write_runs(tmp_path / protocol, ("mipnerf360/garden",), methods, seeds=(0,), pictures=False, protocol=own)
    found = {section.protocol.name: section for section in sections_of(tmp_path)}
    for name in ("nerfbaselines", "nerfbaselines-8bit"):
        table = titled(found[name], "mipnerf360/garden")
        assert row_of(table, "3dgs").published["psnr"] == Decimal("27.34")
        assert not row_of(table, "3dgs_tuned").published
        assert row_of(table, "gsplat").runs_text == "published"
        assert any("printed by nerfbaselines (e1c9749)" in note for note in notes(found[name], table))
    assert not found["strict"].tables[0].published
