#include "sample_tree.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace fewrays {
namespace {

constexpr int window = 6;  // neighbours on either side that a node may be joined with

// Least values at the corners of lens × time: lens -1 and 1 at one time, then at the other.
using Corners = float[4];

// Positions of a path seen from lens = -1 and 1 at two times.
void path_corners(const Path& path, bool vertical, float opens, float closes, float c1, Corners& out) {
    int i = 0;
    for (float time : {opens, closes})
        for (float lens : {-1.0f, 1.0f}) {
            const Sight sight = sight_of(path, lens, lens, time, c1);
            out[i++] = vertical ? sight.y : sight.x;
        }
}

// The plane through the middle slopes of the corners' values that lies below them all, or above if `side` is -1.
Plane plane_beside(const Corners& value, float opens, float closes, float side) {
    Plane plane{0.25f * (value[1] - value[0] + value[3] - value[2]), 0.0f, 0.0f};
    if (closes > opens) plane.b = 0.5f * (value[2] - value[0] + value[3] - value[1]) / (closes - opens);
    float c = std::numeric_limits<float>::infinity();
    for (int i = 0; i < 4; ++i) {
        const float lens = i % 2 == 0 ? -1.0f : 1.0f, time = i < 2 ? opens : closes;
        c = std::min(c, side * (value[i] - plane.a * lens - plane.b * time));
    }
    plane.c = side * c;
    return plane;
}

void plane_corners(const Plane& plane, float opens, float closes, Corners& out) {
    int i = 0;
    for (float time : {opens, closes})
        for (float lens : {-1.0f, 1.0f}) out[i++] = plane.at(lens, time);
}

// The times between which a point is in front of the camera.
void times_in_front(const Path& path, float& opens, float& closes) {
    opens = 0.0f;
    closes = 1.0f;
    if (path.dw > 0 && path.w < nearest_depth) opens = (nearest_depth - path.w) / path.dw;
    if (path.dw < 0 && path.w + path.dw < nearest_depth) closes = (nearest_depth - path.w) / path.dw;
}

// Bounds of one path. Seen from one lens point it moves over the screen as a Möbius function of time does, whose
// greatest distance from its chord is the chord's rise times (√w1 - √w0) / (√w1 + √w0), for depths w0 and w1.
TreeNode bounds_of(const Path& path, float c1) {
    TreeNode node{};
    times_in_front(path, node.opens, node.closes);
    const float slope0 = sight_of(path, 0, 0, node.opens, c1).slope,
                slope1 = sight_of(path, 0, 0, node.closes, c1).slope;
    node.nearest = std::min(slope0, slope1);
    node.farthest = std::max(slope0, slope1);
    const float root0 = std::sqrt(std::max(depth_at(path, node.opens), 0.0f));
    const float root1 = std::sqrt(std::max(depth_at(path, node.closes), 0.0f));
    const float bend = (root1 - root0) / (root1 + root0);
    for (bool vertical : {false, true}) {
        Corners ends, low, high;
        path_corners(path, vertical, node.opens, node.closes, c1, ends);
        for (int lens = 0; lens < 2; ++lens) {
            const float beyond = bend * (ends[2 + lens] - ends[lens]);
            for (int i : {lens, 2 + lens}) {
                low[i] = ends[i] + std::min(beyond, 0.0f);
                high[i] = ends[i] + std::max(beyond, 0.0f);
            }
        }
        (vertical ? node.top : node.left) = plane_beside(low, node.opens, node.closes, 1.0f);
        (vertical ? node.bottom : node.right) = plane_beside(high, node.opens, node.closes, -1.0f);
    }
    return node;
}

Plane merged(const Plane& one, const Plane& other, float opens, float closes, float side) {
    Corners values, others;
    plane_corners(one, opens, closes, values);
    plane_corners(other, opens, closes, others);
    for (int i = 0; i < 4; ++i) values[i] = side > 0 ? std::min(values[i], others[i]) : std::max(values[i], others[i]);
    return plane_beside(values, opens, closes, side);
}

TreeNode merged(const TreeNode& one, const TreeNode& other) {
    TreeNode node{};
    node.opens = std::min(one.opens, other.opens);
    node.closes = std::max(one.closes, other.closes);
    node.nearest = std::min(one.nearest, other.nearest);
    node.farthest = std::max(one.farthest, other.farthest);
    node.left = merged(one.left, other.left, node.opens, node.closes, 1.0f);
    node.right = merged(one.right, other.right, node.opens, node.closes, -1.0f);
    node.top = merged(one.top, other.top, node.opens, node.closes, 1.0f);
    node.bottom = merged(one.bottom, other.bottom, node.opens, node.closes, -1.0f);
    return node;
}

// Planes move up or down by what rounding may cost, so that they still bound.
void loosen(TreeNode& node) {
    const auto move = [](Plane& plane, float side) {
        const float size = std::fabs(plane.a) + std::fabs(plane.b) + std::fabs(plane.c);
        plane.c += side * (4e-6f * size + 1e-6f);
    };
    move(node.left, -1.0f);
    move(node.right, 1.0f);
    move(node.top, -1.0f);
    move(node.bottom, 1.0f);
}

// How much of the screen a node takes, seen from wherever on the lens it takes most, roughly.
float size_of_union(const TreeNode& one, const TreeNode& other) {
    const auto extent = [](const Plane& low, const Plane& high, const Plane& other_low, const Plane& other_high) {
        float largest = 0;
        for (float lens : {-1.0f, 1.0f})
            for (float time : {0.0f, 1.0f})
                largest = std::max(largest, std::max(high.at(lens, time), other_high.at(lens, time)) -
                                                std::min(low.at(lens, time), other_low.at(lens, time)));
        return largest;
    };
    return extent(one.left, one.right, other.left, other.right) * extent(one.top, one.bottom, other.top, other.bottom);
}

std::uint32_t spread_bits(std::uint32_t bits) {
    bits = (bits | bits << 8) & 0x00ff00ffu;
    bits = (bits | bits << 4) & 0x0f0f0f0fu;
    bits = (bits | bits << 2) & 0x33333333u;
    return (bits | bits << 1) & 0x55555555u;
}

struct Placed {
    std::uint32_t square;  // Morton number of the bin
    std::int32_t sample;
};

// Cuts the samples into leaves: squares of few samples, divided so that samples of a leaf cross nowhere.
class Leaves {
public:
    Leaves(const LightField& field, const TreeRule& rule) : field_(field), rule_(rule) {}

    void run(std::vector<std::int32_t>& order, std::vector<TreeNode>& nodes) {
        std::vector<Placed> placed = place();
        std::sort(placed.begin(), placed.end(), [](const Placed& a, const Placed& b) {
            return a.square != b.square ? a.square < b.square : a.sample < b.sample;
        });
        order_ = &order;
        nodes_ = &nodes;
        order.reserve(placed.size());
        divide(placed.data(), placed.data() + placed.size(), 30);
    }

private:
    struct Seen {
        std::int32_t sample;
        float slope, speed_x, speed_y;
    };

    std::vector<Placed> place() const {
        std::vector<Placed> placed;
        placed.reserve(field_.count);
        const auto bin = [&](float position, float low, float high) {
            const float inside = std::clamp(position, low, high) - low;
            return spread_bits(static_cast<std::uint32_t>(std::min(inside / rule_.bin, 65535.0f)));
        };
        for (std::int32_t i = 0; i < field_.count; ++i) {
            const Path path = field_.path(i);
            float opens, closes;
            times_in_front(path, opens, closes);
            const Sight sight = sight_of(path, 0, 0, std::clamp(0.5f, opens, closes), field_.far_slope());
            placed.push_back({bin(sight.x, rule_.left, rule_.right) | bin(sight.y, rule_.top, rule_.bottom) << 1, i});
        }
        return placed;
    }

    // Squares of one level lie one after the other; `bits` are those of the Morton number that still vary.
    void divide(const Placed* first, const Placed* end, int bits) {
        if (first == end) return;
        if (end - first <= rule_.most_samples || bits < 0) return add_leaves(first, end);
        while (first != end) {
            const std::uint32_t quarter = first->square >> bits;
            const Placed* const next =
                std::partition_point(first, end, [&](const Placed& each) { return each.square >> bits == quarter; });
            divide(first, next, bits - 2);
            first = next;
        }
    }

    // Sorted by slope, then by speed along both axes, samples are cut where they might cross.
    void add_leaves(const Placed* first, const Placed* end) {
        seen_.clear();
        for (const Placed* each = first; each != end; ++each) {
            const Path path = field_.path(each->sample);
            float opens, closes;
            times_in_front(path, opens, closes);
            const Sight sight = sight_of(path, 0, 0, std::clamp(0.5f, opens, closes), field_.far_slope());
            seen_.push_back({each->sample, sight.slope, sight.speed_x, sight.speed_y});
        }
        cut(0, seen_.size(), 0);
    }

    void cut(std::size_t first, std::size_t end, int key) {
        if (key == 3) return add_leaf(first, end);
        const auto value = [key](const Seen& seen) {
            return key == 0 ? seen.slope : key == 1 ? seen.speed_x : seen.speed_y;
        };
        const float widest = rule_.tolerance / (key == 0 ? rule_.along_lens : rule_.along_time);
        std::sort(seen_.begin() + static_cast<std::ptrdiff_t>(first), seen_.begin() + static_cast<std::ptrdiff_t>(end),
                  [&](const Seen& a, const Seen& b) {
                      return value(a) != value(b) ? value(a) < value(b) : a.sample < b.sample;
                  });
        while (first < end) {
            std::size_t next = first + 1;
            while (next < end && value(seen_[next]) - value(seen_[first]) <= widest) ++next;
            cut(first, next, key + 1);
            first = next;
        }
    }

    void add_leaf(std::size_t first, std::size_t end) {
        const auto start = static_cast<std::int32_t>(order_->size());
        TreeNode node{};
        for (std::size_t i = first; i < end; ++i) {
            const std::int32_t sample = seen_[i].sample;
            const TreeNode bounds = bounds_of(field_.path(sample), field_.far_slope());
            node = i == first ? bounds : merged(node, bounds);
            order_->push_back(sample);
        }
        node.first = ~start;
        node.second = static_cast<std::int32_t>(order_->size());
        loosen(node);
        nodes_->push_back(node);
    }

    const LightField& field_;
    const TreeRule& rule_;
    std::vector<std::int32_t>* order_ = nullptr;
    std::vector<TreeNode>* nodes_ = nullptr;
    std::vector<Seen> seen_;
};

// Joins nodes from the leaves up: in every round, each pair of neighbours that suit each other best. Neighbours are
// those in the order of the squares.
void agglomerate(std::vector<TreeNode>& nodes) {
    std::vector<std::int32_t> current(nodes.size()), best, next;
    std::iota(current.begin(), current.end(), 0);
    while (current.size() > 1) {
        const int n = static_cast<int>(current.size());
        best.assign(n, -1);
        std::vector<float> least(n, std::numeric_limits<float>::infinity());
        for (int i = 0; i < n; ++i)
            for (int j = i + 1; j <= std::min(i + window, n - 1); ++j) {
                const float size = size_of_union(nodes[current[i]], nodes[current[j]]);
                if (size < least[i]) least[i] = size, best[i] = j;
                if (size < least[j]) least[j] = size, best[j] = i;
            }
        next.clear();
        bool joined = false;
        for (int i = 0; i < n; ++i) {
            const int other = best[i];
            if (other >= 0 && best[other] == i) {
                if (other < i) continue;  // joined already
                TreeNode node = merged(nodes[current[i]], nodes[current[other]]);
                node.first = current[i];
                node.second = current[other];
                loosen(node);
                nodes.push_back(node);
                next.push_back(static_cast<std::int32_t>(nodes.size()) - 1);
                joined = true;
            } else {
                next.push_back(current[i]);
            }
        }
        if (!joined) {  // nothing but infinite sizes: any pairs will do
            next.clear();
            for (int i = 0; i < n; i += 2) {
                if (i + 1 == n) {
                    next.push_back(current[i]);
                    continue;
                }
                TreeNode node = merged(nodes[current[i]], nodes[current[i + 1]]);
                node.first = current[i];
                node.second = current[i + 1];
                nodes.push_back(node);
                next.push_back(static_cast<std::int32_t>(nodes.size()) - 1);
            }
        }
        current.swap(next);
    }
}

}  // namespace

SampleTree::SampleTree(const LightField& field, const TreeRule& rule) : field_(field) {
    Leaves(field_, rule).run(order_, nodes_);
    leaf_count_ = nodes_.size();
    nodes_.reserve(2 * nodes_.size());
    agglomerate(nodes_);
}

void SampleTree::write_depth_first(TreeNode* nodes) const {
    std::vector<std::int32_t> size(nodes_.size(), 1);  // of the subtree; children come before their parents
    for (std::size_t i = 0; i < nodes_.size(); ++i)
        if (!nodes_[i].leaf()) size[i] += size[nodes_[i].first] + size[nodes_[i].second];
    std::vector<std::int32_t> left;
    if (!nodes_.empty()) left.push_back(static_cast<std::int32_t>(nodes_.size()) - 1);
    for (std::int32_t place = 0; !left.empty(); ++place) {
        const std::int32_t number = left.back();
        left.pop_back();
        const TreeNode& node = nodes_[number];
        nodes[place] = node;
        if (node.leaf()) continue;
        nodes[place].first = place + 1;
        nodes[place].second = place + size[number];
        left.push_back(node.second);
        left.push_back(node.first);
    }
}

}  // namespace fewrays
