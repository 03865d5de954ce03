// What the mean of locations gains on a GPU: bands of blur smoothed, and the correction towards the samples' own mean.
// Twin of src/fewrays/temporal/refine.py, whose steps are in the same order here. Between the steps, planes of numbers
// are blurred; what goes into a blur together are channels of one image.
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "atomics.h"
#include "block.h"
#include "each_texel.h"
#include "median.h"

namespace fewrays {

constexpr int most_blur_taps = 97;  // on one side of a blur, with the middle
constexpr float least_trust = 1e-30f;

struct BlurArguments {
    const float* image;  // (height, width, step), of which channels from `first` on are blurred
    float* blurred;      // (height, width, channels)
    std::int32_t height, width, channels, first, step;
    std::int32_t along;  // rows are blurred where it is 1, columns where it is 0
    std::int32_t reach;
    float taps[most_blur_taps];
};

// One pass of a Gaussian blur, which takes nothing to be beyond the borders. A thread has one number.
inline void run_temporal_blur(const BlurArguments& a, const Block& block, NothingShared&) {
    each_texel(block, a.height, a.width * a.channels, [&](int row, int across) {
        const int column = across / a.channels, channel = across % a.channels;
        const int at = a.along ? column : row, size = a.along ? a.width : a.height;
        const std::int64_t stride = a.along ? a.step : static_cast<std::int64_t>(a.width) * a.step;
        const std::int64_t pixel = static_cast<std::int64_t>(row) * a.width + column;
        const float* const source = a.image + pixel * a.step + a.first + channel;
        float sum = 0.0f;
        for (int k = std::max(-a.reach, -at); k <= std::min(a.reach, size - 1 - at); ++k)
            sum += a.taps[k < 0 ? -k : k] * source[k * stride];
        a.blurred[pixel * a.channels + channel] = sum;
    });
}

struct JoinArguments {
    const float* bands;   // (height, width, band_count, 4): sums of radiance and of weights
    const float* smooth;  // (band_count - first_smooth, height, width, 4): bands blurred
    float* image;         // (height, width, 3)
    std::int32_t height, width, band_count, first_smooth;
};

// Joins bands of blur to an image: of the smoothed ones the mean around, as much of it as the pixel sees.
inline void run_temporal_join(const JoinArguments& a, const Block& block, NothingShared&) {
    const std::int64_t pixels = static_cast<std::int64_t>(a.height) * a.width;
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = static_cast<std::int64_t>(row) * a.width + column;
        float radiance[3] = {}, weight = 0.0f;
        for (int band = 0; band < a.band_count; ++band) {
            const float* const own = a.bands + 4 * (pixel * a.band_count + band);
            weight += own[3];
            if (band < a.first_smooth) {
                for (int c = 0; c < 3; ++c) radiance[c] += own[c];
                continue;
            }
            const float* const around = a.smooth + 4 * ((band - a.first_smooth) * pixels + pixel);
            if (around[3] > 0.0f)
                for (int c = 0; c < 3; ++c) radiance[c] += around[c] / around[3] * own[3];
        }
        for (int c = 0; c < 3; ++c) a.image[3 * pixel + c] = weight > 0.0f ? radiance[c] / weight : 0.0f;
    });
}

// How a pixel's variance, known from its neighbours, is told.
struct NoiseArguments {
    const float* mean;            // (height, width, 4): radiance; 1 where it is known, else 0
    const float* near;            // alike: blurred by a pixel
    float* squares;               // (height, width, 2): of what differs from that; 1 where it is known
    const float* around;          // alike: blurred
    const float* variance;        // (height, width): of pixels of several samples
    const std::uint8_t* several;  // alike: which these are
    float* noise;                 // (height, width, 2): variance, where it is known; 1 there
    std::int32_t height, width;
    float own_share;  // part of a pixel's noise in what differs from its surroundings
};

// By how much pixels differ from those around.
inline void run_temporal_squares(const NoiseArguments& a, const Block& block, NothingShared&) {
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = static_cast<std::int64_t>(row) * a.width + column;
        const float *const mean = a.mean + 4 * pixel, *const near = a.near + 4 * pixel;
        float square = 0.0f;
        for (int c = 0; c < 3; ++c) {
            const float difference = mean[c] - (near[3] > 0.0f ? near[c] / near[3] : 0.0f);
            square += difference * difference;
        }
        a.squares[2 * pixel] = mean[3] * (square / a.own_share);
        a.squares[2 * pixel + 1] = mean[3];
    });
}

// The variance of every pixel: of a single sample, what its neighbours tell.
inline void run_temporal_noise(const NoiseArguments& a, const Block& block, NothingShared&) {
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = static_cast<std::int64_t>(row) * a.width + column;
        const float* const around = a.around + 2 * pixel;
        const float told = around[1] > 0.0f ? around[0] / around[1] : 0.0f, known = a.mean[4 * pixel + 3];
        a.noise[2 * pixel] = known * (a.several[pixel] ? a.variance[pixel] : told);
        a.noise[2 * pixel + 1] = known;
    });
}

// How much pixels are trusted.
struct TrustArguments {
    const float* noise;      // (height, width, 2): variance; 1 where it is known
    const float* pooled;     // alike: blurred
    float* trust;            // (height, width): first the pooled variance, then the weight
    std::uint32_t* counts;   // (2, half_values): 0 before each count
    Middle* middle;          // of the pooled variances
    std::uint32_t* largest;  // bits of the largest weight; 0 at first
    std::int32_t height, width;
    float least_noise;  // in units of the median
};

// Pools the variance, and counts what is known by its upper bits.
inline void run_temporal_pool(const TrustArguments& a, const Block& block, NothingShared&) {
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = static_cast<std::int64_t>(row) * a.width + column;
        const float* const pooled = a.pooled + 2 * pixel;
        a.trust[pixel] = pooled[1] > 0.0f ? pooled[0] / pooled[1] : 0.0f;
        if (a.noise[2 * pixel + 1] > 0.0f) count_upper(a.counts, a.trust[pixel]);
    });
}

inline void run_temporal_upper(const TrustArguments& a, const Block& block, PartSums& sums) {
    sum_parts(a.counts, block, sums);
    const std::uint32_t count = sums.before[pick_threads];
    for (int which = 0; which < 2; ++which)
        pick_rank(a.counts, count ? (count - 1 + which) / 2 : 0, block, sums,
                  [&](std::uint32_t value, std::uint32_t rank) {
                      a.middle->upper[which] = value;
                      a.middle->rank[which] = rank;
                      a.middle->any = 1;
                  });
}

// Counts by the lower bits.
inline void run_temporal_count(const TrustArguments& a, const Block& block, NothingShared&) {
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = static_cast<std::int64_t>(row) * a.width + column;
        if (a.noise[2 * pixel + 1] > 0.0f) count_lower(a.counts, *a.middle, a.trust[pixel]);
    });
}

inline void run_temporal_lower(const TrustArguments& a, const Block& block, PartSums& sums) {
    for (int which = 0; which < 2; ++which) {
        const std::uint32_t* const counts = a.counts + which * half_values;
        sum_parts(counts, block, sums);
        pick_rank(counts, a.middle->rank[which], block, sums,
                  [&](std::uint32_t value, std::uint32_t) { a.middle->lower[which] = value; });
    }
}

// Weighs pixels by how little noise there is around them.
inline void run_temporal_trust(const TrustArguments& a, const Block& block, std::uint32_t& largest) {
    block.each([&](int thread) {
        if (thread == 0) largest = 0;
    });
    const float least = a.least_noise * a.middle->median();
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = static_cast<std::int64_t>(row) * a.width + column;
        const float known = a.noise[2 * pixel + 1], noise = a.trust[pixel] + least;
        const float weight = noise > 0.0f ? known / noise : known;
        a.trust[pixel] = weight;
        atomic_most(&largest, std::bit_cast<std::uint32_t>(weight));
    });
    block.each([&](int thread) {
        if (thread == 0) atomic_most(a.largest, largest);
    });
}

// How the image is corrected.
struct CorrectArguments {
    const float* image;            // (height, width, 3)
    const float* mean;             // (height, width, 4): the samples'; 1 where it is known, else 0
    const float* noise;            // (height, width, 2): its variance, and the same
    const float* trust;            // (height, width)
    const std::uint32_t* largest;  // bits of the largest of these
    float* weighed;                // (height, width, 4): difference times trust, and trust
    float* weighed_noise;          // (height, width): variance times its square
    const float* around;           // (height, width, 4): the former, blurred
    const float* around_noise;     // (height, width): the latter
    float* difference;             // (height, width, 3): smoothed
    float* energies;               // (height, width, 3): of difference, image and noise
    const float* pooled;           // alike: blurred
    float* corrected;              // (height, width, 3)
    std::int32_t height, width;
    float noise_share, bearable, least_left;
};

// Weighs what the samples' mean differs by.
inline void run_temporal_difference(const CorrectArguments& a, const Block& block, NothingShared&) {
    const float most = std::max(std::bit_cast<float>(*a.largest), least_trust);
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = static_cast<std::int64_t>(row) * a.width + column;
        const float trust = a.trust[pixel] / most;
        for (int c = 0; c < 3; ++c) a.weighed[4 * pixel + c] = trust * (a.mean[4 * pixel + c] - a.image[3 * pixel + c]);
        a.weighed[4 * pixel + 3] = trust;
        a.weighed_noise[pixel] = trust * trust * a.noise[2 * pixel];
    });
}

inline float squared_length(const float* color) {
    return color[0] * color[0] + color[1] * color[1] + color[2] * color[2];
}

// The difference in the mean over a neighbourhood, and the energies that say how much of it to believe.
inline void run_temporal_energies(const CorrectArguments& a, const Block& block, NothingShared&) {
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = static_cast<std::int64_t>(row) * a.width + column;
        const float* const around = a.around + 4 * pixel;
        const float reciprocal = around[3] > 0.0f ? 1.0f / around[3] : 0.0f;
        for (int c = 0; c < 3; ++c) a.difference[3 * pixel + c] = around[c] * reciprocal;
        float* const energies = a.energies + 3 * pixel;
        energies[0] = squared_length(a.difference + 3 * pixel);
        energies[1] = squared_length(a.image + 3 * pixel);
        energies[2] = a.around_noise[pixel] * (reciprocal * reciprocal);
    });
}

inline void run_temporal_correct(const CorrectArguments& a, const Block& block, NothingShared&) {
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = static_cast<std::int64_t>(row) * a.width + column;
        const float *const pooled = a.pooled + 3 * pixel, square = pooled[0], expected = pooled[2];
        const float bearable = a.bearable * a.bearable * pooled[1];
        float share = 1.0f - a.noise_share * (square > 0.0f ? expected / square : 1.0f);
        share *= bearable > 0.0f ? bearable / (bearable + expected) : 0.0f;
        for (int c = 0; c < 3; ++c) {
            const float own = a.image[3 * pixel + c], least = own > 0.0f ? a.least_left * own : own;
            const float corrected = own + std::max(share, 0.0f) * a.difference[3 * pixel + c];
            a.corrected[3 * pixel + c] = std::max(corrected, least);
        }
    });
}

}  // namespace fewrays

FEWRAYS_KERNEL(temporal_blur, fewrays::texel_threads, fewrays::BlurArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_join, fewrays::texel_threads, fewrays::JoinArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_squares, fewrays::texel_threads, fewrays::NoiseArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_noise, fewrays::texel_threads, fewrays::NoiseArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_pool, fewrays::texel_threads, fewrays::TrustArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_upper, fewrays::pick_threads, fewrays::TrustArguments, fewrays::PartSums)
FEWRAYS_KERNEL(temporal_count, fewrays::texel_threads, fewrays::TrustArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_lower, fewrays::pick_threads, fewrays::TrustArguments, fewrays::PartSums)
FEWRAYS_KERNEL(temporal_trust, fewrays::texel_threads, fewrays::TrustArguments, std::uint32_t)
FEWRAYS_KERNEL(temporal_difference, fewrays::texel_threads, fewrays::CorrectArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_energies, fewrays::texel_threads, fewrays::CorrectArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_correct, fewrays::texel_threads, fewrays::CorrectArguments, fewrays::NothingShared)
