//! How far a mesh is from the truth.
