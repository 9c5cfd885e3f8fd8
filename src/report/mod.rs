//! What a person looks at: pictures of meshes.

pub mod render;
