"""What methods say of themselves to reports, and that records carry it."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from envgs_bench.cli.composition import composed
from envgs_bench.methods.configurations import CONFIGURED
from envgs_bench.methods.registry import BUILT_IN, method_class
from envgs_bench.methods.two_d_gs import TwoDGS
from envgs_bench.records import Failure, read_record
from envgs_bench.runs import descriptions
from envgs_bench.runs.descriptions import card_of
from envgs_bench.runs.draft import Draft


def test_every_method_has_a_card_of_its_own() -> None:
    cards = [vars(method_class(kind)).get("card") for kind in BUILT_IN]
    assert all(card is not None and re.fullmatch("#[0-9A-F]{6}", card.color) for card in cards)
    assert len({card.order for card in cards}) == len({card.label for card in cards}) == len(cards)


class Inherits(TwoDGS):
    pass


def test_a_subclass_shares_its_parents_family_and_not_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(descriptions, "method_class", lambda kind: Inherits)
    assert card_of("another", "another:Inherits") == replace(TwoDGS.card, label="")


def test_what_configurations_say_is_said_of_some_and_in_one_order() -> None:
    known = {path.stem for path in descriptions.CONFIGURATIONS.glob("*.yaml")} | set(BUILT_IN)
    assert set(CONFIGURED) <= known
    cards = {name: composed([f"method={name}"]).method for name in CONFIGURED}
    found = [card_of(name, method.kind) for name, method in cards.items()]
    assert len({card.order for card in found if card is not None}) == len(CONFIGURED)


def test_a_ladder_has_a_baseline_and_a_part_a_step() -> None:
    steps = {own["step"]: own.get("adds", "") for own in CONFIGURED.values() if own.get("ladder") == "envgs"}
    assert sorted(steps) == list(range(len(steps)))
    assert [step for step, adds in steps.items() if not adds] == [0]


def test_a_record_carries_the_card(tmp_path: Path) -> None:
    settings = composed(["method=envgs_lean", "dataset=toy/chrome_room"])
    Draft(tmp_path, settings).write("failed", Failure(type="ValueError", message="stopped", log_tail=""))
    card = read_record(tmp_path).card
    assert card is not None
    assert (card.family, card.label, card.reflects) == ("envgs", "EnvGS", True)
