// Light and shadow at the points that camera locations see: section 5 of Lehtinen et al. 2011. Twin of
// src/fewrays/temporal/shadows.py.
#pragma once

#include <cstdint>
#include <deque>
#include <vector>

#include "lamp_reader.h"
#include "view_reader.h"

namespace fewrays {

// What is to be known of camera samples beside where they are.
struct LitPlan {
    Projection camera;
    const float* unlit;   // (N, 3): radiance that is not the lamps'
    const float* normal;  // (N, 3): of shading, in camera space
    const float* facing;  // (N, 3): normal of the surface's tangent plane, in camera space
    std::vector<Lamp> lamps;
    SurfaceRule rule;  // for light samples: lengths in units of their density
};

// Adds light to the locations of one part of the image, view by view.
class Relighting {
public:
    Relighting(const LightField& field, const LitPlan& plan);

    // Forgets the copies of samples made for an earlier part of the image.
    void clear();

    // Takes note of the point that the camera's reader found at a location of a view, whose radiance counts `weight`
    // times in `sums` (3). What is not the lamps' light is added at once.
    void see(const ViewReader& camera, const Location& location, int view, float weight, float* sums);

    // Takes note of a camera sample's own point, as it is at a time, in the same way. Lamps of whose light it gets all
    // are told by a bit each.
    void see(std::ptrdiff_t sample, int view, float time, float weight, std::uint64_t full, float* sums);

    // Which lamps shine on a camera sample's own point with all of their light points between two times: a bit each.
    std::uint64_t full_light(std::ptrdiff_t sample, float first_time, float last_time) const;

    // Adds the lamps' light for all points of a view that were seen.
    void light(int view, float time);

private:
    // What a receiver would add to the sums of its location were the light's radiance 1.
    struct Lit {
        Receiver receiver;
        float gain[3];
        float* sums;
    };
    struct Seen {
        std::ptrdiff_t number;
        float weight;
    };

    Vector point_of(std::ptrdiff_t number, float time) const;
    Vector surface_point(const ViewReader& camera, const Location& location);
    void add_receiver(std::size_t lamp, Vector point, int view, float time, float weight, bool full, float* sums);
    void light_group(LampReader& reader, Lit* first, Lit* last, int view, float time) const;

    const LightField& field_;
    const LitPlan& plan_;
    std::deque<LampReader> readers_;  // of each lamp
    std::vector<std::vector<Lit>> lit_;
    std::vector<Seen> seen_;  // the samples of the location at hand
    Vector facing_{};         // of the surface at hand
};

// How camera samples are shaded one by one: each by `share` of the views, one after the other.
struct ShadingPlan {
    int height, width, spp;
    int tile;  // side of a tile of the image, in pixels
    int view_count, share;
    const float* times;              // (view_count)
    const std::int32_t* first_view;  // (N)
};

// Shades the camera samples of tiles [first, last): adds their radiance to (N, 3).
void shade_tiles(const LightField& field, const LitPlan& lit, const ShadingPlan& plan, int first, int last,
                 float* radiance);

}  // namespace fewrays
