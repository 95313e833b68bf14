"""Events: how a run says what it is doing, to whoever shows it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

# "stage" says what is being done; "step" and "steps" how much of how much is, where that is known; while training,
# "loss", "psnr" and "primitives" (set -> count) how the model stands; before the first step, "dropped_losses"
# (loss -> why) what is trained without, where that is anything; "warning", a `records.TrainingWarning` as a dictionary;
# once the data are loaded, and before the first step, "notes", a list of what was noticed of them and repaired.
Event = dict[str, Any]
EventListener = Callable[[Event], None]
