// Light and shadow of area lights at the points that locations see, on a GPU: section 5 of Lehtinen et al. 2011. Twin
// of src/fewrays/temporal/reference.py and shadows.py.
//
// For each view, one kernel finds the point that every pixel's location sees and what it would send to the camera of
// each lamp's light. Then one for each lamp looks up what of this light gets there. Pixels are neighbours of each
// other, and share a light point: so are their threads.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "../math/receiver.h"
#include "../math/reprojection.h"
#include "../math/seen_point.h"
#include "block.h"
#include "device_samples.h"
#include "lamp_reading.h"
#include "location.h"

namespace fewrays {

constexpr int relight_threads = 128;

// What a location sees.
struct SeenPlace {
    Vector point, facing;  // facing is the normal of its tangent plane; in camera space
    std::int32_t band;     // of blur
};

// What it sends to the camera per unit of a lamp's radiance, 0 if nothing; and how far light samples around are apart.
struct LampShare {
    float gain[3], spacing;
};

// A lamp as the shutter opens.
struct LampPose {
    LightFrame frame;
    Vector motion;
    float area;
};

struct SeeArguments {
    DeviceSamples camera;
    const float *unlit, *normal, *facing;  // (samples, 3): radiance without lamps; normals of shading, and of surfaces
    const LampPose* lamps;                 // (lamp_count)
    const float* points;                   // (lamp_count, views, 2): light points in units of the frames
    const float* reflectance;              // (lamp_count, samples, 3)
    const float* spacing;                  // (lamp_count, samples)
    SeenPlace* seen;                       // (count)
    LampShare* shares;                     // (lamp_count, count)
    float* bands;                          // (pixels, band_count, 4): added to
    std::int64_t first;                    // the first of `count` pixels
    Projection projection;
    float time, offset_x, offset_y, weight;  // of the view
    float band_starts[most_bands];
    std::int32_t band_count, lamp_count, number, views, count, width;  // number is the view's
    SortedView view;
};

FEWRAYS_INLINE const float* motion_of(const DeviceSamples& s, std::int64_t i) {
    return s.motion ? s.motion + 3 * i : nullptr;
}

// Finds the point that a location sees.
FEWRAYS_INLINE SeenPlace place_of(const SeeArguments& a, const Location& location, float x, float y) {
    const DeviceSamples& s = a.camera;
    SeenSurface surface;
    location.visit_found([&](std::int32_t i, float dx, float dy, float) {
        const float own_time = s.time ? s.time[i] : 0.0f;
        surface.include(i, depth_after(s.depth[i], motion_of(s, i), a.time - own_time), dx * dx + dy * dy);
    });
    const std::int64_t nearest = surface.nearest();
    const Vector facing = vector_at(a.facing, nearest);
    const Vector at = point_at(a.projection, path_of_sample(s, nearest), s.depth[nearest], a.time);
    const CameraRay ray = ray_of(a.projection, x, y, a.view.u, a.view.v, s.c0, s.c1);
    return {surface.point(ray, at, facing), facing, band_of(location.slope(), a.band_starts, a.band_count)};
}

FEWRAYS_INLINE LampShare share_of(const SeeArguments& a, const Location& location, const SeenPlace& place, int number,
                                  float weight) {
    const LampPose& lamp = a.lamps[number];
    LightFrame frame = lamp.frame;
    frame.center = frame.center + a.time * lamp.motion;
    const float* const at = a.points + 2 * (static_cast<std::int64_t>(number) * a.views + a.number);
    const Incidence seen = incidence_of(frame, {frame.unit() * at[0], frame.unit() * at[1], 0.0f}, place.point);
    LampShare share{};
    if (!seen.matters()) return share;
    LampGain gain(seen);
    const std::int64_t first = number * a.camera.count;
    location.visit_found([&](std::int32_t i, float, float, float own) {
        gain.include(own, vector_at(a.normal, i), a.reflectance + 3 * (first + i), a.spacing[first + i]);
    });
    if (gain.finish(weight, lamp.area, share.gain)) share.spacing = gain.spacing();
    return share;
}

// Every thread has a pixel: adds what is not the lamps' light, and takes note of what is seen.
inline void run_relighting_see(const SeeArguments& a, const Block& block, NothingShared&) {
    block.each([&](int thread) {
        const std::int64_t k = static_cast<std::int64_t>(block.x()) * relight_threads + thread;
        if (k >= a.count) return;
        const std::int64_t pixel = a.first + k;
        const float x = static_cast<float>(pixel % a.width) + 0.5f + a.offset_x;
        const float y = static_cast<float>(pixel / a.width) + 0.5f + a.offset_y;
        Location location(a.view, a.camera.uv, a.camera.bandwidth, x, y);
        if (!location.resolve()) {
            for (int lamp = 0; lamp < a.lamp_count; ++lamp) a.shares[std::int64_t{lamp} * a.count + k] = {};
            return;
        }
        float total = 0.0f, unlit[3] = {};
        location.visit_found([&](std::int32_t i, float, float, float weight) {
            const Vector own = vector_at(a.unlit, i);
            total += weight;
            unlit[0] += weight * own.x;
            unlit[1] += weight * own.y;
            unlit[2] += weight * own.z;
        });
        const SeenPlace place = place_of(a, location, x, y);
        float* const sums = a.bands + 4 * (a.band_count * pixel + place.band);
        for (int c = 0; c < 3; ++c) sums[c] += a.weight * unlit[c] / total;
        sums[3] += a.weight;
        a.seen[k] = place;
        for (int lamp = 0; lamp < a.lamp_count; ++lamp)
            a.shares[std::int64_t{lamp} * a.count + k] = share_of(a, location, place, lamp, a.weight / total);
    });
}

struct RelightArguments {
    const SeenPlace* seen;                   // (count)
    const LampShare* shares;                 // (count): the lamp's
    float* bands;                            // (pixels, band_count, 4): added to
    std::int64_t first;                      // the first of the pixels
    std::int32_t band_count, number, count;  // number is the view's
    DeviceLamp lamp;
};

// Every thread has a pixel: adds the lamp's light to it.
inline void run_relighting_light(const RelightArguments& a, const Block& block, NothingShared&) {
    block.each([&](int thread) {
        const std::int64_t k = static_cast<std::int64_t>(block.x()) * relight_threads + thread;
        if (k >= a.count) return;
        const LampShare share = a.shares[k];
        if (share.gain[0] == 0.0f && share.gain[1] == 0.0f && share.gain[2] == 0.0f) return;
        const SeenPlace place = a.seen[k];
        const LightView light(a.lamp, a.number);
        const Incidence seen = incidence_of(light.frame, light.point, place.point);
        const Receiver to = receiver_of(light.frame, light.point, place.point, place.facing, seen, share.spacing);
        NearestBlockers blockers;
        float radiance[3];
        if (!LampReading(a.lamp, light, to).shines(blockers, radiance)) return;
        float* const sums = a.bands + 4 * (a.band_count * (a.first + k) + place.band);
        for (int c = 0; c < 3; ++c) sums[c] += share.gain[c] * radiance[c];
    });
}

}  // namespace fewrays

FEWRAYS_KERNEL_WITH_REGISTERS(relighting_see, fewrays::relight_threads, fewrays::SeeArguments, fewrays::NothingShared)
FEWRAYS_KERNEL_WITH_REGISTERS(relighting_light, fewrays::relight_threads, fewrays::RelightArguments,
                              fewrays::NothingShared)
