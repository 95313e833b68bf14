// Differentiates draw_tiles: the same primitives once more, front to back (see blend.h). What a primitive's pixels of
// one warp add to its gradient is summed in the warp, and leaves as one coalesced row of atomic additions.
#include "tile_primitives.cuh"

using namespace envgs;

constexpr bool kRemovals = REMOVALS;  // sums of removal_square in place of dL/dopacity

extern "C" __global__ void __launch_bounds__(kThreads)
    differentiate_tiles(const uint2* ranges,        // [tiles] first and past-the-last instance
                        const u32* instance_slots,  // [instances] slot of the primitive, sorted by tile, then depth
                        const VisiblePrimitive* primitives,  // [visible] by slot
                        const Outline* outlines,             // [visible] by slot, pixels
                        const PinholeCamera* camera_at,      // [1]
                        int tiles_x,                         // tiles in a row of the image
                        float transmittance_min,             // a pixel is finished below this
                        const float* background,             // [3] in [0, 1]
                        const float* color,                  // [3, P] blended color, 1 is white
                        const float* alpha,                  // [P] in [0, 1]
                        const float* depth,                  // [P] expected camera-frame z, 0 where nothing is hit
                        const float* normal,                 // [3, P] world frame, blended, not normalized
                        const float* extras,                 // [E, P] blended extras
                        const float* g_color,                // [3, P] dL/dcolor, null for zero
                        const float* g_alpha,                // [P] dL/dalpha, null for zero
                        const float* g_depth,                // [P] dL/ddepth, null for zero
                        const float* g_normal,               // [3, P] dL/dnormal, null for zero
                        const float* g_extras,               // [E, P] dL/dextras, null for zero
                        float* sums  // [visible, kSumsStride] PrimitiveSums by slot, zeroed before
    ) {
    const PinholeCamera& camera = *camera_at;
    Place place = Place::own();
    long plane = long(camera.width) * camera.height;
    Planes<const float> out = {color, alpha, depth, normal, extras, plane};
    Planes<const float> gradient = {g_color, g_alpha, g_depth, g_normal, g_extras, plane};
    OwnPixels own(camera, place, tiles_x);
    UpstreamGradient g[kPixels];
#pragma unroll
    for (int k = 0; k < kPixels; ++k)
        g[k] = UpstreamGradient(out, gradient, own.lives[k] ? own.pixels[k].at : 0, load3(background));
    TileList list(ranges, instance_slots, primitives, outlines, nullptr, place.tile, tiles_x);
    auto visit = [&](const VisiblePrimitive& p, u32 slot) {
        Kind::Response at[kPixels];
        bool hits[kPixels], hit = own.hit(p.splat, at, hits);
        if (!__any_sync(kFullWarp, hit)) return;
        PrimitiveSums sum = {};
#pragma unroll
        for (int k = 0; k < kPixels; ++k) {
            if (hits[k]) {
                float a = response_alpha(p.splat.opacity, at[k].rho);
                auto [weight, g_a] = g[k].hit(a, p.color, at[k].t, at[k].side, p.normal, p.extras);
                AlphaGradient<float> through = alpha_backward(p.splat.opacity, a, g_a);
                sum.opacity += kRemovals ? removal_square(a, g_a) : through.opacity;
                sum.color = sum.color + weight * g[k].sum.color;
                sum.normal = sum.normal + (weight * at[k].side) * g[k].sum.normal;
#pragma unroll
                for (int e = 0; e < kExtras; ++e) sum.extras[e] += weight * g[k].extras[e];
                add_pixel(sum.geometry, at[k], true, through.rho, weight * g[k].sum.depth);
            }
            own.goes_on(k, own.lives[k] && g[k].transmittance >= transmittance_min);
        }
        float total = TransposedSum<kSums>::of(reinterpret_cast<float*>(&sum));
        if (lane_id() < kSums) atomicAdd(sums + long(kSumsStride) * slot + lane_id(), total);
    };
    if constexpr (kSharedArea) {
        Progress progress[kPixels];
#pragma unroll
        for (int k = 0; k < kPixels; ++k) progress[k] = {own.lives[k] ? 1.0f : 0.0f, g[k].remaining};
        list.share(
            place.area, transmittance_min, progress,
            [&](const VisiblePrimitive& p, Progress(&through)[kPixels]) {
#pragma unroll
                for (int k = 0; k < kPixels; ++k) {
                    auto at = own.response(p.splat, k);
                    if (at.rho > p.splat.support) continue;
                    float a = response_alpha(p.splat.opacity, at.rho);
                    float value = g[k].value(p.color, at.t, at.side, p.normal, p.extras);
                    through[k].remaining += through[k].transmittance * a * value;
                    through[k].transmittance *= 1.0f - a;
                }
            },
            [&](int k, Progress before) {
                g[k].transmittance = before.transmittance, g[k].remaining = before.remaining;
                own.goes_on(k, before.transmittance >= transmittance_min);
            },
            own.live, visit, [](int, bool) {});
    } else {
        list.walk(own.live, visit);
    }
}
