"""The extension built from targets.cpp."""

def supported() -> list[str]:
    """Names of the targets that this CPU runs, the best first."""
