"""Draft: a record while its run is under way. It can be written at any moment, with whatever was reached by then."""

from __future__ import annotations

import shlex
from datetime import UTC, datetime
from pathlib import Path

from envgs_bench.metrics import get_protocol
from envgs_bench.records import Failure, ProtocolName, Provenance, Record, Status, write_record
from envgs_bench.run_folder import run_id_of
from envgs_bench.settings import RunSettings
from envgs_bench.stages.perturbations import perturbation_of
from envgs_bench.stages.results import Results

from . import provenance
from .descriptions import card_of, described
from .identity import data_hash
from .log import shortened

NOTHING_SAVED = "interrupted before anything was saved; the same command starts it again"


class Draft:
    """The record-to-be of the run in `folder`."""

    def __init__(self, folder: Path, settings: RunSettings) -> None:
        self.folder = folder
        self.settings = settings
        self.started = now()
        self.busy = provenance.busy()
        self.checkout = provenance.checkout()
        self.results = Results(settings.dataset_name, settings.steps)

    def write(self, status: Status, failure: Failure | None = None) -> Record:
        """Write record.json; the record that was written."""
        settings, results = self.settings, self.results
        protocol = get_protocol(settings.protocol)
        source = self.checkout | provenance.collect(settings.device, self.busy)
        source["command"] = shlex.join(["envgs-bench", "run", *settings.overrides])  # the user's, not this process's
        source["method"] = described(settings.method.name, settings.method.kind)
        if failure is not None:
            failure = failure.model_copy(update={"message": shortened(failure.message)})
        if results.went_on_from:
            source["went_on_from_steps"] = results.went_on_from
        record = Record(
            status=status,
            error=failure,
            method=settings.method_name,
            kind=settings.method.kind,
            card=card_of(settings.method.name, settings.method.kind),
            dataset=results.dataset,
            data=data_hash(settings),
            placement=results.placement,
            attributes=results.attributes,
            seed=settings.seed,
            steps=results.steps,
            run_id=run_id_of(self.folder),
            overrides=settings.overrides,
            config=settings.model_dump(mode="json"),
            protocol=ProtocolName(name=protocol.name, hash=protocol.hash, description=protocol.description),
            scored_on=settings.score_on,
            perturbation=perturbation_of(settings),
            repair=settings.repair,
            repairs=results.repairs,
            warnings=results.warnings,
            notes=[shortened(text) for text in results.notes],
            given=results.given,
            losses=results.losses,
            dropped_losses={loss: shortened(why) for loss, why in results.dropped_losses.items()},
            metrics=results.metrics,
            masked=results.masked,
            unseen=results.unseen,
            timing=results.timing,
            cost=results.cost,
            program=results.program,
            provenance=Provenance(**source, started=self.started, finished=now()),
        )
        write_record(self.folder, record)
        return record


def now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
