"""The extension built from targets.cpp."""

SOURCES_DIGEST: str  # of all sources of the backend, when it was compiled

def supported() -> list[str]:
    """Names of the targets that this CPU runs, the best first."""
