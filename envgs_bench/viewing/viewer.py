"""Viewer: trained runs in a browser, by viser: its camera, its controls, our pictures behind them."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from envgs_bench.core import Camera, View

from .camera_paths import looked_at, up_direction
from .look import Look, Side, layers_of, view_at
from .opened import IMAGE, OpenedRun
from .resolution import Resolution, Size

STILL_SECONDS = 0.15  # a camera that was not moved for so long stands still
FRUSTUM_SHARE = 0.08  # of the scene's radius: a test camera's size
FRUSTUM_COLOR = (230, 120, 20)
MOVING_QUALITY, STILL_QUALITY = 70, 95  # JPEG
NOTHING = "nothing"  # the right half's run where there is one picture


@dataclass(frozen=True)
class Eye:
    """A browser's camera: where it stands and looks in the world (OpenCV axes), and the window that it fills."""

    position: NDArray[np.float64]  # [3]
    wxyz: NDArray[np.float64]  # camera to world
    fov: float  # from top to bottom, radians
    width: int  # pixels
    height: int

    def camera(self, most_rows: int) -> Camera:
        """The camera of the window's picture, shrunk where it has more rows than `most_rows`."""
        height = max(1, min(self.height, most_rows))
        width = max(2, round(self.width * height / max(self.height, 1)))
        rotation = Rotation.from_quat(self.wxyz, scalar_first=True).as_matrix().T
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ self.position
        focal = height / 2 / np.tan(self.fov / 2)
        intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=torch.float32)
        return Camera(torch.from_numpy(pose).float(), intrinsics, width, height)


def eye_of(camera: Camera, width: int, height: int) -> Eye:
    """An eye that sees what `camera` does, from top to bottom, in a window of this size."""
    rotation = Rotation.from_matrix(camera.world_to_camera[:3, :3].double().numpy().T)
    fov = 2 * np.arctan(camera.height / 2 / float(camera.intrinsics[1, 1]))
    return Eye(camera.center.double().numpy(), rotation.as_quat(scalar_first=True), float(fov), width, height)


def require_viser() -> None:
    """Raises ValueError that says what to install where viser is not."""
    try:
        import viser  # noqa: F401
    except ImportError as error:
        raise ValueError("the viewer needs viser: pip install 'envgs-bench[view]'") from error


@dataclass
class Viewer:
    """Shows the runs to whoever opens the page; each browser has a camera and choices of its own."""

    runs: Sequence[OpenedRun]
    most_rows: int  # of a picture
    drawing: threading.Lock = field(default_factory=threading.Lock)  # one picture at a time: each takes all cores

    def serve(self, host: str, port: int) -> Any:
        """A running viser server. Raises OSError where it cannot listen there."""
        import viser

        logging.getLogger("websockets").setLevel(logging.CRITICAL)  # which reports every browser that just goes away
        server = viser.ViserServer(host=host, port=port, label="envgs-bench", verbose=False)
        server.scene.set_up_direction(up_direction(self.runs[0].cameras))
        layers = {run.label: layers_of(run) for run in self.runs}

        windows: dict[int, Window] = {}

        @server.on_client_connect
        def _(client: Any) -> None:
            windows[client.client_id] = Window(self, client, layers)
            windows[client.client_id].start()

        @server.on_client_disconnect
        def _(client: Any) -> None:
            windows.pop(client.client_id).close()

        return server


class Window(threading.Thread):
    """One browser's: draws what it looks at, coarsely while it moves, and finer and finer once it stands still."""

    def __init__(self, viewer: Viewer, client: Any, layers: dict[str, list[str]]) -> None:
        super().__init__(daemon=True)
        self.viewer, self.client, self.layers = viewer, client, layers
        self.runs = {run.label: run for run in viewer.runs}
        self.resolution = Resolution()
        self._changed, self._closed = threading.Event(), False
        self._add_controls()
        self._add_test_cameras()
        self.go_to(viewer.runs[0].views[0])
        client.camera.on_update(lambda _: self._changed.set())

    def run(self) -> None:
        """Draw until the browser is gone."""
        shown: Size | None = None
        whole = False
        while True:
            moved = self._changed.wait(None if whole else STILL_SECONDS)
            self._changed.clear()
            if self._closed:
                return
            look = self.look()
            full = look.camera.width, look.camera.height
            size = self.resolution.moving(full) if moved or shown is None else self.resolution.still(full, shown)
            whole = size is None or size == full
            if size is not None:
                self._show(look, size, last=whole)
                shown = size

    def close(self) -> None:
        """Nobody looks any more."""
        self._closed = True
        self._changed.set()

    def look(self) -> Look:
        """What the browser looks at now."""
        camera = self.client.camera
        eye = Eye(camera.position, camera.wxyz, camera.fov, camera.image_width, camera.image_height)
        left = Side(self.runs[self.left_run.value], self.left_layer.value)
        right = None
        if self.right_run.value != NOTHING:
            right = Side(self.runs[self.right_run.value], self.right_layer.value)
        return Look(eye.camera(self.viewer.most_rows), left, right, self.divide.value)

    def go_to(self, view: View) -> None:
        """Stand where the view's photograph was taken from."""
        eye = eye_of(view.camera, 1, 1)
        with self.client.atomic():
            self.client.camera.wxyz = eye.wxyz
            self.client.camera.position = eye.position
            # What dragging turns about.
            self.client.camera.look_at = looked_at(view.camera, self.viewer.runs[0].cameras)
            self.client.camera.fov = eye.fov
        self.test_camera.value = view.name

    def _show(self, look: Look, size: Size, last: bool) -> None:
        with self.viewer.drawing:
            began = time.perf_counter()
            picture = look.picture(size)
            seconds = time.perf_counter() - began
        self.resolution.drew(size, seconds)
        if self._closed:
            return
        quality = STILL_QUALITY if last else MOVING_QUALITY
        self.client.scene.set_background_image(picture, format="jpeg", jpeg_quality=quality)
        self.told.content = describe(look, size, seconds)
        self._mark(view_at(look.left.run, look.camera))

    def _add_controls(self) -> None:
        gui, labels = self.client.gui, list(self.runs)
        self.told = gui.add_markdown("")
        self.left_run = gui.add_dropdown("run", labels)
        self.left_layer = gui.add_dropdown("layer", self.layers[labels[0]])
        with gui.add_folder("beside it"):
            beside = labels[1] if len(labels) > 1 else NOTHING
            self.right_run = gui.add_dropdown("run", [NOTHING, *labels], initial_value=beside)
            self.right_layer = gui.add_dropdown("layer", self.layers[labels[0] if beside == NOTHING else beside])
            self.divide = gui.add_slider("divide", 0.0, 1.0, 0.01, 0.5)
        views = {view.name: view for view in self.viewer.runs[0].views}
        self.test_camera = gui.add_dropdown("test camera", list(views))
        self.frusta_shown = gui.add_checkbox("show test cameras", True)
        for run, layer in ((self.left_run, self.left_layer), (self.right_run, self.right_layer)):
            run.on_update(lambda _, run=run, layer=layer: self._offer_layers(run.value, layer))
        for control in (self.left_layer, self.right_layer, self.divide):
            control.on_update(lambda _: self._changed.set())
        self.test_camera.on_update(lambda _: self.go_to(views[self.test_camera.value]))
        self.frusta_shown.on_update(lambda _: self._mark(view_at(self.look().left.run, self.look().camera)))

    def _offer_layers(self, run: str, control: Any) -> None:
        """The run's own layers; what was chosen stays where the run has it too."""
        if run != NOTHING:
            chosen = control.value
            control.options = self.layers[run]
            control.value = chosen if chosen in self.layers[run] else IMAGE
        self._changed.set()

    def _add_test_cameras(self) -> None:
        run = self.viewer.runs[0]
        self.frusta = {}
        for view in run.views:
            eye = eye_of(view.camera, view.camera.width, view.camera.height)
            frustum = self.client.scene.add_camera_frustum(
                f"/test cameras/{view.name}",
                eye.fov,
                eye.width / eye.height,
                scale=FRUSTUM_SHARE * run.scene.radius,
                thickness=1.5,
                thickness_units="screen",
                color=FRUSTUM_COLOR,
                wxyz=tuple(eye.wxyz),
                position=tuple(eye.position),
            )
            frustum.on_click(lambda _, view=view: self.go_to(view))
            self.frusta[view.name] = frustum

    def _mark(self, at: View | None) -> None:
        """Hide the frustum that the camera stands in, whose edges would frame the picture."""
        for name, frustum in self.frusta.items():
            frustum.visible = self.frusta_shown.value and (at is None or name != at.name)


def describe(look: Look, size: Size, seconds: float) -> str:
    """What is shown, how large and how quickly, and of how many primitives it is made: Markdown."""
    sides = [side for side in (look.left, look.right) if side is not None]
    lines = [f"{size[0]} × {size[1]} pixels, {1000 * seconds:.0f} ms" + (" for both" if len(sides) > 1 else "")]
    for run in {side.run.label: side.run for side in sides}.values():
        counts = (f"{count:,} {name}" for name, count in run.method.primitives().items() if count)
        lines.append(f"**{run.label}**: {', '.join(counts)} primitives")
    return "\n\n".join(lines)
