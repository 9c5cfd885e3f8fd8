/* A vessel that grows frame by frame: live MESH
 *
 * The catheter is simulated: it advances by 0.5 mm a frame in a straight vessel of 8 mm radius, with 60 rays. */
#include <lumenmesh.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { FRAMES = 120, RAYS = 60 };

static void check(LumenmeshStatus status) {
    if (status != LUMENMESH_STATUS_OK) {
        fprintf(stderr, "live: %s\n", lumenmesh_last_error());
        exit(1);
    }
}

int main(int argc, char **argv) {
    if (argc < 2) {
        fprintf(stderr, "usage: live MESH\n");
        return 2;
    }
    LumenmeshLive *live = NULL;
    check(lumenmesh_live_new(NULL, &live));

    size_t drawn = 0;
    for (int k = 0; k < FRAMES; k++) {
        /* Row by row; the probe looks along z, along which the catheter advances. */
        const double world_from_sensor[16] = {1, 0, 0, 0, /**/ 0, 1, 0, 0, /**/ 0, 0, 1, 0.5 * k, /**/ 0, 0, 0, 1};
        double contour_mm[2 * RAYS];
        for (int ray = 0; ray < RAYS; ray++) {
            const double angle = 6.283185307179586 * ray / RAYS;
            contour_mm[2 * ray] = 8 * cos(angle);
            contour_mm[2 * ray + 1] = 8 * sin(angle);
        }
        LumenmeshChange change;
        check(lumenmesh_live_push(live, world_from_sensor, RAYS, contour_mm, k / 30.0, &change));

        /* What changed, to the buffers of whoever shows it. */
        size_t *changed = malloc(2 * change.changed * sizeof *changed);
        if (change.changed && !changed) return 1;
        check(lumenmesh_live_changed(live, changed, 2 * change.changed));
        for (size_t range = 0; range < change.changed; range++) {
            LumenmeshMesh *part = NULL;
            size_t vertices = 0;
            check(lumenmesh_live_part(live, changed[2 * range], changed[2 * range + 1], &part));
            check(lumenmesh_mesh_sizes(part, &vertices, NULL, NULL));
            drawn += vertices;
            check(lumenmesh_mesh_free(part));
        }
        free(changed);
    }
    check(lumenmesh_live_flush(live, NULL));

    LumenmeshMesh *mesh = NULL;
    size_t vertices = 0;
    check(lumenmesh_live_surface(live, &mesh));
    check(lumenmesh_mesh_sizes(mesh, &vertices, NULL, NULL));
    check(lumenmesh_mesh_write(mesh, argv[1], NULL));
    printf("%zu vertices, %zu drawn in %d frames\n", vertices, drawn, (int)FRAMES);
    check(lumenmesh_mesh_free(mesh));
    check(lumenmesh_live_free(live));
    return 0;
}
