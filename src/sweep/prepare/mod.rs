//! From contours and poses to the axis that the wall is swept along.

pub(in crate::sweep) mod axis;
pub(in crate::sweep) mod centreline;
pub(in crate::sweep) mod contour;
