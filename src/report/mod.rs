//! Pictures of meshes, plots, and HTML pages of both.

mod anatomy;
mod branches;
mod cylinders;
mod experiments;
mod page;
pub mod plot;
mod reconstruction;
pub mod render;
mod rows;
mod study;
mod sweep;
mod viewer;

pub use anatomy::{Comparison, comparison_page};
pub use experiments::{experiments_page, tables};
pub use page::Table;
pub use reconstruction::{PageContent, html};
pub use study::study_plot;
pub use viewer::viewer_page;
#[cfg(feature = "cli")]
pub(crate) use viewer::{contour_of, floats, frame_of, live_page, vessel_of_mesh};
