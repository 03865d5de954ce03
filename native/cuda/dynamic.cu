// The dynamic light field on a GPU. Twin of src/fewrays/dynamic/reference.py.
//
// Views are made a few at a time, of some rows of the image at a time, so that what they keep for every pixel, the key
// of what is nearest, stays in the card's cache: first all pixels of the sheets are warped to them, then each pixel of
// the image looks up what it sees in them, one view after the other.
#include "../math/cats_eye.h"
#include "../math/disparity.h"
#include "../math/sheet_lookup.h"
#include "../math/texel_blur.h"
#include "atomics.h"
#include "block.h"
#include "each_texel.h"

namespace fewrays {

constexpr int warp_threads = 256;
constexpr int few_cells = 16;  // that one thread writes

// Keys of `views` views from the first on, each of rows [top, bottom) of the image: of its opaque pixels, then of each
// sheet's veils, if it has any.
struct WarpArguments {
    const WarpPixel* pixels;    // (sheets, height, width)
    const Texel* texels;        // alike
    const float* behind;        // (sheets): pixels of slope by which each stands back
    const std::int32_t* veils;  // (sheets): number of its layer of veils, from 1 on; 0 if it has none
    const float* lens_points;   // (views in all, 3): u, v, weight
    std::uint64_t* keys;        // (views, layers, bottom - top, width)
    std::int32_t height, width, layers;
    std::int32_t first_view, top, bottom;
    std::int32_t first_row, end_row;  // of the sheets, whose pixels may be seen in those of the image
    float growth;                     // pixels to every side that a warped pixel covers as well
};

// Cells of a layer of keys, and the key to put there.
struct Rectangle {
    std::uint64_t* keys;
    std::uint64_t key;
    std::int32_t left, columns, top, rows;
};

struct WarpShared {
    std::uint32_t count;
    Rectangle wide[warp_threads];
};

// What a pixel covers of a view's rows; no columns where that is nothing.
inline Rectangle covered_by(const WarpArguments& a, int sheet, int view, int row, int column) {
    const auto sheet_row = static_cast<std::uint32_t>(sheet * a.height + row);
    const std::uint32_t number = sheet_row * static_cast<std::uint32_t>(a.width) + static_cast<std::uint32_t>(column);
    const WarpPixel pixel = a.pixels[number];
    Rectangle none{};
    if (!(pixel.spread >= 0)) return none;
    const float* const point = a.lens_points + 3 * (a.first_view + view);
    const float u = point[0], v = point[1], around = 0.5f + a.growth;
    Covered along =
        covered_pixels(static_cast<float>(column) + pixel.slope * u, around + 0.5f * std::fabs(u) * pixel.spread);
    Covered down =
        covered_pixels(static_cast<float>(row) + pixel.slope * v, around + 0.5f * std::fabs(v) * pixel.spread);
    // The image's border stands for all that lies beyond it.
    if (column == 0) along.first = 0;
    if (column == a.width - 1) along.end = a.width;
    if (row == 0) down.first = 0;
    if (row == a.height - 1) down.end = a.height;
    along = {std::max(along.first, 0), std::min(along.end, a.width)};
    down = {std::max(down.first, a.top), std::min(down.end, a.bottom)};
    if (along.first >= along.end || down.first >= down.end) return none;
    const int layer = a.veils[sheet] != 0 && a.texels[number].coverage < 1 ? a.veils[sheet] : 0;
    const std::int64_t layer_cells = static_cast<std::int64_t>(a.bottom - a.top) * a.width;
    std::uint64_t* const keys = a.keys + (static_cast<std::int64_t>(view) * a.layers + layer) * layer_cells;
    const std::uint64_t key = visibility_key(ascending_bits(pixel.slope + a.behind[sheet]), number);
    return {keys, key, along.first, along.end - along.first, down.first - a.top, down.end - down.first};
}

inline void put_key(const Rectangle& to, int width, int cell) {
    const std::int64_t row = to.top + cell / to.columns;
    atomic_least(to.keys + row * width + to.left + cell % to.columns, to.key);
}

// Blocks along x share out the pixels of the rows; y is the sheet and z the view.
inline void run_dynamic_warp(const WarpArguments& a, const Block& block, WarpShared& shared) {
    const int sheet = block.y(), view = block.z();
    block.each([&](int thread) {
        if (thread == 0) shared.count = 0;
    });
    block.each([&](int thread) {
        const std::int64_t at = static_cast<std::int64_t>(block.x()) * warp_threads + thread;
        const int row = a.first_row + static_cast<int>(at / a.width), column = static_cast<int>(at % a.width);
        if (row >= a.end_row) return;
        const Rectangle to = covered_by(a, sheet, view, row, column);
        const int cells = to.columns * to.rows;
        if (cells > few_cells)
            shared.wide[atomic_take(&shared.count)] = to;
        else
            for (int cell = 0; cell < cells; ++cell) put_key(to, a.width, cell);
    });
    // All threads together write what is wide: the image's corners may stand for all of it.
    block.each([&](int thread) {
        for (std::uint32_t k = 0; k < shared.count; ++k) {
            const Rectangle to = shared.wide[k];
            for (int cell = thread; cell < to.columns * to.rows; cell += warp_threads) put_key(to, a.width, cell);
        }
    });
}

struct SynthesisArguments {
    const Texel* texels;       // (sheets, height, width)
    const float* lens_points;  // (views in all, 3): u, v, weight
    std::uint64_t* keys;       // (views, layers, bottom - top, width): read, and cleared for the next views
    float* sums;               // (height, width, 5): added to
    float* passed;             // (height, width): receives the weights of all rays, valid or not; or null
    FrontRim rim;
    std::int32_t vignetted;
    std::int32_t height, width, layers;
    std::int32_t first_view, views, top, bottom;
    float tolerance;
};

constexpr int synthesis_threads = 128;

// Every thread has one pixel of the rows.
inline void run_dynamic_synthesize(const SynthesisArguments& a, const Block& block, NothingShared&) {
    block.each([&](int thread) {
        const std::int64_t cell = static_cast<std::int64_t>(block.x()) * synthesis_threads + thread;
        const std::int64_t layer_cells = static_cast<std::int64_t>(a.bottom - a.top) * a.width;
        if (cell >= layer_cells) return;
        const int row = a.top + static_cast<int>(cell / a.width), column = static_cast<int>(cell % a.width);
        const std::int64_t pixel = static_cast<std::int64_t>(row) * a.width + column;
        const TexelImage image{a.texels, a.height, a.width, a.tolerance};
        const float x = static_cast<float>(column), y = static_cast<float>(row);
        float sum[ray_channels], passed = 0;
        for (int k = 0; k < ray_channels; ++k) sum[k] = a.sums[ray_channels * pixel + k];
        for (int view = 0; view < a.views; ++view) {
            const float* const point = a.lens_points + 3 * (a.first_view + view);
            const float u = point[0], v = point[1];
            const float passing = a.vignetted ? point[2] * cats_eye_weight(u, v, x + 0.5f, y + 0.5f, a.rim) : point[2];
            std::uint64_t* const keys = a.keys + static_cast<std::int64_t>(view) * a.layers * layer_cells + cell;
            const auto key_of_veil = [&](int veil) { return keys[(veil + 1) * layer_cells]; };
            passed += passing;
            add_ray(image, {x, y, u, v}, keys[0], a.layers - 1, key_of_veil, passing, sum);
            for (int layer = 0; layer < a.layers; ++layer) keys[layer * layer_cells] = nothing_visible;
        }
        for (int k = 0; k < ray_channels; ++k) a.sums[ray_channels * pixel + k] = sum[k];
        if (a.passed) a.passed[pixel] += passed;
    });
}

struct BlurArguments {
    Texel *from, *to, *sheet;  // (height, width); no sheet for the pass along x
    std::int32_t height, width;
    BlurRule rule;
};

inline void run_dynamic_blur_along(const BlurArguments& a, const Block& block, NothingShared&) {
    const MipLevel from{a.from, a.height, a.width}, to{a.to, a.height, a.width};
    each_texel(block, a.height, a.width, [&](int row, int column) { blur_along(from, to, a.rule, row, column); });
}

inline void run_dynamic_blur_down(const BlurArguments& a, const Block& block, NothingShared&) {
    const MipLevel from{a.from, a.height, a.width}, to{a.to, a.height, a.width}, sheet{a.sheet, a.height, a.width};
    each_texel(block, a.height, a.width, [&](int row, int column) { blur_down(from, to, sheet, a.rule, row, column); });
}

struct HalveArguments {
    Texel *fine, *coarse;
    std::int32_t fine_height, fine_width, height, width;
};

inline void run_dynamic_halve(const HalveArguments& a, const Block& block, NothingShared&) {
    const MipLevel fine{a.fine, a.fine_height, a.fine_width}, coarse{a.coarse, a.height, a.width};
    each_texel(block, a.height, a.width, [&](int row, int column) { halve_texel(fine, coarse, row, column); });
}

struct MipmapArguments {
    const MipLevel* levels;
    std::int32_t count, height, width;
    float view_radius;
};

inline void run_dynamic_mipmap(const MipmapArguments& a, const Block& block, NothingShared&) {
    each_texel(block, a.height, a.width,
               [&](int row, int column) { mipmap_texel(a.levels, a.count, a.view_radius, row, column); });
}

}  // namespace fewrays

FEWRAYS_KERNEL(dynamic_warp, fewrays::warp_threads, fewrays::WarpArguments, fewrays::WarpShared)
FEWRAYS_KERNEL(dynamic_synthesize, fewrays::synthesis_threads, fewrays::SynthesisArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(dynamic_blur_along, fewrays::texel_threads, fewrays::BlurArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(dynamic_blur_down, fewrays::texel_threads, fewrays::BlurArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(dynamic_halve, fewrays::texel_threads, fewrays::HalveArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(dynamic_mipmap, fewrays::texel_threads, fewrays::MipmapArguments, fewrays::NothingShared)
