//! What a person looks at: pictures of meshes, plots, and pages of both.

mod experiments;
mod page;
pub mod plot;
mod reconstruction;
pub mod render;
mod study;
mod sweep;

pub use experiments::{experiments_page, tables};
pub use page::Table;
pub use reconstruction::{Subject, html};
pub use study::study_plot;
