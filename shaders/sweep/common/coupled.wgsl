// The echoes' part of the matrix times a vector, at a node. The including shader binds the matrix as `rows`.

// The coefficients of a node: its own four, those with the next node and the next node above of the node before, that with
// the node above of the node below, and that with the next node above of the node before that one.
struct Couplings {
    here: vec4f,
    before: vec2f,
    below: f32,
    below_before: f32,
}

fn couplings_at(k: u32, at: Places, ring: u32) -> Couplings {
    var c = Couplings(rows[at.here], vec2f(rows[at.before].y, rows[at.before].w), 0.0, 0.0);
    if (k > 0u) {
        c.below = rows[at.here - ring].z;
        c.below_before = rows[at.before - ring].w;
    }
    return c;
}

fn coupled(level: Level, k: u32, c: Couplings, s: Stencil) -> f32 {
    var sum = c.here.x * s.here + c.here.y * s.next + c.before.x * s.before;
    if (k + 1u < level.rings) {
        sum += c.here.z * s.above;
        sum += c.here.w * s.above_next;
    }
    if (k > 0u) {
        sum += c.below * s.below;
        sum += c.below_before * s.below_before;
    }
    return sum;
}
