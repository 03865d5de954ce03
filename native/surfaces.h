// What is seen at one reconstruction location: section 3.2 and 3.3 of Lehtinen et al. 2011. Twin of
// src/fewrays/temporal/surfaces.py.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "crowd.h"
#include "sights.h"

namespace fewrays {

// How often each case has occurred.
struct SurfaceStatistics {
    std::int64_t locations, empty, single, quadrants, covered, last;  // by how the surface was found
    std::int64_t wide, surfaces, merged;                              // looks beyond R; surfaces seen, and joined

    SurfaceStatistics& operator+=(const SurfaceStatistics& other);
};

class Surfaces {
public:
    explicit Surfaces(const SurfaceRule& rule) : base_(rule), rule_(rule) {}

    // From now on, lengths of the rule count so many times.
    void scale(float factor) {
        rule_.radius = factor * base_.radius;
        rule_.tolerance = factor * base_.tolerance;
        rule_.overhang = factor * base_.overhang;
    }
    float radius() const { return rule_.radius; }

    // Where there is no need to choose: whether any surface of a crowd covers the location. `obviously` is a quick look
    // at a crowd within R, that may miss it.
    Crowd& crowd() { return crowd_; }
    bool obviously_covers();
    bool any_covers();
    // Whether the crowd lies on all sides of the location.
    bool all_surround();

    // Finds what is seen at a location, radiance and slope; false if no sample is near. All samples within R are in the
    // rows; look(radius, crowd) collects those within a radius.
    template <typename Look>
    bool resolve(const Sights& sights, const SightRow* rows, int row_count, float x, float y, Look&& look,
                 float* seen) {
        ++statistics_.locations;
        float radius = rule_.radius;
        const auto look_closely = [&] {
            look(radius, crowd_);
            crowd_.finish();
        };
        Verdict verdict = glance(sights, rows, row_count, x, y, seen);
        if (verdict == Verdict::several) {
            look_closely();
            verdict = front_surface(seen);
        }
        if (verdict == Verdict::found) return true;
        ++statistics_.wide;
        radius *= 2;
        look_closely();
        if (verdict == Verdict::nothing) {
            while (crowd_.size() == 0 && radius < widest * rule_.radius) {
                radius *= 2;
                look_closely();
            }
            if (crowd_.size() == 0) {
                ++statistics_.empty;
                return false;
            }
        }
        choose(verdict == Verdict::nothing ? radius : rule_.radius, seen);
        return true;
    }

    // Calls visit(sights, index, x, y, weight) for the samples that made up what resolve() found last, with positions
    // relative to the location and weights under the tent. Its arguments are those of resolve().
    template <typename Visit>
    void visit_found(const Sights& sights, const SightRow* rows, int row_count, float x, float y, Visit&& visit) const {
        const auto visit_under = [&](const Sights& from, std::ptrdiff_t i, float dx, float dy) {
            float weight = 1.0f - std::sqrt(dx * dx + dy * dy) / found_.tent;
            if (!(weight > 0)) return;
            if (from.weight) weight *= from.weight[i];
            visit(from, i, dx, dy, weight);
        };
        if (!found_.at_a_glance) {
            const Sights& from = crowd_.from();
            if (found_.nearest >= 0)
                return visit(from, crowd_.source(found_.nearest), sights_.x[found_.nearest], sights_.y[found_.nearest],
                             1.0f);
            for (int i : surface_) visit_under(from, crowd_.source(i), sights_.x[i], sights_.y[i]);
            return;
        }
        const float radius2 = rule_.radius * rule_.radius;
        for (int row = 0; row < row_count; ++row)
            for (std::int32_t i = rows[row].first; i < rows[row].end; ++i) {
                const float dx = sights.x[i] - x, dy = sights.y[i] - y;
                if (dx * dx + dy * dy <= radius2 && sights.slope[i] <= found_.farthest) visit_under(sights, i, dx, dy);
            }
    }

    const SurfaceStatistics& statistics() const { return statistics_; }

private:
    enum class Verdict { found, several, nothing };

    static constexpr float widest = 8;  // of the radii, in R

    Verdict glance(const Sights& sights, const SightRow* rows, int row_count, float x, float y, float* seen);
    Verdict front_surface(float* seen);
    void choose(float radius, float* seen);
    void begin_surfaces();
    void take_all();
    void next_surface();
    bool covers(bool all_within_radius);
    bool fills_quadrants() const;
    bool on_one_side(int n) const;
    void move_towards_location();
    void filter(float radius, float* seen);

    const SurfaceRule base_;
    SurfaceRule rule_;
    Crowd crowd_;
    Sights sights_{};           // of the crowd
    std::vector<float> depth_;  // of the crowd: slopes, infinite for what surfaces have taken
    int left_ = 0;              // of the crowd: how many no surface has taken
    std::vector<int> order_;
    std::vector<int> surface_;            // the samples of the surface at hand
    std::vector<float> ring_x_, ring_y_;  // positions of the surface at hand, for covers()
    // How the samples were chosen that made up what was found: those up to a slope, or the surface at hand, under a
    // tent of this radius; or the nearest alone.
    struct {
        bool at_a_glance;
        float farthest, tent;
        int nearest;
    } found_{};
    SurfaceStatistics statistics_{};
};

}  // namespace fewrays
