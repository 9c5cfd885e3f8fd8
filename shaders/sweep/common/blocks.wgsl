// The rings in blocks: the first two of each but the first block are joints, the others its inside. Twin:
// sweep/passes/blocks.rs.

// Parts of a row's factors.
const INVERSE: u32 = 0u;
const NEXT: u32 = 1u;
const NEXT_BUT_ONE: u32 = 2u;
const FIRST_JOINT: u32 = 3u;
const SECOND_JOINT: u32 = 4u;

fn frequency_count() -> u32 {
    return job.nodes / 2u + 1u;
}

// Coefficients c and N - c of a Hartley transform are of one frequency.
fn frequency_of(coefficient: u32) -> u32 {
    return min(coefficient, job.nodes - coefficient);
}

fn factor_index(part: u32, ring: u32, frequency: u32) -> u32 {
    return (part * job.rings + ring) * frequency_count() + frequency;
}

fn first_inside(block: u32) -> u32 {
    return block * job.block_rings + select(2u, 0u, block == 0u);
}

fn end_of(block: u32) -> u32 {
    return select((block + 1u) * job.block_rings, job.rings, block + 1u == job.blocks);
}
