//! The whole way from a recording to a vessel.

mod live;

pub use live::{Change, Live, Work};

use crate::Result;
use crate::cylinders::fit::engine;
use crate::cylinders::{Reconstruction, Report};
use crate::recording::Recording;
use crate::settings::{Method, Settings};
use crate::surface::Surface;
use crate::sweep::{self, Sweep};
use serde::Serialize;

/// The lumen of a recording, by the method that the settings name.
// One is made a recording: its size does not matter.
#[expect(clippy::large_enum_variant)]
#[derive(Debug, Clone)]
pub enum Lumen {
    /// Local cylinders, merged.
    Cylinders(Reconstruction),
    /// One tube along the centreline.
    Sweep(Sweep),
}

/// What was done, in numbers, by either method.
#[derive(Debug, Clone, Copy, Serialize)]
#[serde(untagged)]
pub enum LumenReport<'a> {
    /// By local cylinders.
    Cylinders(&'a Report),
    /// By one tube.
    Sweep(&'a sweep::SweepReport),
}

impl Lumen {
    /// Reconstructs the lumen of a recording, where and how the settings say. With `history`, cylinders keep their radii
    /// of every iteration; `progress` is told the number of cylinders that have become ready since its last call.
    ///
    /// # Errors
    /// As [`Reconstruction::new`] and [`Sweep::of`], and where there is no such device.
    pub fn of(
        recording: &Recording,
        settings: &Settings,
        history: bool,
        progress: &(dyn Fn(usize) + Sync),
    ) -> Result<Self> {
        match settings.method {
            Method::Cylinders => {
                let engine = engine(settings)?;
                Reconstruction::new(recording, settings, &*engine, history, progress).map(Self::Cylinders)
            }
            Method::Sweep => Sweep::of(recording, settings).map(Self::Sweep),
        }
    }

    /// The lumen as a triangle surface; of a sweep without what no echo supports, unless the settings keep that.
    pub fn surface(&self, settings: &Settings) -> Surface {
        match self {
            Self::Cylinders(reconstruction) => reconstruction.vessel.surface(),
            Self::Sweep(sweep) => sweep.surface(settings.sweep.keep_unsupported),
        }
    }

    /// What was done, in numbers.
    pub fn report(&self) -> LumenReport<'_> {
        match self {
            Self::Cylinders(reconstruction) => LumenReport::Cylinders(&reconstruction.report),
            Self::Sweep(sweep) => LumenReport::Sweep(&sweep.report),
        }
    }
}
