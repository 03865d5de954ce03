// The samples that are seen in a small part of the image from one lens point at one time, sorted into a grid.
#pragma once

#include <cstdint>
#include <vector>

#include "sample_tree.h"
#include "surfaces.h"

namespace fewrays {

// Copies of the samples around a tile, leaf by leaf, as long as the views of the tile need them.
class LeafCache {
public:
    explicit LeafCache(const SampleTree& tree) : tree_(tree), place_of_leaf_(tree.leaf_count(), -1) {}

    struct Place {
        std::int32_t first, count;  // of the copies, with those that fill up the last group
    };

    void clear();
    bool full() const { return fields_[0].size() > most_samples; }
    Place place(std::int32_t leaf, const std::int32_t* samples, std::int32_t count);

    bool moving() const { return tree_.field().motion != nullptr; }
    bool glossy() const { return tree_.field().bandwidth != nullptr; }
    bool spaced() const { return tree_.field().spacing != nullptr; }
    // Paths: x, y and the slope of what is still; x, y, w, their changes and c0 of what moves. Then red, green
    // and blue, and the lens point and bandwidth of what is glossy, or the spacing.
    const float* field(int number) const { return fields_[number].data(); }
    std::int32_t number(std::int32_t copy) const { return numbers_[copy]; }
    int color_field() const { return moving() ? 7 : 3; }
    int gloss_field() const { return color_field() + 3; }
    int spacing_field() const { return gloss_field() + 3; }

    static constexpr int group = 8;  // samples that places are multiples of

private:
    static constexpr std::size_t most_samples = std::size_t{1} << 19;

    const SampleTree& tree_;
    std::vector<std::int32_t> place_of_leaf_, leaves_;
    std::vector<float> fields_[14];
    std::vector<std::int32_t> numbers_;
};

class ViewGrid {
public:
    // With `numbered`, what is seen knows which samples it is; without `colored`, it has no radiance.
    explicit ViewGrid(const SampleTree& tree, bool numbered = false, bool colored = true)
        : tree_(tree), numbered_(numbered), colored_(colored), cache_(tree) {}

    // Forgets the copies made for an earlier part of the image.
    void clear() { cache_.clear(); }
    // Collects what is seen in a box, in cells of this side.
    void fill(const Box& box, const View& view, float cell);

    // The rows of cells within a distance of a place in the box, less than four cells.
    static constexpr int most_rows = 8;
    int rows_around(float x, float y, float distance, SightRow* rows) const;

    Sights sights() const;  // sorted by cell

private:
    bool moving() const { return cache_.moving(); }
    bool glossy() const { return cache_.glossy(); }
    void project(const View& view);
    void sort(const View& view);

    const SampleTree& tree_;
    const bool numbered_, colored_;
    LeafCache cache_;
    Box box_{};
    float cell_ = 0;
    int rows_ = 0, columns_ = 0;
    std::vector<LeafCache::Place> places_;
    std::vector<float> seen_[5];  // x, y, slope and speeds of the samples of all places
    std::vector<std::int32_t> cells_, sources_, starts_;
    std::vector<float> sorted_[10];
    std::vector<std::int32_t> sorted_numbers_;
};

// How much a sample counts from a lens point that lies (u, v) from its own, for a bandwidth; an infinite one fully.
float gloss_weight(float u, float v, float bandwidth);

}  // namespace fewrays
