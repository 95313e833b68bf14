// The arrays of a GaussianSet, row-major float32, as Python hands them over.
#pragma once
#include "lanes.h"  // first: the kernels find the lanes' overloads only if they precede them

#include "kernels/gaussian_3d_splat.h"
#include "kernels/planes.h"
#include "kernels/sites.h"
#include "kernels/surfel_splat.h"

namespace envgs {

constexpr int kMaxExtras = MAX_EXTRAS;  // of gaussians.py, which refuses more

struct Gaussians {
    const float* means;        // [N, 3] centers, world units
    const float* quaternions;  // [N, 4] wxyz, local to world, any non-zero norm
    const float* scales;       // [N, 2] of surfels, [N, 3] of 3D Gaussians: standard deviations, world units
    const float* opacities;    // [N] in [0, 1]
    const float* sh;           // [N, K, 3] SH coefficients, or sites in two rows each
    const float* extras;       // [N, E] further values to blend
    int count, sh_coefficients, extra_count;  // N, K, E
    bool has_sites;
};

// The same arrays to be filled with gradients; zeroed by the caller.
struct GaussianGradients {
    float *means, *quaternions, *scales, *opacities, *sh, *extras;  // shapes as in Gaussians
    float* position_gradients;                                      // [N, 3] Σ t·dL/dmean, world frame
};

inline Quaternion<float> quaternion_at(const Gaussians& g, int i) {
    const float* q = g.quaternions + 4 * i;
    return {q[0], q[1], q[2], q[3]};
}
inline Vec3<float> mean_at(const Gaussians& g, int i) { return load3(g.means + 3 * i); }

// f with the SH degree of so many coefficients, an integral constant: what is compiled once for each degree.
template <class F>
inline auto with_degree(int coefficients, F f) {
    switch (coefficients) {
        case 1: return f(std::integral_constant<int, 0>{});
        case 4: return f(std::integral_constant<int, 1>{});
        case 9: return f(std::integral_constant<int, 2>{});
        default: return f(std::integral_constant<int, 3>{});
    }
}

inline Vec3<float> color_at(const Gaussians& g, int i, Vec3<float> v) {
    const float* sh = g.sh + 3l * g.sh_coefficients * i;
    if (g.has_sites) return site_color(sh, v);
    return with_degree(g.sh_coefficients, [&](auto degree) { return sh_color<degree>(sh, v); });
}
inline Vec3<float> color_backward_at(const Gaussians& g, int i, Vec3<float> v, Vec3<float> color, Vec3<float> gradient,
                                     float* g_sh) {
    const float* sh = g.sh + 3l * g.sh_coefficients * i;
    if (g.has_sites) return site_color_backward(sh, v, color, gradient, g_sh);
    return with_degree(g.sh_coefficients,
                       [&](auto degree) { return sh_color_backward<degree>(sh, v, color, gradient, g_sh); });
}

}  // namespace envgs
