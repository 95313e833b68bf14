"""The page's part on methods: what each is, its settings, and the code that ran it, from records alone."""

from __future__ import annotations

from collections import Counter
from typing import Any

from ..tables.sections import Section


def method_parts(section: Section, prefix: str) -> list[dict[str, Any]]:
    """What the template shows of each method; `prefix` begins the names of their places in the page."""
    parts = []
    for number, name in enumerate(section.methods):
        records = [item.run.record for item in section.runs if item.method == name]
        newest = max(records, key=lambda record: record.provenance.finished)
        sources = {(record.provenance.version, record.provenance.commit) for record in records}
        settings = section.settings[name]
        parts.append(
            {
                "id": f"{prefix}-{number}",
                "name": name,
                "label": section.card(name).label,
                "kind": newest.kind,
                "sentence": (newest.provenance.model_extra or {}).get("method", ""),
                "commits": ", ".join(
                    f"{version}{f' ({commit[:12]})' if commit else ''}" for version, commit in sources
                ),
                "runs": ", ".join(f"{n} {s.replace('_', ' ')}" for s, n in Counter(r.status for r in records).items()),
                "losses": ", ".join(newest.losses),
                "settings": [(key, value) for key, value in sorted(settings.items()) if key != "kind"],
            }
        )
    return parts
