// Memory for the maps of one tile, all given back at once and kept for the next tile.
#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <vector>

namespace fewrays {

class Scratch {
public:
    // Room for `count` numbers of no particular value, until clear().
    float* take(std::size_t count) {
        while (block_ < blocks_.size() && used_ + count > blocks_[block_].size) {
            ++block_;
            used_ = 0;
        }
        if (block_ == blocks_.size()) {
            const std::size_t size = std::max(count, block_size);
            blocks_.push_back({std::make_unique_for_overwrite<float[]>(size), size});
        }
        float* const taken = blocks_[block_].values.get() + used_;
        used_ += count;
        return taken;
    }

    void clear() { block_ = used_ = 0; }

private:
    static constexpr std::size_t block_size = std::size_t{1} << 20;

    struct Block {
        std::unique_ptr<float[]> values;
        std::size_t size;
    };
    std::vector<Block> blocks_;
    std::size_t block_ = 0, used_ = 0;  // where there is room
};

}  // namespace fewrays
