// A stencil and its couplings on the way up a column of a tile.

// From the row below a first one, whose place is given: what the first step up needs.
fn stencil_below(place: u32) -> Stencil {
    let below = place - TILE_COLUMNS;
    var s: Stencil;
    s.below = cells[below - TILE_COLUMNS];
    s.before = cells[below - 1u];
    s.here = cells[below];
    s.next = cells[below + 1u];
    s.above_before = cells[place - 1u];
    s.above = cells[place];
    s.above_next = cells[place + 1u];
    s.above_but_one = cells[place + TILE_COLUMNS];
    return s;
}

// The stencil one row on, at a place.
fn climbed(s: Stencil, place: u32) -> Stencil {
    let above = place + TILE_COLUMNS;
    return Stencil(
        s.below,
        s.before,
        s.here,
        s.next,
        cells[place - 2u],
        s.above_before,
        s.above,
        s.above_next,
        cells[place + 2u],
        cells[above - 1u],
        s.above_but_one,
        cells[above + 1u],
        cells[above + TILE_COLUMNS],
    );
}
