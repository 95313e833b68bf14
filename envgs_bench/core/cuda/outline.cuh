// Which pixels a primitive can touch: the outline of its support on the screen, asked row strip by row strip.
//
// An ellipse cut by a horizontal strip spans one interval of x, known in closed form, so a primitive's tiles cost a few
// operations a tile row, however many there are, and no tile is listed that the ellipse misses.
#pragma once
#include "gaussians.cuh"

namespace envgs {

constexpr int kTile = TILE;
constexpr float kOutlineSlack = 0.02f;  // px, for rounding

// (p − c)ᵀ·[xx xy; xy yy]⁻¹·(p − c) ≤ 1. With yy < 0 the outline is not known: all of the pixel box may be touched.
struct Ellipse {
    float x, y, xx, xy, yy;
};

// Pixel columns and rows, inclusive.
struct PixelRect {
    int column0, row0, column1, row1;
};

struct Columns {
    int first, last;
};

struct alignas(16) Outline {
    Ellipse ellipse;
    float x, y, radius;  // the low-pass's disc about the projected center; radius < 0 where there is none
    PixelRect box;
};
static_assert(sizeof(Outline) == 4 * OUTLINE_FLOATS);

struct XInterval {
    float low, high;
};

ENVGS_FN XInterval merged(XInterval a, XInterval b) { return {minimum(a.low, b.low), maximum(a.high, b.high)}; }

ENVGS_FN XInterval strip_of(const Ellipse& e, float y0, float y1) {
    if (e.yy < 0.0f) return {-kInfinity, kInfinity};
    float half = square_root(e.yy) + kOutlineSlack;
    float below = maximum(y0 - kOutlineSlack - e.y, -half), above = minimum(y1 + kOutlineSlack - e.y, half);
    if (!(below <= above)) return {kInfinity, -kInfinity};
    float rightmost = e.xy / square_root(maximum(e.xx, 1e-20f));
    float inverse = 1.0f / maximum(e.yy, 1e-20f), slope = e.xy * inverse;
    float width = maximum(e.xx - e.xy * slope, 0.0f);
    auto half_width = [&](float dy) { return square_root(width * maximum(1.0f - dy * dy * inverse, 0.0f)); };
    float right = minimum(maximum(rightmost, below), above), left = minimum(maximum(-rightmost, below), above);
    return {e.x + slope * left - half_width(left) - kOutlineSlack,
            e.x + slope * right + half_width(right) + kOutlineSlack};
}

// The pixel columns that may be touched in rows row0 to row1; empty where first > last.
ENVGS_FN Columns columns_in(const Outline& o, int row0, int row1) {
    row0 = max(row0, o.box.row0), row1 = min(row1, o.box.row1);
    if (row0 > row1) return {1, 0};
    float y0 = row0 + 0.5f, y1 = row1 + 0.5f;
    XInterval x = strip_of(o.ellipse, y0, y1);
    if (o.radius > 0.0f) x = merged(x, strip_of({o.x, o.y, o.radius * o.radius, 0.0f, o.radius * o.radius}, y0, y1));
    float first = maximum(ceilf(x.low - 0.5f), float(o.box.column0));
    float last = minimum(floorf(x.high - 0.5f), float(o.box.column1));
    if (!(first <= last)) return {1, 0};
    return {int(first), int(last)};
}

// The tiles that may be touched in a row of tiles.
ENVGS_FN Columns tiles_in(const Outline& o, int tile_row) {
    Columns c = columns_in(o, tile_row * kTile, tile_row * kTile + kTile - 1);
    if (c.first > c.last) return {1, 0};
    return {c.first / kTile, c.last / kTile};
}

ENVGS_FN int count_tiles(const Outline& o) {
    int count = 0;
    for (int row = o.box.row0 / kTile; row <= o.box.row1 / kTile; ++row) {
        Columns c = tiles_in(o, row);
        count += c.last - c.first + 1;
    }
    return count;
}

// The outline of the disc ρ ≤ r² of a surfel with semi-axes axis_u, axis_v: the dual conic of disc_box, inverted about
// the projected center. Unknown where the disc comes near the camera plane.
ENVGS_FN Ellipse disc_ellipse(const PinholeCamera& camera, const Projection& center, Vec3<float> axis_u,
                              Vec3<float> axis_v,
                              float r2) {
    Vec3<float> hu = center.world_to_pixel * axis_u, hv = center.world_to_pixel * axis_v;
    float zc = center.in_camera.z;
    float depth_extent2 = r2 * (hu.z * hu.z + hv.z * hv.z);
    if (!(zc - square_root(depth_extent2) > 0.5f * camera.near)) return {0.0f, 0.0f, 0.0f, 0.0f, -1.0f};
    float ux = hu.x - center.x * hu.z, uy = hu.y - center.y * hu.z;
    float vx = hv.x - center.x * hv.z, vy = hv.y - center.y * hv.z;
    float inverse = 1.0f / (depth_extent2 - zc * zc);
    float x = r2 * (ux * hu.z + vx * hv.z) * inverse, y = r2 * (uy * hu.z + vy * hv.z) * inverse;
    // Grown by as much as disc_box grows the box, for the rounding of large discs.
    float xx = x * x - r2 * (ux * ux + vx * vx) * inverse, xy = x * y - r2 * (ux * uy + vx * vy) * inverse;
    float yy = y * y - r2 * (uy * uy + vy * vy) * inverse;
    constexpr float grown = 1.0004f;
    return {center.x + x, center.y + y, grown * xx, grown * xy, grown * yy};
}

}  // namespace envgs
