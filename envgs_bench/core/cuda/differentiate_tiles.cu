// Differentiates draw_tiles: the same primitives once more, front to back (see blend.h). What a primitive's pixels of
// one warp add to its gradient is summed in the warp, and leaves as one coalesced row of atomic additions.
#include "tile_primitives.cuh"

using namespace envgs;

extern "C" __global__ void __launch_bounds__(256) differentiate_tiles(
    const uint2* ranges,  // [tiles] first and past-the-last instance
    const u32* instance_slots,  // [instances] slot of the primitive, sorted by tile, then depth
    const VisiblePrimitive* primitives,  // [visible] by slot
    const Outline* outlines,  // [visible] by slot, pixels
    const PinholeCamera* camera_at,  // [1]
    int tiles_x,  // tiles in a row of the image
    float transmittance_min,  // a pixel is finished below this
    const float* background,  // [3] in [0, 1]
    const float* color,  // [3, P] blended color, 1 is white
    const float* alpha,  // [P] in [0, 1]
    const float* depth,  // [P] expected camera-frame z, 0 where nothing is hit
    const float* normal,  // [3, P] world frame, blended, not normalized
    const float* extras,  // [E, P] blended extras
    const float* g_color,  // [3, P] dL/dcolor, null for zero
    const float* g_alpha,  // [P] dL/dalpha, null for zero
    const float* g_depth,  // [P] dL/ddepth, null for zero
    const float* g_normal,  // [3, P] dL/dnormal, null for zero
    const float* g_extras,  // [E, P] dL/dextras, null for zero
    float* sums  // [visible, kSumsStride] PrimitiveSums by slot, zeroed before
) {
    const PinholeCamera& camera = *camera_at;
    Place place = Place::own();
    Pixel pixel = own_pixel(camera, place, tiles_x);
    long pixels = long(camera.width) * camera.height;
    Planes<const float> out = {color, alpha, depth, normal, extras, pixels};
    Planes<const float> gradient = {g_color, g_alpha, g_depth, g_normal, g_extras, pixels};
    UpstreamGradient g(out, gradient, pixel.inside ? pixel.at : 0, load3(background));
    float x = pixel.x + 0.5f, y = pixel.y + 0.5f, near = camera.near;
    bool live = pixel.inside;
    TileList list(ranges, instance_slots, primitives, outlines, place.tile, tiles_x);
    auto visit = [&](const VisiblePrimitive& p, u32 slot) {
        auto at = evaluate(p.splat, x, y, near);
        bool hit = live && at.rho <= p.splat.support;
        if (!__any_sync(kFullWarp, hit)) return;
        PrimitiveSums sum = {};
        if (hit) {
            float a = response_alpha(p.splat.opacity, at.rho);
            auto [weight, g_a] = g.hit(a, p.color, at.t, at.side, p.normal, p.extras);
            AlphaGradient<float> own = alpha_backward(p.splat.opacity, a, g_a);
            sum.opacity = own.opacity;
            sum.color = weight * g.sum.color;
            sum.normal = (weight * at.side) * g.sum.normal;
#pragma unroll
            for (int k = 0; k < kExtras; ++k) sum.extras[k] = weight * g.extras[k];
            add_pixel(sum.geometry, at, true, own.rho, weight * g.sum.depth);
            live = g.transmittance >= transmittance_min;
        }
        float total = TransposedSum<kSums>::of(reinterpret_cast<float*>(&sum));
        if (lane_id() < kSums) atomicAdd(sums + long(kSumsStride) * slot + lane_id(), total);
    };
    if constexpr (kSharedArea) {
        Progress progress = {pixel.inside ? 1.0f : 0.0f, g.remaining};
        list.share(
            place.area, transmittance_min, progress,
            [&](const VisiblePrimitive& p, Progress& own) {
                auto at = evaluate(p.splat, x, y, near);
                if (at.rho > p.splat.support) return;
                float a = response_alpha(p.splat.opacity, at.rho);
                own.remaining += own.transmittance * a * g.value(p.color, at.t, at.side, p.normal, p.extras);
                own.transmittance *= 1.0f - a;
            },
            [&](Progress before) {
                g.transmittance = before.transmittance, g.remaining = before.remaining;
                live = before.transmittance >= transmittance_min;
            },
            live, visit, [](bool) {});
    } else {
        list.walk(live, visit);
    }
}
