// CUDA C++ as a C++20 compiler understands it: as much of the language as the kernels use. A kernel's file is compiled
// with this before it; emulator.cpp then runs its threads one at a time. See emulator.py.
#pragma once
#include <bit>
#include <cmath>
#include <concepts>
#include <cstdint>
#include <cstring>
#include <utility>

#define __CUDACC__ 1
#define __device__
#define __host__
#define __global__
#define __constant__
#define __forceinline__ inline
#define __launch_bounds__(...)
// One block runs at a time. A section of its own, so that each block can begin with memory that holds no sense.
#define __shared__ static __attribute__((section("emulated_shared")))

// Those of <algorithm>, without the rest of it: half of what each of thirty kernels takes to read.
template <class T>
constexpr T max(T a, T b) {
    return a < b ? b : a;
}
template <class T>
constexpr T min(T a, T b) {
    return b < a ? b : a;
}

struct alignas(8) float2 {
    float x, y;
};
struct alignas(16) float4 {
    float x, y, z, w;
};
struct alignas(8) int2 {
    int x, y;
};
struct alignas(8) uint2 {
    unsigned x, y;
};
inline float4 make_float4(float x, float y, float z, float w) { return {x, y, z, w}; }
inline float2 make_float2(float x, float y) { return {x, y}; }
inline int2 make_int2(int x, int y) { return {x, y}; }
inline uint2 make_uint2(unsigned x, unsigned y) { return {x, y}; }

inline unsigned __float_as_uint(float value) { return std::bit_cast<unsigned>(value); }
inline float __uint_as_float(unsigned bits) { return std::bit_cast<float>(bits); }
inline int __float_as_int(float value) { return std::bit_cast<int>(value); }
inline float __int_as_float(int bits) { return std::bit_cast<float>(bits); }
inline int __popc(unsigned bits) { return std::popcount(bits); }
inline int __ffs(unsigned bits) { return bits ? std::countr_zero(bits) + 1 : 0; }
inline float __expf(float x) { return std::exp(x); }
inline float __log2f(float x) { return std::log2(x); }
inline float rsqrtf(float x) { return 1.0f / std::sqrt(x); }

// What half.cuh has of the GPU's instructions.
inline unsigned half_of(float value) {
    unsigned sign = std::signbit(value) ? 0x8000u : 0;
    float size = std::fabs(value);
    if (!(size < 65520.0f)) return sign | (std::isnan(value) ? 0x7e00u : 0x7c00u);
    int exponent = size > 0.0f ? max(std::ilogb(size), -14) : -14;
    return sign | (unsigned((exponent + 14) * 1024) + unsigned(std::nearbyint(std::ldexp(size, 10 - exponent))));
}
inline float float_of(unsigned half) {
    int exponent = half >> 10 & 31, fraction = half & 1023;
    float size = exponent == 31 ? (fraction ? NAN : INFINITY)
                                : std::ldexp(float(exponent ? 1024 + fraction : fraction), max(exponent, 1) - 25);
    return half & 0x8000 ? -size : size;
}
inline unsigned halves_of(float low, float high) { return half_of(low) | half_of(high) << 16; }
inline float2 floats_of(unsigned pair) { return {float_of(pair & 0xffff), float_of(pair >> 16)}; }

struct Coordinates {
    unsigned x;
};
extern Coordinates threadIdx, blockIdx, blockDim, gridDim;

namespace emulator {

enum class Operation { none, barrier, barrier_or, sync, ballot, match, shuffle, add, least, greatest };

// The operands of a warp's lanes in one operation; lanes that had ended have none.
struct WarpExchange {
    uint64_t values[32];
    unsigned present;

    template <class Visit>
    void each(const Visit& visit) const {
        for (unsigned rest = present; rest; rest &= rest - 1)
            visit(std::countr_zero(rest), values[std::countr_zero(rest)]);
    }
};

// Returns once all living lanes of the warp have come to the same operation.
const WarpExchange& synchronize_warp(Operation operation, uint64_t value);
// The same for the block; whether any thread brought true.
bool synchronize_block(Operation operation, bool value);
// Ends the launch with an error.
[[noreturn]] void fail(const char* format, ...);

template <class T>
uint64_t to_word(T value) {
    static_assert(sizeof(T) <= 8);
    uint64_t word = 0;
    std::memcpy(&word, &value, sizeof value);
    return word;
}
template <class T>
T from_word(uint64_t word) {
    T value;
    std::memcpy(&value, &word, sizeof value);
    return value;
}

inline void require_full_warp(unsigned mask) {
    if (mask != ~0u) fail("a warp's operation has mask %#x, only whole warps are emulated", mask);
}

using Body = void (*)(void* kernel_and_arguments);
const char* run(unsigned blocks, unsigned threads, int order, Body body, void* kernel_and_arguments);

// p, i or f: how the launcher has to pass a parameter.
template <class T>
constexpr char code() {
    static_assert(std::is_pointer_v<T> || sizeof(T) <= 4, "the launcher passes 32-bit scalars");
    return std::is_pointer_v<T> ? 'p' : std::is_floating_point_v<T> ? 'f' : 'i';
}
template <class... Parameters>
const char* signature(void (*)(Parameters...)) {
    static const char codes[] = {code<Parameters>()..., '\0'};
    return codes;
}

template <class... Parameters>
const char* launch(void (*kernel)(Parameters...), unsigned blocks, unsigned threads, int order, void** arguments) {
    struct Call {
        void (*kernel)(Parameters...);
        void** arguments;
    } call{kernel, arguments};
    auto body = [](void* data) {
        const Call& call = *static_cast<Call*>(data);
        [&]<size_t... I>(std::index_sequence<I...>) {
            call.kernel(*static_cast<Parameters*>(call.arguments[I])...);
        }(std::index_sequence_for<Parameters...>{});
    };
    return run(blocks, threads, order, body, &call);
}

}  // namespace emulator

// Makes a kernel callable from outside; launching returns an error message or null.
#define EXPORT_KERNEL(name)                                                                                \
    extern "C" const char* signature_##name() { return emulator::signature(name); }                        \
    extern "C" const char* launch_##name(unsigned blocks, unsigned threads, int order, void** arguments) { \
        return emulator::launch(name, blocks, threads, order, arguments);                                  \
    }

inline void __syncthreads() { emulator::synchronize_block(emulator::Operation::barrier, false); }
inline int __syncthreads_or(int value) { return emulator::synchronize_block(emulator::Operation::barrier_or, value); }
inline void __syncwarp() { emulator::synchronize_warp(emulator::Operation::sync, 0); }

inline unsigned __ballot_sync(unsigned mask, bool value) {
    emulator::require_full_warp(mask);
    unsigned lanes = 0;
    emulator::synchronize_warp(emulator::Operation::ballot, value).each([&](int lane, uint64_t one) {
        lanes |= unsigned(one) << lane;
    });
    return lanes;
}
inline int __any_sync(unsigned mask, bool value) { return __ballot_sync(mask, value) != 0; }

template <class T>
unsigned __match_any_sync(unsigned mask, T value) {
    emulator::require_full_warp(mask);
    uint64_t own = emulator::to_word(value);
    unsigned lanes = 0;
    emulator::synchronize_warp(emulator::Operation::match, own).each([&](int lane, uint64_t one) {
        if (one == own) lanes |= 1u << lane;
    });
    return lanes;
}

template <class T>
T __shfl_sync(unsigned mask, T value, int source) {
    emulator::require_full_warp(mask);
    const emulator::WarpExchange& exchange =
        emulator::synchronize_warp(emulator::Operation::shuffle, emulator::to_word(value));
    if (!(exchange.present >> (source & 31) & 1))
        emulator::fail("a shuffle reads from lane %d, which has ended", source);
    return emulator::from_word<T>(exchange.values[source & 31]);
}
template <class T>
T __shfl_xor_sync(unsigned mask, T value, int bits) {
    return __shfl_sync(mask, value, int(threadIdx.x & 31) ^ bits);
}
template <class T>
T __shfl_up_sync(unsigned mask, T value, int offset) {
    int lane = threadIdx.x & 31;
    return __shfl_sync(mask, value, lane >= offset ? lane - offset : lane);
}

inline unsigned __reduce_add_sync(unsigned mask, unsigned value) {
    emulator::require_full_warp(mask);
    unsigned sum = 0;
    emulator::synchronize_warp(emulator::Operation::add, value).each([&](int, uint64_t one) { sum += unsigned(one); });
    return sum;
}
inline unsigned __reduce_min_sync(unsigned mask, unsigned value) {
    emulator::require_full_warp(mask);
    emulator::synchronize_warp(emulator::Operation::least, value).each([&](int, uint64_t one) {
        value = min(value, unsigned(one));
    });
    return value;
}
inline unsigned __reduce_max_sync(unsigned mask, unsigned value) {
    emulator::require_full_warp(mask);
    emulator::synchronize_warp(emulator::Operation::greatest, value).each([&](int, uint64_t one) {
        value = max(value, unsigned(one));
    });
    return value;
}

// One thread runs at a time, so nothing can come between.
template <class T, std::convertible_to<T> Value>
T atomicAdd(T* at, Value value) {
    return std::exchange(*at, T(*at + value));
}
inline unsigned atomicMin(unsigned* at, unsigned value) { return std::exchange(*at, min(*at, value)); }
inline unsigned atomicMax(unsigned* at, unsigned value) { return std::exchange(*at, max(*at, value)); }
