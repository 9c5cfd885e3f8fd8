//! What is wrong, or may be, with the frames of a recording.

use super::Recording;
use serde::Serialize;
use std::fmt;

/// One kind of defect, or of something suspicious, and where it occurs.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Finding {
    /// The quantity.
    pub field: &'static str,
    /// What it should be.
    pub expected: String,
    /// Whether [`Recording::check`](super::Recording::check) refuses it; else it is suspicious only.
    pub fatal: bool,
    /// How many frames have it; 0 where it is about the recording as a whole.
    pub frames: usize,
    /// Of so many.
    pub of: usize,
    /// The first of them, at most [`Finding::MAX_EXAMPLES`] runs of frames, or the recording's one.
    pub examples: Vec<Example>,
    /// The option of the command that mends it, where one may.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub remedy: Option<String>,
}

/// One occurrence of a finding.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Example {
    /// The frame's [number](Recording::number); `None`: the recording as a whole.
    pub frame: Option<usize>,
    /// The last one of successive frames in which the same was found.
    pub last_frame: Option<usize>,
    /// How many these are; 0: the recording as a whole.
    pub frames: usize,
    /// What was there.
    pub found: String,
}

impl Finding {
    /// Runs of frames listed per finding.
    pub const MAX_EXAMPLES: usize = 10;
}

/// Findings, one entry per quantity and expectation.
pub(super) struct Findings {
    pub list: Vec<Finding>,
    /// Frames of the recording.
    of: usize,
}

/// Successive frames, by their first and last numbers.
pub(crate) fn frames_named(first: usize, last: usize) -> String {
    if first == last { format!("frame {first}") } else { format!("frames {first} to {last}") }
}

impl Findings {
    pub fn new(of: usize) -> Self {
        Self { list: Vec::new(), of }
    }

    /// Adds what was found in the frame at a place.
    pub fn add(&mut self, field: &'static str, expected: String, fatal: bool, place: usize, found: String) {
        let at =
            self.list.iter().position(|d| d.field == field && d.expected == expected).unwrap_or_else(|| {
                self.list.push(Finding {
                    field,
                    expected,
                    fatal,
                    frames: 0,
                    of: self.of,
                    examples: Vec::new(),
                    remedy: None,
                });
                self.list.len() - 1
            });
        let finding = &mut self.list[at];
        finding.frames += 1;
        let has_room = finding.examples.len() < Finding::MAX_EXAMPLES;
        let last = finding.examples.last_mut();
        let is_next =
            |run: &&mut Example| run.found == found && run.last_frame.is_some_and(|last| last + 1 == place);
        if let Some(run) = last.filter(is_next) {
            (run.last_frame, run.frames) = (Some(place), run.frames + 1);
        } else if has_room {
            let frame = Some(place);
            finding.examples.push(Example { frame, last_frame: frame, frames: 1, found });
        }
    }

    /// The findings, with frames by their [numbers](Recording::number) instead of their places.
    pub fn named(mut self, recording: &Recording) -> Vec<Finding> {
        for example in self.list.iter_mut().flat_map(|finding| &mut finding.examples) {
            for place in [&mut example.frame, &mut example.last_frame].into_iter().flatten() {
                *place = recording.number(*place);
            }
        }
        self.list
    }

    /// Adds what was found in the recording as a whole.
    pub fn add_whole(
        &mut self,
        field: &'static str,
        expected: impl Into<String>,
        fatal: bool,
        found: String,
        remedy: Option<String>,
    ) {
        let examples = vec![Example { frame: None, last_frame: None, frames: 0, found }];
        self.list.push(Finding {
            field,
            expected: expected.into(),
            fatal,
            frames: 0,
            of: self.of,
            examples,
            remedy,
        });
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = if self.fatal { "DEFECT" } else { "SUSPICIOUS" };
        write!(f, "{kind}: {}", self.field)?;
        if self.frames > 0 {
            write!(f, " in {} of {} frames", self.frames, self.of)?;
        }
        writeln!(f, ", expected {}", self.expected)?;
        for Example { frame, last_frame, found, .. } in &self.examples {
            match frame.zip(*last_frame) {
                Some((first, last)) => writeln!(f, "  {}: {found}", frames_named(first, last))?,
                None => writeln!(f, "  {found}")?,
            }
        }
        let listed: usize = self.examples.iter().map(|example| example.frames).sum();
        if self.frames > listed {
            writeln!(f, "  and {} more", self.frames - listed)?;
        }
        if let Some(remedy) = &self.remedy {
            writeln!(f, "  if so: {remedy}")?;
        }
        Ok(())
    }
}
