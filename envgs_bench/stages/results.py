"""Results: what a run has reached so far."""

from __future__ import annotations

from dataclasses import dataclass, field

from envgs_bench.records import (
    Cost,
    MaskedScores,
    Metrics,
    ProgramRun,
    RepairOutcome,
    Timing,
    TrainingWarning,
    WorldPlacement,
)


@dataclass
class Results:
    """The parts of a run's record that its stages fill in; what was reached stays, however the run ends."""

    dataset: str  # the configured name; once the data are loaded, the scene's own
    steps: int
    placement: WorldPlacement | None = None  # of the world that is learned in
    attributes: dict[str, float] = field(default_factory=dict)  # of the scene
    went_on_from: list[int] = field(default_factory=list)  # steps of the snapshots that an interrupted run went on from
    notes: list[str] = field(default_factory=list)
    repairs: list[RepairOutcome] = field(default_factory=list)
    given: list[str] = field(default_factory=list)
    losses: list[str] = field(default_factory=list)
    dropped_losses: dict[str, str] = field(default_factory=dict)
    warnings: list[TrainingWarning] = field(default_factory=list)
    metrics: Metrics | None = None
    masked: dict[str, MaskedScores] = field(default_factory=dict)
    unseen: dict[str, Metrics] = field(default_factory=dict)
    timing: Timing | None = None
    cost: Cost | None = None
    program: ProgramRun | None = None
