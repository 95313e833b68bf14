// Finding the hits of a packet: 32 rays, a thread each, in one warp.
//
// The rays walk the tree together. A shaft encloses them: along the axis that they advance most on, their positions on
// the other two lie between straight lines. The warp holds a node's 32 boxes against the shaft at once, a thread each,
// so a packet pays for a node what a single ray would; surfels whose boxes survive are put before all 32 rays.
//
// Each ray lists the hits that it meets, unsorted. Once the listed hits together would end the ray, nothing beyond the
// farthest can matter and its far end shrinks to that; a full list is sorted and cut to what is blended. Where that
// cannot make room, the nearest are kept and another pass starts strictly after the last pair (t, index) blended, so no
// hit is lost or met twice. Rays too unlike their packet's first make groups of their own.
#pragma once
#include "trace.cuh"

namespace envgs {

constexpr int kListed = 48;              // hits a ray may list in a pass
constexpr int kSpare = 8;                // free places that cutting must leave
constexpr int kStack = 32 * (kMaxLevels - 1);
constexpr float kGroupSlope = 0.25f;     // rays of a group: how far their slopes may differ from the first's
constexpr float kGroupReach = 1.0f / 16; // and their origins, as a share of the scene
constexpr int kMaxSurfels = 1 << 24;     // a listed hit is a surfel's slot and, in 8 bits, its alpha rounded down

struct alignas(16) PacketMemory {
    TracedSurfel surfels[32];
    float t[kListed][32];
    u32 tag[kListed][32];  // slot << 8 | alpha
    float stack_near[kStack];
    u32 stack_node[kStack];  // level << 27 | group
};

ENVGS_FN u32 slot_of(u32 tag) { return tag >> 8; }

struct Shaft {
    int axis;
    float sign;           // of the rays' direction along the axis
    float start;          // where it begins, along sign·axis
    float end;
    float low[2], high[2];            // position at the start, on the two other axes
    float slope_low[2], slope_high[2];
    float slack[2];
};

ENVGS_FN float component(Vec3<float> v, int axis) { return axis == 0 ? v.x : axis == 1 ? v.y : v.z; }

class Packet {
public:
    __device__ Packet(PacketMemory& memory, const Levels& levels, const float* boxes, const TracedSurfel* surfels,
                      const Ray& ray, float t_min, float reach)
        : m_(memory), levels_(levels), boxes_(boxes), surfels_(surfels), ray_(ray), reach_(reach), from_t_(t_min) {}

    // Lists the nearest hits not yet blended, sorted, of the lanes that ask for it.
    __device__ void search(bool wanted, float transmittance, float transmittance_min) {
        count_ = sorted_ = 0;
        transmittance_ = passed_ = transmittance;
        transmittance_min_ = transmittance_min;
        far_t_ = kInfinity, farthest_ = -kInfinity;
        far_slot_ = -1;
        dropped_ = false;
        float size = maximum(absolute(ray_.direction.x), maximum(absolute(ray_.direction.y), absolute(ray_.direction.z)));
        wanted = wanted && size > 0.0f && size < kInfinity;
        for (u32 pending; (pending = __ballot_sync(kFullWarp, wanted)) != 0;) {
            Shaft shaft;
            bool in_group = gather(pending, size, shaft) && wanted;
            walk(shaft, in_group);
            wanted = wanted && !in_group;
        }
        sort();
    }
    __device__ int count() const { return count_; }
    __device__ bool dropped() const { return dropped_; }
    __device__ float t(int k) const { return m_.t[k][lane_id()]; }
    __device__ u32 slot(int k) const { return slot_of(m_.tag[k][lane_id()]); }
    // The next search starts strictly after this hit.
    __device__ void resume_after(float t, u32 slot) { from_t_ = t, from_slot_ = slot; }

private:
    // The group of the first pending ray, and the shaft around it (all lanes get the shaft).
    __device__ bool gather(u32 pending, float size, Shaft& s) {
        int first = __ffs(pending) - 1;
        Vec3<float> o = ray_.origin, d = ray_.direction, leader_o, leader_d;
        leader_o.x = __shfl_sync(kFullWarp, o.x, first), leader_d.x = __shfl_sync(kFullWarp, d.x, first);
        leader_o.y = __shfl_sync(kFullWarp, o.y, first), leader_d.y = __shfl_sync(kFullWarp, d.y, first);
        leader_o.z = __shfl_sync(kFullWarp, o.z, first), leader_d.z = __shfl_sync(kFullWarp, d.z, first);
        float ax = absolute(leader_d.x), ay = absolute(leader_d.y), az = absolute(leader_d.z);
        s.axis = ax >= ay && ax >= az ? 0 : ay >= az ? 1 : 2;
        s.sign = component(leader_d, s.axis) < 0.0f ? -1.0f : 1.0f;
        int b = s.axis == 0 ? 1 : 0, c = s.axis == 2 ? 1 : 2;
        along_ = s.sign * component(d, s.axis);
        origin_along_ = s.sign * component(o, s.axis);
        float inverse = 1.0f / along_, leader_inverse = s.sign / component(leader_d, s.axis);
        float slope[2] = {component(d, b) * inverse, component(d, c) * inverse};
        bool member = along_ > 0.3f * size &&
                      absolute(slope[0] - component(leader_d, b) * leader_inverse) < kGroupSlope &&
                      absolute(slope[1] - component(leader_d, c) * leader_inverse) < kGroupSlope &&
                      absolute(o.x - leader_o.x) < reach_ && absolute(o.y - leader_o.y) < reach_ &&
                      absolute(o.z - leader_o.z) < reach_;
        member = (pending >> lane_id() & 1) && (member || lane_id() == first);
        float start = origin_along_ + maximum(from_t_, 0.0f) * along_;
        s.start = warp_min(member ? start : kInfinity);
        s.start -= 1e-5f * absolute(s.start);
        float origin[2] = {component(o, b), component(o, c)};
#pragma unroll
        for (int k = 0; k < 2; ++k) {
            float at_start = origin[k] + slope[k] * (s.start - origin_along_);
            s.low[k] = warp_min(member ? at_start : kInfinity), s.high[k] = warp_max(member ? at_start : -kInfinity);
            s.slope_low[k] = warp_min(member ? slope[k] : kInfinity);
            s.slope_high[k] = warp_max(member ? slope[k] : -kInfinity);
            float magnitude = member ? absolute(origin[k]) + absolute(slope[k] * (s.start - origin_along_)) : 0.0f;
            s.slack[k] = 2e-6f * warp_max(magnitude);
        }
        return member;
    }

    __device__ void shrink(Shaft& s, bool in_group) const {
        float end = far_t_ < kInfinity ? origin_along_ + far_t_ * along_ : kInfinity;
        s.end = warp_max(in_group ? end : -kInfinity);
        s.end += 1e-5f * absolute(s.end);
    }

    // Whether this thread's box of a group meets the shaft, and where along it.
    __device__ bool meets(const Shaft& s, int group_at, float& near) const {
        int stride = levels_.total(), at = group_at + lane_id();
        const float* low = boxes_ + at;
        const float* high = low + 3l * stride;
        int b = s.axis == 0 ? 1 : 0, c = s.axis == 2 ? 1 : 2;
        float enter = low[long(s.axis) * stride], leave = high[long(s.axis) * stride];
        float box_low[2] = {low[long(b) * stride], low[long(c) * stride]};
        float box_high[2] = {high[long(b) * stride], high[long(c) * stride]};
        if (s.sign < 0.0f) {
            float swapped = -enter;
            enter = -leave, leave = swapped;
        }
        near = maximum(enter, s.start);
        float far = minimum(leave, s.end);
        bool met = near <= far && enter <= leave;
        float advance_near = near - s.start, advance_far = far - s.start;
#pragma unroll
        for (int k = 0; k < 2; ++k) {
            float low_end = s.low[k] + minimum(s.slope_low[k] * advance_near, s.slope_low[k] * advance_far);
            float high_end = s.high[k] + maximum(s.slope_high[k] * advance_near, s.slope_high[k] * advance_far);
            float slack = s.slack[k] + 2e-6f * (absolute(low_end) + absolute(high_end));
            met = met && box_low[k] <= high_end + slack && box_high[k] >= low_end - slack;
        }
        return met;
    }

    __device__ void walk(Shaft& s, bool in_group) {
        shrink(s, in_group);
        int depth = 1;
        if (lane_id() == 0) m_.stack_near[0] = s.start, m_.stack_node[0] = u32(levels_.count - 1) << 27;
        while (depth > 0) {
            __syncwarp();
            --depth;
            u32 node = m_.stack_node[depth];
            if (m_.stack_near[depth] > s.end) continue;
            int level = node >> 27, group = node & ((1u << 27) - 1);
            float near;
            u32 met = __ballot_sync(kFullWarp, meets(s, levels_.offset[level] + 32 * group, near));
            if (!met) continue;
            if (level > 0) {
                // Nearest on top: a child's place is how many of the others lie nearer.
                int nearer = 0;
                for (u32 rest = met; rest; rest &= rest - 1) {
                    int other = __ffs(rest) - 1;
                    float other_near = __shfl_sync(kFullWarp, near, other);
                    nearer += other_near < near || (other_near == near && other < lane_id());
                }
                __syncwarp();
                int children = __popc(met);
                if (met >> lane_id() & 1) {
                    int at = depth + children - 1 - nearer;
                    m_.stack_near[at] = near;
                    m_.stack_node[at] = u32(level - 1) << 27 | u32(32 * group + lane_id());
                }
                depth += children;
            } else if (test(32 * group, met, in_group)) {
                shrink(s, in_group);
            }
        }
        __syncwarp();
    }

    // Holds surfels against the group's rays; true where some ray's far end may have moved.
    __device__ bool test(int first_slot, u32 candidates, bool in_group) {
        if (candidates >> lane_id() & 1) m_.surfels[lane_id()] = surfels_[first_slot + lane_id()];
        __syncwarp();
        bool moved = false;
        for (; candidates; candidates &= candidates - 1) {
            int k = __ffs(candidates) - 1;
            const TracedSurfel& s = m_.surfels[k];
            PlaneHit<float> hit = intersect(s.frame, ray_.origin - s.mean, ray_.direction);
            float rho = hit.u * hit.u + hit.v * hit.v;
            bool met = in_group && rho <= s.support && hit.t >= from_t_ && hit.t <= far_t_ &&
                       absolute(hit.d_z) > kDirectionEpsilon;
            if (met) moved |= list(hit.t, first_slot + k, response_alpha(s.opacity, rho));
            if (__any_sync(kFullWarp, count_ == kListed)) cut(), moved = true;
        }
        return __any_sync(kFullWarp, moved);
    }

    __device__ bool list(float t, u32 slot, float alpha) {
        if (t == from_t_ && from_slot_ >= 0 && !precedes(from_slot_, slot)) return false;
        if (t == far_t_ && far_slot_ >= 0 && !precedes(slot, far_slot_)) return false;
        m_.t[count_][lane_id()] = t;
        m_.tag[count_][lane_id()] = slot << 8 | u32(alpha * 256.0f);
        ++count_;
        passed_ *= 1.0f - alpha;
        farthest_ = maximum(farthest_, t);
        if (far_t_ < kInfinity || passed_ >= 0.999f * transmittance_min_) return false;
        far_t_ = farthest_;
        return true;
    }

    // The order of hits at equal t.
    __device__ bool precedes(u32 slot, u32 other) const { return surfels_[slot].index < surfels_[other].index; }

    __device__ void sort() {
        for (; sorted_ < count_; ++sorted_) {
            float t = m_.t[sorted_][lane_id()];
            u32 tag = m_.tag[sorted_][lane_id()];
            int at = sorted_;
            for (; at > 0; --at) {
                float before = m_.t[at - 1][lane_id()];
                u32 before_tag = m_.tag[at - 1][lane_id()];
                if (before < t || (before == t && precedes(slot_of(before_tag), slot_of(tag)))) break;
                m_.t[at][lane_id()] = before;
                m_.tag[at][lane_id()] = before_tag;
            }
            m_.t[at][lane_id()] = t;
            m_.tag[at][lane_id()] = tag;
        }
    }

    // Cuts a list to what is certainly blended, or else to the nearest that leave room.
    __device__ void cut() {
        sort();
        float passed = transmittance_;
        int kept = 0;
        while (kept < count_ && passed >= 0.999f * transmittance_min_)
            passed *= 1.0f - (m_.tag[kept++][lane_id()] & 255) * (1.0f / 256.0f);
        if (count_ == kListed && kept > kListed - kSpare) kept = kListed - kSpare, dropped_ = true;
        if (kept < count_) {
            count_ = sorted_ = kept;
            far_t_ = m_.t[kept - 1][lane_id()];
            far_slot_ = slot_of(m_.tag[kept - 1][lane_id()]);
        }
    }

    PacketMemory& m_;
    const Levels& levels_;
    const float* boxes_;
    const TracedSurfel* surfels_;
    Ray ray_;
    float reach_;
    float along_, origin_along_;
    float from_t_;
    int from_slot_ = -1;  // −1: hits at from_t_ itself are taken
    float far_t_, farthest_, passed_, transmittance_, transmittance_min_;
    int far_slot_, count_, sorted_;
    bool dropped_;
};

}  // namespace envgs
