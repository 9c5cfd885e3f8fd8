//! The tiles of a grid that workgroups hold in their memory (`shaders/sweep/common/tile.wgsl`): here they are the order of
//! sums.

use super::{Level, WallParameters, sum_of_workgroup};

/// Rings of a tile …
pub const TILE_RINGS: u32 = 22;
/// … and of a low one, of a grid with …
pub const LOW_TILE_RINGS: u32 = 8;
/// … fewer nodes than these: margins cost less than workgroups that a device has no work for.
pub const MANY_NODES: u32 = 1 << 18;
/// Nodes of a row of a tile, margins included: four invocations go up each column, a quarter of the rows each.
pub const TILE_COLUMNS: u32 = 64;
/// Without the margins of `descend`, those of `ascend` and those of `apply`.
pub const DESCEND_COLUMNS: u32 = TILE_COLUMNS - 10;
/// See [`DESCEND_COLUMNS`].
pub const ASCEND_COLUMNS: u32 = TILE_COLUMNS - 8;
/// See [`DESCEND_COLUMNS`].
pub const APPLY_COLUMNS: u32 = TILE_COLUMNS - 4;

/// The rings of a grid's tiles.
fn tile_rings(parameters: &WallParameters, level: &Level) -> u32 {
    if parameters.low_tiles != 0 && level.count < MANY_NODES { LOW_TILE_RINGS } else { TILE_RINGS }
}

/// The number of tiles of a grid with that many columns.
pub fn tile_count(parameters: &WallParameters, level: &Level, columns: u32) -> u32 {
    level.nodes.div_ceil(columns) * level.rings.div_ceil(tile_rings(parameters, level))
}

/// The sum over the nodes of each tile with equal margins to all sides.
pub(super) fn tile_sums(
    parameters: &WallParameters,
    level: &Level,
    columns: u32,
    addend: impl Fn(usize) -> f32,
) -> Vec<f32> {
    let rings = tile_rings(parameters, level);
    let across = level.nodes.div_ceil(columns);
    let margin = (TILE_COLUMNS - columns) / 2;
    (0..tile_count(parameters, level, columns))
        .map(|index| {
            let (ring, node) = (rings * (index / across), columns * (index % across));
            let mut own = [0.0; 256];
            for row in 0..rings.min(level.rings - ring) {
                for column in 0..columns.min(level.nodes - node) {
                    let invocation = row / rings.div_ceil(4) * TILE_COLUMNS + margin + column;
                    own[invocation as usize] += addend(((ring + row) * level.nodes + node + column) as usize);
                }
            }
            sum_of_workgroup(&mut own)
        })
        .collect()
}
