// Lists a face that is not short, in no particular order. The including shader binds `listed_faces`.

fn list_face(face: u32, points: u32) {
    if (points > parameters.max_narrow) {
        let index = atomicAdd(&listed_faces[LONG_COUNT], 1u);
        atomicStore(&listed_faces[FIRST_LISTED + index], face);
    } else if (points > parameters.max_middle) {
        let index = atomicAdd(&listed_faces[NARROW_COUNT], 1u);
        atomicStore(&listed_faces[FIRST_LISTED + parameters.most_long + index], face);
    } else if (points > parameters.max_short) {
        let index = atomicAdd(&listed_faces[MIDDLE_COUNT], 1u);
        atomicStore(&listed_faces[arrayLength(&listed_faces) - 1u - index], face);
    }
}
