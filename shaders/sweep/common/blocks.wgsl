// The rings in blocks (nested dissection). The first two rings of every block but the first are separators,
// the other rings are interiors.

// Planes of the factors.
const INVERSE: u32 = 0u;
const NEXT: u32 = 1u;
const NEXT_BUT_ONE: u32 = 2u;
const FIRST_SEPARATOR: u32 = 3u;
const SECOND_SEPARATOR: u32 = 4u;

fn frequency_count() -> u32 {
    return parameters.nodes / 2u + 1u;
}

// Coefficients c and N - c of a Hartley transform are of one frequency.
fn frequency_of(coefficient: u32) -> u32 {
    return min(coefficient, parameters.nodes - coefficient);
}

fn factor_index(part: u32, ring: u32, frequency: u32) -> u32 {
    return (part * parameters.rings + ring) * frequency_count() + frequency;
}

fn first_interior(block: u32) -> u32 {
    return block * parameters.block_rings + select(2u, 0u, block == 0u);
}

fn end_of_interior(block: u32) -> u32 {
    return select((block + 1u) * parameters.block_rings, parameters.rings, block + 1u == parameters.blocks);
}
