#include "shadows.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace fewrays {
namespace {

constexpr float rounding = 2e-5f;      // of the distances that a point's place is made of
constexpr float grazing = 1e-3f;       // sine of the least angle at which light leaves the lamp
constexpr float most_scale_ratio = 2;  // of receivers that share a grid of light samples
constexpr float second_look = 1.5f;    // at what is not the first surface on the way, with lengths that many times
constexpr float spare_area = 4;        // of a grid: cells for each of its receivers, and beside
constexpr float spare_cells = 64;

Vector vector_at(const float* values, std::ptrdiff_t i) {
    return {values[3 * i], values[3 * i + 1], values[3 * i + 2]};
}

LightFrame frame_at(const Lamp& lamp, float time) {
    LightFrame frame = lamp.frame;
    frame.center = frame.center + time * lamp.motion;
    return frame;
}

Vector light_point_of(const Lamp& lamp, int view) {
    const float unit = lamp.frame.unit();
    return {unit * lamp.points[2 * view], unit * lamp.points[2 * view + 1], 0.0f};
}

}  // namespace

Relighting::Relighting(const LightField& field, const LitPlan& plan)
    : field_(field), plan_(plan), receivers_(plan.lamps.size()) {
    for (const Lamp& lamp : plan.lamps) readers_.emplace_back(*lamp.tree, plan.rule, true);
}

void Relighting::clear() {
    for (ViewReader& reader : readers_) reader.clear();
}

// How deep a camera sample's point is at a time.
float Relighting::depth_of(std::ptrdiff_t number, float time) const {
    const float depth = field_.depth[number];
    return field_.motion ? depth + (time - field_.time[number]) * field_.motion[3 * number + 2] : depth;
}

// Where a camera sample's point is at a time, in camera space.
Vector Relighting::point_of(std::ptrdiff_t number, float time) const {
    const Path path = field_.path(static_cast<std::int32_t>(number));
    const float w = depth_at(path, time);
    return plan_.camera.point((path.x + time * path.dx) / w, (path.y + time * path.dy) / w, w * field_.depth[number]);
}

// The point that a location sees: on the tangent plane of the nearest of its samples, but neither in front of all of
// them nor behind.
Vector Relighting::surface_point(const ViewReader& camera, const Location& location) {
    seen_.clear();
    float nearest2 = std::numeric_limits<float>::infinity(), least = nearest2, most = 0;
    std::ptrdiff_t nearest = 0;
    camera.visit_found([&](const Sights& from, std::ptrdiff_t i, float dx, float dy, float weight) {
        const std::ptrdiff_t number = from.number[i];
        seen_.push_back({number, weight});
        const float depth = depth_of(number, location.time);
        least = std::min(least, depth);
        most = std::max(most, depth);
        const float distance2 = dx * dx + dy * dy;
        if (distance2 > nearest2 || (distance2 == nearest2 && number > nearest)) return;
        nearest2 = distance2;
        nearest = number;
    });
    facing_ = vector_at(plan_.facing, nearest);
    const CameraRay ray = ray_of(plan_.camera, location.x, location.y, location.u, location.v, field_.c0, field_.c1);
    const float depth = depth_on_plane(ray, point_of(nearest, location.time), facing_);
    return ray.from + std::clamp(depth, least, most) * ray.towards;
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
    for (std::size_t k = 0; k < plan_.lamps.size(); ++k)
        add_receiver(plan_.lamps[k], receivers_[k], point, view, location.time, weight / total, sums);
}

void Relighting::add_receiver(const Lamp& lamp, Receivers& receivers, Vector point, int view, float time, float weight,
                              float* sums) const {
    const LightFrame frame = frame_at(lamp, time);
    const Vector light_point = light_point_of(lamp, view);
    const Vector to_light = frame.leave(light_point) - point;
    Receiver receiver{};
    receiver.point = frame.enter(point);
    const float distance = length(to_light), cosine = receiver.point.z / distance;
    if (!(cosine > grazing)) return;

    float density = 0, sum_of_weights = 0;
    for (const Seen& each : seen_) {
        const std::ptrdiff_t i = each.number;
        if (!(lamp.density[i] > 0)) continue;
        density += each.weight * lamp.density[i];
        sum_of_weights += each.weight;
        const float own = each.weight * std::max(dot(vector_at(plan_.normal, i), to_light), 0.0f) / distance;
        for (int channel = 0; channel < 3; ++channel) receiver.gain[channel] += own * lamp.reflectance[3 * i + channel];
    }
    const float factor = weight * lamp.area * cosine / (distance * distance);
    for (float& gain : receiver.gain) gain *= factor;
    if (receiver.gain[0] == 0 && receiver.gain[1] == 0 && receiver.gain[2] == 0) return;
    receiver.scale = density / sum_of_weights;
    receiver.facing = frame.turn(dot(facing_, to_light) >= 0 ? facing_ : -1.0f * facing_);
    receiver.at = on_second_plane(frame, light_point, receiver.point);
    receiver.precision = rounding * (distance + length(point) + length(frame.center));
    receiver.sums = sums;
    receivers.push_back(receiver);
}

void Relighting::light(int view, float time) {
    for (std::size_t k = 0; k < plan_.lamps.size(); ++k) {
        const Lamp& lamp = plan_.lamps[k];
        Receivers& receivers = receivers_[k];
        if (!receivers.empty())
            light_group(lamp, readers_[k], receivers.data(), receivers.data() + receivers.size(),
                        light_point_of(lamp, view), {lamp.points[2 * view], lamp.points[2 * view + 1], time});
        receivers.clear();
    }
}

// Receivers share a grid of light samples where they are close to each other on the second plane and the samples are
// about equally dense; others are divided.
void Relighting::light_group(const Lamp& lamp, ViewReader& reader, Receiver* first, Receiver* last, Vector light_point,
                             const View& view) {
    Box box{first->at.x, first->at.x, first->at.y, first->at.y};
    float least = first->scale, most = first->scale;
    for (const Receiver* each = first; each != last; ++each) {
        box.left = std::min(box.left, each->at.x);
        box.right = std::max(box.right, each->at.x);
        box.top = std::min(box.top, each->at.y);
        box.bottom = std::max(box.bottom, each->at.y);
        least = std::min(least, each->scale);
        most = std::max(most, each->scale);
    }
    const float width = box.right - box.left, height = box.bottom - box.top;
    const float margin = 4 * most * plan_.rule.radius;
    const auto count = static_cast<float>(last - first);
    const auto divide = [&](auto&& comes_first) {
        Receiver* const middle = std::partition(first, last, comes_first);
        light_group(lamp, reader, first, middle, light_point, view);
        light_group(lamp, reader, middle, last, light_point, view);
    };
    if (most > most_scale_ratio * least) {
        const float middle = std::sqrt(most * least);
        return divide([&](const Receiver& each) { return each.scale < middle; });
    }
    const float cells = (width + margin) * (height + margin) / (margin * margin / 16);
    if (last - first > 1 && cells > spare_area * count + spare_cells) {
        const float x = box.left + 0.5f * width, y = box.top + 0.5f * height;
        if (width >= height && box.left < x && x < box.right)
            return divide([&](const Receiver& each) { return each.at.x < x; });
        if (width < height && box.top < y && y < box.bottom)
            return divide([&](const Receiver& each) { return each.at.y < y; });
    }
    reader.fill(box, view, most, second_look * most);
    const LightFrame frame = frame_at(lamp, view.time);
    for (const Receiver* each = first; each != last; ++each) light_one(lamp, frame, reader, *each, light_point);
}

// What stops light in front of a receiver lies in front of the receiver's tangent plane. On one and the same curved
// surface, so do neighbours of a hollow; but then their tangent planes pass behind the receiver.
void Relighting::light_one(const Lamp& lamp, const LightFrame& frame, ViewReader& reader, const Receiver& receiver,
                           Vector light_point) {
    float seen[4];
    float total = 0, radiance[3] = {};
    if (!reader.read(receiver.at.x, receiver.at.y, seen, receiver.scale)) return;
    // Where the camera does not see all that lies in a blocker's shadow, fewer light samples meet the blocker.
    if (!reader.found_first() && !reader.read(receiver.at.x, receiver.at.y, seen, second_look * receiver.scale)) return;
    // A hit lies from the light point on towards its place on the second plane: so far in front of the tangent plane.
    const float start = dot(receiver.facing, light_point - receiver.point), unit = frame.unit();
    const Vector to_plane = Vector{receiver.at.x, receiver.at.y, frame.distance} - light_point;
    const float step = dot(receiver.facing, to_plane);
    reader.visit_found([&](const Sights& from, std::ptrdiff_t i, float dx, float dy, float weight) {
        total += weight;
        const float share = unit / (unit - from.slope[i]);
        if (start + share * (step + receiver.facing.x * dx + receiver.facing.y * dy) > receiver.precision) {
            const std::ptrdiff_t number = from.number[i];
            if (!lamp.arrives[number]) return;
            const Vector facing = frame.turn(vector_at(plan_.facing, number));
            const Vector hit = light_point + share * (to_plane + Vector{dx, dy, 0.0f});
            const float side = dot(facing, light_point - hit) >= 0 ? 1.0f : -1.0f;
            if (side * dot(facing, receiver.point - hit) < -receiver.precision) return;
        }
        radiance[0] += weight * from.red[i];
        radiance[1] += weight * from.green[i];
        radiance[2] += weight * from.blue[i];
    });
    for (int channel = 0; channel < 3; ++channel)
        receiver.sums[channel] += receiver.gain[channel] * radiance[channel] / total;
}

}  // namespace fewrays
