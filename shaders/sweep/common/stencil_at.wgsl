// The stencil at a node of ring k, in a vector where `ring` places lie from a ring to the next: the including shader defines
// it as `value`.

fn stencil_at(level: Level, k: u32, at: Places, ring: u32) -> Stencil {
    var s: Stencil;
    s.last_but_one = value(at.last_but_one);
    s.before = value(at.before);
    s.here = value(at.here);
    s.next = value(at.next);
    s.next_but_one = value(at.next_but_one);
    if (k >= 1u) {
        s.below_before = value(at.before - ring);
        s.below = value(at.here - ring);
        s.below_next = value(at.next - ring);
    }
    if (k >= 2u) {
        s.below_but_one = value(at.here - 2u * ring);
    }
    if (k + 1u < level.rings) {
        s.above_before = value(at.before + ring);
        s.above = value(at.here + ring);
        s.above_next = value(at.next + ring);
    }
    if (k + 2u < level.rings) {
        s.above_but_one = value(at.here + 2u * ring);
    }
    return s;
}
