// The arithmetic that the kernels are written in. A kernel is a template over R: `float` for a CUDA thread or one CPU
// lane, a SIMD vector (cpu/lanes.h) for several pixels, hits or primitives at once. Comparing two R gives a mask;
// select() takes one apart again.
#pragma once

#ifdef __CUDACC__
#define ENVGS_FN __device__ __forceinline__
#define ENVGS_TABLE __constant__ constexpr
#else
#include <cmath>
#define ENVGS_FN inline
#define ENVGS_TABLE constexpr
#endif

namespace envgs {

constexpr float kMaxSupport = 9.0f;          // squared radius of the largest support: three standard deviations
constexpr float kMaxAlpha = 0.99f;           // a primitive never hides all that lies behind it
constexpr float kDirectionEpsilon = 1e-12f;  // below this a ray counts as parallel to a surfel's plane
constexpr float kInfinity = 3.0e38f;

ENVGS_FN float select(bool mask, float a, float b) { return mask ? a : b; }
ENVGS_FN float minimum(float a, float b) { return a < b ? a : b; }
ENVGS_FN float maximum(float a, float b) { return a > b ? a : b; }
ENVGS_FN float absolute(float a) { return fabsf(a); }
ENVGS_FN float square_root(float a) { return sqrtf(a); }
#ifdef __CUDACC__
ENVGS_FN float exponential(float a) { return __expf(a); }
#else
ENVGS_FN float exponential(float a) { return expf(a); }
#endif

// An R whose every lane is `value`.
template <class R>
ENVGS_FN R broadcast(float value) {
    return R{} + value;
}

}  // namespace envgs
