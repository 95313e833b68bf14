"""The viewer in a real browser, driven through its debugging port: what is on the screen is what the run renders."""

from __future__ import annotations

import base64
import io
import json
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest
from fakes.runs import set_environment
from PIL import Image
from trained_runs import trained_run

from envgs_bench.viewing.look import Look, Side
from envgs_bench.viewing.opened import open_runs
from envgs_bench.viewing.viewer import Viewer, eye_of

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
WAIT_SECONDS = 90
WITHOUT_GPU = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu")

pytestmark = [pytest.mark.slow, pytest.mark.skipif(BROWSER is None, reason="no Chromium or Chrome here")]


@contextmanager
def page(url: str, profile: Path) -> Iterator[Callable[..., Any]]:
    """A page that shows `url` in a browser; what is yielded asks it something by the DevTools protocol."""
    client = pytest.importorskip("websockets.sync.client")
    assert BROWSER is not None
    flags = ("--headless", "--no-sandbox", "--window-size=800,600", "--remote-debugging-port=0", *WITHOUT_GPU)
    process = subprocess.Popen([BROWSER, *flags, f"--user-data-dir={profile}", url], stderr=subprocess.DEVNULL)
    try:
        port = awaited(lambda: (profile / "DevToolsActivePort").read_text().split()[0])
        tabs = f"http://127.0.0.1:{port}/json"
        tab = awaited(lambda: next(each for each in json.load(urlopen(tabs)) if each["type"] == "page"))
        with client.connect(tab["webSocketDebuggerUrl"], max_size=None) as socket:

            def ask(method: str, **parameters: Any) -> Any:
                socket.send(json.dumps({"id": 1, "method": method, "params": parameters}))
                while (answer := json.loads(socket.recv(WAIT_SECONDS))).get("id") != 1:
                    pass
                return answer["result"]

            yield ask
    finally:
        process.terminate()
        process.wait(20)


def awaited(look: Callable[[], Any]) -> Any:
    """What `look` returns once it raises nothing and that is true."""
    ends = time.monotonic() + WAIT_SECONDS
    while time.monotonic() < ends:
        try:
            if found := look():
                return found
        except (OSError, StopIteration, IndexError):
            pass
        time.sleep(0.2)
    raise AssertionError("nothing came")


def screen(ask: Callable[..., Any]) -> np.ndarray:
    content = ask("Page.captureScreenshot", format="png")["data"]
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(content))).convert("RGB")).astype(float)


def test_the_screen_shows_the_first_test_view_and_another_after_a_drag(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("viser")
    set_environment(monkeypatch)
    trained_run(tmp_path / "run", "2dgs")
    (run,) = open_runs([tmp_path / "run"], "cpu")
    server = Viewer([run], most_rows=2000).serve("127.0.0.1", 0)
    try:
        with page(f"http://127.0.0.1:{server.get_port()}", tmp_path / "profile") as ask:

            def as_rendered() -> bool:
                """The lower left, where nothing stands before the picture."""
                shown = screen(ask)
                height, width = shown.shape[:2]
                camera = eye_of(run.views[0].camera, width, height).camera(most_rows=2000)
                wanted = Look(camera, Side(run, "image")).picture((width, height)).astype(float)
                part = (slice(height // 2, height - 80), slice(80, width // 2))
                return float(np.abs(shown[part] - wanted[part]).mean()) < 6

            assert awaited(as_rendered)
            before = screen(ask)
            for kind, x in (("mousePressed", 300), ("mouseMoved", 380), ("mouseMoved", 460), ("mouseReleased", 460)):
                ask("Input.dispatchMouseEvent", type=kind, x=x, y=400, button="left", clickCount=1)
            assert awaited(lambda: np.abs(screen(ask) - before)[300:500, 80:400].mean() > 6)
            assert not as_rendered()
    finally:
        server.stop()
