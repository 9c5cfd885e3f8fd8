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
    /// The first of them, at most [`Finding::MAX_EXAMPLES`], or the recording's one.
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
    /// What was there.
    pub found: String,
}

impl Finding {
    /// Frames listed per finding.
    pub const MAX_EXAMPLES: usize = 10;
}

/// Findings, one entry per quantity and expectation.
pub(super) struct Findings {
    pub list: Vec<Finding>,
    /// Frames of the recording.
    of: usize,
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
        if finding.examples.len() < Finding::MAX_EXAMPLES {
            finding.examples.push(Example { frame: Some(place), found });
        }
    }

    /// The findings, with frames by their [numbers](Recording::number) instead of their places.
    pub fn named(mut self, recording: &Recording) -> Vec<Finding> {
        for example in self.list.iter_mut().flat_map(|finding| &mut finding.examples) {
            example.frame = example.frame.map(|place| recording.number(place));
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
        let examples = vec![Example { frame: None, found }];
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
        for example in &self.examples {
            match example.frame {
                Some(k) => writeln!(f, "  frame {k}: {}", example.found)?,
                None => writeln!(f, "  {}", example.found)?,
            }
        }
        if self.frames > self.examples.len() {
            writeln!(f, "  and {} more", self.frames - self.examples.len())?;
        }
        if let Some(remedy) = &self.remedy {
            writeln!(f, "  if so: {remedy}")?;
        }
        Ok(())
    }
}
