// Which pixels a primitive can touch: the outline of its support on the screen, asked strip by strip.
//
// An ellipse cut by a horizontal strip spans one interval of x, known in closed form, so a primitive's tiles cost a few
// operations a tile row, however many there are, and no tile is listed that the ellipse misses. A strip may be as high
// as a row of tiles or as a row of pixels' centers, which has no height.
#pragma once
#include "gaussian_3d_splat.h"
#include "surfel_splat.h"

namespace envgs {

constexpr float kOutlineSlack = 0.02f;  // px, for rounding

// (p − c)ᵀ·[xx xy; xy yy]⁻¹·(p − c) ≤ 1. Kept are slope = xy/yy, by which the middles of its rows lean, and
// left = xx − xy²/yy, the square of half its width in a row through the center, which xx and xy of a needle do not
// tell. With yy < 0 the outline is not known: all of the pixel box may be touched.
struct Ellipse {
    float x, y, left, slope, yy;
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

// Pixels whose centers lie in the box; false where there are none, or the box is not finite.
ENVGS_FN bool pixels_of(const PinholeCamera& camera, PixelBox box, PixelRect& rect) {
    if (!(box.x1 >= 0.5f && box.y1 >= 0.5f && box.x0 <= camera.width - 0.5f && box.y0 <= camera.height - 0.5f &&
          box.x0 <= box.x1))
        return false;
    rect.column0 = int(ceilf(maximum(box.x0, 0.5f) - 0.5f));
    rect.row0 = int(ceilf(maximum(box.y0, 0.5f) - 0.5f));
    rect.column1 = int(floorf(minimum(box.x1, camera.width - 0.5f) - 0.5f));
    rect.row1 = int(floorf(minimum(box.y1, camera.height - 0.5f) - 0.5f));
    return rect.column0 <= rect.column1 && rect.row0 <= rect.row1;
}

// The outline of the disc ρ ≤ r² of a surfel with semi-axes axis_u, axis_v: the dual conic of disc_box, inverted about
// the projected center. Unknown where the disc comes near the camera plane.
ENVGS_FN Ellipse disc_ellipse(const PinholeCamera& camera, const Projection& center, Vec3<float> axis_u,
                              Vec3<float> axis_v, float r2) {
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
    float slope = xy / maximum(yy, 1e-20f);
    return {center.x + x, center.y + y, grown * maximum(xx - xy * slope, 0.0f), slope, grown * yy};
}

ENVGS_FN Ellipse ellipse_of(const PinholeCamera& camera, const SurfelInput& in, const SurfelSplat& splat) {
    float inverse;
    Axes<float> axes = axes_of(normalized(in.quaternion, inverse));
    return disc_ellipse(camera, project(camera, in.mean), in.scale_u * axes.u, in.scale_v * axes.v, splat.support);
}
ENVGS_FN Ellipse ellipse_of(const PinholeCamera&, const Gaussian3dInput&, const Gaussian3dSplat& s) {
    // Of V⁻¹ = L⁻ᵀ·L⁻¹: left is the inverse of its xx, slope −xy/xx. V's yy is the squared length of L's second row.
    float xx = s.xx * s.xx + s.yx * s.yx, lyy = 1.0f / s.yy, lyx = s.yx * lyy / s.xx;
    return {s.x, s.y, s.support / xx, -s.yx * s.yy / xx, s.support * (lyx * lyx + lyy * lyy)};
}

ENVGS_FN float low_pass_radius(const SurfelSplat& splat) {
    return splat.screen_support > 0.0f ? square_root(0.5f * splat.support) : -1.0f;
}
ENVGS_FN float low_pass_radius(const Gaussian3dSplat&) { return -1.0f; }  // its covariance is widened instead

// Of a primitive whose splat is prepared and whose box holds pixels, rect.
template <class Input, class Splat>
ENVGS_FN Outline outline_of(const PinholeCamera& camera, const Input& in, const Splat& splat, PixelRect rect) {
    return {ellipse_of(camera, in, splat), splat.x, splat.y, low_pass_radius(splat), rect};
}

// Empty where low > high.
template <class R>
struct XInterval {
    R low, high;
};

template <class R>
ENVGS_FN XInterval<R> merged(XInterval<R> a, XInterval<R> b) {
    return {minimum(a.low, b.low), maximum(a.high, b.high)};
}

// What lies between y0 and y1 of the ellipse; everything where it is not known.
template <class R>
ENVGS_FN XInterval<R> strip_of(const Ellipse& e, R y0, R y1) {
    R infinite = broadcast<R>(kInfinity);
    if (e.yy < 0.0f) return {-infinite, infinite};
    float half = square_root(e.yy) + kOutlineSlack;
    R below = maximum(y0 - kOutlineSlack - e.y, broadcast<R>(-half));
    R above = minimum(y1 + kOutlineSlack - e.y, broadcast<R>(half));
    float inverse = 1.0f / maximum(e.yy, 1e-20f), xy = e.slope * e.yy;
    float rightmost = xy / square_root(maximum(e.left + xy * e.slope, 1e-20f));
    auto half_width = [&](R dy) { return square_root(e.left * maximum(1.0f - dy * dy * inverse, broadcast<R>(0.0f))); };
    R right = minimum(maximum(broadcast<R>(rightmost), below), above);
    R left = minimum(maximum(broadcast<R>(-rightmost), below), above);
    auto touched = below <= above;
    return {select(touched, e.x + e.slope * left - half_width(left) - kOutlineSlack, infinite),
            select(touched, e.x + e.slope * right + half_width(right) + kOutlineSlack, -infinite)};
}

// What lies between y0 and y1 of all that may be touched, the box aside.
template <class R>
ENVGS_FN XInterval<R> strip_of(const Outline& o, R y0, R y1) {
    XInterval<R> x = strip_of(o.ellipse, y0, y1);
    float square = o.radius * o.radius;
    if (o.radius > 0.0f) x = merged(x, strip_of(Ellipse{o.x, o.y, square, 0.0f, square}, y0, y1));
    return x;
}

// The pixel columns that may be touched in rows row0 to row1; empty where first > last.
ENVGS_FN Columns columns_in(const Outline& o, int row0, int row1) {
    row0 = row0 > o.box.row0 ? row0 : o.box.row0, row1 = row1 < o.box.row1 ? row1 : o.box.row1;
    if (row0 > row1) return {1, 0};
    XInterval<float> x = strip_of(o, row0 + 0.5f, row1 + 0.5f);
    float first = maximum(ceilf(x.low - 0.5f), float(o.box.column0));
    float last = minimum(floorf(x.high - 0.5f), float(o.box.column1));
    if (!(first <= last)) return {1, 0};
    return {int(first), int(last)};
}

// The tiles of side² pixels that may be touched in a row of tiles.
template <int Side>
ENVGS_FN Columns tiles_in(const Outline& o, int tile_row) {
    Columns c = columns_in(o, tile_row * Side, tile_row * Side + Side - 1);
    if (c.first > c.last) return {1, 0};
    return {c.first / Side, c.last / Side};
}

}  // namespace envgs
