// Finds the samples that are seen near a place from a point of the lens at a time: the hierarchy of section 4 and
// Appendix A of Lehtinen et al. 2011.
#pragma once

#include <cstdint>
#include <vector>

#include "math/reprojection.h"
#include "math/tree_node.h"

namespace fewrays {

// Samples of a light field, one after the other.
struct LightField {
    const float* xy;         // (N, 2)
    const float* uv;         // (N, 2)
    const float* depth;      // (N)
    const float* color;      // (N, 3)
    const float* time;       // (N), or null where nothing moves
    const float* motion;     // (N, 3), or null
    const float* bandwidth;  // (N): standard deviation on the lens over which the radiance holds; or null
    const float* spacing;    // (N): how far samples like it are apart, where that differs from place to place; or null
    std::int32_t count;
    float c0, c1;

    // The slope's constant, within reach.
    float far_slope() const { return within_reach(c1); }

    Path path(std::int32_t i) const {
        return path_of(xy[2 * i], xy[2 * i + 1], uv[2 * i], uv[2 * i + 1], depth[i], time ? time[i] : 0.0f,
                       motion ? motion + 3 * std::ptrdiff_t{i} : nullptr, c0, c1);
    }
};

struct TreeRule {
    float bin;                                // side of the smallest squares, in pixels
    int most_samples;                         // of a square that is not divided
    float along_lens, along_time, tolerance;  // as in SurfaceRule: samples that may cross go to different leaves
    float left, right, top,
        bottom;  // samples seen beyond these edges of the lens centre's screen are in its outermost bins
};

class SampleTree {
public:
    SampleTree(const LightField& field, const TreeRule& rule);

    // Calls visit(node number, samples, count) for every leaf that may have samples in the box.
    template <typename Visit>
    void visit(const Box& box, const View& view, Visit&& visit_leaf) const {
        if (nodes_.empty()) return;
        std::vector<std::int32_t> stack{static_cast<std::int32_t>(nodes_.size()) - 1};
        while (!stack.empty()) {
            const std::int32_t number = stack.back();
            stack.pop_back();
            const TreeNode& node = nodes_[number];
            if (!node.meets(box, view)) continue;
            if (node.leaf()) {
                visit_leaf(number, order_.data() + ~node.first, node.second - ~node.first);
            } else {
                stack.push_back(node.second);
                stack.push_back(node.first);
            }
        }
    }

    // Whether any(samples, count) holds for any leaf; what lies within nodes for which may(node) does not hold is
    // passed over.
    template <typename May, typename Any>
    bool any(May&& may, Any&& any_of) const {
        std::vector<std::int32_t> stack;
        if (!nodes_.empty()) stack.push_back(static_cast<std::int32_t>(nodes_.size()) - 1);
        while (!stack.empty()) {
            const TreeNode& node = nodes_[stack.back()];
            stack.pop_back();
            if (!may(node)) continue;
            if (node.leaf()) {
                if (any_of(order_.data() + ~node.first, node.second - ~node.first)) return true;
            } else {
                stack.push_back(node.second);
                stack.push_back(node.first);
            }
        }
        return false;
    }

    // Writes the nodes in depth-first order, from the root on: to be walked without a stack. What follows a node, or
    // its first child, is the next; behind an inner node's last descendant is its `second`. Leaves are as they were.
    void write_depth_first(TreeNode* nodes) const;

    const LightField& field() const { return field_; }
    // Numbers of the samples, leaf by leaf.
    const std::vector<std::int32_t>& order() const { return order_; }
    std::size_t node_count() const { return nodes_.size(); }
    std::size_t leaf_count() const { return leaf_count_; }
    std::size_t bytes() const { return order_.capacity() * sizeof(order_[0]) + nodes_.capacity() * sizeof(nodes_[0]); }

private:
    const LightField field_;
    std::vector<std::int32_t> order_;  // of samples, leaf by leaf
    std::vector<TreeNode> nodes_;      // leaves first, the root last
    std::size_t leaf_count_ = 0;
};

}  // namespace fewrays
