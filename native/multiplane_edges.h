// Rays gathered along edges.
#pragma once

#include "multiplane_estimate.h"

namespace fewrays {

// Adds to each cell's sums those of the cells along the edge that runs through it, if one does. Edges show in `coarse`,
// the estimate of cells twice as wide. `along` is how many rays to look for, to each side.
void gather_along_edges(const EstimateMaps& coarse, float along, const CellRange& range, EstimateMaps& fine);

}  // namespace fewrays
