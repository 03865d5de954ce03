// Light and shadow at the points that camera locations see: section 5 of Lehtinen et al. 2011. Twin of
// src/fewrays/temporal/shadows.py.
#pragma once

#include <cstdint>
#include <deque>
#include <vector>

#include "math/light.h"
#include "sample_tree.h"
#include "surfaces.h"
#include "view_reader.h"

namespace fewrays {

// An area light with its samples: one for each camera sample.
struct Lamp {
    const SampleTree* tree;       // of the light samples
    const float* reflectance;     // (N, 3) of the camera sample's point
    const float* density;         // (N): how far apart they are on the second plane, per pixel; 0 if there is none
    const std::uint8_t* arrives;  // (N): whether it ends at its camera sample's point
    const float* points;          // (views, 2): light points in units of the frame, one for each view
    LightFrame frame;             // as the shutter opens
    Vector motion;                // of the light until it closes, in camera space
    float area;
};

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

    // Adds the lamps' light for all locations of a view that were seen.
    void light(int view, float time);

private:
    // A point and what it would add to the sums were the light's radiance 1 and nothing in between.
    struct Receiver {
        Vector point, facing;  // in light space
        PlanePosition at;      // on the second plane
        float scale;           // density of the light samples there
        float precision;       // distance that rounding may move points by
        float gain[3];
        float* sums;
    };
    using Receivers = std::vector<Receiver>;
    struct Seen {
        std::ptrdiff_t number;
        float weight;
    };

    float depth_of(std::ptrdiff_t number, float time) const;
    Vector point_of(std::ptrdiff_t number, float time) const;
    Vector surface_point(const ViewReader& camera, const Location& location);
    void add_receiver(const Lamp& lamp, Receivers& receivers, Vector point, int view, float time, float weight,
                      float* sums) const;
    void light_group(const Lamp& lamp, ViewReader& reader, Receiver* first, Receiver* last, Vector light_point,
                     const View& view);
    void light_one(const Lamp& lamp, const LightFrame& frame, ViewReader& reader, const Receiver& receiver,
                   Vector light_point);

    const LightField& field_;
    const LitPlan& plan_;
    std::deque<ViewReader> readers_;  // of each lamp
    std::vector<Receivers> receivers_;
    std::vector<Seen> seen_;  // the samples of the location at hand
    Vector facing_{};         // of the surface at hand
};

}  // namespace fewrays
