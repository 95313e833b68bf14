"""Frame times under a clock that the test turns, so that nothing here depends on this machine's speed."""

import numpy as np
import pytest
import torch

from envgs_bench.core import Camera, View
from envgs_bench.settings import TimingSettings
from envgs_bench.stages import stopwatch
from envgs_bench.stages.stopwatch import time_calls
from envgs_bench.stages.timing import FrameTimes, contract, time_frames, time_views


class Clock:
    """perf_counter, advanced by whoever does work."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(stopwatch, "perf_counter", clock)
    return clock


def camera(width=8, height=6):
    return Camera(torch.eye(4), torch.tensor([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]]), width, height)


class Renderer:
    """Takes the given seconds in turn, the last for ever, and remembers which camera it drew."""

    device = torch.device("cpu")

    def __init__(self, clock, *seconds):
        self.clock, self.seconds, self.drawn, self.prepared = clock, list(seconds), [], 0

    def picture(self, camera):
        self.drawn.append(camera)
        self.clock.now += self.seconds.pop(0) if len(self.seconds) > 1 else self.seconds[0]

    def prepare(self):
        self.prepared += 1
        self.clock.now += 0.25


def test_the_first_frame_of_every_view_is_not_counted(clock):
    cameras = [camera(), camera()]
    renderer = Renderer(clock, 0.5, 0.01, 0.01, 0.01, 0.7, 0.02)
    times = time_views(renderer.picture, cameras, "cpu", frames=3, seconds=10).times_ms
    np.testing.assert_allclose(times, [[10] * 3, [20] * 3])
    assert [c is cameras[0] for c in renderer.drawn] == [True] * 4 + [False] * 4


def test_the_time_limit_can_end_a_view_before_the_frame_limit(clock):
    times = time_views(Renderer(clock, 0.3).picture, [camera()], "cpu", frames=50, seconds=1.0).times_ms
    np.testing.assert_allclose(times, [[300] * 4])
    one = time_views(Renderer(clock, 5.0).picture, [camera()], "cpu", frames=50, seconds=1.0).times_ms
    np.testing.assert_allclose(one, [[5000]])


def test_slow_work_is_timed_as_often_as_was_asked_for(clock):
    """At least so often, however few repeats were wanted and however long each takes."""
    renderer = Renderer(clock, 5.0)
    for repeats, expected in ((1, 3), (2, 3), (9, 3)):
        times = time_calls(lambda: renderer.picture(None), torch.device("cpu"), repeats, 1.0, at_least=3)
        np.testing.assert_allclose(times, [5000] * expected)
    assert len(time_calls(lambda: renderer.picture(None), torch.device("cpu"), 4, 100.0, at_least=3)) == 4


def test_a_scenes_value_is_the_mean_of_medians_and_a_hiccup_shows_in_p95_only():
    frames = FrameTimes([[10.0] * 9 + [500.0], [30.0] * 10])
    assert frames.frame_ms == 20
    assert frames.fps == 50
    assert frames.frame_ms_p95 == pytest.approx(np.percentile([10.0] * 9 + [500.0] + [30.0] * 10, 95))


def test_fps_of_the_mean_is_not_the_mean_of_fps():
    """Two views of 5 and 32 ms: their frame rates average to 116, but 54 frames are drawn a second."""
    frames = FrameTimes([[5.0], [32.0]])
    assert frames.fps == pytest.approx(1000 / 18.5)
    assert np.mean([1000 / 5, 1000 / 32]) > 2 * frames.fps


def test_a_methods_timing_is_complete_and_prepare_is_apart(clock):
    views = [View(name, camera(), torch.zeros(6, 8, 3, dtype=torch.uint8)) for name in ("a", "b")]
    renderer = Renderer(clock, 0.02)
    result = time_frames(renderer, views, TimingSettings(frames=5, seconds=9.0))
    assert renderer.prepared == 1
    assert (result.height, result.width) == (6, 8)
    assert result.prepare_ms == pytest.approx(250)
    assert result.frame_ms == pytest.approx(20)
    assert result.fps == pytest.approx(50)
    assert [(view.view, len(view.times_ms)) for view in result.per_view] == [("a", 5), ("b", 5)]
    assert "8×6 px" in result.contract
    assert "5 frames or 9 s" in result.contract
    with pytest.raises(ValueError, match="no test views"):
        time_frames(renderer, [], TimingSettings(frames=5, seconds=9.0))


def test_contract_says_what_was_timed():
    text = contract([camera(), camera(16, 12)], "cuda", 50, 1.0)
    assert "8×6 16×12 px" in text
    assert "2 views" in text
    assert "device events" in text
    assert "perf_counter" in contract([camera()], "cpu", 50, 1.0)


class Device:
    """A GPU whose calls take 20 ms each, and 1 ms to launch; an event records when all work before it has ended."""

    def __init__(self, clock):
        self.clock, self.busy_until, self.most_waiting = clock, clock.now, 0

    def launch(self):
        self.clock.now += 0.001
        self.busy_until = max(self.busy_until, self.clock.now) + 0.020
        self.most_waiting = max(self.most_waiting, round((self.busy_until - self.clock.now) / 0.020))

    def event(self, enable_timing):
        assert enable_timing
        return DeviceEvent(self)

    def synchronize(self):
        self.clock.now = max(self.clock.now, self.busy_until)


class DeviceEvent:
    def __init__(self, device):
        self.device = device

    def record(self):
        self.at = max(self.device.busy_until, self.device.clock.now)

    def synchronize(self):
        self.device.clock.now = max(self.device.clock.now, self.at)

    def elapsed_time(self, later):
        return 1000 * (later.at - self.at)


@pytest.mark.parametrize(("queued", "each_ms"), [(1, 21), (3, 20)])
def test_on_a_gpu_no_more_calls_are_under_way_than_may_be(clock, monkeypatch, queued, each_ms):
    """One at a time, a call's time has its launch in it; with others queued before it, it has not."""
    device = Device(clock)
    monkeypatch.setattr(torch.cuda, "Event", device.event)
    monkeypatch.setattr(torch.cuda, "synchronize", device.synchronize)
    times = time_calls(device.launch, torch.device("cuda"), 20, 10.0, queued=queued)
    np.testing.assert_allclose(times, [21] + [each_ms] * 19)
    assert device.most_waiting == queued
    assert len(time_calls(device.launch, torch.device("cuda"), 1000, 0.5, queued=queued)) < 30


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_on_a_gpu_every_frame_is_positive():
    square = torch.randn(512, 512, device="cuda")
    times = time_views(lambda camera: square @ square, [camera().to("cuda")] * 2, "cuda", frames=4, seconds=5).times_ms
    assert [len(view) for view in times] == [4, 4]
    assert min(map(min, times)) > 0


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_on_a_gpu_the_time_limit_ends_a_view_although_launching_takes_no_time():
    square = torch.randn(8192, 8192, device="cuda")
    times = time_views(lambda camera: square @ square, [camera().to("cuda")], "cuda", frames=5000, seconds=0.2).times_ms
    assert len(times[0]) < 5000
