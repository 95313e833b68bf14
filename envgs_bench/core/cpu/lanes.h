// SIMD vectors of W floats, as the compiler's own vector types: they carry the arithmetic operators, run on whatever
// the target has (AVX-512, AVX2, NEON, or scalars), and fill the R of the kernels.
#pragma once
#include <cstdint>
#include <cstring>
#include <type_traits>

#if defined(__SSE2__)
#include <immintrin.h>
#endif

#include "kernels/real.h"

namespace envgs {

template <int W>
struct LaneTypes {
    typedef float Float __attribute__((vector_size(4 * W)));
    typedef int32_t Int __attribute__((vector_size(4 * W)));
};

// Eight lanes serve a BVH node's eight children and a leaf's eight surfels; pixels take as many as a register holds.
using Float8 = LaneTypes<8>::Float;
using Int8 = LaneTypes<8>::Int;
#if defined(__AVX512F__)
constexpr int kPixelLanes = 16;
#elif defined(__AVX__)
constexpr int kPixelLanes = 8;
#else
constexpr int kPixelLanes = 4;
#endif
using PixelFloat = LaneTypes<kPixelLanes>::Float;
using PixelInt = LaneTypes<kPixelLanes>::Int;

template <class F> struct LanesOf;
template <> struct LanesOf<LaneTypes<4>::Float> {
    static constexpr int width = 4;
    using Int = LaneTypes<4>::Int;
};
template <> struct LanesOf<LaneTypes<8>::Float> {
    static constexpr int width = 8;
    using Int = LaneTypes<8>::Int;
};
template <> struct LanesOf<LaneTypes<16>::Float> {
    static constexpr int width = 16;
    using Int = LaneTypes<16>::Int;
};

template <class F, class I = typename LanesOf<F>::Int>
inline F select(I mask, F a, F b) {
    return mask ? a : b;
}
// One instruction where x86 has it, which says the same of NaN and of two zeros: b. The compiler makes two of it.
template <class F, class = LanesOf<F>>
inline F minimum(F a, F b) {
    constexpr int W = LanesOf<F>::width;
#if defined(__AVX512F__)
    if constexpr (W == 16) return (F)_mm512_min_ps((__m512)a, (__m512)b);
#endif
#if defined(__AVX2__)
    if constexpr (W == 8) return (F)_mm256_min_ps((__m256)a, (__m256)b);
#endif
#if defined(__SSE2__)
    if constexpr (W == 4) return (F)_mm_min_ps((__m128)a, (__m128)b);
#endif
    return a < b ? a : b;
}
template <class F, class = LanesOf<F>>
inline F maximum(F a, F b) {
    constexpr int W = LanesOf<F>::width;
#if defined(__AVX512F__)
    if constexpr (W == 16) return (F)_mm512_max_ps((__m512)a, (__m512)b);
#endif
#if defined(__AVX2__)
    if constexpr (W == 8) return (F)_mm256_max_ps((__m256)a, (__m256)b);
#endif
#if defined(__SSE2__)
    if constexpr (W == 4) return (F)_mm_max_ps((__m128)a, (__m128)b);
#endif
    return a > b ? a : b;
}
template <class F, class I = typename LanesOf<F>::Int>
inline F absolute(F a) {
    return (F)((I)a & 0x7fffffff);
}

template <class F>
inline F load_lanes(const float* p) {
    F out;
    std::memcpy(&out, p, sizeof out);
    return out;
}
template <class T, class F>
inline void store_lanes(T* p, F value) {
    std::memcpy(p, &value, sizeof value);
}

// Bit i is set where lane i of the mask is.
inline unsigned mask_bits(LaneTypes<4>::Int mask) {
#if defined(__SSE2__)
    return unsigned(_mm_movemask_ps((__m128)mask));
#else
    unsigned bits = 0;
    for (int i = 0; i < 4; ++i) bits |= unsigned(mask[i] & 1) << i;
    return bits;
#endif
}
inline unsigned mask_bits(Int8 mask) {
#if defined(__AVX2__)
    return unsigned(_mm256_movemask_ps((__m256)mask));
#else
    LaneTypes<4>::Int halves[2];
    std::memcpy(halves, &mask, sizeof mask);
    return mask_bits(halves[0]) | mask_bits(halves[1]) << 4;
#endif
}
inline unsigned mask_bits(LaneTypes<16>::Int mask) {
#if defined(__AVX512F__)
    return _mm512_cmplt_epi32_mask((__m512i)mask, _mm512_setzero_si512());
#else
    unsigned bits = 0;
    for (int i = 0; i < 16; ++i) bits |= unsigned(mask[i] & 1) << i;
    return bits;
#endif
}

inline Float8 square_root(Float8 a) {
#if defined(__AVX2__)
    return (Float8)_mm256_sqrt_ps((__m256)a);
#else
    for (int i = 0; i < 8; ++i) a[i] = sqrtf(a[i]);
    return a;
#endif
}

// Halves added to halves: a fixed order.
template <class F, class = LanesOf<F>>
inline float sum_lanes(F a) {
    constexpr int W = LanesOf<F>::width;
    if constexpr (W == 4) {
        return (a[0] + a[2]) + (a[1] + a[3]);
    } else {
        typename LaneTypes<W / 2>::Float low, high;
        std::memcpy(&low, &a, sizeof low);
        std::memcpy(&high, reinterpret_cast<const char*>(&a) + sizeof low, sizeof high);
        return sum_lanes(typename LaneTypes<W / 2>::Float(low + high));
    }
}

// values[lanes[i]] in lane i.
inline Int8 permuted(Int8 values, Int8 lanes) {
#if defined(__AVX2__)
    return (Int8)_mm256_permutevar8x32_epi32((__m256i)values, (__m256i)lanes);
#else
    Int8 out;
    for (int i = 0; i < 8; ++i) out[i] = values[lanes[i] & 7];
    return out;
#endif
}

// Lane i and lane i ^ M exchange their values where the one further back holds the larger.
template <int M>
inline Int8 larger_first(Int8 x) {
#if defined(__AVX2__)
    Int8 other = __builtin_shufflevector(x, x, 0 ^ M, 1 ^ M, 2 ^ M, 3 ^ M, 4 ^ M, 5 ^ M, 6 ^ M, 7 ^ M);
    constexpr Int8 front = {-1,
                            1 < (1 ^ M) ? -1 : 0,
                            2 < (2 ^ M) ? -1 : 0,
                            3 < (3 ^ M) ? -1 : 0,
                            4 < (4 ^ M) ? -1 : 0,
                            5 < (5 ^ M) ? -1 : 0,
                            6 < (6 ^ M) ? -1 : 0,
                            0};
    return front ? (x > other ? x : other) : (x < other ? x : other);
#else
    constexpr int m = M & 3;  // within a half; the compiler shuffles what is wider than a register lane by lane
    LaneTypes<4>::Int halves[2], out[2];
    std::memcpy(halves, &x, sizeof x);
    for (int k = 0; k < 2; ++k) {
        LaneTypes<4>::Int own = halves[k], from = halves[k ^ M >> 2];
        LaneTypes<4>::Int other = __builtin_shufflevector(from, from, 0 ^ m, 1 ^ m, 2 ^ m, 3 ^ m);
        LaneTypes<4>::Int front = {0 < (0 ^ m) ? -1 : 0, 1 < (1 ^ m) ? -1 : 0, 2 < (2 ^ m) ? -1 : 0, 0};
        if (M >> 2) front = LaneTypes<4>::Int{} - (k == 0);
        out[k] = front ? (own > other ? own : other) : (own < other ? own : other);
    }
    std::memcpy(&x, out, sizeof x);
    return x;
#endif
}

// The lanes' values, largest first: a bitonic network, without a branch.
inline Int8 sorted_lanes(Int8 x) {
    x = larger_first<1>(x);
    x = larger_first<1>(larger_first<3>(x));
    return larger_first<1>(larger_first<2>(larger_first<7>(x)));
}

// A struct whose members are all R, however nested, as the array of R that it is in memory.
template <class S, class R>
constexpr int count_of = sizeof(S) / sizeof(R);
template <class R, class S>
inline auto array_of(S& s) {
    return reinterpret_cast<std::conditional_t<std::is_const_v<S>, const R, R>*>(&s);
}

// e^x to about 2 ulp for x in [−87, 0]; below it, e^−87. Cody–Waite reduction and a polynomial on ±ln2/2.
template <class F, class I = typename LanesOf<F>::Int>
inline F exponential(F x) {
    x = maximum(x, F{} - 87.0f);
    F shifted = x * 1.44269504f + 12582912.0f;  // 1.5·2²³: rounds to an integer in the low bits
    F n = shifted - 12582912.0f;
    F r = x - n * 0.693359375f + n * 2.12194440e-4f;
    F p = r * 1.3930436e-3f + 8.3610420e-3f;
    p = p * r + 4.1666453e-2f;
    p = p * r + 1.6666520e-1f;
    p = p * r + 0.5f;
    p = p * (r * r) + r + 1.0f;
    I bits = ((I)shifted << 23) + (I)p;  // the shift drops the rounding constant's own bits
    return (F)bits;
}

}  // namespace envgs
