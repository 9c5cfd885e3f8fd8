#!/usr/bin/env python3
"""Poisson reconstruction of the same echoes, the yardstick of `cargo run --example accuracy`.

usage: poisson.py ECHOES MESH_FOLDER
       poisson.py --check                 # exit status 0 where Open3D is there

ECHOES: little-endian float64, six numbers an echo: its place and the centroid of its contour, mm. Normals: plane
through the nearest neighbours, pointing away from the contour's centroid. Screened Poisson (Open3D) at depths 6 to 9;
of each mesh, triangles with a node farther than 1 mm from every echo are cut off, which takes the caps away.
Writes depth_N.ply.
"""
import sys

NEIGHBOURS = 100
DEPTHS = range(6, 10)
WITHIN_MM = 1.0


def main(echoes, folder):
    import numpy as np
    import open3d as o3d

    places, centres = np.split(np.fromfile(echoes, "<f8").reshape(-1, 6), 2, axis=1)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(places))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(NEIGHBOURS))
    normals = np.asarray(cloud.normals)
    inward = np.sum(normals * (places - centres), axis=1) < 0
    normals[inward] *= -1
    cloud.normals = o3d.utility.Vector3dVector(normals)
    for depth in DEPTHS:
        mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=depth, n_threads=2)
        nodes = o3d.geometry.PointCloud(mesh.vertices)
        mesh.remove_vertices_by_mask(np.asarray(nodes.compute_point_cloud_distance(cloud)) > WITHIN_MM)
        mesh.remove_unreferenced_vertices()
        mesh.vertex_normals = o3d.utility.Vector3dVector()
        o3d.io.write_triangle_mesh(f"{folder}/depth_{depth}.ply", mesh)


if __name__ == "__main__":
    if sys.argv[1:] == ["--check"]:
        import numpy, open3d
    else:
        main(*sys.argv[1:])
