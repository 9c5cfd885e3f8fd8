/* From a recording to a mesh: batch RECORDING MESH [TRUTH] */
#include <lumenmesh.h>
#include <stdio.h>
#include <stdlib.h>

/* Ends the program with the library's message where a call fails. */
static void check(LumenmeshStatus status) {
    if (status != LUMENMESH_STATUS_OK) {
        fprintf(stderr, "batch: %s\n", lumenmesh_last_error());
        exit(1);
    }
}

int main(int argc, char **argv) {
    if (argc < 3) {
        fprintf(stderr, "usage: batch RECORDING MESH [TRUTH]\n");
        return 2;
    }
    if (lumenmesh_abi_version() != LUMENMESH_ABI_VERSION) {
        fprintf(stderr, "batch: compiled for another version of the library\n");
        return 1;
    }

    LumenmeshSettings *settings = NULL;
    check(lumenmesh_settings_new(&settings));
    check(lumenmesh_settings_set(settings, "backend", "cpu"));

    LumenmeshRecording *recording = NULL;
    LumenmeshLumen *lumen = NULL;
    LumenmeshMesh *mesh = NULL;
    check(lumenmesh_recording_read(argv[1], &recording));
    check(lumenmesh_reconstruct(recording, settings, &lumen));
    check(lumenmesh_lumen_mesh(lumen, &mesh));
    check(lumenmesh_mesh_write(mesh, argv[2], NULL));

    /* Sizes first, then copies into buffers of one's own. */
    size_t vertices = 0, triangles = 0;
    check(lumenmesh_mesh_sizes(mesh, &vertices, &triangles, NULL));
    double *vertices_mm = malloc(3 * vertices * sizeof *vertices_mm);
    uint32_t *indices = malloc(3 * triangles * sizeof *indices);
    double *support = malloc(vertices * sizeof *support);
    if (!vertices_mm || !indices || !support) return 1;
    check(lumenmesh_mesh_copy_vertices(mesh, vertices_mm, 3 * vertices));
    check(lumenmesh_mesh_copy_triangles(mesh, indices, 3 * triangles));
    check(lumenmesh_mesh_copy_array(mesh, "support", support, vertices));
    printf("%zu vertices, %zu triangles; %g points behind the first vertex\n", vertices, triangles, support[0]);

    if (argc > 3) {
        LumenmeshMesh *truth = NULL;
        double mean_mm = 0;
        check(lumenmesh_mesh_read(argv[3], &truth));
        check(lumenmesh_evaluate(mesh, truth, &mean_mm, NULL, 0, NULL));
        printf("fitting error %.4f mm\n", mean_mm);
        check(lumenmesh_mesh_free(truth));
    }

    free(vertices_mm);
    free(indices);
    free(support);
    check(lumenmesh_mesh_free(mesh));
    check(lumenmesh_lumen_free(lumen));
    check(lumenmesh_recording_free(recording));
    check(lumenmesh_settings_free(settings));
    return 0;
}
