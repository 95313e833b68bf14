// Three-vectors and 3×3 matrices of R.
#pragma once
#include "real.h"

namespace envgs {

template <class R>
struct Vec3 {
    R x, y, z;
};

template <class R> ENVGS_FN Vec3<R> operator+(Vec3<R> a, Vec3<R> b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
template <class R> ENVGS_FN Vec3<R> operator-(Vec3<R> a, Vec3<R> b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
template <class R> ENVGS_FN Vec3<R> operator-(Vec3<R> a) { return {-a.x, -a.y, -a.z}; }
template <class R, class S> ENVGS_FN Vec3<R> operator*(S s, Vec3<R> a) { return {s * a.x, s * a.y, s * a.z}; }
template <class R> ENVGS_FN R dot(Vec3<R> a, Vec3<R> b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
template <class R> ENVGS_FN R length(Vec3<R> a) { return square_root(dot(a, a)); }
template <class R> ENVGS_FN Vec3<R> cross(Vec3<R> a, Vec3<R> b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <class R> ENVGS_FN Vec3<R> load3(const R* p) { return {p[0], p[1], p[2]}; }
template <class R> ENVGS_FN void store3(R* p, Vec3<R> a) { p[0] = a.x, p[1] = a.y, p[2] = a.z; }

// Rows first: m * v = (rows · v).
template <class R>
struct Mat3 {
    Vec3<R> row0, row1, row2;
};

template <class R> ENVGS_FN Vec3<R> operator*(Mat3<R> m, Vec3<R> v) {
    return {dot(m.row0, v), dot(m.row1, v), dot(m.row2, v)};
}
// mᵀ · v
template <class R> ENVGS_FN Vec3<R> transposed_times(Mat3<R> m, Vec3<R> v) {
    return v.x * m.row0 + v.y * m.row1 + v.z * m.row2;
}
template <class R> ENVGS_FN Mat3<R> transposed(Mat3<R> m) {
    return {{m.row0.x, m.row1.x, m.row2.x}, {m.row0.y, m.row1.y, m.row2.y}, {m.row0.z, m.row1.z, m.row2.z}};
}
template <class R> ENVGS_FN Mat3<R> operator*(Mat3<R> a, Mat3<R> b) {
    return {transposed_times(b, a.row0), transposed_times(b, a.row1), transposed_times(b, a.row2)};
}
template <class R> ENVGS_FN Mat3<R> load_mat3(const R* p) { return {load3(p), load3(p + 3), load3(p + 6)}; }

// The derivative of v / |v|: dL/dv from dL/d(unit).
template <class R>
ENVGS_FN Vec3<R> normalize_backward(Vec3<R> unit, R inverse_length, Vec3<R> gradient) {
    return inverse_length * (gradient - dot(unit, gradient) * unit);
}

}  // namespace envgs
