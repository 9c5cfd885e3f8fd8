// Values of triangles, those without points filled from their edge neighbours. Twin: cylinders/passes/fill.rs.

// A triangle's value from its word; 0 without points.
fn value_of(word: u32) -> f32 {
    return select(0.0, bitcast<f32>(~word), word != NO_VALUE);
}

fn mean_of_neighbours(first: f32, second: f32, third: f32, has_third: bool) -> f32 {
    if (has_third) {
        return (first + second + third) / 3.0;
    }
    return (first + second) / 2.0;
}

// The value of a bottom triangle from its own word, or without points from the values of its neighbours: the top
// triangles of its face, of the next one and of the one below. They count 0 without points.
fn bottom_value(own: u32, same: f32, next: f32, below: f32, has_below: bool) -> f32 {
    if (own != NO_VALUE) {
        return value_of(own);
    }
    return mean_of_neighbours(same, next, below, has_below);
}

// The value of a top triangle from its own word, or without points from the values of its neighbours, as filled:
// the bottom triangles of its face, of the previous one and of the one above.
fn top_value(own: u32, same: f32, previous: f32, above: f32, has_above: bool) -> f32 {
    if (own != NO_VALUE) {
        return value_of(own);
    }
    return mean_of_neighbours(same, previous, above, has_above);
}
