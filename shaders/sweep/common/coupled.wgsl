// The echoes' couplings times `value`, which whoever includes it says what is; so is `rows`.

fn coupled(k: u32, j: u32) -> f32 {
    let row = k * job.nodes;
    let next = select(j + 1u, 0u, j + 1u == job.nodes);
    let before = select(j, job.nodes, j == 0u) - 1u;
    let here = rows[row + j];
    var sum = here.x * value(row + j) + here.y * value(row + next) + rows[row + before].y * value(row + before);
    if (k + 1u < job.rings) {
        let above = row + job.nodes;
        sum += here.z * value(above + j);
        sum += here.w * value(above + next);
    }
    if (k > 0u) {
        let below = row - job.nodes;
        sum += rows[below + j].z * value(below + j);
        sum += rows[below + before].w * value(below + before);
    }
    return sum;
}
