"""How long parts of the checks took, and a failure where one is by half more than its bound.

    python3 .ci/timed.py NAME SECONDS COMMAND ... [-- NAME SECONDS COMMAND ...]

Several run side by side. What they print is then shown one after the other, with what failed at the end. Bounds hold
for two cores of an AMD EPYC of the first generation with nothing but those beside. A slower machine's are longer by
the ratio of a fixed loop's times, measured before and after. A command's last line is printed after its time.
"""

from __future__ import annotations

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import groupby

REFERENCE = 0.11  # seconds of the loop on that processor, by the ratio of compile times there and on a Xeon of 2023
TOLERANCE = 1.5
BESIDE = "--"  # between parts that run side by side


@dataclass(frozen=True)
class Part:
    """A part of the checks; where it is alone, what it prints is passed on at once."""

    name: str
    bound: float  # seconds
    command: list[str]
    alone: bool

    def carry_out(self) -> Ended:
        began, lines = time.perf_counter(), [""]
        errors = None if self.alone else subprocess.STDOUT
        with subprocess.Popen(self.command, stdout=subprocess.PIPE, stderr=errors, text=True) as process:
            assert process.stdout is not None
            for line in process.stdout:
                if self.alone:
                    print(lines.pop(), end="", flush=True)
                lines.append(line)
        return Ended(self, process.returncode, time.perf_counter() - began, lines)


@dataclass(frozen=True)
class Ended:
    """A part that has ended: its exit status, its seconds, the lines that are still to be shown."""

    part: Part
    status: int
    seconds: float
    lines: list[str]

    def show(self, ratio: float) -> int:
        """Print its lines and its time; its exit status, or 1 where it took too long."""
        name, bound, allowed = self.part.name, self.part.bound, self.part.bound * ratio * TOLERANCE
        if not self.part.alone:
            print(f"--- {name} ---")
        print("".join(self.lines[:-1]), end="")
        print(f"{name}: {self.seconds:.0f} s, bound {bound:g} s times {ratio:.2f} for this machine, ", end="")
        print(f"at most {allowed:.0f} s")
        if self.seconds > allowed:
            print(f"{name} took too long: make it quicker, or say in .ci/ why its bound is another")
        if self.status:
            print(f"{name} failed with exit status {self.status}")
        print(self.lines[-1], end="", flush=True)
        return self.status or int(self.seconds > allowed)


def loop() -> float:
    """Seconds of the loop: the least of three."""
    times = []
    for _ in range(3):
        began, total = time.perf_counter(), 0
        for number in range(1_500_000):
            total += number * number % 7
        times.append(time.perf_counter() - began)
    return min(times)


def main(arguments: list[str]) -> int:
    """Carry out the parts; the exit status of one that failed, or 1 where one took too long."""
    given = [list(words) for between, words in groupby(arguments, lambda word: word == BESIDE) if not between]
    parts = [Part(name, float(bound), command, len(given) == 1) for name, bound, *command in given]
    first = loop()
    with ThreadPoolExecutor(len(parts)) as threads:
        ended = sorted(threads.map(Part.carry_out, parts), key=lambda each: each.status != 0)
    ratio = max(1.0, (first + loop()) / 2 / REFERENCE)
    return next(filter(None, [each.show(ratio) for each in ended]), 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
