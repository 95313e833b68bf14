// Top-down construction by the surface area heuristic over binned centroids (Wald 2007), along the longest axis of the
// centroids' box. A node is split until it has eight parts, the part of largest area first, which builds the wide
// hierarchy at once. Costs count leaves of eight, not surfels: a leaf is tested as a whole.
#include "bvh.h"

#include <algorithm>

#include "parallel.h"

namespace envgs {

namespace {

constexpr int kWidth = 8;
constexpr int kMaxBins = 16;
constexpr int kManySurfels = 128;  // parts of fewer are cut into half as many bins: sweeping bins would cost most
using Float4 = LaneTypes<4>::Float;

inline Float4 lower(Float4 a, Float4 b) { return a < b ? a : b; }
inline Float4 upper(Float4 a, Float4 b) { return a > b ? a : b; }

struct Aabb {
    Float4 low = Float4{} + kInfinity, high = Float4{} - kInfinity;

    void add(const Aabb& other) {
        low = lower(low, other.low);
        high = upper(high, other.high);
    }
    float area() const {
        Float4 d = upper(high - low, Float4{});
        return d[0] * d[1] + d[1] * d[2] + d[2] * d[0];
    }
};

struct Item {
    Aabb box;  // the fourth lane of `low` holds the primitive's index, that of `high` nothing: see index_of
};

inline int index_of(const Item& item) {
    int index;
    float lane = item.box.low[3];
    std::memcpy(&index, &lane, sizeof index);
    return index;
}

// Twice the centroid: all that binning needs.
inline Float4 centroid(const Item& item) { return item.box.low + item.box.high; }

struct BuildPart {
    int begin, end;
    Aabb box, centroids;

    int count() const { return end - begin; }
};

inline int leaves_for(int count) { return (count + kWidth - 1) / kWidth; }

BuildPart part_of(const std::vector<Item>& items, int begin, int end) {
    BuildPart part{begin, end, {}, {}};
    for (int i = begin; i < end; ++i) {
        Float4 c = centroid(items[i]);
        part.box.add(items[i].box);
        part.centroids.add({c, c});
    }
    return part;
}

// Splits a part of more than eight surfels in two, neither empty.
std::pair<BuildPart, BuildPart> split(std::vector<Item>& items, const BuildPart& part) {
    Float4 extent = part.centroids.high - part.centroids.low;
    int axis = extent[0] >= extent[1] && extent[0] >= extent[2] ? 0 : extent[1] >= extent[2] ? 1 : 2;
    auto halves = [&] {
        int middle = (part.begin + part.end) / 2;
        return std::pair(part_of(items, part.begin, middle), part_of(items, middle, part.end));
    };
    int bins = part.count() < kManySurfels ? kMaxBins / 2 : kMaxBins;
    float origin = part.centroids.low[axis], scale = float(bins) * 0.9999f / extent[axis];
    if (!(extent[axis] > 0.0f && extent[axis] < kInfinity && scale < kInfinity)) return halves();

    Aabb boxes[kMaxBins];
    int counts[kMaxBins] = {};
    for (int i = part.begin; i < part.end; ++i) {
        int bin = int((centroid(items[i])[axis] - origin) * scale);
        boxes[bin].add(items[i].box);
        ++counts[bin];
    }
    float right_cost[kMaxBins];
    Aabb box;
    int count = 0;
    for (int bin = bins - 1; bin > 0; --bin) {
        box.add(boxes[bin]);
        count += counts[bin];
        right_cost[bin] = count ? box.area() * leaves_for(count) : 0.0f;
    }
    box = {};
    count = 0;
    int best = -1;
    float best_cost = kInfinity;
    for (int bin = 1; bin < bins; ++bin) {
        box.add(boxes[bin - 1]);
        count += counts[bin - 1];
        if (count == 0 || count == part.count()) continue;
        float cost = box.area() * leaves_for(count) + right_cost[bin];
        if (cost < best_cost) best_cost = cost, best = bin;
    }
    // The ends of the centroids' box fall into the first and the last bin, so some plane has surfels on both sides;
    // none is best where the boxes' areas are too large for a float.
    if (best < 0) return halves();
    BuildPart left{part.begin, part.begin, {}, {}}, right{part.end, part.end, {}, {}};
    for (int bin = 0; bin < bins; ++bin) (bin < best ? left : right).box.add(boxes[bin]);
    while (left.end < right.begin) {
        Item& item = items[left.end];
        Float4 c = centroid(item);
        if (int((c[axis] - origin) * scale) < best) {
            left.centroids.add({c, c});
            ++left.end;
        } else {
            right.centroids.add({c, c});
            std::swap(item, items[--right.begin]);
        }
    }
    return {left, right};
}

// A leaf during construction: a range of the items. The surfels themselves are copied once, at the end.
struct LeafRange {
    int begin, count;
};

struct Subtree {
    std::vector<BvhNode> nodes;
    std::vector<LeafRange> leaves;
};

class Builder {
public:
    explicit Builder(std::vector<Item>& items) : items_(items) {}

    // The parts of one node: at most eight, in a fixed order.
    std::vector<BuildPart> parts_of(const BuildPart& whole) {
        std::vector<BuildPart> parts = {whole};
        while (parts.size() < kWidth) {
            int largest = -1;
            float area = -1.0f;
            for (int i = 0; i < int(parts.size()); ++i)
                if (parts[i].count() > kWidth && parts[i].box.area() > area) largest = i, area = parts[i].box.area();
            if (largest < 0) break;
            auto [left, right] = split(items_, parts[largest]);
            parts[largest] = left;
            parts.push_back(right);
        }
        return parts;
    }

    // Appends the subtree over `part` and returns it as a child: a node or ~leaf.
    int build(const BuildPart& part, Subtree& tree) {
        if (part.count() <= kWidth) {
            tree.leaves.push_back({part.begin, part.count()});
            return ~int(tree.leaves.size() - 1);
        }
        std::vector<BuildPart> parts = parts_of(part);
        int node = int(tree.nodes.size());
        tree.nodes.push_back(node_of(parts));
        for (int i = 0; i < int(parts.size()); ++i) {
            int child = build(parts[i], tree);
            tree.nodes[node].child[i] = child;
        }
        return node;
    }

    static BvhNode node_of(const std::vector<BuildPart>& parts) {
        BvhNode node;
        for (int i = 0; i < kWidth; ++i) {
            bool used = i < int(parts.size());
            for (int axis = 0; axis < 3; ++axis) {
                node.low[axis][i] = used ? parts[i].box.low[axis] : kInfinity;
                node.high[axis][i] = used ? parts[i].box.high[axis] : -kInfinity;
            }
            node.child[i] = 0;
        }
        return node;
    }

private:
    std::vector<Item>& items_;
};

BvhLeaf leaf_of(const std::vector<Item>& items, LeafRange range, const std::vector<TracedSurfel>& surfels) {
    BvhLeaf leaf = {};
    for (int lane = 0; lane < kWidth; ++lane) {
        leaf.support[lane] = -1.0f;
        leaf.index[lane] = -1;
        if (lane >= range.count) continue;
        int index = index_of(items[range.begin + lane]);
        const TracedSurfel& s = surfels[index];
        const float* rows[4] = {&s.frame.u.x, &s.frame.v.x, &s.frame.n.x, &s.mean.x};
        for (int axis = 0; axis < 3; ++axis) {
            leaf.u[axis][lane] = rows[0][axis];
            leaf.v[axis][lane] = rows[1][axis];
            leaf.n[axis][lane] = rows[2][axis];
            leaf.mean[axis][lane] = rows[3][axis];
        }
        leaf.support[lane] = s.support;
        leaf.opacity[lane] = s.opacity;
        leaf.index[lane] = index;
    }
    return leaf;
}

// The box of the supporting disc: along each axis r·√((s_u·t_u)² + (s_v·t_v)²), and a hair for rounding.
Item item_of(const TracedSurfel& s, Axes<float> axes, float scale_u, float scale_v, int index) {
    const float* u = &axes.u.x;
    const float* v = &axes.v.x;
    const float* mean = &s.mean.x;
    Item item;
    item.box.low = item.box.high = Float4{};
    for (int axis = 0; axis < 3; ++axis) {
        float a = scale_u * u[axis], b = scale_v * v[axis];
        float half = square_root(s.support * (a * a + b * b));
        half += 1e-6f * (std::fabs(mean[axis]) + half);
        item.box.low[axis] = mean[axis] - half;
        item.box.high[axis] = mean[axis] + half;
    }
    float lane;
    std::memcpy(&lane, &index, sizeof lane);
    item.box.low[3] = lane;
    return item;
}

bool is_finite(const Item& item) {
    for (int axis = 0; axis < 3; ++axis)
        if (!std::isfinite(item.box.low[axis]) || !std::isfinite(item.box.high[axis])) return false;
    return true;
}

}  // namespace

Bvh::Bvh(const Gaussians& g, int threads) : surfels(g.count) {
    // Each worker packs the visible surfels of its range to the range's front; then the gaps are closed.
    std::vector<Item> items(g.count);
    std::vector<std::pair<int, int>> packed(threads);
    parallel_ranges(threads, g.count, [&](int begin, int end, int worker) {
        int to = begin;
        for (int i = begin; i < end; ++i) {
            TracedSurfel& s = surfels[i];
            float inverse_norm, scale_u = g.scales[2 * i], scale_v = g.scales[2 * i + 1];
            Axes<float> axes = axes_of(normalized(quaternion_at(g, i), inverse_norm));
            s = {surfel_frame(axes, scale_u, scale_v), mean_at(g, i), support_of(g.opacities[i]), g.opacities[i]};
            if (!(s.support > 0.0f)) continue;
            Item item = item_of(s, axes, scale_u, scale_v, i);
            if (is_finite(item)) items[to++] = item;
        }
        packed[worker] = {begin, to};
    });
    int count = 0;
    for (auto [begin, end] : packed) {
        if (count != begin) std::copy(items.begin() + begin, items.begin() + end, items.begin() + count);
        count += end - begin;
    }
    if (!count) return;

    Builder builder(items);
    std::vector<BuildPart> parts = builder.parts_of(part_of(items, 0, count));
    std::vector<Subtree> trees(parts.size());
    std::vector<int> roots(parts.size());
    parallel_interleaved(threads, int(parts.size()), [&](int i, int) { roots[i] = builder.build(parts[i], trees[i]); });

    std::vector<LeafRange> ranges;
    nodes.push_back(Builder::node_of(parts));
    for (size_t i = 0; i < parts.size(); ++i) {
        int node_offset = int(nodes.size()), leaf_offset = int(ranges.size());
        auto moved = [&](int child) { return child >= 0 ? child + node_offset : child - leaf_offset; };
        nodes[0].child[i] = moved(roots[i]);
        for (BvhNode node : trees[i].nodes) {
            for (int& child : node.child) child = moved(child);
            nodes.push_back(node);
        }
        ranges.insert(ranges.end(), trees[i].leaves.begin(), trees[i].leaves.end());
    }
    leaves.resize(ranges.size());
    parallel_ranges(threads, int(ranges.size()), [&](int begin, int end, int) {
        for (int i = begin; i < end; ++i) leaves[i] = leaf_of(items, ranges[i], surfels);
    });
}

}  // namespace envgs
