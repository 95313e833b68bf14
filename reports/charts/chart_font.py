"""The charts' font: what Latin text, Greek and arrows need of DejaVu Sans, in a file that embeds fast."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from functools import cache
from pathlib import Path

import matplotlib as mpl
from matplotlib import font_manager

FAMILY = "DejaVu Sans"
RANGES = ((0x20, 0x17F), (0x370, 0x3FF), (0x2010, 0x2044), (0x2070, 0x209F), (0x2190, 0x21FF), (0x2212, 0x2265))


@cache
def chart_fonts() -> list[str]:
    """The families to ask for: the small one first, the whole one for whatever it lacks.

    A PDF brings the glyphs that it uses. To pick them out of the whole font takes longer than to draw a chart.
    """
    from fontTools import subset

    source = Path(mpl.get_data_path()) / "fonts/ttf/DejaVuSans.ttf"
    options = subset.Options(
        layout_features=[],
        name_IDs=[1, 2, 4, 6],
        glyph_names=True,
        drop_tables=["FFTM", "GSUB", "GPOS", "GDEF", "kern"],
    )
    font = subset.load_font(str(source), options)
    chosen = subset.Subsetter(options)
    chosen.populate(unicodes=[code for low, high in RANGES for code in range(low, high + 1)])
    chosen.subset(font)
    for number, name in ((1, f"{FAMILY} Chart"), (4, f"{FAMILY} Chart"), (6, "DejaVuSansChart")):
        font["name"].setName(name, number, 3, 1, 0x409)
    folder = Path(tempfile.mkdtemp(prefix="envgs-bench-font-"))  # read again for every file, so it stays until the end
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    font.save(folder / "chart.ttf")
    font_manager.fontManager.addfont(folder / "chart.ttf")
    return [f"{FAMILY} Chart", FAMILY]
