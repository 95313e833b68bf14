// Primitives are sorted by depth once and binned into tiles in that order, so that the tiles' lists need no sort of
// their own. A tile is drawn by one thread, primitive by primitive, W pixels of a row at a time, with all sums of its
// pixels in the first-level cache. Which of these runs a primitive touches is known beforehand, a bit each, so that
// nearly all that is evaluated is hit and the processor need not guess. The backward pass goes through the same lists
// in the same order.
#include "rasterize.h"

#include <algorithm>
#include <bit>
#include <utility>
#include <vector>

#include "kernels/outline.h"
#include "lanes.h"
#include "parallel.h"
#include "radix_sort.h"

namespace envgs {

namespace {

constexpr int kTile = 16;
constexpr int kTilePixels = kTile * kTile;
using F = PixelFloat;
using I = PixelInt;
constexpr int W = kPixelLanes;
constexpr int kRuns = kTilePixels / W;

// A tile's runs of W pixels, a bit each: all rows' first, then all rows' second, so that eight rows are asked at once.
using RunBits = uint64_t;
static_assert(kRuns <= 64);
// Where a pixel of the tile stands in its arrays: those of a run together.
constexpr int place_of(int row, int x) { return (x / W * kTile + row) * W + x % W; }

// What the rasterizer needs to know of surfels.
struct SurfelKind {
    using Splat = SurfelSplat;
    using Input = SurfelInput;
    template <class R> using Sums = SurfelSums<R>;
    static constexpr int scale_count = 2;
    static Input input(const Gaussians& g, int i) {
        return {mean_at(g, i), quaternion_at(g, i), g.scales[2 * i], g.scales[2 * i + 1]};
    }
};

// The same for 3D Gaussians.
struct Gaussian3dKind {
    using Splat = Gaussian3dSplat;
    using Input = Gaussian3dInput;
    template <class R> using Sums = Gaussian3dSums<R>;
    static constexpr int scale_count = 3;
    static Input input(const Gaussians& g, int i) {
        return {mean_at(g, i), quaternion_at(g, i), load3(g.scales + 3 * i)};
    }
};

// A visible primitive, ready to draw.
template <class Splat>
struct VisiblePrimitive {
    Splat splat;
    Vec3<float> color, normal;
    int index;
    Outline outline;
};

// What a tile adds up for one primitive; see array_of.
template <class Sums, class R>
struct PrimitiveSums {
    Sums geometry;
    Vec3<R> color, normal;
    R opacity;
    R extras[kMaxExtras];
};

// The centers of W pixels, the first of which begins at 0.
inline F pixel_centers() {
    F x;
    for (int i = 0; i < W; ++i) x[i] = i + 0.5f;
    return x;
}

// One value of each of a tile's pixels.
struct TilePlane {
    float values[kTilePixels];
};

// W neighboring pixels of a struct of planes, or a single one's, as the same struct of lanes.
template <class To, class R, class From>
inline To load_pixels(const From& planes, int at) {
    To pixels;
    for (int k = 0; k < count_of<From, TilePlane>; ++k)
        array_of<R>(pixels)[k] = load_lanes<R>(array_of<TilePlane>(planes)[k].values + at);
    return pixels;
}
template <class R, class From, class To>
inline void store_pixels(To& planes, int at, const From& pixels) {
    for (int k = 0; k < count_of<To, TilePlane>; ++k)
        store_lanes(array_of<TilePlane>(planes)[k].values + at, array_of<R>(pixels)[k]);
}

template <class Kind>
class TileRasterizer final : public RasterPass {
    using Splat = typename Kind::Splat;
    using LaneSums = PrimitiveSums<typename Kind::template Sums<F>, F>;
    using FloatSums = PrimitiveSums<typename Kind::template Sums<float>, float>;
    static constexpr int kSums = count_of<FloatSums, float>;
    static_assert(count_of<LaneSums, F> == kSums);

public:
    TileRasterizer(const Gaussians& gaussians, const PinholeCamera& camera, Vec3<float> background,
                   float transmittance_min, int threads)
        : g_(gaussians),
          camera_(camera),
          background_(background),
          transmittance_min_(transmittance_min),
          threads_(threads),
          tiles_x_((camera.width + kTile - 1) / kTile),
          tiles_y_((camera.height + kTile - 1) / kTile) {}

    void forward(Planes<float> out, int* hits, float* weights) override;
    void backward(Planes<const float> out, Planes<const float> gradient, GaussianGradients result,
                  bool removals) override;
    std::vector<int> list_lengths() const override;

private:
    struct alignas(64) TileBuffers {
        BlendedSums<TilePlane> sums;
        TilePlane transmittance, extras[kMaxExtras];
        int hits[kTilePixels];
    };
    struct alignas(64) TileGradientBuffers {
        SumGradient<TilePlane> sum;
        TilePlane transmittance, remaining, extras[kMaxExtras];
    };
    struct TileRect {
        int x0, y0, width, height;
        F x[kTile / W];  // the pixels' centers, of a row's runs
        float y[kTile];
    };

    void prepare_primitives();
    void fill_tiles();
    TileRect rect_of(int tile) const {
        int x0 = tile % tiles_x_ * kTile, y0 = tile / tiles_x_ * kTile;
        TileRect rect = {x0, y0, std::min(kTile, camera_.width - x0), std::min(kTile, camera_.height - y0), {}, {}};
        for (int run = 0; run < kTile / W; ++run) rect.x[run] = pixel_centers() + float(x0 + run * W);
        for (int row = 0; row < kTile; ++row) rect.y[row] = y0 + row + 0.5f;
        return rect;
    }
    void draw_tile(int tile, Planes<float> out, int* hits, float* weights);
    void load_gradients(const TileRect& rect, Planes<const float> out, Planes<const float> gradient,
                        TileGradientBuffers& t);
    void differentiate_tile(int tile, Planes<const float> out, Planes<const float> gradient, FloatSums* sums,
                            bool removals);
    void finish_primitive(int visible_index, const std::vector<std::vector<FloatSums>>& sums, GaussianGradients result);

    // The runs that lie in the image.
    RunBits runs_of(const TileRect& rect) const {
        RunBits rows = (RunBits(1) << rect.height) - 1, runs = 0;
        for (int run = 0; run * W < rect.width; ++run) runs |= rows << run * kTile;
        return runs;
    }
    // The runs that the primitive may touch.
    RunBits runs_of(const Outline& outline, const TileRect& rect) const {
        RunBits runs = 0;
        for (int row = 0; row < kTile; row += 8) {
            if (rect.y0 + row > outline.box.row1 || rect.y0 + row + 7 < outline.box.row0) continue;
            Float8 y = load_lanes<Float8>(rect.y + row);
            XInterval<Float8> x = strip_of(outline, y, y);
            Int8 inside = (y > float(outline.box.row0)) & (y < outline.box.row1 + 1.0f);
            for (int run = 0; run < kTile / W; ++run) {
                int column = rect.x0 + run * W;
                if (column > outline.box.column1 || column + W <= outline.box.column0) continue;
                Int8 touched = inside & (x.low <= column + (W - 0.5f)) & (x.high >= column + 0.5f);
                runs |= RunBits(mask_bits(touched)) << (run * kTile + row);
            }
        }
        return runs;
    }

    // Calls visit(the run's offset into the tile's arrays, x of its lanes, y, its bit) for each run.
    template <class Visit>
    void for_each_run(RunBits runs, const TileRect& rect, const Visit& visit) const {
        for (; runs; runs &= runs - 1) {
            int run = std::countr_zero(runs);
            visit(run * W, rect.x[run / kTile], rect.y[run % kTile], RunBits(1) << run);
        }
    }

    Gaussians g_;
    PinholeCamera camera_;
    Vec3<float> background_;
    float transmittance_min_;
    int threads_, tiles_x_, tiles_y_;
    std::vector<VisiblePrimitive<Splat>> visible_;  // visible primitives, front to back
    std::vector<long> tile_begin_;                  // tile -> its part of tile_items_
    std::vector<int> tile_items_;                   // indices into visible_, front to back
};

template <class Kind>
void TileRasterizer<Kind>::prepare_primitives() {
    std::vector<std::vector<VisiblePrimitive<Splat>>> found(threads_);
    parallel_ranges(threads_, g_.count, [&](int begin, int end, int worker) {
        for (int i = begin; i < end; ++i) {
            VisiblePrimitive<Splat> d;
            typename Kind::Input input = Kind::input(g_, i);
            PixelBox box = prepare(camera_, input, g_.opacities[i], d.splat);
            PixelRect rect;
            if (!pixels_of(camera_, box, rect)) continue;
            d.outline = outline_of(camera_, input, d.splat, rect);
            d.index = i;
            d.color = color_at(g_, i, input.mean - camera_.center);
            d.normal = normal_of(input);
            found[worker].push_back(d);
        }
    });
    std::vector<SortItem> order;
    std::vector<const VisiblePrimitive<Splat>*> all;
    for (const auto& part : found)
        for (const VisiblePrimitive<Splat>& d : part) {
            order.push_back({sortable_bits(d.splat.depth), uint32_t(all.size())});
            all.push_back(&d);
        }
    radix_sort(order);
    visible_.resize(order.size());
    parallel_ranges(threads_, int(order.size()), [&](int begin, int end, int) {
        for (int i = begin; i < end; ++i) visible_[i] = *all[order[i].value];
    });
}

template <class Kind>
void TileRasterizer<Kind>::fill_tiles() {
    int tiles = tiles_x_ * tiles_y_;
    tile_begin_.assign(tiles + 1, 0);
    std::vector<std::pair<int, int>> touched;  // tile, index into visible_
    for (int i = 0; i < int(visible_.size()); ++i) {
        const Outline& outline = visible_[i].outline;
        for (int y = outline.box.row0 / kTile; y <= outline.box.row1 / kTile; ++y) {
            Columns columns = tiles_in<kTile>(outline, y);
            for (int x = columns.first; x <= columns.last; ++x) {
                touched.push_back({y * tiles_x_ + x, i});
                ++tile_begin_[touched.back().first + 1];
            }
        }
    }
    for (int tile = 0; tile < tiles; ++tile) tile_begin_[tile + 1] += tile_begin_[tile];
    tile_items_.resize(tile_begin_[tiles]);
    std::vector<long> next(tile_begin_.begin(), tile_begin_.end() - 1);
    for (auto [tile, i] : touched) tile_items_[next[tile]++] = i;
}

template <class Kind>
std::vector<int> TileRasterizer<Kind>::list_lengths() const {
    std::vector<int> lengths;
    for (size_t tile = 0; tile + 1 < tile_begin_.size(); ++tile)
        lengths.push_back(int(tile_begin_[tile + 1] - tile_begin_[tile]));
    return lengths;
}

template <class Kind>
void TileRasterizer<Kind>::forward(Planes<float> out, int* hits, float* weights) {
    prepare_primitives();
    fill_tiles();
    std::vector<std::vector<float>> partial(threads_, std::vector<float>(visible_.size(), 0.0f));
    parallel_interleaved(threads_, tiles_x_ * tiles_y_,
                         [&](int tile, int worker) { draw_tile(tile, out, hits, partial[worker].data()); });
    std::fill(weights, weights + g_.count, 0.0f);
    for (size_t i = 0; i < visible_.size(); ++i)
        for (int worker = 0; worker < threads_; ++worker) weights[visible_[i].index] += partial[worker][i];
}

template <class Kind>
void TileRasterizer<Kind>::draw_tile(int tile_index, Planes<float> out, int* hits, float* weights) {
    TileRect rect = rect_of(tile_index);
    // Clear: nothing is blended, all of the light comes through.
    TileBuffers tile;
    std::memset(&tile, 0, sizeof tile);
    for (int row = 0; row < rect.height; ++row)
        for (int x = 0; x < rect.width; ++x) tile.transmittance.values[place_of(row, x)] = 1.0f;
    // Blend: primitive by primitive, front to back, in the runs of pixels that have not ended.
    RunBits live = runs_of(rect);
    for (long item = tile_begin_[tile_index]; item < tile_begin_[tile_index + 1] && live; ++item) {
        const VisiblePrimitive<Splat>& p = visible_[tile_items_[item]];
        const float* extras = g_.extras + long(p.index) * g_.extra_count;
        F weight_sum = {};
        for_each_run(runs_of(p.outline, rect) & live, rect, [&](int at, F x, float y, RunBits run) {
            // Intersect.
            auto pixel = evaluate(p.splat, x, F{} + y, camera_.near);
            F transmittance = load_lanes<F>(tile.transmittance.values + at);
            I hit = (pixel.rho <= p.splat.support) & (transmittance >= transmittance_min_);
            // Weigh.
            F alpha = select(hit, response_alpha(F{} + p.splat.opacity, pixel.rho), F{});
            F weight = transmittance * alpha;
            transmittance = transmittance * (1.0f - alpha);
            store_lanes(tile.transmittance.values + at, transmittance);
            // Add.
            auto sums = load_pixels<BlendedSums<F>, F>(tile.sums, at);
            blend(sums, weight, p.color, select(hit, pixel.t, F{}), pixel.side, p.normal);
            store_pixels<F>(tile.sums, at, sums);
            for (int e = 0; e < g_.extra_count; ++e) {
                float* plane = tile.extras[e].values + at;
                store_lanes(plane, load_lanes<F>(plane) + weight * extras[e]);
            }
            weight_sum += weight;
            // Count, and end the run where every pixel has.
            I count;
            std::memcpy(&count, tile.hits + at, sizeof count);
            count -= hit;
            std::memcpy(tile.hits + at, &count, sizeof count);
            if (!mask_bits(transmittance >= transmittance_min_)) live &= ~run;
        });
        weights[tile_items_[item]] += sum_lanes(weight_sum);
    }
    // Write: what is left of the light shows the background.
    for (int row = 0; row < rect.height; ++row)
        for (int x = 0; x < rect.width; ++x) {
            int at = place_of(row, x);
            long to = long(rect.y0 + row) * camera_.width + rect.x0 + x;
            write_blended(out, to, load_pixels<BlendedSums<float>, float>(tile.sums, at), tile.transmittance.values[at],
                          background_);
            for (int e = 0; e < g_.extra_count; ++e) out.extras[e * out.pixels + to] = tile.extras[e].values[at];
            hits[to] = tile.hits[at];
        }
}

template <class Kind>
void TileRasterizer<Kind>::load_gradients(const TileRect& rect, Planes<const float> out, Planes<const float> gradient,
                                          TileGradientBuffers& t) {
    for (int row = 0; row < rect.height; ++row)
        for (int x = 0; x < rect.width; ++x) {
            int to = place_of(row, x);
            long at = long(rect.y0 + row) * camera_.width + rect.x0 + x;
            auto [sum, remaining] = read_gradient(out, gradient, at, background_);
            store_pixels<float>(t.sum, to, sum);
            for (int e = 0; e < g_.extra_count; ++e) {
                float g_extra = read(gradient.extras, e * out.pixels + at);
                remaining += g_extra * out.extras[e * out.pixels + at];
                t.extras[e].values[to] = g_extra;
            }
            t.transmittance.values[to] = 1.0f;
            t.remaining.values[to] = remaining;
        }
}

template <class Kind>
void TileRasterizer<Kind>::differentiate_tile(int tile_index, Planes<const float> out, Planes<const float> gradient,
                                              FloatSums* sums, bool removals) {
    TileRect rect = rect_of(tile_index);
    // Load: each pixel's gradient, and what of it lies behind the next primitive: at first all.
    TileGradientBuffers tile;
    std::memset(&tile, 0, sizeof tile);
    load_gradients(rect, out, gradient, tile);
    // Differentiate: the same primitives in the same order, the same hits in the same runs.
    RunBits live = runs_of(rect);
    for (long item = tile_begin_[tile_index]; item < tile_begin_[tile_index + 1] && live; ++item) {
        const VisiblePrimitive<Splat>& p = visible_[tile_items_[item]];
        const float* extras = g_.extras + long(p.index) * g_.extra_count;
        LaneSums sum = {};
        bool touched = false;
        for_each_run(runs_of(p.outline, rect) & live, rect, [&](int at, F x, float y, RunBits run) {
            // Intersect.
            auto pixel = evaluate(p.splat, x, F{} + y, camera_.near);
            F transmittance = load_lanes<F>(tile.transmittance.values + at);
            I hit = (pixel.rho <= p.splat.support) & (transmittance >= transmittance_min_);
            if (!mask_bits(hit)) return;
            touched = true;
            F alpha = select(hit, response_alpha(F{} + p.splat.opacity, pixel.rho), F{});
            // Unblend: what of the gradient lies behind this hit.
            auto g_sum = load_pixels<SumGradient<F>, F>(tile.sum, at);
            F value = hit_value(g_sum, p.color, select(hit, pixel.t, F{}), pixel.side, p.normal);
            for (int e = 0; e < g_.extra_count; ++e) value += load_lanes<F>(tile.extras[e].values + at) * extras[e];
            F remaining = load_lanes<F>(tile.remaining.values + at);
            HitGradient<F> g_hit = blend_backward(alpha, value, transmittance, remaining);
            F weight = g_hit.weight;
            store_lanes(tile.transmittance.values + at, transmittance);
            store_lanes(tile.remaining.values + at, remaining);
            // Add, to the primitive's sums of its lanes.
            for (int e = 0; e < g_.extra_count; ++e)
                sum.extras[e] += weight * load_lanes<F>(tile.extras[e].values + at);
            F g_alpha = select(hit, g_hit.alpha, F{});
            AlphaGradient<F> g = alpha_backward(F{} + p.splat.opacity, alpha, g_alpha);
            sum.opacity += removals ? removal_square(alpha, g_alpha) : g.opacity;
            sum.color = sum.color + weight * g_sum.color;
            sum.normal = sum.normal + (weight * pixel.side) * g_sum.normal;
            add_pixel(sum.geometry, pixel, hit, g.rho, weight * g_sum.depth);
            // End the run where every pixel has.
            if (!mask_bits(transmittance >= transmittance_min_)) live &= ~run;
        });
        if (!touched) continue;
        // Join the lanes.
        float* total = array_of<float>(sums[tile_items_[item]]);
        int used = kSums - kMaxExtras + g_.extra_count;
        for (int k = 0; k < used; ++k) total[k] += sum_lanes(array_of<F>(sum)[k]);
    }
}

template <class Kind>
void TileRasterizer<Kind>::finish_primitive(int visible_index, const std::vector<std::vector<FloatSums>>& sums,
                                            GaussianGradients result) {
    FloatSums sum = sums[0][visible_index];
    for (int worker = 1; worker < threads_; ++worker) {
        const float* other = array_of<float>(sums[worker][visible_index]);
        for (int k = 0; k < kSums; ++k) array_of<float>(sum)[k] += other[k];
    }
    const VisiblePrimitive<Splat>& p = visible_[visible_index];
    long i = p.index;
    typename Kind::Input input = Kind::input(g_, p.index);
    SplatGradient g = finish(camera_, input, sum.geometry, sum.normal);
    Vec3<float> through_color = color_backward_at(g_, p.index, input.mean - camera_.center, p.color, sum.color,
                                                  result.sh + 3 * g_.sh_coefficients * i);
    store3(result.means + 3 * i, g.mean + through_color);
    store3(result.position_gradients + 3 * i, g.position_statistic);
    float* q = result.quaternions + 4 * i;
    q[0] = g.quaternion.w, q[1] = g.quaternion.x, q[2] = g.quaternion.y, q[3] = g.quaternion.z;
    const float scales[3] = {g.scales.x, g.scales.y, g.scales.z};
    for (int k = 0; k < Kind::scale_count; ++k) result.scales[Kind::scale_count * i + k] = scales[k];
    result.opacities[i] = sum.opacity;
    for (int e = 0; e < g_.extra_count; ++e) result.extras[g_.extra_count * i + e] = sum.extras[e];
}

template <class Kind>
void TileRasterizer<Kind>::backward(Planes<const float> out, Planes<const float> gradient, GaussianGradients result,
                                    bool removals) {
    std::vector<std::vector<FloatSums>> sums(threads_);
    parallel(threads_, [&](int worker) { sums[worker].assign(visible_.size(), FloatSums{}); });
    parallel_interleaved(threads_, tiles_x_ * tiles_y_, [&](int tile, int worker) {
        differentiate_tile(tile, out, gradient, sums[worker].data(), removals);
    });
    parallel_ranges(threads_, int(visible_.size()), [&](int begin, int end, int) {
        for (int i = begin; i < end; ++i) finish_primitive(i, sums, result);
    });
}

}  // namespace

std::unique_ptr<RasterPass> make_raster_pass(const Gaussians& gaussians, bool surfels, const PinholeCamera& camera,
                                             Vec3<float> background, float transmittance_min, int threads) {
    if (surfels)
        return std::make_unique<TileRasterizer<SurfelKind>>(gaussians, camera, background, transmittance_min, threads);
    return std::make_unique<TileRasterizer<Gaussian3dKind>>(gaussians, camera, background, transmittance_min, threads);
}

}  // namespace envgs
