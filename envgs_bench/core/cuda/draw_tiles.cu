// Draws: a thread a pixel, or eight that share it (see tile_primitives.cuh).
#include "tile_primitives.cuh"

using namespace envgs;

extern "C" __global__ void __launch_bounds__(256) draw_tiles(
    const uint2* ranges,  // [tiles] first and past-the-last instance
    const u32* instance_slots,  // [instances] slot of the primitive, sorted by tile, then depth
    const VisiblePrimitive* primitives,  // [visible] by slot
    const Outline* outlines,  // [visible] by slot, pixels
    const PinholeCamera* camera_at,  // [1]
    int tiles_x,  // tiles in a row of the image
    float transmittance_min,  // a pixel is finished below this
    const float* background,  // [3] in [0, 1]
    const Counters* counters,  // [1]
    float* color,  // [3, P] blended color, 1 is white
    float* alpha,  // [P] in [0, 1]
    float* depth,  // [P] expected camera-frame z, 0 where nothing is hit
    float* normal,  // [3, P] world frame, blended, not normalized
    float* extras,  // [E, P] blended extras
    int* hit_counts,  // [P] hits blended
    const int* indices,  // [visible] by slot: the primitive's index
    float* weights  // [N] sums of the blending weights, zeroed before
) {
    const PinholeCamera& camera = *camera_at;
    Place place = Place::own();
    Pixel pixel = own_pixel(camera, place, tiles_x);
    float x = pixel.x + 0.5f, y = pixel.y + 0.5f, near = camera.near;
    BlendedPixel blended = BlendedPixel::initial();
    bool live = pixel.inside;
    TileList list(ranges, instance_slots, primitives, outlines, place.tile, tiles_x);
    auto visit = [&](const VisiblePrimitive& p, u32 slot) {
        auto at = evaluate(p.splat, x, y, near);
        bool hit = live && at.rho <= p.splat.support;
        if (!__any_sync(kFullWarp, hit)) return;
        float weight = 0.0f;
        if (hit) {
            float a = response_alpha(p.splat.opacity, at.rho);
            weight = blended.transmittance * a;
            blended.add(weight, p.color, at.t, at.side, p.normal, p.extras);
            blended.transmittance *= 1.0f - a;
            live = blended.transmittance >= transmittance_min;
        }
        float total = warp_sum_of_weights(weight);
        if (lane_id() == 0) atomicAdd(weights + indices[slot], total);
    };
    if constexpr (kSharedArea) {
        __shared__ float finished_at[32];
        __shared__ BlendedPixel whole[32];
        Progress progress = {pixel.inside ? 1.0f : 0.0f, 0.0f};
        list.share(
            place.area, transmittance_min, progress,
            [&](const VisiblePrimitive& p, Progress& own) {
                auto at = evaluate(p.splat, x, y, near);
                if (at.rho <= p.splat.support) own.transmittance *= 1.0f - response_alpha(p.splat.opacity, at.rho);
            },
            [&](Progress before) {
                blended.transmittance = before.transmittance;
                live = before.transmittance >= transmittance_min;
            },
            live, visit,
            [&](bool finished) {
                if (finished) finished_at[lane_id()] = blended.transmittance;
            });
        for (int warp = 0; warp < kAreas; ++warp) {
            __syncthreads();
            if (warp != warp_id()) continue;
            if (warp > 0) blended.join(whole[lane_id()]);
            whole[lane_id()] = blended;
        }
        if (warp_id() != kAreas - 1) return;
        bool finished = progress.transmittance < transmittance_min;
        blended.transmittance = finished ? finished_at[lane_id()] : progress.transmittance;
    } else {
        list.walk(live, visit);
    }
    if (!pixel.inside) return;
    // Too little room for the instances, seen only after the fact: an image that cannot be mistaken for the right one.
    if (counters->instances > counters->drawn_instances) blended.transmittance = __int_as_float(0x7fc00000);
    Planes<float> out = {color, alpha, depth, normal, extras, long(camera.width) * camera.height};
    blended.store(out, hit_counts, pixel.at, load3(background));
}
