// The echoes' part of the matrix times a vector, at a node. The including shader defines the vector as
// `value`, and binds the matrix as `rows`.

fn coupled(level: Level, k: u32, j: u32) -> f32 {
    let row = k * level.nodes;
    let next = select(j + 1u, 0u, j + 1u == level.nodes);
    let before = select(j, level.nodes, j == 0u) - 1u;
    let here = rows[row + j];
    var sum = here.x * value(row + j) + here.y * value(row + next) + rows[row + before].y * value(row + before);
    if (k + 1u < level.rings) {
        let above = row + level.nodes;
        sum += here.z * value(above + j);
        sum += here.w * value(above + next);
    }
    if (k > 0u) {
        let below = row - level.nodes;
        sum += rows[below + j].z * value(below + j);
        sum += rows[below + before].w * value(below + before);
    }
    return sum;
}
