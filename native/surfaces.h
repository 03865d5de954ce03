// What is seen at one reconstruction location: section 3.2 and 3.3 of Lehtinen et al. 2011. Twin of
// src/fewrays/temporal/surfaces.py.
#pragma once

#include <cmath>
#include <compare>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace fewrays {

struct SurfaceRule {
    float radius;                  // R, in pixels: no hole of the samples is wider
    float along_lens, along_time;  // how far lens points and times vary within a location
    float tolerance;               // pixels that samples of a surface may cross
    float tent;                    // radius of the tent filter, in R; 0 takes the nearest sample instead
    float overhang;                // pixels that a surface juts out beyond its outermost samples, on average
};

// Samples as seen from one lens point at one time.
struct Sights {
    const float *x, *y, *slope;
    const float *speed_x, *speed_y;   // null where nothing moves
    const float* weight;              // less than 1 for samples far from their own lens point; null where all are matte
    const float *red, *green, *blue;  // null where nobody asks
    const float* spacing;             // as in LightField
    const std::int32_t* number;       // which of all samples it is; null where nobody asks
};

// Some of them, one after the other. Arrays have room for `read_beyond` more.
struct SightRow {
    std::int32_t first, end;
};
constexpr int read_beyond = 16;

// Samples near a location; positions are relative to it.
class Crowd {
public:
    // Keeps the nearest of them.
    void thin(int most);

    // Begins anew, with at most so many of certain samples.
    void begin(const Sights& from, int most);
    void add(float x, float y, std::int32_t i, bool wanted = true) {
        x_[size_] = x;
        y_[size_] = y;
        source_[size_] = i;
        size_ += wanted;
    }
    void finish();  // looks up what else there is to know of those that stay

    static constexpr int most_samples = 512;  // of more, the nearest stay

    int size() const { return size_; }
    const Sights& from() const { return from_; }
    std::ptrdiff_t source(int i) const { return source_[i]; }
    Sights sights() const;  // positions, slopes and speeds

private:
    struct Nearness {  // the nearest first
        float distance2, x, y;
        std::int32_t source;

        auto operator<=>(const Nearness&) const = default;
    };

    Sights from_{};
    int size_ = 0;
    std::vector<Nearness> order_;
    std::vector<std::int32_t> source_;
    std::vector<float> x_, y_, slope_, speed_x_, speed_y_;
};

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
