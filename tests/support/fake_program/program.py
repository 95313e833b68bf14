"""A program that trains nothing well and fails in every way: `python program.py MODE DATA OUTPUT STEPS [FLAGS]`.

It reads the blender layout, writes one picture a test view in the mean color of the training pictures.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from PIL import Image


def pictures_of(data: Path, split: str) -> list[Path]:
    frames = json.loads((data / f"transforms_{split}.json").read_text())["frames"]
    return [data / (frame["file_path"] + ".png") for frame in frames]


def draw(data: Path, output: Path, mode: str) -> None:
    color = np.mean(
        [np.asarray(Image.open(path).convert("RGB")).mean((0, 1)) for path in pictures_of(data, "train")], 0
    )
    paths = pictures_of(data, "test")
    (output / "test").mkdir(exist_ok=True)
    paths = {"half": paths[: len(paths) // 2], "more": [*paths, paths[0]]}.get(mode, paths)
    for number, path in enumerate(paths):
        height, width = np.asarray(Image.open(path)).shape[:2]
        if mode == "small":
            width -= 1
        picture = np.broadcast_to(color.round().astype(np.uint8), (height, width, 3))
        if mode == "beside":  # the photograph on the left
            picture = np.concatenate([np.zeros_like(picture), picture], axis=1)
        if mode == "nan":
            np.save(output / "test" / f"{number:05d}.npy", np.full((height, width, 3), np.nan, np.float32))
        else:
            Image.fromarray(np.ascontiguousarray(picture)).save(output / "test" / f"{number:05d}.png")
        if mode == "truncated":
            content = (output / "test" / f"{number:05d}.png").read_bytes()
            (output / "test" / f"{number:05d}.png").write_bytes(content[:60])


def fail(mode: str) -> None:
    """What ends or holds up the training."""
    if mode == "raises":
        raise RuntimeError("the splats are in a bad mood")
    if mode == "exits":
        print("no license for reflections", file=sys.stderr)
        sys.exit(3)
    if mode == "segfaults":
        os.kill(os.getpid(), signal.SIGSEGV)
    if mode == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if mode == "no-memory":
        print("torch.OutOfMemoryError: CUDA out of memory. Tried to allocate 1.00 TiB")
        sys.exit(1)
    if mode == "greedy":
        held = [bytearray(os.urandom(1 << 20) * 64)]
        while len(held) < 16:  # 1 GB
            held.append(bytearray(held[0]))
            time.sleep(0.01)
        time.sleep(600)
    if mode == "ignores":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if mode in ("hangs", "ignores"):
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], start_new_session=True)
        print(f"child {child.pid}", flush=True)
        time.sleep(600)
    if mode == "leaves-child":
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    if mode == "floods":
        for _ in range(64):
            sys.stdout.buffer.write(b"\xff\xfe no text \r" * 4096)


def main() -> None:
    mode, data, output, steps = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[4])
    attempts = output.parent.parent / "attempts.txt"  # beside what an attempt may remove
    with attempts.open("a") as stream:
        print(" ".join(sys.argv[4:]), file=stream)
    if "--once" in sys.argv and len(attempts.read_text().splitlines()) > 1:
        mode = "fine"
    for step in range(1, steps + 1):
        print(f"step {step}/{steps}", flush=True)
        if 2 * step > steps:
            fail(mode)
    if mode == "copies":  # what somebody else drew, and the model that it was drawn from
        shutil.copytree(sys.argv[5], output, dirs_exist_ok=True)
    elif mode != "nothing":
        draw(data, output, mode)
    print("trained for 1,500 ms")


main()
