"""Cards: what a method says of itself in its records, and what stands in for that in records that say nothing."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from envgs_bench.parts import MethodCard
from envgs_bench.records import Record

LAST = 1_000_000  # the place of a method without a card: after all that have one, by name


def card_of(record: Record) -> MethodCard:
    """The record's card; of one that has none a card with the method's name alone, and no color."""
    card = record.card or MethodCard(family=record.method, label="", order=LAST, color="")
    return replace(card, label=card.label or record.method)


def newest_cards(records: Iterable[Record]) -> dict[str, MethodCard]:
    """Method's name -> the card of its newest record."""
    ordered = sorted(records, key=lambda record: record.provenance.finished)
    return {record.method: card_of(record) for record in ordered}
