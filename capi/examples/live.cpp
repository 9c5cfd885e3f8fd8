// A vessel that grows frame by frame: live MESH
//
// The catheter is simulated: it advances by 0.5 mm a frame in a straight vessel of 8 mm radius, with 60 rays.
#include <lumenmesh.hpp>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <string>

static lumenmesh::Frame frame(int k) {
    lumenmesh::Frame frame;
    // Row by row; the probe looks along z, along which the catheter advances.
    frame.world_from_sensor = {1, 0, 0, 0, /**/ 0, 1, 0, 0, /**/ 0, 0, 1, 0.5 * k, /**/ 0, 0, 0, 1};
    frame.time_s = k / 30.0;
    for (int ray = 0; ray < 60; ray++) {
        const double angle = 6.283185307179586 * ray / 60;
        frame.contour_mm.push_back({8 * std::cos(angle), 8 * std::sin(angle)});
    }
    return frame;
}

int main(int argc, char **argv) try {
    if (argc < 2) {
        std::fprintf(stderr, "usage: live MESH\n");
        return 2;
    }
    lumenmesh::Live live;
    live.keep_frames();
    const std::string state = std::string(argv[1]) + ".state";
    std::size_t drawn = 0;
    double longest_ms = 0;
    for (int k = 0; k < 120; k++) {
        const auto before = std::chrono::steady_clock::now();
        live.push(frame(k));
        const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - before;
        longest_ms = std::max(longest_ms, took.count());
        // What changed, to the buffers of whoever shows it.
        for (const auto &[first, end] : live.changed()) drawn += live.part(first, end).vertices_mm().size();
        if (k == 60) {
            // A host that ends here and is started again goes on where it was.
            live.snapshot(state);
            live = lumenmesh::Live::restore(state);
            std::remove(state.c_str());
        }
    }
    live.flush();
    const lumenmesh::Mesh mesh = live.surface();
    mesh.write(argv[1]);
    std::printf("%zu vertices, %zu drawn in 120 frames\n", mesh.vertices_mm().size(), drawn);
    // All frames at once are more accurate than one by one.
    const lumenmesh::Mesh batch = live.finish().mesh();
    std::fprintf(stderr, "%zu vertices from all frames at once\n", batch.vertices_mm().size());
    std::fprintf(stderr, "the longest frame took %.2f ms\n", longest_ms);
    return 0;
} catch (const lumenmesh::Error &error) {
    std::fprintf(stderr, "live: %s\n", error.what());
    return 1;
}
