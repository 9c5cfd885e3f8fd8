// The angle of (x, y) in [0, 2π); 0 at the origin. Twin: numerics/angle.rs, which also supplies the
// coefficients.

fn angle(y: f32, x: f32) -> f32 {
    let ax = abs(x);
    let ay = abs(y);
    let steep = ay > ax;
    let small = select(ay, ax, steep);
    let large = select(ax, ay, steep);
    let t = small / select(1.0, large, large > 0.0);
    let s = t * t;
    var p = ANGLE_8;
    p = p * s + ANGLE_7;
    p = p * s + ANGLE_6;
    p = p * s + ANGLE_5;
    p = p * s + ANGLE_4;
    p = p * s + ANGLE_3;
    p = p * s + ANGLE_2;
    p = p * s + ANGLE_1;
    p = p * s + ANGLE_0;
    let octant = t + t * s * p;
    let quadrant = select(octant, ANGLE_HALF_PI - octant, steep);
    let half = select(quadrant, ANGLE_PI - quadrant, x < 0.0);
    let full = select(half, ANGLE_TAU - half, y < 0.0);
    return select(full, 0.0, full >= ANGLE_TAU);
}
