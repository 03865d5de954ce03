#include "multiplane_sheet.h"

#include <algorithm>
#include <bit>
#include <cstdint>

#include "multiplane_blocks.h"
#include "simd.h"

namespace fewrays {
namespace {

constexpr int lanes = sheet_margin;  // pixels that are composited at once: half a block's row
constexpr float opaque = 0.01f;      // transmittance below which what lies behind does not show
static_assert(block_columns == 2 * lanes);

// How a view reads a plane's blocks: by four cells, which count (left, right) times (upper, lower).
struct Reader {
    const DepthPlane& plane;
    const Taps& taps;
    std::ptrdiff_t channel;  // from one channel's first map to the next one's
    float left, right, upper, lower;

    Reader(const DepthPlane& plane_, const Taps& taps_)
        : plane(plane_),
          taps(taps_),
          channel(std::ptrdiff_t{map_size} * plane.cells * plane.cells),
          left(half_bias * (taps.weights[0] + taps.weights[2])),
          right(half_bias * (taps.weights[1] + taps.weights[3])),
          upper(taps.weights[0] + taps.weights[1]),
          lower(taps.weights[2] + taps.weights[3]) {}
};

// Numbers of so many pixels, by channel.
struct Values {
    alignas(64) float of[block_channels][lanes];
};

// The upper two cells of pixels, or the lower two, with what each of them counts.
FEWRAYS_INLINE void read_pair(const Reader& from, const Half* FEWRAYS_RESTRICT first,
                              const Half* FEWRAYS_RESTRICT second, Values& values) {
    for (int c = 0; c < block_channels; ++c)
        for (int i = 0; i < lanes; ++i)
            values.of[c][i] = from.left * half_bits(first[c * from.channel + i]) +
                              from.right * half_bits(second[c * from.channel + i]);
}

// Lays pixels behind what a view has seen so far.
template <class Sheet>
FEWRAYS_INLINE void lay_behind(const Reader& from, const Values& above, const Values& below, std::ptrdiff_t at,
                               Sheet& sheet) {
    float* FEWRAYS_RESTRICT transmittance = sheet.transmittance + at;
    float* FEWRAYS_RESTRICT red = sheet.color[0] + at;
    float* FEWRAYS_RESTRICT green = sheet.color[1] + at;
    float* FEWRAYS_RESTRICT blue = sheet.color[2] + at;
    const float scale = from.plane.scale, upper = from.upper, lower = from.lower;
    for (int i = 0; i < lanes; ++i) {
        const float before = transmittance[i], share = scale * before;
        transmittance[i] = before - before * (upper * above.of[0][i] + lower * below.of[0][i]);
        red[i] += share * (upper * above.of[1][i] + lower * below.of[1][i]);
        green[i] += share * (upper * above.of[2][i] + lower * below.of[2][i]);
        blue[i] += share * (upper * above.of[3][i] + lower * below.of[3][i]);
    }
}

// Whether anything shows behind pixels. Positive numbers are in the order of their bits.
FEWRAYS_INLINE bool shows_behind(const float* FEWRAYS_RESTRICT transmittance) {
    std::int32_t most[lanes / 2];
    for (int i = 0; i < lanes / 2; ++i) {
        const auto a = std::bit_cast<std::int32_t>(transmittance[i]);
        const auto b = std::bit_cast<std::int32_t>(transmittance[i + lanes / 2]);
        most[i] = a > b ? a : b;
    }
    for (int half = lanes / 4; half > 0; half /= 2)
        for (int i = 0; i < half; ++i) most[i] = most[i] > most[i + half] ? most[i] : most[i + half];
    return most[0] >= std::bit_cast<std::int32_t>(opaque);
}

// Lays rows of half a block behind what a view has seen: from `block` on, to `at` in the sheet. Cells of a whole pixel
// are read once, as the lower ones of a row and the upper ones of the next.
template <bool whole_pixels, class Sheet>
FEWRAYS_INLINE void lay_rows(const Reader& from, const Half* block, int rows, std::ptrdiff_t at, Sheet& sheet) {
    const Half* cells[4] = {block + from.taps.at[0], block + from.taps.at[1], block + from.taps.at[2],
                            block + from.taps.at[3]};
    Values above, below;
    bool known = false;
    for (int j = 0; j < rows; ++j, at += Sheet::stride) {
        const bool shows = shows_behind(sheet.transmittance + at);
        if (shows) {
            if (!known) read_pair(from, cells[0], cells[1], above);
            read_pair(from, cells[2], cells[3], below);
            lay_behind(from, above, below, at, sheet);
            if (whole_pixels) above = below;
        }
        known = whole_pixels && shows;
        for (const Half*& cell : cells) cell += map_row;
    }
}

template <class Sheet>
FEWRAYS_INLINE void lay_blocks(const DepthPlane& plane, const std::int32_t* slots, const Half* halves, const Taps& taps,
                               int sheet_row, int sheet_column, Sheet& sheet) {
    const Reader from(plane, taps);
    const int top = sheet_row + taps.row, left = sheet_column + taps.column;  // in the plane
    const int first_row = std::max(divide_down(top, block_rows), 0);
    const int last_row = std::min(divide_down(top + Sheet::rows - 1, block_rows), plane.rows - 1);
    const int first_column = std::max(divide_down(left, block_columns), 0);
    const int last_column = std::min(divide_down(left + Sheet::columns - 1, block_columns), plane.columns - 1);
    for (int row = first_row; row <= last_row; ++row) {
        const int begin = std::max(row * block_rows - top, 0);
        const int end = std::min((row + 1) * block_rows - top, Sheet::rows);
        for (int column = first_column; column <= last_column; ++column) {
            const std::int32_t slot = slots[plane.first_slot + std::ptrdiff_t{row} * plane.columns + column];
            if (slot < 0) continue;
            const Half* block =
                halves + half_padding + slot * unit_halves + std::ptrdiff_t{top + begin - row * block_rows} * map_row;
            for (int half = 0; half < block_columns; half += lanes) {
                const int to = column * block_columns + half - left;
                if (to <= -lanes || to >= Sheet::columns) continue;
                const std::ptrdiff_t at = begin * Sheet::stride + sheet_margin + to;
                if (plane.cells == 1)
                    lay_rows<true>(from, block + half, end - begin, at, sheet);
                else
                    lay_rows<false>(from, block + half, end - begin, at, sheet);
            }
        }
    }
}

// Interpolates a row of pixels between two rows of half the resolution, of which the nearer one comes first.
FEWRAYS_INLINE void twice(const float* FEWRAYS_RESTRICT nearer, const float* FEWRAYS_RESTRICT farther,
                          float* FEWRAYS_RESTRICT out) {
    float line[HalfSheet::columns];
    for (int i = 0; i < HalfSheet::columns; ++i) line[i] = 0.75f * nearer[i] + 0.25f * farther[i];
    for (int i = 0; i < tile_columns / 2; ++i) {
        const float middle = 0.75f * line[i + 1];
        out[2 * i] = middle + 0.25f * line[i];
        out[2 * i + 1] = middle + 0.25f * line[i + 2];
    }
}

// A row of a tile, interpolated from a map of half its resolution that begins a pixel before the tile.
FEWRAYS_INLINE void row_of(const float* halved, int row, float* FEWRAYS_RESTRICT out) {
    const int own = row / 2 + 1, other = own + (row % 2 ? 1 : -1);
    twice(halved + own * HalfSheet::stride + sheet_margin, halved + other * HalfSheet::stride + sheet_margin, out);
}

}  // namespace

FEWRAYS_CLONES
void lay_plane(const DepthPlane& plane, const std::int32_t* slots, const Half* halves, const Taps& taps, int row,
               int column, TileSheet& sheet) {
    lay_blocks(plane, slots, halves, taps, row, column, sheet);
}

FEWRAYS_CLONES
void lay_plane(const DepthPlane& plane, const std::int32_t* slots, const Half* halves, const Taps& taps, int row,
               int column, HalfSheet& sheet) {
    lay_blocks(plane, slots, halves, taps, row, column, sheet);
}

FEWRAYS_CLONES
void start_with(const HalfSheet& front, TileSheet& sheet) {
    for (int row = 0; row < tile_rows; ++row) {
        const int at = row * TileSheet::stride + sheet_margin;
        row_of(front.transmittance, row, sheet.transmittance + at);
        for (int c = 0; c < 3; ++c) row_of(front.color[c], row, sheet.color[c] + at);
    }
}

FEWRAYS_CLONES
void finish_with(const HalfSheet& back, TileSheet& sheet) {
    alignas(64) float line[tile_columns];
    for (int row = 0; row < tile_rows; ++row) {
        const int at = row * TileSheet::stride + sheet_margin;
        float* transmittance = sheet.transmittance + at;
        for (int c = 0; c < 3; ++c) {
            row_of(back.color[c], row, line);
            float* color = sheet.color[c] + at;
            for (int i = 0; i < tile_columns; ++i) color[i] += transmittance[i] * line[i];
        }
        row_of(back.transmittance, row, line);
        for (int i = 0; i < tile_columns; ++i) transmittance[i] *= line[i];
    }
}

}  // namespace fewrays
