// Coarse layers' maps at every pixel.
#pragma once

#include <cstddef>
#include <vector>

#include "layer_maps.h"
#include "scratch.h"

namespace fewrays {

// A coarse layer's map, channel by channel.
struct CoarseBins {
    const float* values;
    std::ptrdiff_t plane, stride;  // from channel to channel, from row to row
    int rows, columns;

    const float* at(int channel, int row, int column) const { return values + channel * plane + row * stride + column; }
};

// Reads a coarse layer's map between its bins, at every pixel of a rectangle, by quadratic B-splines: linear ones would
// flatten every peak.
class Magnifier {
public:
    // Returns a map in `scratch`. The first of the `rows` x `columns` pixels lies `row` and `column` pixels from the
    // first bin's corner; beyond the bins that there are, the outermost go on.
    FilteredMap run(const CoarseBins& source, int level, int row, int column, int rows, int columns, Scratch& scratch);

private:
    std::vector<float> lines_[3], between_, pixels_;
};

}  // namespace fewrays
