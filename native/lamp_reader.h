// Finds out how much light comes from one point of an area light to points in the scene, at one time. Twin of
// src/fewrays/temporal/shadows.py.
#pragma once

#include <cstdint>
#include <vector>

#include "math/receiver.h"
#include "tree_gatherer.h"
#include "view_grid.h"

namespace fewrays {

// An area light with its samples: one for each camera sample.
struct Lamp {
    const SampleTree* tree;       // of the light samples, which know how far they are apart
    const float* reflectance;     // (N, 3) of the camera sample's point
    const std::uint8_t* arrives;  // (N): whether the light sample ends at its camera sample's point
    const float* facing;          // (N, 3): normal of the tangent plane at that point, in camera space
    const float* points;          // (views, 2): light points in units of the frame, one for each view
    LightFrame frame;             // as the shutter opens
    Vector motion;                // of the light until it closes, in camera space
    const float* radiance;        // (3) of the whole light; null if it differs from place to place
    float area, farthest;         // the light point that is farthest from the centre, in units of the frame

    LightFrame frame_at(float time) const {
        LightFrame moved = frame;
        moved.center = frame.center + time * motion;
        return moved;
    }
    Vector facing_at(std::ptrdiff_t sample) const {
        return {facing[3 * sample], facing[3 * sample + 1], facing[3 * sample + 2]};
    }
    Vector light_point(int view) const {
        return {frame.unit() * points[2 * view], frame.unit() * points[2 * view + 1], 0.0f};
    }
};

class LampReader {
public:
    // Lengths of the rule are in units of spacing.
    LampReader(const Lamp& lamp, const SurfaceRule& rule)
        : lamp_(lamp),
          rule_(rule),
          grid_(*lamp.tree, true, !lamp.radiance),
          gatherer_(*lamp.tree, true),
          surfaces_(rule) {}

    // Forgets the copies of samples made for an earlier part of the image.
    void clear() { grid_.clear(); }

    // Prepares for receivers in a box on the second plane, around which samples are up to so far apart.
    void fill(const Box& places, float most_spacing, int view, float time);

    // Finds the radiance (3) that comes to a receiver.
    void read(const Receiver& receiver, float* radiance);

private:
    // Whether any light comes to a receiver; and the radiance, unless it is the same everywhere.
    bool shines(const Receiver& receiver, float* radiance);

    struct Sorted {  // the samples around a receiver
        int lit, blocked;
        bool blocked_near;  // within R
    };

    Sorted sort_out(const Sights& sights, const SightRow* rows, int row_count, PlanePosition at, const Receiver& to,
                    float spread, float* radiance);
    void find_near(const Sights& sights, const SightRow* rows, int row_count, PlanePosition at, const Receiver& to,
                   float radius);
    bool blocks(const Receiver& to, std::ptrdiff_t number, float share, float dx, float dy) const;

    const Lamp& lamp_;
    const SurfaceRule rule_;
    ViewGrid grid_;
    TreeGatherer gatherer_;
    Surfaces surfaces_;
    Crowd gathered_;
    std::vector<std::int32_t> near_;
    LightFrame frame_{};
    Vector light_point_{};
    View view_{};
};

}  // namespace fewrays
