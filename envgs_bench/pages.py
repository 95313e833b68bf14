"""Pages of the documentation that messages lead to. They are installed with the program, as Markdown."""

from __future__ import annotations

from pathlib import Path

DOCS = Path(__file__).parent / "docs"
FAILED = "how_to/it_failed"
OF_ERRORS = {  # an error's class, by its name as records have it -> the page on what it is about
    "DatasetError": "reference/data_sets",
    "CountsError": "reference/sampled_scenes",
    "FetchError": "reference/paper",
    "SettingsError": "reference/settings",
    "RendersError": "how_to/other_programs",
    "PredictionsError": "how_to/other_programs",
    "RecipeError": "tutorials/other_program",
    "RecordError": "reference/records",
    "PictureError": "reference/records",
    "WeightsUnavailable": "reference/measuring",
    "TableError": "how_to/add_table",
    "FigureError": "reference/reports",
    "RunsFileError": "how_to/add_table",
    "NoRunsError": "how_to/add_table",
    "MarksError": "reference/faithful",
}


def page(name: str) -> str:
    """Where a page lies, as `how_to/masks`."""
    return str(DOCS / f"{name}.md")


def help_at(name: str) -> str:
    """A line that leads to a page, as `how_to/masks`."""
    return f"what helps: {page(name)}"


def help_on(error: str) -> str:
    """A line that leads from an error, by its class's name, to the page that helps."""
    return help_at(OF_ERRORS.get(error, FAILED))
