"""What the emulator of CUDA kernels itself has to notice, and its half precision."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from cuda_emulator.emulator import ORDERS, EmulatedKernels

FAULTY = """
extern "C" __global__ void race(float* out) {
    __shared__ float shared[64];
    shared[threadIdx.x] = threadIdx.x;
    out[threadIdx.x] = shared[(threadIdx.x + 1) % 64];
}
extern "C" __global__ void outside(float* out, int at) {
    __shared__ float shared[64];
    shared[threadIdx.x] = 1.0f;
    out[threadIdx.x] = shared[threadIdx.x + at];
}
extern "C" __global__ void unaligned(float* out, int at) { *reinterpret_cast<float4*>(out + at) = {}; }
extern "C" __global__ void __launch_bounds__(64) divergent(float* out) {
    if (threadIdx.x % 32 < 7) __syncwarp();
    out[threadIdx.x] = __ballot_sync(~0u, true);
}
extern "C" __global__ void stuck(float* out) {
    if (threadIdx.x == 3) __syncthreads();
    __syncwarp();
}
extern "C" __global__ void endless(float* out) {
    while (__any_sync(~0u, out[0] >= 0.0f)) continue;
}
extern "C" __global__ void astray(float* out, int at) { out[long(at) << 40] = 1.0f; }
extern "C" __global__ void reused(float* out) {
    __shared__ float shared[2];
    for (int round = 0; round < 3; ++round) {
        if (threadIdx.x % 32 == 0) shared[threadIdx.x / 32] = round;
        __syncthreads();
        out[threadIdx.x] += shared[1 - threadIdx.x / 32] - round;
    }
}
extern "C" __global__ void stale(float* out) {
    __shared__ float shared[64];
    if (blockIdx.x == 0) shared[threadIdx.x] = 1.0f;
    out[threadIdx.x] = shared[threadIdx.x];
}
"""


@pytest.fixture
def faulty(emulate, tmp_path) -> Callable[[str], EmulatedKernels]:
    (tmp_path / "faulty.cu").write_text(FAULTY)
    return lambda order: EmulatedKernels(
        (str(tmp_path / "faulty.cu"),), torch.device("cpu"), builds=tmp_path, order=order
    )


HALVES = """
#include "half.cuh"
using namespace envgs;
extern "C" __global__ void halved(const float* values, float* out) {
    float2 pair = floats_of(halves_of(values[2 * threadIdx.x], values[2 * threadIdx.x + 1]));
    out[2 * threadIdx.x] = pair.x, out[2 * threadIdx.x + 1] = pair.y;
}
"""


@pytest.mark.usefixtures("emulate")
def test_halves_are_rounded_as_elsewhere(tmp_path):
    """Every half, and what lies on either side of the middle between two."""
    (tmp_path / "halves.cu").write_text(HALVES)
    source, device = str(tmp_path / "halves.cu"), torch.device("cpu")
    launch = EmulatedKernels((source,), device, builds=tmp_path, order="ascending")
    halves = torch.arange(1 << 16, dtype=torch.int32).to(torch.int16).view(torch.float16).float()
    halves = halves[halves.isfinite()]
    between = (halves[:-1] + halves[1:]) / 2
    for values in (halves, between, between.nextafter(halves[1:]), between.nextafter(halves[:-1])):
        for some in values[: len(values) // 512 * 512].reshape(-1, 512).contiguous():
            out = torch.empty(512)
            launch("halved", 1, 256, some, out)
            assert torch.equal(out, some.half().float())


def test_mistakes_in_a_kernel_are_noticed(faulty):
    launch, out = faulty("ascending"), torch.zeros(64)
    for name, arguments, message in [
        ("outside", (1,), r"faulty.cu:10: index 64 is outside"),
        ("unaligned", (1,), r"is not aligned|outside all memory"),  # as GCC says, and as Clang's faster load does
        ("divergent", (), r"different operations"),
        ("stuck", (), r"deadlock"),
        ("astray", (1,), r"outside all memory"),
        ("endless", (), r"does not end"),
        ("outside", (1.0,), r"takes parameters pi, launched with pf"),
    ]:
        with pytest.raises(AssertionError, match=message):
            launch(name, 1, 64, out, *arguments)
        launch("outside", 1, 64, out, 0)  # and the next launch is a fresh one
        assert (out == 1).all()
    launch("stale", 2, 64, out)
    assert out.isnan().all()


def test_a_race_shows_in_the_order_of_the_threads(faulty):
    results = []
    for order in ORDERS:
        results.append(torch.zeros(64))
        faulty(order)("race", 1, 64, results[-1])
    assert results[1][:63].tolist() == list(range(1, 64))
    assert results[0].isnan().sum() == 63
    assert not torch.equal(results[2].nan_to_num(), results[1].nan_to_num())


def test_a_warp_that_runs_ahead_shows_that_a_barrier_is_missing(faulty):
    """It writes for the next round before the other warp has read."""
    for order in ("ascending", "descending"):
        out = torch.zeros(64)
        faulty(order)("reused", 1, 64, out)
        assert out.any()
