//! Merging cylinders into one vessel.
