// The dynamic light field's CPU kernel, one thread. Twin of src/fewrays/dynamic/reference.py.
#pragma once

#include <cstdint>

#include "math/behind.h"
#include "math/cats_eye.h"
#include "math/sheet_lookup.h"
#include "math/texel_blur.h"

namespace fewrays {

// All sheets, (sheet_count, H, W).
struct Sheets {
    const Texel* texels;
    const WarpPixel* pixels;
    const float* behind;  // (sheet_count): pixels of slope by which each stands back
    int sheet_count, height, width;
};

// Square blocks of the sheets' pixels, (sheet_count, block rows, block columns): which slopes are warped, so that
// tiles of a view can pass over what does not reach them.
struct BlockRange {
    float least, most;  // slopes; least > most where there are none
    float spread;       // the widest
    float translucent;  // 1 where any pixel does not cover its place wholly
};

struct DynamicPlan {
    int tile;   // side of a tile of the image, in pixels
    int block;  // side of a block
    const BlockRange* blocks;
    int view_count;
    const float* views;   // (view_count, 3): u, v, weight
    float tolerance;      // slopes in pixels by which neighbours of one surface may differ
    int growth;           // pixels to every side that a warped pixel covers as well
    const FrontRim* rim;  // of the lens, or none
    float* passed;        // (H, W): receives the weights of all rays, valid or not; or none
};

// Processor time of the two stages, in seconds.
struct StageSeconds {
    double warping, synthesis;
};

// Rows [first, last) of the next coarser level.
void dynamic_halve(const MipLevel& fine, const MipLevel& coarse, int first, int last);

// Blurs rows [first, last) of the level 0 of a pyramid in place, as wide as a part of the aperture, of a radius in lens
// units, blurs them.
void dynamic_mipmap(const MipLevel* levels, int level_count, float view_radius, int first, int last);

// One pass of a kernel over rows [first, last), along x: from `level` into `passed`.
void dynamic_blur_along(const MipLevel& level, const MipLevel& passed, const BlurRule& rule, int first, int last);

// The other pass, along y, from `passed` into `level`; pixels that are to be blurred no wider go to the sheet.
void dynamic_blur_down(const MipLevel& passed, const MipLevel& level, const MipLevel& sheet, const BlurRule& rule,
                       int first, int last);

// Rows [first, last) of what is behind the pixels that need it; nothing known elsewhere.
void dynamic_background(const FrontImage& image, const BehindRule& rule, int first, int last,
                        BackgroundPixel* background);

// Ranges of blocks in block rows [first, last), all sheets' rows counted through.
void dynamic_blocks(const Sheets& sheets, int block, int first, int last, BlockRange* blocks);

// Adds all views of tiles [first, last) to the sums, (H, W, 6): light, and the weights of the rays that are valid and
// of all.
StageSeconds dynamic_tiles(const Sheets& sheets, const DynamicPlan& plan, int first, int last, float* sums);

}  // namespace fewrays
