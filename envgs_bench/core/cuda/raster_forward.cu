// Draws: a block a tile, a thread a pixel.
#include "tile_walk.cuh"

using namespace envgs;

extern "C" __global__ void __launch_bounds__(256)
    draw_tiles(const uint2* ranges, const u32* instance_slots, const Record* records, const Outline* outlines,
               const View* view_at, int tiles_x, float transmittance_min, const float* background,
               const Counters* counters, float* color, float* alpha, float* depth, float* normal, float* extras,
               int* hit_counts, const int* indices, float* weights) {
    const View& view = *view_at;
    Pixel pixel = own_pixel(view, blockIdx.x, tiles_x);
    float x = pixel.x + 0.5f, y = pixel.y + 0.5f, near = view.near;
    Blended sums = Blended::nothing();
    bool live = pixel.inside;
    walk_tile(ranges[blockIdx.x], instance_slots, records, outlines, blockIdx.x % tiles_x * kTile,
              blockIdx.x / tiles_x * kTile, live, [&](const Record& p, u32 slot) {
                  auto at = evaluate(p.splat, x, y, near);
                  bool hit = live && at.rho <= p.splat.support;
                  if (!__any_sync(kFullWarp, hit)) return;
                  float weight = 0.0f;
                  if (hit) {
                      float a = response_alpha(p.splat.opacity, at.rho);
                      weight = sums.transmittance * a;
                      sums.add(weight, p.color, at.t, at.side * p.normal, p.extras);
                      sums.transmittance *= 1.0f - a;
                      live = sums.transmittance >= transmittance_min;
                  }
                  float total = warp_sum_of_weights(weight);
                  if (lane_id() == 0) atomicAdd(weights + indices[slot], total);
              });
    if (!pixel.inside) return;
    // Too little room for the instances, seen only after the fact: an image that cannot be mistaken for the right one.
    if (counters->instances > counters->drawn_instances) sums.transmittance = __int_as_float(0x7fc00000);
    Planes<float> out = {color, alpha, depth, normal, extras, long(view.width) * view.height};
    sums.store(out, hit_counts, pixel.at, load3(background));
}
