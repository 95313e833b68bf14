// Real spherical harmonics to degree 3, in the order and with the signs of 3D Gaussian Splatting.
#pragma once
#include "vec3.h"

namespace envgs {

constexpr float kSh0 = 0.28209479177387814f;
constexpr float kSh1 = 0.4886025119029199f;
ENVGS_TABLE float kSh2[5] = {1.0925484305920792f, -1.0925484305920792f, 0.31539156525252005f, -1.0925484305920792f,
                             0.5462742152960396f};
ENVGS_TABLE float kSh3[7] = {-0.5900435899266435f, 2.890611442640554f, -0.4570457994644658f, 0.3731763325901154f,
                             -0.4570457994644658f, 1.445305721320277f, -0.5900435899266435f};

// y[k] = Y_k(d) for k < (degree + 1)², d unit.
template <int Degree, class R>
ENVGS_FN void sh_basis(Vec3<R> d, R* y) {
    y[0] = broadcast<R>(kSh0);
    if constexpr (Degree > 0) {
        y[1] = -kSh1 * d.y;
        y[2] = kSh1 * d.z;
        y[3] = -kSh1 * d.x;
    }
    if constexpr (Degree > 1) {
        R xx = d.x * d.x, yy = d.y * d.y, zz = d.z * d.z;
        y[4] = kSh2[0] * d.x * d.y;
        y[5] = kSh2[1] * d.y * d.z;
        y[6] = kSh2[2] * (2.0f * zz - xx - yy);
        y[7] = kSh2[3] * d.x * d.z;
        y[8] = kSh2[4] * (xx - yy);
        if constexpr (Degree > 2) {
            y[9] = kSh3[0] * d.y * (3.0f * xx - yy);
            y[10] = kSh3[1] * d.x * d.y * d.z;
            y[11] = kSh3[2] * d.y * (4.0f * zz - xx - yy);
            y[12] = kSh3[3] * d.z * (2.0f * zz - 3.0f * xx - 3.0f * yy);
            y[13] = kSh3[4] * d.x * (4.0f * zz - xx - yy);
            y[14] = kSh3[5] * d.z * (xx - yy);
            y[15] = kSh3[6] * d.x * (xx - 3.0f * yy);
        }
    }
}

// Σ g[k]·∇Y_k(d): the gradient with respect to d, taken as if d's components were free.
template <int Degree, class R>
ENVGS_FN Vec3<R> sh_basis_backward(Vec3<R> d, const R* g) {
    Vec3<R> out = {broadcast<R>(0.0f), broadcast<R>(0.0f), broadcast<R>(0.0f)};
    if constexpr (Degree > 0) {
        out.x -= kSh1 * g[3];
        out.y -= kSh1 * g[1];
        out.z += kSh1 * g[2];
    }
    if constexpr (Degree > 1) {
        out.x +=
            kSh2[0] * d.y * g[4] - 2.0f * kSh2[2] * d.x * g[6] + kSh2[3] * d.z * g[7] + 2.0f * kSh2[4] * d.x * g[8];
        out.y +=
            kSh2[0] * d.x * g[4] + kSh2[1] * d.z * g[5] - 2.0f * kSh2[2] * d.y * g[6] - 2.0f * kSh2[4] * d.y * g[8];
        out.z += kSh2[1] * d.y * g[5] + 4.0f * kSh2[2] * d.z * g[6] + kSh2[3] * d.x * g[7];
    }
    if constexpr (Degree > 2) {
        R xx = d.x * d.x, yy = d.y * d.y, zz = d.z * d.z, xy = d.x * d.y, xz = d.x * d.z, yz = d.y * d.z;
        out.x += 6.0f * kSh3[0] * xy * g[9] + kSh3[1] * yz * g[10] - 2.0f * kSh3[2] * xy * g[11] -
                 6.0f * kSh3[3] * xz * g[12] + kSh3[4] * (4.0f * zz - 3.0f * xx - yy) * g[13] +
                 2.0f * kSh3[5] * xz * g[14] + 3.0f * kSh3[6] * (xx - yy) * g[15];
        out.y += 3.0f * kSh3[0] * (xx - yy) * g[9] + kSh3[1] * xz * g[10] +
                 kSh3[2] * (4.0f * zz - xx - 3.0f * yy) * g[11] - 6.0f * kSh3[3] * yz * g[12] -
                 2.0f * kSh3[4] * xy * g[13] - 2.0f * kSh3[5] * yz * g[14] - 6.0f * kSh3[6] * xy * g[15];
        out.z += kSh3[1] * xy * g[10] + 8.0f * kSh3[2] * yz * g[11] + 3.0f * kSh3[3] * (2.0f * zz - xx - yy) * g[12] +
                 8.0f * kSh3[4] * xz * g[13] + kSh3[5] * (xx - yy) * g[14];
    }
    return out;
}

}  // namespace envgs
