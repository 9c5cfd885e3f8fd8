// Tiles of a grid in workgroup memory, `cells`: each of 256 invocations goes up a quarter of a column, one row after the
// other, so that it reads most values only once. About a tile there are margins, since what is computed in it depends on
// nodes beyond it; about the axis they go on around it.

struct Tile {
    // The ring and the node at its first row and column.
    ring: u32,
    node: u32,
    // Rows and columns of the margins before them.
    low: u32,
    // The first column behind it.
    end: u32,
}

// The rows of a tile.
fn tile_rings(level: Level) -> u32 {
    return select(TILE_RINGS, LOW_TILE_RINGS, parameters.low_tiles != 0u && level.count < MANY_NODES);
}

// The number of tiles with that many columns.
fn tile_count(level: Level, columns: u32) -> u32 {
    let rings = tile_rings(level);
    return ((level.nodes + columns - 1u) / columns) * ((level.rings + rings - 1u) / rings);
}

fn tile_of(level: Level, index: u32, columns: u32, low: u32) -> Tile {
    let across = (level.nodes + columns - 1u) / columns;
    let ring = tile_rings(level) * (index / across);
    let node = columns * (index % across);
    return Tile(ring, node, low, low + min(columns, level.nodes - node));
}

// The node of a column, margins included.
fn node_of(level: Level, tile: Tile, column: u32) -> u32 {
    return (tile.node + column + tile.low * (level.nodes - 1u)) % level.nodes;
}

// The ring of a row, margins included: beyond the rings of the grid where there is none.
fn ring_of(tile: Tile, row: u32) -> u32 {
    return tile.ring + row - tile.low;
}
