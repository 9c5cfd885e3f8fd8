//! What is measured of a vessel by itself: its axis, sections across it, stenoses and aneurysms.

mod axis;
mod compare;
mod file;
mod find;
mod lesions;
mod sections;
mod uncertainty;

pub use axis::VesselAxis;
pub use compare::{AreaPair, Overlap};
pub use file::check_axis_ending;
pub use find::VesselTree;
pub use lesions::{Interval, Lesion, LesionKind, LesionRules, Profile};
pub use sections::{LumenSection, Measures, Sections, places, read_values};
