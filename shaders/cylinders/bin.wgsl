// The face of each point, and its place among the points of that face. The place depends on the order in
// which invocations run; no later result depends on the place.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
// r of all slots, then θ, then z.
@group(0) @binding(1) var<storage, read> section: array<f32>;
@group(0) @binding(2) var<storage, read> owners: array<u32>;
// Points per face.
@group(0) @binding(3) var<storage, read_write> counts: array<atomic<u32>>;
// The faces of all slots (NONE where the point did not pass the gate), then their places.
@group(0) @binding(4) var<storage, read_write> places: array<u32>;

// 1: at most 1024 faces in the batch, for which a workgroup counts its own points first: a million atomic
// additions to the same sixty words take longer than all else.
override FEW: u32 = 0u;

var<workgroup> own_counts: array<atomic<u32>, 1024>;

fn place_of_all(face: u32) -> u32 {
    if (face == NONE) {
        return 0u;
    }
    return atomicAdd(&counts[face], 1u);
}

fn place_of_own(face: u32) -> u32 {
    if (face == NONE) {
        return 0u;
    }
    return atomicAdd(&own_counts[face], 1u);
}

fn write(slot: u32, face: u32, place: u32) {
    if (slot < parameters.slots) {
        places[slot] = face;
        places[parameters.slots + slot] = place;
    }
}

fn write_behind(slot: u32, face: u32, place: u32) {
    if (face == NONE) {
        write(slot, face, 0u);
    } else {
        write(slot, face, atomicLoad(&own_counts[face]) + place);
    }
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let slot = workgroup_index(group, groups) * 1024u + local;
    let face_0 = face_of(slot);
    let face_1 = face_of(slot + 256u);
    let face_2 = face_of(slot + 512u);
    let face_3 = face_of(slot + 768u);
    let all_faces = parameters.cylinders * parameters.faces;
    if (FEW == 0u) {
        write(slot, face_0, place_of_all(face_0));
        write(slot + 256u, face_1, place_of_all(face_1));
        write(slot + 512u, face_2, place_of_all(face_2));
        write(slot + 768u, face_3, place_of_all(face_3));
        return;
    }
    for (var face = local; face < all_faces; face += 256u) {
        atomicStore(&own_counts[face], 0u);
    }
    workgroupBarrier();
    let place_0 = place_of_own(face_0);
    let place_1 = place_of_own(face_1);
    let place_2 = place_of_own(face_2);
    let place_3 = place_of_own(face_3);
    workgroupBarrier();
    for (var face = local; face < all_faces; face += 256u) {
        let own = atomicLoad(&own_counts[face]);
        if (own > 0u) {
            atomicStore(&own_counts[face], atomicAdd(&counts[face], own));
        }
    }
    workgroupBarrier();
    write_behind(slot, face_0, place_0);
    write_behind(slot + 256u, face_1, place_1);
    write_behind(slot + 512u, face_2, place_2);
    write_behind(slot + 768u, face_3, place_3);
}
