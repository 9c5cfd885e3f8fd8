// What `bin`, the prefix sums and `scatter` do, at once by one workgroup, where there are few points and faces: the faces'
// numbers of points, where each face's points begin, the list of faces that are not short, and the points in the order
// of their faces.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
// r of all slots, then θ, then z.
@group(0) @binding(1) var<storage, read> section: array<f32>;
@group(0) @binding(2) var<storage, read> owners: array<u32>;
@group(0) @binding(3) var<storage, read_write> offsets: array<u32>;
@group(0) @binding(4) var<storage, read_write> listed_faces: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read_write> grouped: array<vec4u>;

// Invocations, 256 or more.
override THREADS: u32 = 256u;

// Points per face; then the place of each face's next point.
var<workgroup> places: array<atomic<u32>, 1024>;

// The faces of four points of an invocation.
fn four_faces(slot: u32) -> vec4u {
    return vec4u(
        face_of(slot),
        face_of(slot + THREADS),
        face_of(slot + 2u * THREADS),
        face_of(slot + 3u * THREADS),
    );
}

fn count(face: u32) {
    if (face != NONE) {
        atomicAdd(&places[face], 1u);
    }
}

fn put(slot: u32, face: u32) {
    if (face != NONE) {
        grouped[atomicAdd(&places[face], 1u)] = grouped_point(slot, face);
    }
}

@compute @workgroup_size(THREADS)
fn main(@builtin(local_invocation_index) local: u32) {
    let all_faces = parameters.cylinders * parameters.faces;
    for (var face = local; face < 1024u; face += THREADS) {
        atomicStore(&places[face], 0u);
    }
    if (local < FIRST_LISTED) {
        atomicStore(&listed_faces[local], 0u);
    }
    storageBarrier();
    workgroupBarrier();
    for (var slot = local; slot < parameters.slots; slot += 4u * THREADS) {
        let faces = four_faces(slot);
        count(faces.x);
        count(faces.y);
        count(faces.z);
        count(faces.w);
    }
    workgroupBarrier();
    let first = 4u * local;
    var own = vec4u(0u);
    if (local < 256u) {
        for (var i = 0u; i < 4u; i++) {
            own[i] = atomicLoad(&places[first + i]);
        }
    }
    let sum = own.x + own.y + own.z + own.w;
    var before = inclusive_scan(sum, local) - sum;
    if (local < 256u) {
        for (var i = 0u; i < 4u; i++) {
            if (first + i < all_faces) {
                offsets[first + i] = before;
                atomicStore(&places[first + i], before);
                list_face(first + i, own[i]);
                before += own[i];
                if (first + i + 1u == all_faces) {
                    offsets[all_faces] = before;
                }
            }
        }
    }
    workgroupBarrier();
    for (var slot = local; slot < parameters.slots; slot += 4u * THREADS) {
        let faces = four_faces(slot);
        put(slot, faces.x);
        put(slot + THREADS, faces.y);
        put(slot + 2u * THREADS, faces.z);
        put(slot + 3u * THREADS, faces.w);
    }
}
