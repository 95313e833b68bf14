"""Health: what a training shows when it goes wrong, noticed while it goes on, and the end of one that is hopeless.

Everything is judged when losses are read anyway, every few steps, so that no step waits for the device. What happens
for good reasons must not be taken for a failure: an opacity reset empties the pictures for some hundred steps, a
photograph may be darker than all others, an environment comes out of nothing. So a collapse counts once it has lasted.
"""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Mapping
from typing import Any

from torch import Tensor

from envgs_bench.core import View
from envgs_bench.memory import machine_memory, process_memory
from envgs_bench.methods.gaussians.parameters import DEGENERATE
from envgs_bench.methods.method import Method, Monitor
from envgs_bench.parts import ALPHA, BASE, BETA, ENV, REFLECTIVE
from envgs_bench.records import TrainingWarning, WarningKind

NON_FINITE_STEPS = 20  # in a row without a finite loss, or skipped, and the run has diverged
LOOK_EVERY = 50  # steps between two looks at pictures and memory
LASTING = (
    8  # looks in a row that make a collapse: longer than opacities take to come back after a reset; or half a short run
)
HOPELESS = 40  # looks in a row that end the run
PSNR_STEPS = 50  # whose median says how well the method does
LOOKED_AT = 256  # rows, and columns, of a picture that its PSNR in one color is told by
PSNR_DROP = 6.0  # dB below the best median so far
EMPTY = 0.05  # share of the largest coverage so far below which a picture is empty
SATURATED, ABSENT = 0.8, 0.005  # mean β where nothing reflects that is too much, and where mirrors are that is none
# The share of a set that must outlive a step. An environment starts as primitives at random: the first densification
# prunes more than half of them.
KEPT = {BASE: 0.5, ENV: 0.1}
DEGENERATES = 0.01  # share of a set's primitives that is too many: sound sets have a tenth of it at most
MIN_SET = 100  # primitives of a set below which its changes say nothing
MEMORY_SHARE = 0.95  # of the machine's memory that a run may take before it ends by itself


class Diverged(RuntimeError):
    """The model's loss or renders are not finite any more, or nothing of it is left to train."""


class Health:
    """The health of one training run.

    Attributes:
        warnings: what was noticed, the first of each kind and part.
    """

    def __init__(self, method: Method, steps: int) -> None:
        self.warnings: list[TrainingWarning] = []
        self._method, self._steps = method, steps
        self._monitor = method.monitor or Monitor()
        self._enough = max(3, min(LASTING, steps // (2 * LOOK_EVERY)))
        self._counts: dict[str, int] = {}
        self._non_finite = self._skipped = self._skipped_in_row = 0
        self._psnr: deque[float] = deque(maxlen=PSNR_STEPS)
        self._one_color: deque[float] = deque(maxlen=LASTING)
        self._best_psnr = self._best_alpha = -math.inf
        self._lasting: dict[str, int] = {}
        self._memory = MEMORY_SHARE * machine_memory()

    def count(self, step: int, counts: Mapping[str, int]) -> None:
        """Look at the sets after a step.

        Raises:
            Diverged: the base set is empty: nothing can grow again.
        """
        before, self._counts = self._counts, dict(counts)
        for name, count in counts.items():
            earlier = before.get(name, 0)
            if count == earlier or earlier < MIN_SET:
                continue
            if count < KEPT.get(name, KEPT[BASE]) * earlier and not self._monitor.prunes(step):
                self._warn("set_shrinks", step, name, f"from {earlier:,} to {count:,} primitives in one step")
            if count > 2 * earlier:
                self._warn("set_doubles", step, name, f"from {earlier:,} to {count:,} primitives in one step")
        if before.get(BASE) and not counts.get(BASE):
            raise Diverged(f"no primitive of the base set is left after step {step}")

    def expect(self, counts: Mapping[str, int]) -> None:
        """Take sizes for granted that a budget made of the sets between two steps."""
        self._counts = dict(counts)

    def read(self, step: int, losses: Mapping[str, float | Tensor]) -> tuple[float, float]:
        """Judge one step's losses; returns the total and the PSNR, NaN where there is none.

        Raises:
            Diverged: NON_FINITE_STEPS steps in a row (or all there are) had a loss that is not finite.
        """
        loss, psnr = float(losses["loss"]), float(losses.get("psnr", math.nan))
        if math.isfinite(psnr):
            self._psnr.append(psnr)
        if math.isfinite(loss):
            self._non_finite = 0
            return loss, psnr
        self._non_finite += 1
        terms = {name: float(value) for name, value in losses.items() if name not in ("loss", "psnr")}
        for name, value in ({n: v for n, v in terms.items() if not math.isfinite(v)} or {"loss": loss}).items():
            self._warn("non_finite", step, name, f"the loss {name} was {value}, and the step skipped")
        if self._non_finite >= min(NON_FINITE_STEPS, self._steps):
            raise Diverged(f"the loss was not finite in {self._non_finite} steps in a row, up to step {step}")
        return loss, psnr

    def count_skips(self, step: int, steps: int) -> None:
        """Look at how many of the last `steps` steps, up to `step`, were skipped.

        Raises:
            Diverged: NON_FINITE_STEPS in a row were.
        """
        skipped = int(self._method.skipped_steps)
        new, self._skipped = skipped - self._skipped, skipped
        self._skipped_in_row = self._skipped_in_row + new if new >= steps else 0
        for part in self._monitor.non_finite_gradients() if new else ():
            self._warn("non_finite", step, part, f"a gradient of {part} was not finite, and the step skipped")
        if self._skipped_in_row >= NON_FINITE_STEPS:
            raise Diverged(f"{self._skipped_in_row} steps in a row were skipped, up to step {step}")

    def state(self) -> dict[str, Any]:
        """What was found, and all that later judgments depend on: what `restore` becomes in another process."""
        return {
            "warnings": [warning.model_dump() for warning in self.warnings],
            "counts": self._counts,
            "non_finite": self._non_finite,
            "skipped": [self._skipped, self._skipped_in_row],
            "psnr": [list(self._psnr), self._best_psnr],
            "one_color": list(self._one_color),
            "best_alpha": self._best_alpha,
            "lasting": self._lasting,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Become what `state` returned of a run of as many steps."""
        self.warnings[:] = [TrainingWarning.model_validate(warning) for warning in state["warnings"]]
        self._counts, self._lasting = dict(state["counts"]), dict(state["lasting"])
        self._non_finite = state["non_finite"]
        self._skipped, self._skipped_in_row = state["skipped"]
        psnr, self._best_psnr = state["psnr"]
        self._psnr.extend(psnr)
        self._one_color.extend(state["one_color"])
        self._best_alpha = state["best_alpha"]

    def due(self, step: int) -> bool:
        """Whether `look` is due after this step."""
        return step % LOOK_EVERY == 0

    def look(self, step: int, view: View) -> None:
        """Look at what the last step drew, of `view`, how well the method does, its primitives' shapes and the memory.

        Raises:
            Diverged: the pictures have been empty, or far worse than they were, for HOPELESS looks.
            MemoryError: hardly any memory is left.
        """
        self._look_at_psnr(step, view)
        maps = self._monitor.last_maps()
        if ALPHA in maps:
            self._look_at_alpha(step, float(maps[ALPHA].float().mean()))
        if BETA in maps:
            self._look_at_beta(step, maps[BETA], view)
        self._look_at_sizes(step)
        self._look_at_shapes(step)
        self._look_at_memory(step)

    def _look_at_psnr(self, step: int, view: View) -> None:
        if len(self._psnr) < PSNR_STEPS:
            return
        psnr = statistics.median(self._psnr)
        self._one_color.append(one_color_psnr(view))
        least = statistics.median(self._one_color)
        text = f"a median PSNR of {psnr:.1f} dB over {PSNR_STEPS} steps, where views in one color have {least:.1f} dB"
        self._collapses("learns_nothing", psnr < least, step, text)
        self._best_psnr = max(self._best_psnr, psnr)
        text = f"a median PSNR of {psnr:.1f} dB over {PSNR_STEPS} steps, {self._best_psnr:.1f} dB before"
        self._collapses("loss_climbs", psnr < self._best_psnr - PSNR_DROP, step, text)

    def _look_at_alpha(self, step: int, alpha: float) -> None:
        self._best_alpha = max(self._best_alpha, alpha)
        text = f"the picture's mean alpha is {alpha:.4f}, at its best it was {self._best_alpha:.3f}"
        self._collapses("alpha_vanishes", alpha < EMPTY * self._best_alpha, step, text)

    def _look_at_beta(self, step: int, beta: Tensor, view: View) -> None:
        """β against the view's own mask of what reflects; where it has none, only that nearly all reflects is said."""
        mirrors = view.masks.get(REFLECTIVE)
        diffuse = beta if mirrors is None else beta[~mirrors.to(beta.device)]
        if diffuse.numel():
            mean = float(diffuse.mean())
            self._lasts("beta_saturates", mean > SATURATED, step, f"a mean β of {mean:.2f} where nothing reflects")
        if mirrors is not None and mirrors.any():
            mean = float(beta[mirrors.to(beta.device)].mean())
            self._lasts("beta_vanishes", mean < ABSENT, step, f"a mean β of {mean:.4f} on what reflects")

    def _look_at_sizes(self, step: int) -> None:
        caps = self._monitor.at_size_limit()
        for name in self._method.primitives():
            text = f"settings let it have {caps.get(name, 0):,} primitives and it has no fewer"
            self._lasts("size_limit", name in caps, step, text, part=name)

    def _look_at_shapes(self, step: int) -> None:
        for name, share in self._monitor.degenerate().items():
            text = f"{float(share):.1%} of the primitives are degenerate, {DEGENERATE:g} times as long as wide and more"
            self._lasts("degenerate", float(share) > DEGENERATES, step, text, part=name)

    def _look_at_memory(self, step: int) -> None:
        used = process_memory()
        if used > self._memory:
            text = (
                f"{used / 1e9:.1f} GB in use, {self._memory / 1e9:.1f} GB are the most that this machine leaves a run"
            )
            self._warn("budget", step, "", text)
            raise MemoryError(f"{text}; stopped after step {step} before the system would have")

    def _collapses(self, kind: WarningKind, wrong: bool, step: int, text: str) -> None:
        """As `_lasts`, and the end of a run that it lasts on in, unless that has no step left to lose."""
        self._lasts(kind, wrong, step, text)
        if self._lasting[kind] >= HOPELESS and step < self._steps:
            raise Diverged(f"{text}; it has been so for {HOPELESS * LOOK_EVERY} steps, up to step {step}")

    def _lasts(self, kind: WarningKind, wrong: bool, step: int, text: str, part: str = "") -> None:
        what = f"{kind} {part}".rstrip()
        self._lasting[what] = self._lasting.get(what, 0) + 1 if wrong else 0
        if self._lasting[what] == self._enough:
            self._warn(kind, step, part, f"{text}, for {self._enough * LOOK_EVERY} steps")

    def _warn(self, kind: WarningKind, step: int, part: str, message: str) -> None:
        for index, warning in enumerate(self.warnings):
            if (warning.kind, warning.part) == (kind, part):
                self.warnings[index] = warning.model_copy(update={"times": warning.times + 1})
                return
        self.warnings.append(TrainingWarning(kind=kind, step=step, part=part, message=message))


def one_color_psnr(view: View) -> float:
    """The PSNR of the view in its own mean color, dB: a picture that shows nothing. At most 100 dB.

    Of a large picture so many of its pixels tell it as well as all.
    """
    height, width = view.image.shape[:2]
    some = view.image[:: max(1, height // LOOKED_AT), :: max(1, width // LOOKED_AT)]
    variance = float((some.float() / 255).var(dim=(0, 1), correction=0).mean())
    return -10 * math.log10(max(variance, 1e-10))
