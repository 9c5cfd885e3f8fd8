//! Which frames of a recording are fit to be used: they are judged before they become anatomy.

mod artefacts;
mod bursts;
mod chords;
mod cleaning;
mod hints;
mod live;
mod no_echo;
mod path;
mod probe;
mod repeats;
mod suspicions;

pub use artefacts::RingDown;
pub use chords::{Chords, FixedChord};
pub use cleaning::Cleaning;
pub(crate) use live::{Judged, LiveScreening};
pub use no_echo::NoEcho;

use super::finding::{Finding, frames_named};
use super::{Conventions, Frame, Recording};
use crate::geometry::Pose;
use crate::{Error, Result};
use path::Place;
use rayon::iter::Either;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// What is done with frames that a [`Screening`] finds unfit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum UnfitFrames {
    /// They are left out, and listed with the reason.
    #[default]
    LeaveOut,
    /// The recording is refused.
    Refuse,
    /// They are used, unless they have a [defect](crate::recording::Frame::defects): then the recording is refused.
    Keep,
}

/// The frames of a recording that a reconstruction leaves out, and why; points that stand for a missing echo; and what else
/// makes the recording suspicious.
///
/// A tracker that loses its sensor repeats a fixed pose, sends zeros or jumps; a recorder repeats images; a segmentation
/// follows the wrong border. A frame is left out for one of these [reasons](Reason). Those that lie off the path of the
/// others are found by dynamic programming: the path is the sequence of frames that maximises the number of its frames
/// less a price for each of its jumps, a step that is longer than the usual ones explain. So a lost frame or a short run
/// of them is left out, wherever it stands, whereas a sensor that is moved elsewhere and stays there is not. Bursts of wrong
/// contours show in abrupt changes of the outline, there and back; a shape that other passes of the catheter saw at the same
/// place is kept.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Screening {
    /// Frames of the recording.
    pub frames: usize,
    /// The frames that are left out, in their order.
    pub left_out: Vec<LeftOut>,
    /// What is done to the points of contours before.
    #[serde(flatten)]
    pub cleaning: Cleaning,
    /// What may be wrong with the recording as a whole, or with frames that are used all the same.
    pub suspicions: Vec<Finding>,
}

/// A frame that is left out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct LeftOut {
    /// The frame's place in the recording (0-based).
    pub place: usize,
    /// The frame's [number](Recording::number).
    pub frame: usize,
    /// The kind of reason.
    pub reason: Reason,
    /// The quantity that is to blame.
    pub field: &'static str,
    /// What was there.
    pub found: String,
    /// What should have been there.
    pub expected: String,
}

impl LeftOut {
    /// Runs of successive frames that are left out for the same reason.
    pub fn runs(left_out: &[Self]) -> Vec<&[Self]> {
        let are_alike =
            |a: &Self, b: &Self| a.frame + 1 == b.frame && a.reason == b.reason && a.field == b.field;
        left_out.chunk_by(are_alike).collect()
    }

    /// The frames of such a run, by name: `frame 4`, or `frames 4 to 6`; nothing of an empty one.
    pub fn frames_of(run: &[Self]) -> String {
        let ends = run.first().zip(run.last());
        ends.map_or_else(String::new, |(first, last)| frames_named(first.frame, last.frame))
    }
}

/// Why a frame is left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Reason {
    /// It has a [defect](super::Frame::defects), such as a pose that is not a number.
    Defect,
    /// Its pose is one that trackers send for a sensor that they have lost: at the origin.
    Lost,
    /// Its pose lies off the path of the others.
    OffPath,
    /// Its contour belongs to a few that have another size or shape than those just before and after.
    OffShape,
    /// The probe lies outside its contour.
    ProbeOutside,
    /// Its pose repeats the one before while the sensor moves on.
    Frozen,
    /// The published method finds no cylinder for it, or no points in its cylinder's section.
    NoCylinder,
    /// Its pose or its contour repeats the one before to the last bit: it is not measured anew.
    Repeated,
}

impl LeftOut {
    /// The frame that an error is about; any other error is given back.
    pub(crate) fn because(error: Error, reason: Reason) -> Result<Self> {
        match error {
            Error::Frame { frame, field, found, expected } => {
                Ok(Self { place: frame, frame, reason, field, found, expected })
            }
            other => Err(other),
        }
    }

    /// Gives the frame the number that it has in the recording.
    pub(crate) fn name(&mut self, recording: &Recording) {
        self.frame = recording.number(self.place);
    }

    /// The same as an error.
    pub(crate) fn into_error(self) -> Error {
        let Self { frame, field, found, expected, .. } = self;
        Error::Frame { frame, field, found, expected }
    }
}

impl Reason {
    /// Whether the frame is wrong, rather than only nothing new.
    pub(crate) fn is_unfit(self) -> bool {
        self != Reason::Repeated
    }
}

/// A recording that is ready to be reconstructed, and what was found when it was screened.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Screened<'a> {
    /// The recording without what is unfit.
    pub recording: Cow<'a, Recording>,
    /// What was found.
    pub screening: Screening,
}

impl<'a> Screened<'a> {
    /// Brings a recording to this project's conventions, screens it and leaves out what is unfit. Frames keep their places:
    /// one that is left out has no contour, and the pose of the nearest frame that is kept.
    ///
    /// # Errors
    /// Where there is no frame, one is unfit and the settings refuse that, or more are than [`Screening::MAX_SHARE`].
    pub fn of(recording: &'a Recording, conventions: &Conventions, unfit: UnfitFrames) -> Result<Self> {
        if recording.frames.is_empty() {
            recording.check()?;
        }
        let recording = conventions.apply(recording);
        let (screening, cleaned) = match unfit {
            UnfitFrames::Keep => (Screening::none(&recording), None),
            _ => {
                let (screening, cleaned) = Screening::with_cleaned(&recording);
                let changed = match cleaned {
                    Cow::Borrowed(_) => None,
                    Cow::Owned(frames) => Some(Recording { frames }),
                };
                (screening, changed)
            }
        };
        if unfit == UnfitFrames::Refuse {
            screening.refuse()?;
        }
        let cleaned = cleaned.map_or(recording, Cow::Owned);
        Ok(Self { recording: screening.without_left_out(cleaned)?, screening })
    }
}

impl Screening {
    /// Largest share of a recording's frames that may be unfit: with more, nothing tells which frames are right. Repeated
    /// frames do not count.
    pub const MAX_SHARE: f64 = 0.25;

    /// Leaves no frame out.
    pub fn none(recording: &Recording) -> Self {
        Self {
            frames: recording.frames.len(),
            left_out: Vec::new(),
            cleaning: Cleaning::default(),
            suspicions: suspicions::suspicions(recording, &recording.frames, &[]),
        }
    }

    /// Screens a recording.
    pub fn of(recording: &Recording) -> Self {
        Self::with_cleaned(recording).0
    }

    /// Screens a recording; its frames with their contours cleaned come along.
    fn with_cleaned(recording: &Recording) -> (Self, Cow<'_, [Frame]>) {
        let (cleaning, frames) = Cleaning::of(&recording.frames);
        let defect = |(k, frame): (usize, &Frame)| {
            let defect = frame.defects().into_iter().next();
            defect.map_or(Either::Left(k), |defect| {
                Either::Right(LeftOut {
                    place: k,
                    frame: k,
                    reason: Reason::Defect,
                    field: defect.field,
                    found: defect.found,
                    expected: defect.expected.into(),
                })
            })
        };
        let (mut sound, mut left_out): (Vec<usize>, Vec<LeftOut>) =
            frames.par_iter().enumerate().partition_map(defect);
        let mut places: Vec<Place> = sound.par_iter().map(|&k| Place::of(&frames[k])).collect();
        let mut leave = |found: Vec<LeftOut>, sound: &mut Vec<usize>, places: &mut Vec<Place>| {
            let is_left = |k: &usize| found.binary_search_by_key(k, |one| one.place).is_ok();
            let mut kept = sound.iter().map(|k| !is_left(k));
            places.retain(|_| kept.next().unwrap_or(true));
            sound.retain(|k| !is_left(k));
            left_out.extend(found);
        };
        leave(path::lost(&sound, &places), &mut sound, &mut places);
        leave(repeats::repeats(&frames, &sound), &mut sound, &mut places);
        leave(probe::outside(&frames, &sound), &mut sound, &mut places);
        leave(path::off_the_path(&sound, &places), &mut sound, &mut places);
        leave(bursts::bursts(&frames, &sound, &places), &mut sound, &mut places);
        left_out.sort_by_key(|one| one.place);
        let suspicions = suspicions::suspicions(recording, &frames, &left_out);
        left_out.iter_mut().for_each(|one| one.name(recording));
        (Self { frames: frames.len(), left_out, cleaning, suspicions }, frames)
    }

    /// The recording with the contours of the frames that are left out emptied, and with their poses taken from the
    /// nearest frame that is kept, so that frames keep their places; points that stand for a missing echo are NaN.
    ///
    /// # Errors
    /// [`Error::Frame`] with the first unfit frame where these are more than [`Screening::MAX_SHARE`] of all.
    pub fn apply<'a>(&self, recording: &'a Recording) -> Result<Cow<'a, Recording>> {
        let cleaned = match self.cleaning.clone().add(&recording.frames) {
            Cow::Borrowed(_) => Cow::Borrowed(recording),
            Cow::Owned(frames) => Cow::Owned(Recording { frames }),
        };
        self.without_left_out(cleaned)
    }

    /// The same for a recording whose contours are cleaned.
    fn without_left_out<'a>(&self, recording: Cow<'a, Recording>) -> Result<Cow<'a, Recording>> {
        let mut unfit = self.left_out.iter().filter(|one| one.reason.is_unfit());
        let count = unfit.clone().count();
        if count as f64 > Self::MAX_SHARE * self.frames as f64
            && let Some(LeftOut { frame, field, found, expected, .. }) = unfit.next().cloned()
        {
            return Err(Error::Frame {
                frame,
                field,
                found: format!("{found}; {count} of {} frames are unfit", self.frames),
                expected,
            });
        }
        if self.left_out.is_empty() {
            return Ok(recording);
        }
        let mut screened = recording.into_owned();
        let mut is_kept = vec![true; self.frames];
        self.left_out.iter().for_each(|one| is_kept[one.place] = false);
        let nearest = nearest_kept(&is_kept);
        for LeftOut { place, .. } in &self.left_out {
            let pose = nearest[*place].map_or(Pose::IDENTITY, |k| screened.frames[k].world_from_sensor);
            let empty = &mut screened.frames[*place];
            empty.world_from_sensor = pose;
            empty.time_s = empty.time_s.filter(|t| t.is_finite());
            empty.contour_mm.clear();
            empty.cylinder = None;
        }
        Ok(Cow::Owned(screened))
    }

    /// Refuses what would be left out because it is unfit. Repeated frames are not.
    ///
    /// # Errors
    /// [`Error::Frame`] with the first unfit frame.
    pub fn refuse(&self) -> Result<()> {
        let unfit = self.left_out.iter().find(|one| one.reason.is_unfit()).cloned();
        unfit.map_or(Ok(()), |one| Err(one.into_error()))
    }
}

/// For each frame the nearest one that is kept; the earlier one where two are equally near.
fn nearest_kept(is_kept: &[bool]) -> Vec<Option<usize>> {
    let mut before = None;
    let mut nearest: Vec<Option<usize>> = Vec::with_capacity(is_kept.len());
    for (k, &kept) in is_kept.iter().enumerate() {
        before = if kept { Some(k) } else { before };
        nearest.push(before);
    }
    let mut after: Option<usize> = None;
    for (k, &kept) in is_kept.iter().enumerate().rev() {
        after = if kept { Some(k) } else { after };
        let is_nearer = |after: usize| nearest[k].is_none_or(|before| after - k < k - before);
        if let Some(after) = after.filter(|&after| is_nearer(after)) {
            nearest[k] = Some(after);
        }
    }
    nearest
}
