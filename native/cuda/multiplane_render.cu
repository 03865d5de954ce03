// From planes to images on a GPU. Twin of src/fewrays/multiplane/reference.py.
//
// Smoothing: a block of threads makes one block of a smoothed plane, or gives up its place. Rendering: a block of
// threads has a tile of the image and goes through all views, and in each through all planes that the tile can see,
// front to back. What its pixels have seen stays in registers; where the view looks at each plane is worked out once
// for all of them. Planes at half resolution are laid behind one another in shared memory, and then interpolated.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "../math/cats_eye.h"
#include "../math/depth_plane.h"
#include "atomics.h"
#include "block.h"
#include "halves.h"
#include "plane_blocks.h"

namespace fewrays {

constexpr int tile_side = 32;  // pixels
constexpr int render_threads = 256;
constexpr int own_pixels = tile_side * tile_side / render_threads;  // of a thread: one column, every eighth row
constexpr int rows_apart = render_threads / tile_side;
constexpr int half_side = tile_side / 2 + 2;  // pixels of twice the size, with one around the tile
constexpr int planes_at_once = 128;
constexpr int most_planes = 32768;
constexpr float opaque = 0.002f;     // transmittance below which what lies behind does not show
constexpr float least_seen = 1e-3f;  // opacity below which a view tells nothing of a pixel

struct RenderArguments {
    const DepthPlane* planes;         // (count), front to back
    const float* shrink;              // (count): scale of offsets and lens points
    const float* reach;               // (count): pixels that any view shifts each plane, at most
    const std::uint8_t* is_smoothed;  // (count): whether blocks are in `smoothed` instead of `built`
    const std::int32_t* slots;        // of each place for a block, the number of its first map; -1 without one
    const HalfTexel *built, *smoothed;
    const float* views;  // (view_count, 6): u, v, time, offset from the pixel's centre (x, y), weight
    float* image;        // (height, width, 4): radiance, and the share of the light that planes know
    FrontRim rim;
    std::int32_t count, view_count, height, width;
    std::int32_t front_end, back_begin;  // planes before and from these on are at half resolution
    std::int32_t vignetted, darken;
};

// Where a view looks at one plane.
struct PlaneView {
    const HalfTexel* source;
    const std::int32_t* slots;
    std::int32_t column, row, columns, rows;
    std::int32_t at[4];
    float weights[4];
    float scale;
};

// What the view at hand sees.
struct Seen {
    float transmittance, color[3];
};

struct RenderShared {
    std::uint32_t near[most_planes / 32];  // a bit for every plane that the tile can see
    PlaneView views[planes_at_once];
    Seen halved[half_side * half_side];
};

struct RenderPixel : Seen {
    float sums[3], seen;  // of all views so far
    float light;          // that passes the rim
};

struct RenderState {
    RenderPixel pixels[own_pixels];
};

// Shifting divides down, below 0 as well.
constexpr int block_row_bits = 3, block_column_bits = 5;
static_assert(1 << block_row_bits == block_rows && 1 << block_column_bits == block_columns);

inline bool is_halved(const RenderArguments& a, int k) { return k < a.front_end || k >= a.back_begin; }

// Whether any view may see a block of the plane in the tile.
inline bool is_near(const RenderArguments& a, int k, int tile_top, int tile_left) {
    const DepthPlane plane = a.planes[k];
    const bool halved = is_halved(a, k);
    const int top = halved ? tile_top / 2 - 1 : tile_top, left = halved ? tile_left / 2 - 1 : tile_left;
    const int side = halved ? half_side : tile_side;
    const float reach = within_image_reach(halved ? 0.5f * a.reach[k] : a.reach[k]);
    const int around = static_cast<int>(std::ceil(reach)) + 1;
    const int first_row = std::max((top - around - plane.top) >> block_row_bits, 0);
    const int last_row = std::min((top + side + around - plane.top) >> block_row_bits, plane.rows - 1);
    const int first_column = std::max((left - around - plane.left) >> block_column_bits, 0);
    const int last_column = std::min((left + side + around - plane.left) >> block_column_bits, plane.columns - 1);
    for (int row = first_row; row <= last_row; ++row)
        for (int column = first_column; column <= last_column; ++column)
            if (a.slots[plane.first_slot + row * plane.columns + column] >= 0) return true;
    return false;
}

inline int bits_in(std::uint32_t word) {
#ifdef __CUDACC__
    return __popc(word);
#else
    return __builtin_popcount(word);
#endif
}

// How many of the planes at hand, from `first` on, the tile can see in front of plane `first + n`.
inline int near_before(const RenderShared& shared, int first, int n) {
    int before = 0;
    for (int word = 0; word < n / 32; ++word) before += bits_in(shared.near[first / 32 + word]);
    const std::uint32_t below = (std::uint32_t{1} << (n % 32)) - 1;
    return n % 32 == 0 ? before : before + bits_in(shared.near[first / 32 + n / 32] & below);
}

inline PlaneView view_of(const RenderArguments& a, int k, const float* view) {
    const DepthPlane plane = a.planes[k];
    const Taps taps = taps_of(plane, shift_of(plane, a.shrink[k], view));
    PlaneView seen{a.is_smoothed[k] ? a.smoothed : a.built,
                   a.slots + plane.first_slot,
                   taps.column,
                   taps.row,
                   plane.columns,
                   plane.rows,
                   {},
                   {},
                   plane.scale};
    for (int tap = 0; tap < 4; ++tap) {
        seen.at[tap] = static_cast<std::int32_t>(taps.at[tap]);
        seen.weights[tap] = taps.weights[tap];
    }
    return seen;
}

// Lays a plane behind what a pixel has seen.
inline void lay_behind(const PlaneView& plane, int row, int column, Seen& pixel) {
    const int i = row + plane.row, j = column + plane.column;
    const int block_row = i >> block_row_bits, block_column = j >> block_column_bits;
    if (block_row < 0 || block_row >= plane.rows || block_column < 0 || block_column >= plane.columns) return;
    const std::int32_t slot = plane.slots[block_row * plane.columns + block_column];
    if (slot < 0) return;
    const HalfTexel* const place = plane.source + static_cast<std::int64_t>(slot) * map_size +
                                   (i & (block_rows - 1)) * map_row + (j & (block_columns - 1));
    Values values{};
    for (int tap = 0; tap < 4; ++tap) add(values, plane.weights[tap], load(place + plane.at[tap]));
    const float share = pixel.transmittance * plane.scale;
    pixel.color[0] += share * values.red;
    pixel.color[1] += share * values.green;
    pixel.color[2] += share * values.blue;
    pixel.transmittance -= pixel.transmittance * values.opacity;
}

// How much of a view's light passes the rim on its way to a pixel.
inline float passing(const RenderArguments& a, const float* view, int row, int column) {
    const float x = static_cast<float>(column) + 0.5f, y = static_cast<float>(row) + 0.5f;
    return cats_eye_weight(view[0], view[1], x, y, a.rim);
}

// Adds what a view has seen; where that is less than a pixel's worth, it stands for all of it.
inline void add_view(const RenderArguments& a, const float* view, int row, int column, RenderPixel& pixel) {
    const float seen = 1.0f - pixel.transmittance;
    if (!(seen > least_seen)) return;
    float weight = view[5];
    // Where the rim lets no view pass, all count unless that shall darken.
    if (a.vignetted && (a.darken || pixel.light > 0.0f)) weight *= passing(a, view, row, column);
    for (int c = 0; c < 3; ++c) pixel.sums[c] += weight / seen * pixel.color[c];
    pixel.seen += weight;
}

inline void store(const RenderArguments& a, const RenderPixel& pixel, int row, int column) {
    const float light = a.darken || pixel.light > 0.0f ? pixel.light : 1.0f, lit = a.darken ? light : 1.0f;
    float* const to = a.image + 4 * (static_cast<std::int64_t>(row) * a.width + column);
    for (int c = 0; c < 3; ++c) to[c] = pixel.seen != 0.0f ? lit * pixel.sums[c] / pixel.seen : 0.0f;
    to[3] = light != 0.0f ? pixel.seen / light : 0.0f;
}

// Lays what a view sees at half resolution behind what a pixel of the tile has seen.
inline void lay_halved_behind(const Seen* halved, int row, int column, RenderPixel& pixel) {
    const int rows[] = {row / 2 + 1, row / 2 + (row % 2 ? 2 : 0)};
    const int columns[] = {column / 2 + 1, column / 2 + (column % 2 ? 2 : 0)};
    Seen sum{};
    for (int k = 0; k < 4; ++k) {
        const float weight = (k / 2 ? 0.25f : 0.75f) * (k % 2 ? 0.25f : 0.75f);
        const Seen& own = halved[rows[k / 2] * half_side + columns[k % 2]];
        sum.transmittance += weight * own.transmittance;
        for (int c = 0; c < 3; ++c) sum.color[c] += weight * own.color[c];
    }
    for (int c = 0; c < 3; ++c) pixel.color[c] += pixel.transmittance * sum.color[c];
    pixel.transmittance *= sum.transmittance;
}

// Calls lay(number of views) for every few of the planes [begin, end) that the tile can see, whose views are then in
// shared memory. Returns whether there were any.
template <typename Lay>
inline bool each_planes(const RenderArguments& a, const Block& block, RenderShared& shared, const float* view,
                        int begin, int end, const Lay& lay) {
    bool any = false;
    for (int first = begin / planes_at_once * planes_at_once; first < end; first += planes_at_once) {
        const int last = std::min(end - first, planes_at_once), skipped = std::max(begin - first, 0);
        const int before = near_before(shared, first, skipped);
        const int here = near_before(shared, first, last) - before;
        if (here == 0) continue;
        block.each([&](int thread) {
            if (thread < skipped || thread >= last) return;
            if ((shared.near[(first + thread) / 32] >> ((first + thread) % 32) & 1u) == 0) return;
            shared.views[near_before(shared, first, thread) - before] = view_of(a, first + thread, view);
        });
        lay(here);
        any = true;
    }
    return any;
}

inline void run_multiplane_render(const RenderArguments& a, const Block& block, RenderShared& shared) {
    const int top = block.y() * tile_side, left = block.x() * tile_side;
    Own<RenderState, render_threads> states;
    const auto each_pixel = [&](int thread, auto&& work) {
        for (int k = 0; k < own_pixels; ++k)
            work(states[thread].pixels[k], top + thread / tile_side + rows_apart * k, left + thread % tile_side);
    };
    block.each([&](int thread) {
        for (int word = thread; word * 32 < a.count; word += render_threads) shared.near[word] = 0;
        each_pixel(thread, [&](RenderPixel& pixel, int row, int column) {
            pixel = {};
            if (!a.vignetted) pixel.light = 1.0f;
            for (int n = 0; a.vignetted && n < a.view_count; ++n)
                pixel.light += a.views[6 * n + 5] * passing(a, a.views + 6 * n, row, column);
        });
    });
    block.each([&](int thread) {
        for (int k = thread; k < a.count; k += render_threads)
            if (is_near(a, k, top, left)) atomic_set(&shared.near[k / 32], std::uint32_t{1} << (k % 32));
    });
    const auto lay_halved = [&](const float* view, int begin, int end) {
        if (begin >= end) return;
        // Where the view looks in pixels of twice the size.
        const float half_view[] = {view[0], view[1], view[2], 0.5f * view[3], 0.5f * view[4], view[5]};
        block.each([&](int thread) {
            for (int i = thread; i < half_side * half_side; i += render_threads) shared.halved[i] = {1.0f, {}};
        });
        const bool any = each_planes(a, block, shared, half_view, begin, end, [&](int count) {
            block.each([&](int thread) {
                for (int i = thread; i < half_side * half_side; i += render_threads) {
                    Seen& pixel = shared.halved[i];
                    const int row = top / 2 - 1 + i / half_side, column = left / 2 - 1 + i % half_side;
                    for (int k = 0; k < count && pixel.transmittance >= opaque; ++k)
                        lay_behind(shared.views[k], row, column, pixel);
                }
            });
        });
        if (!any) return;
        block.each([&](int thread) {
            each_pixel(thread, [&](RenderPixel& pixel, int row, int column) {
                lay_halved_behind(shared.halved, row - top, column - left, pixel);
            });
        });
    };
    for (int n = 0; n < a.view_count; ++n) {
        const float* const view = a.views + 6 * n;
        block.each([&](int thread) {
            each_pixel(thread, [&](RenderPixel& pixel, int, int) { static_cast<Seen&>(pixel) = {1.0f, {}}; });
        });
        lay_halved(view, 0, a.front_end);
        each_planes(a, block, shared, view, a.front_end, a.back_begin, [&](int count) {
            block.each([&](int thread) {
                for (int k = 0; k < count; ++k)
                    each_pixel(thread, [&](RenderPixel& pixel, int row, int column) {
                        if (pixel.transmittance >= opaque) lay_behind(shared.views[k], row, column, pixel);
                    });
            });
        });
        lay_halved(view, a.back_begin, a.count);
        block.each([&](int thread) {
            each_pixel(thread, [&](RenderPixel& pixel, int row, int column) { add_view(a, view, row, column, pixel); });
        });
    }
    block.each([&](int thread) {
        each_pixel(thread, [&](const RenderPixel& pixel, int row, int column) {
            if (row < a.height && column < a.width) store(a, pixel, row, column);
        });
    });
}

constexpr int smooth_threads = 256;
constexpr int most_reach = 32;                 // cells; a wider Gaussian is cut off
constexpr float least_opacity = 1.0f / 32.0f;  // of a block that smoothing adds

struct SmoothArguments {
    const DepthPlane *planes, *copies;  // as they were built, and smoothed
    const std::int32_t* slots;   // of each place for a block, the number of its first map of `built`; -1 without one
    std::int32_t* places;        // the same of `smoothed`; becomes -1 where next to nothing comes and `built` has none
    const std::int32_t* blocks;  // numbers of the places that may have a smoothed block, in order
    const float* sigma;          // (count): standard deviation in pixels
    const HalfTexel* built;
    HalfTexel* smoothed;
    std::int32_t count;        // of planes
    std::int32_t first_block;  // of those that are made
};

FEWRAYS_INLINE float wide(float value) { return value; }

template <bool condition>
struct Stored {
    using Number = Half;
};
template <>
struct Stored<true> {
    using Number = float;  // means of halves are none
};

// A block of a copy of a plane with `cells` per pixel and axis, of which every `factor` times `factor` become one:
// `own` in every `pitch` pixels, which are the copy's unit.
template <int cells, int factor>
struct SmoothShared {
    static constexpr int own = factor > cells ? 1 : cells / factor;
    static constexpr int pitch = own * factor / cells;
    static constexpr int rows = (block_rows + 1) * own, columns = map_row * own;  // that are made
    static constexpr int stride = columns + 2 * most_reach;
    std::int32_t plane, reach;
    float taps[most_reach + 1];
    float down[rows * stride];
    typename Stored<(factor > 1)>::Number cells_around[(rows + 2 * most_reach) * stride];
};

// One channel of a plane's cell, as bits; 0 where there is no block.
template <int cells>
FEWRAYS_INLINE Half cell_of(const SmoothArguments& a, const DepthPlane& plane, int row, int column, int channel) {
    constexpr int height = block_rows * cells, width = block_columns * cells;
    if (row < 0 || row >= plane.rows * height || column < 0 || column >= plane.columns * width) return 0;
    const std::int32_t slot = a.slots[plane.first_slot + row / height * plane.columns + column / width];
    if (slot < 0) return 0;
    return a.built[static_cast<std::int64_t>(slot) * map_size + place_of_cell(cells, row % height, column % width)]
        .channels[channel];
}

// The same of `factor` times `factor` cells together.
template <int cells, int factor>
FEWRAYS_INLINE typename Stored<(factor > 1)>::Number mean_of(const SmoothArguments& a, const DepthPlane& plane, int row,
                                                             int column, int channel) {
    if constexpr (factor == 1) {
        return cell_of<cells>(a, plane, row, column, channel);
    } else {
        float sum = 0.0f;
        for (int k = 0; k < factor * factor; ++k)
            sum += wide(cell_of<cells>(a, plane, row * factor + k / factor, column * factor + k % factor, channel));
        return sum / (factor * factor);
    }
}

// Whether the plane itself has something where a block of its copy is, whose corner is there in pixels.
template <int pitch>
inline bool has_own(const SmoothArguments& a, const DepthPlane& plane, int top, int left) {
    const int first_row = (top - plane.top) >> block_row_bits, first_column = (left - plane.left) >> block_column_bits;
    for (int row = std::max(first_row, 0); row < std::min(first_row + pitch, plane.rows); ++row)
        for (int column = std::max(first_column, 0); column < std::min(first_column + pitch, plane.columns); ++column)
            if (a.slots[plane.first_slot + row * plane.columns + column] >= 0) return true;
    return false;
}

template <int cells, int factor>
inline void smooth_block(const SmoothArguments& a, const Block& block, SmoothShared<cells, factor>& shared) {
    using Shared = SmoothShared<cells, factor>;
    constexpr int own = Shared::own, pitch = Shared::pitch;
    const std::int32_t place = a.blocks[a.first_block + block.x()];
    block.each([&](int thread) {
        if (thread > 0) return;
        shared.plane = plane_of_block(a.copies, a.count, place);
        const float sigma = a.sigma[shared.plane] * static_cast<float>(own) / static_cast<float>(pitch);
        shared.reach = std::min(static_cast<int>(std::ceil(3.0f * sigma)), most_reach);
        float total = 0.0f;
        for (int k = 0; k <= shared.reach; ++k) {
            const float distance = static_cast<float>(k) / sigma;
            shared.taps[k] = std::exp(-0.5f * distance * distance);
            total += (k ? 2.0f : 1.0f) * shared.taps[k];
        }
        for (int k = 0; k <= shared.reach; ++k) shared.taps[k] /= total;
    });
    const DepthPlane plane = a.planes[shared.plane], copy = a.copies[shared.plane];
    const int number = place - copy.first_slot, reach = shared.reach;
    const int top_pixel = copy.top + number / copy.columns * block_rows;
    const int left_pixel = copy.left + number % copy.columns * block_columns;
    // In cells of the copy, from the plane's corner.
    const int top = top_pixel * own - plane.top * own / pitch, left = left_pixel * own - plane.left * own / pitch;
    const int rows = Shared::rows + 2 * reach, columns = Shared::columns + 2 * reach;
    const bool added = !has_own<pitch>(a, plane, top_pixel * pitch, left_pixel * pitch);
    HalfTexel* const to = a.smoothed + static_cast<std::int64_t>(a.places[place]) * map_size;
    for (int channel = 0; channel < 4; ++channel) {
        block.each([&](int thread) {
            for (int i = thread; i < rows * columns; i += smooth_threads)
                shared.cells_around[i / columns * Shared::stride + i % columns] =
                    mean_of<cells, factor>(a, plane, top - reach + i / columns, left - reach + i % columns, channel);
        });
        block.each([&](int thread) {
            for (int i = thread; i < Shared::rows * columns; i += smooth_threads) {
                const auto* const middle = shared.cells_around + (i / columns + reach) * Shared::stride + i % columns;
                float sum = shared.taps[0] * wide(*middle);
                for (int k = 1; k <= reach; ++k)
                    sum += shared.taps[k] * (wide(middle[-k * Shared::stride]) + wide(middle[k * Shared::stride]));
                shared.down[i / columns * Shared::stride + i % columns] = sum;
            }
        });
        const bool any = block.any([&](int thread) {
            bool speaks = false;
            for (int i = thread; i < Shared::rows * Shared::columns; i += smooth_threads) {
                const int row = i / Shared::columns, column = i % Shared::columns;
                const float* const middle = shared.down + row * Shared::stride + column + reach;
                float sum = shared.taps[0] * middle[0];
                for (int k = 1; k <= reach; ++k) sum += shared.taps[k] * (middle[-k] + middle[k]);
                to[place_of_cell(own, row, column)].channels[channel] = to_half(sum);
                // The last row and column repeat other blocks' cells.
                speaks |= row < block_rows * own && column < block_columns * own && sum > least_opacity;
            }
            return speaks;
        });
        // Opacity comes first.
        if (channel == 0 && added && !any) {
            block.each([&](int thread) {
                if (thread == 0) a.places[place] = -1;
            });
            return;
        }
    }
}

using SmoothShared12 = SmoothShared<1, 2>;
using SmoothShared24 = SmoothShared<2, 4>;
using SmoothShared11 = SmoothShared<1, 1>;
using SmoothShared21 = SmoothShared<2, 1>;
using SmoothShared22 = SmoothShared<2, 2>;
using SmoothShared31 = SmoothShared<3, 1>;

// By cells per pixel of the plane, and how many of them become one along each axis.
inline void run_multiplane_smooth_1_1(const SmoothArguments& a, const Block& block, SmoothShared11& shared) {
    smooth_block<1, 1>(a, block, shared);
}
inline void run_multiplane_smooth_1_2(const SmoothArguments& a, const Block& block, SmoothShared12& shared) {
    smooth_block<1, 2>(a, block, shared);
}
inline void run_multiplane_smooth_2_4(const SmoothArguments& a, const Block& block, SmoothShared24& shared) {
    smooth_block<2, 4>(a, block, shared);
}
inline void run_multiplane_smooth_2_1(const SmoothArguments& a, const Block& block, SmoothShared21& shared) {
    smooth_block<2, 1>(a, block, shared);
}
inline void run_multiplane_smooth_2_2(const SmoothArguments& a, const Block& block, SmoothShared22& shared) {
    smooth_block<2, 2>(a, block, shared);
}
inline void run_multiplane_smooth_3_1(const SmoothArguments& a, const Block& block, SmoothShared31& shared) {
    smooth_block<3, 1>(a, block, shared);
}

}  // namespace fewrays

FEWRAYS_KERNEL(multiplane_render, fewrays::render_threads, fewrays::RenderArguments, fewrays::RenderShared)
FEWRAYS_KERNEL(multiplane_smooth_1_1, fewrays::smooth_threads, fewrays::SmoothArguments, fewrays::SmoothShared11)
FEWRAYS_KERNEL(multiplane_smooth_1_2, fewrays::smooth_threads, fewrays::SmoothArguments, fewrays::SmoothShared12)
FEWRAYS_KERNEL(multiplane_smooth_2_4, fewrays::smooth_threads, fewrays::SmoothArguments, fewrays::SmoothShared24)
FEWRAYS_KERNEL(multiplane_smooth_2_1, fewrays::smooth_threads, fewrays::SmoothArguments, fewrays::SmoothShared21)
FEWRAYS_KERNEL(multiplane_smooth_2_2, fewrays::smooth_threads, fewrays::SmoothArguments, fewrays::SmoothShared22)
FEWRAYS_KERNEL(multiplane_smooth_3_1, fewrays::smooth_threads, fewrays::SmoothArguments, fewrays::SmoothShared31)
