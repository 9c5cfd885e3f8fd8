//! What everyone who follows the vessel is told.

use crate::Result;
use crate::reconstruction::{Change, Live};
use crate::recording::Frame;
use crate::surface::Surface;

/// A frame that was taken, or the end of the waiting for frames, and what it changed.
pub(crate) struct Update<'a> {
    /// The vessel.
    pub live: &'a Live,
    /// What changed.
    pub change: &'a Change,
    /// The frame in this project's conventions; `None` at the end of the waiting.
    pub frame: Option<&'a Frame>,
    /// Its number.
    pub number: usize,
}

/// How it ended.
pub(crate) struct End<'a> {
    /// The final mesh, where there is one.
    pub mesh: Option<&'a Surface>,
    /// Whether that is of all frames at once, rather than the vessel that grew.
    pub is_finished: bool,
    /// For people.
    pub text: &'a str,
}

/// Somebody who follows the vessel. None of its functions waits for anyone: what is slow has its own thread.
pub(crate) trait Sink {
    /// Takes an update.
    ///
    /// # Errors
    /// What went wrong since the last time. The run goes on.
    fn take(&mut self, update: &Update) -> Result<()>;

    /// Takes a remark for people.
    fn say(&mut self, _text: &str) {}

    /// No frame will follow. Frames that jump off the path still wait.
    ///
    /// # Errors
    /// As [`take`](Self::take).
    fn last_frame(&mut self, _live: &Live) -> Result<()> {
        Ok(())
    }

    /// Takes the end.
    fn end(&mut self, _end: &End) {}
}
