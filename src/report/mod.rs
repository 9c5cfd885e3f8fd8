//! What a person looks at: pictures of meshes, plots, and pages of both.

mod page;
pub mod plot;
pub mod render;

pub use page::Table;
