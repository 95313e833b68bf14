"""Cards: what methods and metrics say of themselves in records, and what stands in where records say nothing."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from envgs_bench.parts import MethodCard, MetricCard
from envgs_bench.records import Record

PLAIN = {  # of records without cards of metrics
    "psnr": MetricCard("PSNR", 2, "higher", "dB", "peak signal-to-noise ratio, dB"),
    "ssim": MetricCard("SSIM", 3, "higher", explanation="structural similarity"),
    "flip": MetricCard("FLIP", 3, "lower", explanation="perceived difference, FLIP"),
    "lpips": MetricCard("LPIPS", 3, "lower", explanation="learned perceptual distance"),
}
KNOWN = PLAIN | {f"cc_{name}": replace(PLAIN[name], corrected=True) for name in ("psnr", "ssim", "lpips")}
LAST = 1_000_000  # the place of a method without a card: after all that have one, by name


def card_of(record: Record) -> MethodCard:
    """The record's card; of one that has none a card with the method's name alone, and no color."""
    card = record.card or MethodCard(family=record.method, label="", order=LAST, color="")
    return replace(card, label=card.label or record.method)


def newest_cards(records: Iterable[Record]) -> dict[str, MethodCard]:
    """Method's name -> the card of its newest record."""
    ordered = sorted(records, key=lambda record: record.provenance.finished)
    return {record.method: card_of(record) for record in ordered}


def metric_cards(records: Iterable[Record]) -> dict[str, MetricCard]:
    """Metric's name -> its card in the newest record that has one; `KNOWN` ones stand first."""
    ordered = sorted(records, key=lambda record: record.provenance.finished)
    found = (record.metrics.cards for record in ordered if record.metrics is not None)
    return KNOWN | {name: card for cards in found for name, card in cards.items()}
