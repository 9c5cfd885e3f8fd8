// lumenmesh for C++17: handles that free themselves, exceptions, std::vector. Header only, over lumenmesh.h.
//
// Lengths are in mm, angles in rad, times in s, indices count from 0. A pose is a 4x4 matrix, row by row, with the
// translation in its last column.
#ifndef LUMENMESH_HPP
#define LUMENMESH_HPP

#include "lumenmesh.h"

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace lumenmesh {

// What went wrong, in the words of the command line.
class Error : public std::runtime_error {
public:
    Error(LumenmeshStatus status, const char *message) : std::runtime_error(message), status_(status) {}
    LumenmeshStatus status() const noexcept { return status_; }

private:
    LumenmeshStatus status_;
};

namespace detail {

inline void check(LumenmeshStatus status) {
    if (status != LUMENMESH_STATUS_OK) throw Error(status, lumenmesh_last_error());
}

// A handle that can be moved and not copied.
template <typename T, LumenmeshStatus (*free)(T *)> class Handle {
public:
    Handle() = default;
    Handle(Handle &&other) noexcept : pointer_(std::exchange(other.pointer_, nullptr)) {}
    Handle &operator=(Handle &&other) noexcept {
        std::swap(pointer_, other.pointer_);
        return *this;
    }
    Handle(const Handle &) = delete;
    Handle &operator=(const Handle &) = delete;
    ~Handle() { free(pointer_); }

    T *get() const noexcept { return pointer_; }
    T **out() noexcept { return &pointer_; }

private:
    T *pointer_ = nullptr;
};

// A text that is asked for its size first.
template <typename Ask> std::string text(Ask ask) {
    std::size_t length = 0;
    check(ask(nullptr, 0, &length));
    std::string text(length, '\0');
    check(ask(&text[0], text.size(), nullptr));
    text.resize(length - 1);
    return text;
}

} // namespace detail

using Pose = std::array<double, 16>;
using Point2 = std::array<double, 2>;
using Point3 = std::array<double, 3>;
using Triangle = std::array<std::uint32_t, 3>;
static_assert(sizeof(Point2) == 2 * sizeof(double) && sizeof(Triangle) == 3 * sizeof(std::uint32_t), "no padding");

// No time, or no echo.
constexpr double none = std::numeric_limits<double>::quiet_NaN();

// What the probe saw in one frame.
struct Frame {
    Pose world_from_sensor{};
    std::vector<Point2> contour_mm;
    double time_s = none;
};

// Settings by the names of the TOML file: Settings().set("method", "cylinders").set("nodes", "24").
class Settings {
public:
    Settings() { detail::check(lumenmesh_settings_new(handle_.out())); }
    explicit Settings(const std::string &path) { detail::check(lumenmesh_settings_read(path.c_str(), handle_.out())); }

    Settings &set(const std::string &name, const std::string &value) {
        detail::check(lumenmesh_settings_set(handle_.get(), name.c_str(), value.c_str()));
        return *this;
    }
    std::string toml() const {
        return detail::text([this](char *to, std::size_t size, std::size_t *length) {
            return lumenmesh_settings_toml(handle_.get(), to, size, length);
        });
    }
    const LumenmeshSettings *get() const noexcept { return handle_.get(); }

private:
    detail::Handle<LumenmeshSettings, lumenmesh_settings_free> handle_;
};

// A recording, from frames or from a file.
class Recording {
public:
    explicit Recording(const std::string &path) { detail::check(lumenmesh_recording_read(path.c_str(), handle_.out())); }
    explicit Recording(const std::vector<Frame> &frames) {
        std::vector<double> poses, contours, times;
        std::vector<std::size_t> points;
        for (const Frame &frame : frames) {
            poses.insert(poses.end(), frame.world_from_sensor.begin(), frame.world_from_sensor.end());
            points.push_back(frame.contour_mm.size());
            for (const Point2 &point : frame.contour_mm) contours.insert(contours.end(), point.begin(), point.end());
            times.push_back(frame.time_s);
        }
        detail::check(lumenmesh_recording_new(frames.size(), poses.data(), points.data(), contours.data(), times.data(),
                                              handle_.out()));
    }

    void write(const std::string &path) const { detail::check(lumenmesh_recording_write(handle_.get(), path.c_str())); }
    std::size_t frames() const {
        std::size_t frames = 0;
        detail::check(lumenmesh_recording_frames(handle_.get(), &frames));
        return frames;
    }
    const LumenmeshRecording *get() const noexcept { return handle_.get(); }

private:
    detail::Handle<LumenmeshRecording, lumenmesh_recording_free> handle_;
};

// A triangle mesh with arrays over its vertices.
class Mesh {
public:
    explicit Mesh(const std::string &path) { detail::check(lumenmesh_mesh_read(path.c_str(), handle_.out())); }
    Mesh(const std::vector<Point3> &vertices_mm, const std::vector<Triangle> &triangles) {
        const double *vertices = vertices_mm.empty() ? nullptr : vertices_mm.front().data();
        const std::uint32_t *indices = triangles.empty() ? nullptr : triangles.front().data();
        detail::check(lumenmesh_mesh_new(vertices_mm.size(), vertices, triangles.size(), indices, handle_.out()));
    }

    // The space is "ras" (the tracker's axes) or "lps" (x and y negated); the file says which.
    void write(const std::string &path, const std::string &space = "ras") const {
        detail::check(lumenmesh_mesh_write(handle_.get(), path.c_str(), space.c_str()));
    }
    std::vector<Point3> vertices_mm() const {
        std::vector<Point3> to(sizes()[0]);
        detail::check(lumenmesh_mesh_copy_vertices(handle_.get(), to.empty() ? nullptr : to.front().data(), 3 * to.size()));
        return to;
    }
    std::vector<Triangle> triangles() const {
        std::vector<Triangle> to(sizes()[1]);
        detail::check(lumenmesh_mesh_copy_triangles(handle_.get(), to.empty() ? nullptr : to.front().data(), 3 * to.size()));
        return to;
    }
    std::vector<std::string> array_names() const {
        std::vector<std::string> names;
        for (std::size_t number = 0; number < sizes()[2]; number++) {
            names.push_back(detail::text([this, number](char *to, std::size_t size, std::size_t *length) {
                return lumenmesh_mesh_array_name(handle_.get(), number, to, size, length);
            }));
        }
        return names;
    }
    std::vector<double> array(const std::string &name) const {
        std::vector<double> to(sizes()[0]);
        detail::check(lumenmesh_mesh_copy_array(handle_.get(), name.c_str(), to.data(), to.size()));
        return to;
    }
    // The mean distance from this mesh's vertices to the truth's triangles, mm.
    double fitting_error_mm(const Mesh &truth) const {
        double mean_mm = 0;
        detail::check(lumenmesh_evaluate(handle_.get(), truth.handle_.get(), &mean_mm, nullptr, 0, nullptr));
        return mean_mm;
    }

private:
    friend class Lumen;
    friend class Live;
    Mesh() = default;

    std::array<std::size_t, 3> sizes() const {
        std::array<std::size_t, 3> sizes{};
        detail::check(lumenmesh_mesh_sizes(handle_.get(), &sizes[0], &sizes[1], &sizes[2]));
        return sizes;
    }

    detail::Handle<LumenmeshMesh, lumenmesh_mesh_free> handle_;
};

// A reconstructed lumen.
class Lumen {
public:
    explicit Lumen(const Recording &recording) { run(recording, nullptr); }
    Lumen(const Recording &recording, const Settings &settings) { run(recording, settings.get()); }
    // progress(stage, done, total) is called from any thread, and from several at once; false ends the reconstruction with
    // an Error of status LUMENMESH_STATUS_CANCELLED. What it throws has the same effect.
    using Progress = std::function<bool(const char *stage, std::size_t done, std::size_t total)>;
    Lumen(const Recording &recording, const Settings &settings, const Progress &progress) {
        const auto call = [](const char *stage, std::size_t done, std::size_t total, void *data) -> std::int32_t {
            try {
                return (*static_cast<const Progress *>(data))(stage, done, total) ? 0 : 1;
            } catch (...) {
                return 1;
            }
        };
        detail::check(lumenmesh_reconstruct_with(recording.get(), settings.get(), call,
                                                 const_cast<Progress *>(&progress), handle_.out()));
    }

    Mesh mesh() const {
        Mesh mesh;
        detail::check(lumenmesh_lumen_mesh(handle_.get(), mesh.handle_.out()));
        return mesh;
    }
    // Settings, frames that were left out and why, and the method's numbers, as JSON.
    std::string report() const {
        return detail::text([this](char *to, std::size_t size, std::size_t *length) {
            return lumenmesh_lumen_report(handle_.get(), to, size, length);
        });
    }

private:
    friend class Live;
    Lumen() = default;

    void run(const Recording &recording, const LumenmeshSettings *settings) {
        detail::check(lumenmesh_reconstruct(recording.get(), settings, handle_.out()));
    }

    detail::Handle<LumenmeshLumen, lumenmesh_lumen_free> handle_;
};

// A vessel that grows frame by frame.
class Live {
public:
    Live() { detail::check(lumenmesh_live_new(nullptr, handle_.out())); }
    explicit Live(const Settings &settings) { detail::check(lumenmesh_live_new(settings.get(), handle_.out())); }

    // A vessel as it was when snapshot() wrote the file.
    static Live restore(const std::string &path) {
        Live live{nullptr};
        detail::check(lumenmesh_live_restore(path.c_str(), live.handle_.out()));
        return live;
    }
    void snapshot(const std::string &path) const {
        detail::check(lumenmesh_live_snapshot(handle_.get(), path.c_str()));
    }
    // Keeps all frames from now on for finish(); before the first one.
    void keep_frames() { detail::check(lumenmesh_live_keep_frames(handle_.get())); }
    // The lumen of all frames at once.
    Lumen finish() const {
        Lumen lumen;
        detail::check(lumenmesh_live_finish(handle_.get(), lumen.handle_.out()));
        return lumen;
    }

    LumenmeshChange push(const Frame &frame) {
        const double *contour = frame.contour_mm.empty() ? nullptr : frame.contour_mm.front().data();
        LumenmeshChange change{};
        detail::check(lumenmesh_live_push(handle_.get(), frame.world_from_sensor.data(), frame.contour_mm.size(), contour,
                                          frame.time_s, &change));
        changed_ = change.changed;
        return change;
    }
    // After the last frame.
    LumenmeshChange flush() {
        LumenmeshChange change{};
        detail::check(lumenmesh_live_flush(handle_.get(), &change));
        changed_ = change.changed;
        return change;
    }
    void reset() {
        detail::check(lumenmesh_live_reset(handle_.get()));
        changed_ = 0;
    }
    // Ranges of rings that the last frame changed: the first, and the one after the last.
    std::vector<std::array<std::size_t, 2>> changed() const {
        std::vector<std::array<std::size_t, 2>> to(changed_);
        detail::check(lumenmesh_live_changed(handle_.get(), to.empty() ? nullptr : to.front().data(), 2 * to.size()));
        return to;
    }
    // Frames that were found unfit with the last one, and why, as a JSON array.
    std::string left_out() const {
        return detail::text([this](char *to, std::size_t size, std::size_t *length) {
            return lumenmesh_live_left_out(handle_.get(), to, size, length);
        });
    }
    // Where frames are computed, and why there, as a JSON object; "null" before the first cylinder.
    std::string engine() const {
        return detail::text([this](char *to, std::size_t size, std::size_t *length) {
            return lumenmesh_live_engine(handle_.get(), to, size, length);
        });
    }
    Mesh surface() const {
        Mesh mesh;
        detail::check(lumenmesh_live_surface(handle_.get(), mesh.handle_.out()));
        return mesh;
    }
    Mesh part(std::size_t first, std::size_t end) const {
        Mesh mesh;
        detail::check(lumenmesh_live_part(handle_.get(), first, end, mesh.handle_.out()));
        return mesh;
    }

private:
    explicit Live(std::nullptr_t) {}

    detail::Handle<LumenmeshLive, lumenmesh_live_free> handle_;
    std::size_t changed_ = 0;
};

} // namespace lumenmesh

#endif
