#include "shadows.h"

#include <algorithm>
#include <cmath>

#include "full_light.h"
#include "math/seen_point.h"

namespace fewrays {
namespace {

constexpr float most_ratio = 2;   // of spacings that share a grid of light samples
constexpr float grid_border = 6;  // cells of a grid around its receivers, of the side R
constexpr float spare_cells = 2;  // that a grid may have for each of its receivers, and of its border's

Vector vector_at(const float* values, std::ptrdiff_t i) {
    return {values[3 * i], values[3 * i + 1], values[3 * i + 2]};
}

}  // namespace

Relighting::Relighting(const LightField& field, const LitPlan& plan)
    : field_(field), plan_(plan), lit_(plan.lamps.size()) {
    for (const Lamp& lamp : plan.lamps) readers_.emplace_back(lamp, plan.rule);
}

void Relighting::clear() {
    for (LampReader& reader : readers_) reader.clear();
}

// Where a camera sample's point is at a time, in camera space.
Vector Relighting::point_of(std::ptrdiff_t number, float time) const {
    return point_at(plan_.camera, field_.path(static_cast<std::int32_t>(number)), field_.depth[number], time);
}

// The point that a location sees, with the samples that it is made of.
Vector Relighting::surface_point(const ViewReader& camera, const Location& location) {
    seen_.clear();
    SeenSurface surface;
    camera.visit_found([&](const Sights& from, std::ptrdiff_t i, float dx, float dy, float weight) {
        const std::ptrdiff_t number = from.number[i];
        seen_.push_back({number, weight});
        const float* const motion = field_.motion ? field_.motion + 3 * number : nullptr;
        const float after = motion ? location.time - field_.time[number] : 0.0f;
        surface.include(number, depth_after(field_.depth[number], motion, after), dx * dx + dy * dy);
    });
    facing_ = vector_at(plan_.facing, surface.nearest());
    const CameraRay ray = ray_of(plan_.camera, location.x, location.y, location.u, location.v, field_.c0, field_.c1);
    return surface.point(ray, point_of(surface.nearest(), location.time), facing_);
}

void Relighting::see(const ViewReader& camera, const Location& location, int view, float weight, float* sums) {
    const Vector point = surface_point(camera, location);
    float total = 0, unlit[3] = {};
    for (const Seen& each : seen_) {
        total += each.weight;
        for (int channel = 0; channel < 3; ++channel)
            unlit[channel] += each.weight * plan_.unlit[3 * each.number + channel];
    }
    for (int channel = 0; channel < 3; ++channel) sums[channel] += weight * unlit[channel] / total;
    for (std::size_t lamp = 0; lamp < plan_.lamps.size(); ++lamp)
        add_receiver(lamp, point, view, location.time, weight / total, false, sums);
}

void Relighting::see(std::ptrdiff_t sample, int view, float time, float weight, std::uint64_t full, float* sums) {
    seen_.assign(1, {sample, 1.0f});
    facing_ = vector_at(plan_.facing, sample);
    for (int channel = 0; channel < 3; ++channel) sums[channel] += weight * plan_.unlit[3 * sample + channel];
    for (std::size_t lamp = 0; lamp < plan_.lamps.size(); ++lamp)
        add_receiver(lamp, point_of(sample, time), view, time, weight, full >> lamp & 1, sums);
}

std::uint64_t Relighting::full_light(std::ptrdiff_t sample, float first_time, float last_time) const {
    std::uint64_t full = 0;
    const Vector point = point_of(sample, first_time);
    for (std::size_t lamp = 0; lamp < plan_.lamps.size(); ++lamp)
        if (gets_full_light(plan_.lamps[lamp], plan_.rule.radius, sample, point, first_time, last_time))
            full |= std::uint64_t{1} << lamp;
    return full;
}

void Relighting::add_receiver(std::size_t number, Vector point, int view, float time, float weight, bool full,
                              float* sums) {
    const Lamp& lamp = plan_.lamps[number];
    const LightFrame frame = lamp.frame_at(time);
    const Vector light_point = lamp.light_point(view);
    const Incidence seen = incidence_of(frame, light_point, point);
    if (!seen.matters()) return;

    Lit lit{};
    LampGain gain(seen);
    for (const Seen& each : seen_)
        gain.include(each.weight, vector_at(plan_.normal, each.number), lamp.reflectance + 3 * each.number,
                     lamp.tree->field().spacing[each.number]);
    if (!gain.finish(weight, lamp.area, lit.gain)) return;
    if (full) {
        for (int channel = 0; channel < 3; ++channel) sums[channel] += lit.gain[channel] * lamp.radiance[channel];
        return;
    }
    lit.receiver = receiver_of(frame, light_point, point, facing_, seen, gain.spacing());
    lit.sums = sums;
    lit_[number].push_back(lit);
}

void Relighting::light(int view, float time) {
    for (std::size_t lamp = 0; lamp < plan_.lamps.size(); ++lamp) {
        std::vector<Lit>& lit = lit_[lamp];
        if (!lit.empty()) light_group(readers_[lamp], lit.data(), lit.data() + lit.size(), view, time);
        lit.clear();
    }
}

// Receivers share a grid of light samples where they are close to each other on the second plane and the samples are
// about equally far apart; others are divided.
void Relighting::light_group(LampReader& reader, Lit* first, Lit* last, int view, float time) const {
    const PlanePosition corner = first->receiver.at;
    Box box{corner.x, corner.x, corner.y, corner.y};
    float least = first->receiver.spacing, most = least;
    for (const Lit* each = first; each != last; ++each) {
        const auto [x, y] = each->receiver.at;
        box = {std::min(box.left, x), std::max(box.right, x), std::min(box.top, y), std::max(box.bottom, y)};
        least = std::min(least, each->receiver.spacing);
        most = std::max(most, each->receiver.spacing);
    }
    const auto divide = [&](auto&& comes_first) {
        Lit* const middle = std::partition(first, last, comes_first);
        light_group(reader, first, middle, view, time);
        light_group(reader, middle, last, view, time);
    };
    if (most > most_ratio * least) {
        const float middle = std::sqrt(most * least);
        return divide([&](const Lit& each) { return each.receiver.spacing < middle; });
    }
    const float cell = most * plan_.rule.radius, width = box.right - box.left, height = box.bottom - box.top;
    const float cells = (width / cell + grid_border) * (height / cell + grid_border);
    if (cells > spare_cells * (static_cast<float>(last - first) + grid_border * grid_border)) {
        const float x = box.left + 0.5f * width, y = box.top + 0.5f * height;
        if (width >= height && box.left < x && x < box.right)
            return divide([&](const Lit& each) { return each.receiver.at.x < x; });
        if (width < height && box.top < y && y < box.bottom)
            return divide([&](const Lit& each) { return each.receiver.at.y < y; });
    }
    reader.fill(box, most, view, time);
    for (const Lit* each = first; each != last; ++each) {
        float radiance[3];
        reader.read(each->receiver, radiance);
        for (int channel = 0; channel < 3; ++channel) each->sums[channel] += each->gain[channel] * radiance[channel];
    }
}

void shade_tiles(const LightField& field, const LitPlan& lit, const ShadingPlan& plan, int first, int last,
                 float* radiance) {
    Relighting lighting(field, lit);
    const int columns = (plan.width + plan.tile - 1) / plan.tile;
    const float weight = 1.0f / static_cast<float>(plan.share);
    std::vector<std::uint64_t> full;  // of the tile's samples
    for (int tile = first; tile < last; ++tile) {
        const int top = tile / columns * plan.tile, left = tile % columns * plan.tile;
        lighting.clear();
        full.clear();
        const auto each_sample = [&](auto&& visit) {
            for (int row = top; row < std::min(top + plan.tile, plan.height); ++row)
                for (int column = left; column < std::min(left + plan.tile, plan.width); ++column)
                    for (int number = 0; number < plan.spp; ++number)
                        visit((std::ptrdiff_t{row} * plan.width + column) * plan.spp + number);
        };
        each_sample([&](std::ptrdiff_t sample) {
            const std::int32_t view = plan.first_view[sample];
            full.push_back(lighting.full_light(sample, plan.times[view], plan.times[view + plan.share - 1]));
        });
        for (int view = 0; view < plan.view_count; ++view) {
            const std::uint64_t* next = full.data();
            each_sample([&](std::ptrdiff_t sample) {
                const std::uint64_t lit_by = *next++;
                const int place = view - plan.first_view[sample];
                if (place >= 0 && place < plan.share)
                    lighting.see(sample, view, plan.times[view], weight, lit_by, radiance + 3 * sample);
            });
            lighting.light(view, plan.times[view]);
        }
    }
}

}  // namespace fewrays
