// Rotations as quaternions, wxyz.
#pragma once
#include "vec3.h"

namespace envgs {

template <class R>
struct Quaternion {
    R w, x, y, z;
};

template <class R>
ENVGS_FN Quaternion<R> normalized(Quaternion<R> q, R& inverse_norm) {
    inverse_norm = 1.0f / square_root(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    return {q.w * inverse_norm, q.x * inverse_norm, q.y * inverse_norm, q.z * inverse_norm};
}

// The columns of the rotation matrix of a unit quaternion: the local axes in the world frame.
template <class R>
struct Axes {
    Vec3<R> u, v, n;
};

template <class R>
ENVGS_FN Axes<R> axes_of(Quaternion<R> q) {
    R xx = q.x * q.x, yy = q.y * q.y, zz = q.z * q.z;
    R xy = q.x * q.y, xz = q.x * q.z, yz = q.y * q.z;
    R wx = q.w * q.x, wy = q.w * q.y, wz = q.w * q.z;
    return {{1.0f - 2.0f * (yy + zz), 2.0f * (xy + wz), 2.0f * (xz - wy)},
            {2.0f * (xy - wz), 1.0f - 2.0f * (xx + zz), 2.0f * (yz + wx)},
            {2.0f * (xz + wy), 2.0f * (yz - wx), 1.0f - 2.0f * (xx + yy)}};
}

// dL/dq of an unnormalized q, where dL = torque · ω for a small rotation ω about the local axes: dR = R·[ω]×.
// With q unit, ω = 2·Im(q* ⊗ dq), so dL/dq = 2·q ⊗ (0, torque): orthogonal to q, hence right for any norm.
template <class R>
ENVGS_FN Quaternion<R> quaternion_gradient(Quaternion<R> q, R inverse_norm, Vec3<R> torque) {
    R s = 2.0f * inverse_norm;
    return {
        -s * (q.x * torque.x + q.y * torque.y + q.z * torque.z), s * (q.w * torque.x + q.y * torque.z - q.z * torque.y),
        s * (q.w * torque.y + q.z * torque.x - q.x * torque.z), s * (q.w * torque.z + q.x * torque.y - q.y * torque.x)};
}

}  // namespace envgs
