"""Budget of a run: its method, made to stay within it."""

from __future__ import annotations

from envgs_bench.methods.method import Budget, Method
from envgs_bench.methods.registry import create_method
from envgs_bench.records import ELSEWHERE
from envgs_bench.settings import RunSettings, SettingsError


def limited_method(settings: RunSettings, device: str) -> Method:
    """A new method of these settings, limited where the run has a budget.

    Raises:
        ValueError: settings that the method does not have, or a budget that it cannot stay within.
    """
    method = create_method(settings.method.kind, settings.method.settings, device, settings.seed)
    if settings.budget is not None:
        method.limit(Budget(**settings.budget.model_dump()))
    return method


def check_budget(settings: RunSettings) -> None:
    """Raise a SettingsError where the run has a budget that its method cannot stay within."""
    if settings.budget is None:
        return
    if settings.method.kind in ELSEWHERE:
        raise SettingsError(
            f"method {settings.method.kind} trains no model of ours that a budget could limit: run it without budget"
        )
    try:
        limited_method(settings, "cpu")
    except ValueError as error:
        raise SettingsError(f"method {settings.method.name}: {error}") from error
