// Values of triangles, those without points filled from their edge neighbours. Twin: cylinders/passes/fill.rs.

fn mean_of_neighbours(first: f32, second: f32, third: f32, has_third: bool) -> f32 {
    if (has_third) {
        return (first + second + third) / 3.0;
    }
    return (first + second) / 2.0;
}

// The value of a bottom triangle from its own statistic, or without points from those of its neighbours: the
// top triangles of its face, of the next one and of the one below. They count 0 without points.
fn bottom_value(own: TriangleStatistic, same: f32, next: f32, below: f32, has_below: bool) -> f32 {
    return select(mean_of_neighbours(same, next, below, has_below), own.value, own.kept > 0u);
}

// The value of a top triangle from its own statistic, or without points from the values of its neighbours, as
// filled: the bottom triangles of its face, of the previous one and of the one above.
fn top_value(own: TriangleStatistic, same: f32, previous: f32, above: f32, has_above: bool) -> f32 {
    return select(mean_of_neighbours(same, previous, above, has_above), own.value, own.kept > 0u);
}
