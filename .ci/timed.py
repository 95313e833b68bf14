"""How long a part of the checks took, and a failure where that is by half more than its bound.

    python3 .ci/timed.py NAME SECONDS COMMAND ...

Bounds hold for two cores of an AMD EPYC of the first generation with nothing beside. A slower machine's are longer by
the ratio of a fixed loop's times, measured before and after. The command's last line is printed last.
"""

from __future__ import annotations

import subprocess
import sys
import time

REFERENCE = 0.11  # seconds of the loop on that processor, by the ratio of compile times there and on a Xeon of 2023
TOLERANCE = 1.5


def loop() -> float:
    """Seconds of the loop: the least of three."""
    times = []
    for _ in range(3):
        began, total = time.perf_counter(), 0
        for number in range(1_500_000):
            total += number * number % 7
        times.append(time.perf_counter() - began)
    return min(times)


def main(name: str, bound: float, command: list[str]) -> int:
    """Run the command, its output passed on; its exit status, or 1 where it took too long."""
    first, began, held = loop(), time.perf_counter(), ""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            print(held, end="", flush=True)
            held = line
    seconds, ratio = time.perf_counter() - began, max(1.0, (first + loop()) / 2 / REFERENCE)
    allowed = bound * ratio * TOLERANCE
    print(f"{name}: {seconds:.0f} s, bound {bound:g} s times {ratio:.2f} for this machine, at most {allowed:.0f} s")
    if seconds > allowed:
        print(f"{name} took too long: make it quicker, or say in .ci/ why its bound is another")
    print(held, end="", flush=True)
    return process.returncode or int(seconds > allowed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], float(sys.argv[2]), sys.argv[3:]))
