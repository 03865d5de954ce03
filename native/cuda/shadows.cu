// Light and shadow of area lights at the camera samples' own points, on a GPU. Twin of
// src/fewrays/temporal/shading_reference.py and shadows.py.
//
// One lamp after the other. Every thread has a camera sample and all of its light points.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "../math/clear_view.h"
#include "../math/receiver.h"
#include "../math/reprojection.h"
#include "../math/seen_point.h"
#include "../math/tree_node.h"
#include "block.h"
#include "device_samples.h"
#include "lamp_reading.h"

namespace fewrays {

struct PlaceArguments {
    DeviceSamples samples;  // of a lamp
    const float* spacing;
    const std::int32_t* order;  // of the hierarchy
    PlacedSample* placed;
};

inline void run_shadows_place(const PlaceArguments& a, const Block& block, NothingShared&) {
    each_sample(block, a.samples, [&](std::int64_t place) {
        const std::int64_t i = a.order[place];
        a.placed[place] = {path_of_sample(a.samples, i), a.spacing[i]};
    });
}

constexpr int shade_threads = 128;

struct ShadeArguments {
    DeviceSamples camera;
    const float* normal;                 // (samples, 3): of shading, in camera space
    const std::int32_t* first_view;      // (samples): each gets `share` of the views from there on
    const std::int32_t* listed;          // (count): the samples to shade
    std::uint8_t* open;                  // (samples): whether light points must be looked up one by one
    float* radiance;                     // (samples, 3): added to
    const float *reflectance, *spacing;  // (samples, 3), (samples): by which light samples are apart
    Projection projection;
    std::int32_t count, share;
    DeviceLamp lamp;
};

// A camera sample that is to be lit.
class LitSample {
public:
    FEWRAYS_INLINE LitSample(const ShadeArguments& a, std::int64_t number)
        : a_(a), number_(number), path_(path_of_sample(a.camera, number)) {}

    FEWRAYS_INLINE Vector point_at(float time) const {
        return fewrays::point_at(a_.projection, path_, a_.camera.depth[number_], time);
    }

    // What the sample would send to the camera per unit of the light point's radiance; false if nothing.
    FEWRAYS_INLINE bool gain(const Incidence& seen, float* gain) const {
        if (!seen.matters()) return false;
        const float falling = dot(vector_at(a_.normal, number_), seen.to_light) / seen.distance;
        const float factor = falling * seen.factor(a_.lamp.area) / static_cast<float>(a_.share);
        for (int c = 0; c < 3; ++c) gain[c] = factor * a_.reflectance[3 * number_ + c];
        return falling > 0.0f && (gain[0] != 0.0f || gain[1] != 0.0f || gain[2] != 0.0f);
    }

    // Adds the light of all its light points: shine(view, seen, point, radiance) says what each sends, if anything.
    template <typename Shine>
    FEWRAYS_INLINE void add_light(Shine&& shine) const {
        float sums[3] = {};
        const int first = a_.first_view[number_];
        for (int number = first; number < first + a_.share; ++number) {
            const LightView view(a_.lamp, number);
            const Vector point = point_at(view.view.time);
            const Incidence seen = incidence_of(view.frame, view.point, point);
            float own[3], radiance[3];
            if (!gain(seen, own) || !shine(view, seen, point, radiance)) continue;
            for (int c = 0; c < 3; ++c) sums[c] += own[c] * radiance[c];
        }
        for (int c = 0; c < 3; ++c) a_.radiance[3 * number_ + c] += sums[c];
    }

private:
    const ShadeArguments& a_;
    const std::int64_t number_;
    const Path path_;
};

// Every thread has a sample, and gives it all of the lamp's light if nothing can come in between.
inline void run_shadows_clear(const ShadeArguments& a, const Block& block, NothingShared&) {
    block.each([&](int thread) {
        const std::int64_t k = static_cast<std::int64_t>(block.x()) * shade_threads + thread;
        if (k >= a.count) return;
        const std::int64_t i = a.listed[k];
        const float first = a.lamp.times[a.first_view[i]], last = a.lamp.times[a.first_view[i] + a.share - 1];
        const LitSample sample(a, i);
        const ClearView view(a.lamp.frame, sample.point_at(first), vector_at(a.lamp.facing, i), a.spacing[i],
                             a.lamp.rule.radius, a.lamp.farthest, first, last);
        const auto may_matter = [&](const TreeNode& node) { return view.may_matter(node); };
        const auto may_block = [&](std::int32_t place) {
            return view.may_block(a.lamp.placed[place].path, a.lamp.far_slope, a.lamp.placed[place].spacing);
        };
        if (!view.decides() || walk(a.lamp, may_matter, may_block)) return;
        a.open[i] = 0;
        sample.add_light([&](const LightView&, const Incidence&, const Vector&, float* radiance) {
            copy_even_radiance(a.lamp, radiance);
            return true;
        });
    });
}

// Every thread has a sample, and looks its light points up one by one.
inline void run_shadows_light(const ShadeArguments& a, const Block& block, NothingShared&) {
    block.each([&](int thread) {
        const std::int64_t k = static_cast<std::int64_t>(block.x()) * shade_threads + thread;
        if (k >= a.count) return;
        const std::int64_t i = a.listed[k];
        NearestBlockers blockers;
        const Vector facing = vector_at(a.lamp.facing, i);
        const auto look_up = [&](const LightView& light, const Incidence& seen, const Vector& point, float* radiance) {
            const Receiver to = receiver_of(light.frame, light.point, point, facing, seen, a.spacing[i]);
            return LampReading(a.lamp, light, to).shines(blockers, radiance);
        };
        LitSample(a, i).add_light(look_up);
    });
}

}  // namespace fewrays

FEWRAYS_KERNEL(shadows_place, fewrays::sample_threads, fewrays::PlaceArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(shadows_clear, fewrays::shade_threads, fewrays::ShadeArguments, fewrays::NothingShared)
FEWRAYS_KERNEL_WITH_REGISTERS(shadows_light, fewrays::shade_threads, fewrays::ShadeArguments, fewrays::NothingShared)
