// From layers with depth to the sheets that are warped: the twin of src/fewrays/dynamic/prepare.py, a pixel at a time.
//
// Sheets are numbered as there: the first layer, those behind it, emptiness, what was made up. Here the last two have
// their place also where there is nothing of them, so that nobody waits to know.
#include "../math/behind.h"
#include "../math/edge_split.h"
#include "../math/sheet_lookup.h"
#include "atomics.h"
#include "block.h"
#include "each_texel.h"

namespace fewrays {

// What is found out about a layer.
struct LayerSurvey {
    std::uint32_t wrong_colors, wrong_depths, wrong_alphas;  // values that no renderer means
    std::uint32_t steepest;                                  // bits of the greatest size of a slope
};

struct LayerArguments {
    const float* color;  // (height, width, 3)
    const float* depth;  // (height, width)
    const float* alpha;  // alike, or none where all is opaque
    Texel* texels;       // alike
    std::uint8_t* shown;
    LayerSurvey* survey;  // zeros at first
    std::int32_t height, width, mend;
    float c0, c1, most;  // the lens, and what slopes are cut off at
};

inline bool is_finite(float x) { return std::fabs(x) < INFINITY; }

// A layer as it is, seen through the lens.
inline void run_dynamic_layer(const LayerArguments& a, const Block& block, LayerSurvey& survey) {
    block.each([&](int thread) {
        if (thread == 0) survey = {};
    });
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = static_cast<std::int64_t>(row) * a.width + column;
        const float coverage = a.alpha ? a.alpha[pixel] : 1.0f, given = a.depth[pixel];
        const bool visible = coverage > 0, good = given > 0;
        std::uint32_t wrong = 0;
        Texel texel{};
        for (int k = 0; k < 3; ++k) {
            texel.light[k] = a.color[3 * pixel + k];
            wrong += !is_finite(texel.light[k]);
        }
        if (wrong) atomic_increase(&survey.wrong_colors, wrong);
        if (visible && !good && !a.mend) atomic_increase(&survey.wrong_depths, 1u);
        if (!(coverage >= 0 && coverage <= 1)) atomic_increase(&survey.wrong_alphas, 1u);
        const float slope = a.c0 / (visible && good ? given : INFINITY) + a.c1;
        texel.slope = std::clamp(slope, -a.most, a.most);
        texel.light[3] = texel.coverage = coverage;
        a.texels[pixel] = texel;
        a.shown[pixel] = visible;
        atomic_most(&survey.steepest, std::bit_cast<std::uint32_t>(std::fabs(texel.slope)));
    });
    block.each([&](int thread) {
        if (thread > 0) return;
        if (survey.wrong_colors) atomic_increase(&a.survey->wrong_colors, survey.wrong_colors);
        if (survey.wrong_depths) atomic_increase(&a.survey->wrong_depths, survey.wrong_depths);
        if (survey.wrong_alphas) atomic_increase(&a.survey->wrong_alphas, survey.wrong_alphas);
        atomic_most(&a.survey->steepest, survey.steepest);
    });
}

// Everything that the sheets are made from, (height, width) if not said otherwise.
struct PrepareArguments {
    const Texel* whole;      // the first layer as it is
    Texel* texels;           // (sheets, height, width): receives the first sheet; the other layers' are there
    std::uint8_t* shown;     // (sheets, height, width): pixels that are warped
    WarpPixel* pixels;       // (sheets, height, width)
    float* light;            // (height, width, 4): of the first thing that shows in a pixel
    float* slope;            // of the same
    float* front;            // slope of the surface in front
    std::uint8_t* opaque;    // whether that thing covers its pixel
    std::uint8_t* edge;      // whether it is beside another surface
    std::uint8_t* in_front;  // whether it is the surface in front
    std::uint8_t* mixed;     // pixels of that surface that have been taken apart
    std::uint8_t* needed;    // pixels to look behind
    BackgroundPixel* back;   // what is behind; nothing at first
    std::int32_t height, width;
    std::int32_t seen;      // sheets that show what was given: layers, and emptiness
    std::int32_t empty;     // number of the sheet of emptiness, 0 for none
    std::int32_t made_up;   // number of the sheet of what was made up, 0 for none
    std::int32_t split;     // take mixed pixels apart
    std::int32_t carry_on;  // show what is behind all edges, not only behind what was taken apart
    float empty_slope, tolerance;
    float most;  // no slope is greater
    float agreement;
    std::int32_t reach;
};

inline std::int64_t texel_number(const PrepareArguments& a, int sheet, int row, int column) {
    return (static_cast<std::int64_t>(sheet) * a.height + row) * a.width + column;
}

// A layer's pixel as it was given.
inline const Texel& given_texel(const PrepareArguments& a, int sheet, int row, int column) {
    return (sheet == 0 ? a.whole : a.texels)[texel_number(a, sheet, row, column)];
}

// Finds out where all layers let light pass, and what is the first thing that shows.
inline void run_dynamic_front(const PrepareArguments& a, const Block& block, NothingShared&) {
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = texel_number(a, 0, row, column);
        if (a.empty) {
            bool passing = true;
            for (int sheet = 0; sheet < a.empty; ++sheet) passing &= given_texel(a, sheet, row, column).coverage < 1;
            a.texels[texel_number(a, a.empty, row, column)] = {{}, 1.0f, a.empty_slope, {}};
            a.shown[texel_number(a, a.empty, row, column)] = passing;
        }
        Texel first = a.whole[pixel];
        for (int sheet = 1; sheet < a.seen && first.coverage == 0; ++sheet)
            if (a.shown[texel_number(a, sheet, row, column)]) first = given_texel(a, sheet, row, column);
        for (int k = 0; k < 4; ++k)
            a.light[4 * pixel + k] = first.light[k] / (first.coverage > 0 ? first.coverage : 1.0f);
        a.slope[pixel] = first.slope;
        a.opaque[pixel] = first.coverage >= 1;
    });
}

// The least slope of a pixel and its eight neighbours, by slope_at(pixel).
template <typename SlopeAt>
inline float front_slope(const PrepareArguments& a, int row, int column, const SlopeAt& slope_at) {
    float least = INFINITY;
    for (int i = std::max(row - 1, 0); i <= std::min(row + 1, a.height - 1); ++i)
        for (int j = std::max(column - 1, 0); j <= std::min(column + 1, a.width - 1); ++j)
            least = std::min(least, slope_at(texel_number(a, 0, i, j)));
    return least;
}

// Whether a neighbour shows another surface.
inline bool beside_another(const PrepareArguments& a, int row, int column) {
    const float own = a.slope[texel_number(a, 0, row, column)];
    for (int i = std::max(row - 1, 0); i <= std::min(row + 1, a.height - 1); ++i)
        for (int j = std::max(column - 1, 0); j <= std::min(column + 1, a.width - 1); ++j)
            if (std::fabs(a.slope[texel_number(a, 0, i, j)] - own) > a.tolerance) return true;
    return false;
}

// Number of the first layer behind the surface in front that is seen and opaque; 0 for none, and where the pixel shows
// what is behind that surface itself.
inline int seen_behind(const PrepareArguments& a, int row, int column, float slope, bool in_front) {
    if (!in_front) return 0;
    for (int sheet = 1; sheet < a.seen; ++sheet) {
        const Texel& texel = given_texel(a, sheet, row, column);
        if (a.shown[texel_number(a, sheet, row, column)] && texel.coverage >= 1 && texel.slope > slope + a.tolerance)
            return sheet;
    }
    return 0;
}

// Tells which pixels are edges, and which surface is in front there.
inline void run_dynamic_edges(const PrepareArguments& a, const Block& block, NothingShared&) {
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = texel_number(a, 0, row, column);
        const float own = a.slope[pixel];
        const float nearest = front_slope(a, row, column, [&](std::int64_t at) { return a.slope[at]; });
        const bool in_front = own <= nearest + a.tolerance;
        const bool edge = !a.opaque[pixel] || beside_another(a, row, column);
        const int seen = seen_behind(a, row, column, own, in_front);
        a.front[pixel] = seen ? given_texel(a, seen, row, column).slope : edge ? nearest : own;
        a.edge[pixel] = edge;
        a.in_front[pixel] = in_front;
        a.needed[pixel] = edge && a.opaque[pixel];
    });
}

// Guesses what is behind the pixels that need it, and leaves the others as they are.
inline void run_dynamic_background(const PrepareArguments& a, const Block& block, NothingShared&) {
    const FrontImage image{a.light, a.slope, a.front, a.edge, a.needed, a.height, a.width, a.most};
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = texel_number(a, 0, row, column);
        if (a.needed[pixel]) a.back[pixel] = background_of(image, row, column, {a.tolerance, a.agreement, a.reach});
    });
}

// Takes a mixed pixel of the first layer apart; `seen` is the sheet that is seen behind it, if any.
inline Texel apart(const PrepareArguments& a, int row, int column, int seen) {
    const std::int64_t pixel = texel_number(a, 0, row, column);
    Texel texel = a.whole[pixel];
    const BackgroundPixel& back = a.back[pixel];
    const auto mixes = [&](std::int64_t at) { return a.edge[at] && a.whole[at].coverage >= 1; };
    if (!a.split || !mixes(pixel) || !(seen || back.known > 0)) return texel;
    const Texel* const behind = seen ? &given_texel(a, seen, row, column) : nullptr;
    const float nearest = front_slope(a, row, column, [&](std::int64_t at) { return a.whole[at].slope; });
    Mixture of{{}, nearest, behind ? behind->light : back.light, behind ? behind->slope : back.slope};
    // An edge before nothing has its own alpha; what is not behind makes no mixture.
    if (!(of.behind_slope - nearest > a.tolerance && of.behind[3] > opaque_from)) return texel;
    of.front = front_light(a.whole, a.height, a.width, row, column, nearest + a.tolerance, mixes);
    split_texel(of, a.tolerance, texel);
    return texel;
}

// Makes the first sheet, and says what is yet to be looked for behind it.
inline void run_dynamic_split(const PrepareArguments& a, const Block& block, NothingShared&) {
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = texel_number(a, 0, row, column);
        BackgroundPixel& back = a.back[pixel];
        const int seen = seen_behind(a, row, column, a.slope[pixel], a.in_front[pixel] != 0);
        const Texel first = apart(a, row, column, seen);
        const bool mixed = first.coverage < a.whole[pixel].coverage;
        a.texels[pixel] = first;
        a.shown[pixel] = first.coverage > 0;
        a.mixed[pixel] = mixed && a.in_front[pixel];
        a.needed[pixel] = a.opaque[pixel] && !mixed;
        if (!a.carry_on && (!mixed || seen)) back.known = 0;
        if (!mixed || a.in_front[pixel]) return;
        for (int k = 0; k < 4; ++k) a.light[4 * pixel + k] = back.light[k];
        a.slope[pixel] = back.slope;
    });
}

// Makes the sheet of what is believed to be behind. Elsewhere it repeats the first, so that lookups between pixels find
// its surfaces going on.
inline void run_dynamic_made_up(const PrepareArguments& a, const Block& block, NothingShared&) {
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = texel_number(a, 0, row, column), to = texel_number(a, a.made_up, row, column);
        const BackgroundPixel& back = a.back[pixel];
        Texel texel = a.texels[pixel];
        if (back.known > 0)
            texel = {{back.light[0], back.light[1], back.light[2], back.light[3]}, 1.0f, back.slope, {}};
        a.texels[to] = texel;
        a.shown[to] = back.known > 0;
    });
}

// How fast the slope changes from a pixel to its neighbours of the same surface along an axis.
inline float slope_change(const PrepareArguments& a, std::int64_t pixel, bool before, bool after, std::int64_t stride) {
    const auto change = [&](std::int64_t other) {
        const float size = std::fabs(a.texels[pixel].slope - a.texels[other].slope);
        return a.shown[other] && size <= a.tolerance ? size : 0.0f;
    };
    return std::max(before ? change(pixel - stride) : 0.0f, after ? change(pixel + stride) : 0.0f);
}

// What warping reads. Blocks along x share out a sheet's pixels; y is the sheet.
inline void run_dynamic_spread(const PrepareArguments& a, const Block& block, NothingShared&) {
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = texel_number(a, block.y(), row, column);
        float spread = -1;
        if (a.shown[pixel] && a.texels[pixel].coverage > 0)
            spread = slope_change(a, pixel, column > 0, column + 1 < a.width, 1) +
                     slope_change(a, pixel, row > 0, row + 1 < a.height, a.width);
        a.pixels[pixel] = {a.texels[pixel].slope, spread};
    });
}

}  // namespace fewrays

FEWRAYS_KERNEL(dynamic_layer, fewrays::texel_threads, fewrays::LayerArguments, fewrays::LayerSurvey)
FEWRAYS_KERNEL(dynamic_front, fewrays::texel_threads, fewrays::PrepareArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(dynamic_edges, fewrays::texel_threads, fewrays::PrepareArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(dynamic_background, fewrays::texel_threads, fewrays::PrepareArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(dynamic_split, fewrays::texel_threads, fewrays::PrepareArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(dynamic_made_up, fewrays::texel_threads, fewrays::PrepareArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(dynamic_spread, fewrays::texel_threads, fewrays::PrepareArguments, fewrays::NothingShared)
