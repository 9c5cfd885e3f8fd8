//! Frames from their source to the vessel, and the vessel to whoever follows it.

use super::arrivals::{Arrivals, ArrivalsReport};
use super::log::FrameLog;
use super::queue::{Faults, Next};
use super::source::Source;
use super::times::FrameTimes;
use super::update::{Sink, Update};
use crate::reconstruction::{Change, Live, Work};
use crate::recording::{Frame, LeftOut};
use crate::settings::UnfitFrames;
use crate::{Error, Result};
use std::time::Instant;

/// Frames in a row without a pose after which people are told.
const LOST_FRAMES: usize = 12;

/// Why a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ended {
    /// The source has no more frames.
    Source,
    /// Somebody asked for it.
    Interrupted,
}

/// What happened.
pub(crate) struct Outcome {
    pub ended: Ended,
    pub arrivals: ArrivalsReport,
    /// Frames that were dropped for newer ones.
    pub dropped: usize,
    /// What came and was no frame.
    pub faults: Faults,
    /// Frames that were left out, and why, in the order in which that was found.
    pub left_out: Vec<LeftOut>,
    /// Frames at which the vessel began anew.
    pub restarts: Vec<usize>,
    pub off_axis: usize,
    /// The first frame with a vessel.
    pub first_frame: Option<usize>,
    pub times: Vec<FrameTimes>,
    pub most_work: Work,
    /// Rings after each frame.
    pub rings: Vec<usize>,
    /// The first thing that could not be written.
    pub failure: Option<Error>,
}

/// Takes frames until the source ends or `is_ended` says so. `on_frame` is called after each.
///
/// A sink that fails is told of on stderr, once, and the run goes on.
///
/// # Errors
/// Where the source fails, or a frame is unfit and the settings refuse it. Frames of a queue that the settings
/// keep, and that have defects, are counted as faults instead: a live run does not end because of one frame.
pub(crate) fn run(
    live: &mut Live,
    source: &mut Source,
    sinks: &mut [Box<dyn Sink>],
    log: Option<&mut FrameLog>,
    is_ended: &dyn Fn() -> bool,
    on_frame: &mut dyn FnMut(),
) -> Result<Outcome> {
    let mut running = Running {
        sinks,
        log,
        arrivals: Arrivals::default(),
        unfit: Faults::default(),
        without_pose: 0,
        outcome: Outcome::new(),
    };
    loop {
        if is_ended() {
            running.outcome.ended = Ended::Interrupted;
            break;
        }
        match source.next(is_ended) {
            Next::Idle => {}
            Next::Ended(None) => {
                running.outcome.ended = if is_ended() { Ended::Interrupted } else { Ended::Source };
                break;
            }
            Next::Ended(Some(error)) => {
                // All that came before is as good as it was.
                running.fail(Err(error));
                break;
            }
            Next::Frame(frame, came) => {
                let is_kept =
                    matches!(source, Source::Queued(_)) && live.settings().unfit_frames == UnfitFrames::Keep;
                running.frame(live, &frame, came, is_kept)?;
                on_frame();
            }
        }
    }
    running.end(live)?;
    let mut outcome = running.outcome;
    outcome.arrivals = running.arrivals.report().clone();
    outcome.dropped = source.dropped();
    outcome.faults = source.faults();
    running.unfit.first.into_iter().for_each(|text| outcome.faults.first.push(text));
    outcome.faults.count += running.unfit.count;
    Ok(outcome)
}

impl Outcome {
    fn new() -> Self {
        Self {
            ended: Ended::Source,
            arrivals: ArrivalsReport::default(),
            dropped: 0,
            faults: Faults::default(),
            left_out: Vec::new(),
            restarts: Vec::new(),
            off_axis: 0,
            first_frame: None,
            times: Vec::new(),
            most_work: Work::default(),
            rings: Vec::new(),
            failure: None,
        }
    }
}

struct Running<'a> {
    sinks: &'a mut [Box<dyn Sink>],
    log: Option<&'a mut FrameLog>,
    arrivals: Arrivals,
    /// Frames with defects that were to be kept.
    unfit: Faults,
    /// Frames in a row without a pose, up to now.
    without_pose: usize,
    outcome: Outcome,
}

impl Running<'_> {
    fn frame(&mut self, live: &mut Live, frame: &Frame, came: Instant, is_kept: bool) -> Result<()> {
        let taken = Instant::now();
        let waiting_s = taken.saturating_duration_since(came).as_secs_f64();
        self.arrivals.take(frame, came);
        let change = match live.push(frame) {
            Ok(change) => change,
            Err(error @ Error::Frame { .. }) if is_kept => {
                self.unfit.add(error.to_string());
                return Ok(());
            }
            Err(error) => return Err(error),
        };
        let showing = Instant::now();
        self.lost(frame, change.frame);
        let shown = live.settings().conventions.apply_to(frame);
        let number = frame.number.unwrap_or(change.frame);
        self.show(&Update { live, change: &change, frame: Some(&shown), number });
        let showing_s = showing.elapsed().as_secs_f64();
        let times = FrameTimes { waiting_s, stages: change.times, showing_s };
        if let Some(log) = &mut self.log {
            let logged = log.frame(number, shown.time_s, &change, &times);
            self.fail(logged);
        }
        self.outcome.times.push(times);
        self.outcome.rings.push(change.rings);
        self.count(change);
        Ok(())
    }

    /// Tells people once when poses fail to come.
    fn lost(&mut self, frame: &Frame, number: usize) {
        self.without_pose = if frame.world_from_sensor.is_finite() { 0 } else { self.without_pose + 1 };
        if self.without_pose == LOST_FRAMES {
            let first = number + 1 - LOST_FRAMES;
            let text = format!("The tracker has sent no valid pose since frame {first}.");
            self.sinks.iter_mut().for_each(|sink| sink.say(&text));
        }
    }

    fn count(&mut self, change: Change) {
        let outcome = &mut self.outcome;
        outcome.off_axis += usize::from(change.off_axis);
        if change.restarted {
            outcome.restarts.push(change.frame);
            outcome.first_frame = None;
        }
        outcome.first_frame = outcome.first_frame.or((change.rings > 0).then_some(change.frame));
        outcome.most_work.echoes = outcome.most_work.echoes.max(change.work.echoes);
        outcome.most_work.rings = outcome.most_work.rings.max(change.work.rings);
        outcome.left_out.extend(change.left_out);
    }

    fn show(&mut self, update: &Update) {
        for k in 0..self.sinks.len() {
            let done = self.sinks[k].take(update);
            self.fail(done);
        }
    }

    /// Tells of the first failure, and remembers it.
    fn fail(&mut self, done: Result<()>) {
        if let Err(error) = done
            && self.outcome.failure.is_none()
        {
            eprintln!("lumenmesh: {error}");
            self.outcome.failure = Some(error);
        }
    }

    /// Ends the waiting for frames that jump off the path.
    fn end(&mut self, live: &mut Live) -> Result<()> {
        for k in 0..self.sinks.len() {
            let done = self.sinks[k].last_frame(live);
            self.fail(done);
        }
        let change = live.flush()?;
        let number = change.frame;
        self.show(&Update { live, change: &change, frame: None, number });
        let first_frame = self.outcome.first_frame;
        self.count(change);
        self.outcome.first_frame = first_frame;
        Ok(())
    }
}
