//! Frames out of messages: a pose and a contour of the same moment.

use super::content::{Content, Tool};
use super::image::ImageContent;
use super::message::{DEVICE_BYTES, Message};
use super::poly_data::PolyData;
use super::time::Timestamp;
use super::wire::{cut, refused};
use crate::geometry::Pose;
use crate::recording::{Frame, MaskOptions};
use crate::{Error, Result};
use glam::{DMat3, DQuat, DVec2};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;

/// Points of a contour, at most.
pub(super) const MAX_POINTS: usize = 100_000;
/// Poses that are remembered, the newest.
const MAX_POSES: usize = 4096;
/// Contours that wait for their poses, at most.
const MAX_WAITING: usize = 256;
/// How much later other messages may be made until a contour has waited long enough for its pose, s.
const MAX_WAIT_S: f64 = 0.5;
/// A time that lies farther from the one before it is of another clock, or of a program that was started
/// again, s.
const NEW_CLOCK_S: f64 = 10.0;
/// How far from the probe's plane the points of its contour may lie, mm.
const MAX_OFF_PLANE_MM: f32 = 0.01;

/// How frames are made of messages.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct AssemblerOptions {
    /// The device whose `TRANSFORM` is the sensor in the world, or the tool's name in `TDATA`.
    pub pose_device: String,
    /// The device whose `POINT`, `POLYDATA`, `IMAGE` or `STRING` has the contours. Without one, all of those
    /// of all devices count, but for images: those of the ultrasound system come as `IMAGE` too.
    pub contour_device: Option<String>,
    /// How images become contours. Without a threshold it is half of the largest pixel of all images so far,
    /// without the size of a pixel the image's matrix is taken for `ImageToProbe`.
    pub mask: MaskOptions,
    /// The longest time between two poses, s, within which the pose of a contour between them is
    /// interpolated. PLUS does not send poses that are invalid: a longer gap means that there was none.
    pub max_pose_gap_s: f64,
    /// How much later than the image was taken contours are stamped, s: the time that a segmentation takes.
    pub contour_delay_s: f64,
}

impl Default for AssemblerOptions {
    fn default() -> Self {
        Self {
            pose_device: "ProbeToTracker".into(),
            contour_device: None,
            mask: MaskOptions::default(),
            max_pose_gap_s: 0.05,
            contour_delay_s: 0.0,
        }
    }
}

crate::setters::setters!(AssemblerOptions {
    with_pose_device => pose_device: String,
    with_contour_device => contour_device: Option<String>,
    with_mask => mask: MaskOptions,
    with_max_pose_gap_s => max_pose_gap_s: f64,
    with_contour_delay_s => contour_delay_s: f64,
});

impl AssemblerOptions {
    fn check(&self) -> Result<()> {
        self.mask.check()?;
        if self.pose_device.is_empty() {
            return Err(Error::setting("pose device", "no name", "a device's name"));
        }
        if !(0.0..=60.0).contains(&self.max_pose_gap_s) {
            return Err(Error::setting("longest gap between poses", self.max_pose_gap_s, "0 to 60 s"));
        }
        if !(-60.0..=60.0).contains(&self.contour_delay_s) {
            return Err(Error::setting("delay of contours", self.contour_delay_s, "-60 to 60 s"));
        }
        Ok(())
    }
}

/// What became of the messages.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
#[non_exhaustive]
pub struct FrameCounts {
    /// Frames that were made.
    pub frames: usize,
    /// Of these: with a pose between two others.
    pub interpolated: usize,
    /// Of these: without a pose, because the tracker said so.
    pub pose_not_ok: usize,
    /// Of these: without a pose, because none came near their time.
    pub pose_missing: usize,
    /// Of these: whole frames as texts.
    pub as_text: usize,
    /// Poses of the device.
    pub poses: usize,
    /// Poses of a time that was there already; the first counts.
    pub poses_repeated: usize,
    /// Poses that came after later ones.
    pub poses_out_of_order: usize,
    /// Contours of a time that was there already; the first counts.
    pub contours_repeated: usize,
    /// Contours that came after the frame of a later one was made; they are left out.
    pub contours_late: usize,
    /// Times that began anew.
    pub new_clocks: usize,
    /// Messages that are for others, by device, the first twenty.
    pub other_devices: BTreeMap<String, usize>,
}

impl fmt::Display for FrameCounts {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} frames of {} poses", self.frames, self.poses)?;
        for (count, what) in [
            (self.as_text, "as texts"),
            (self.interpolated, "with an interpolated pose"),
            (self.pose_not_ok, "whose pose the tracker called invalid"),
            (self.pose_missing, "without a pose of their time"),
            (self.poses_repeated, "repeated poses"),
            (self.poses_out_of_order, "poses out of order"),
            (self.contours_repeated, "repeated contours"),
            (self.contours_late, "late contours left out"),
            (self.new_clocks, "times that began anew"),
        ] {
            if count > 0 {
                write!(f, ", {count} {what}")?;
            }
        }
        if !self.other_devices.is_empty() {
            let devices: Vec<String> =
                self.other_devices.iter().map(|(name, count)| format!("{name:?} {count}")).collect();
            write!(f, "; messages of other devices: {}", devices.join(", "))?;
        }
        Ok(())
    }
}

/// Joins poses and contours of the same moment to frames.
///
/// The rules:
/// - A contour has the pose with its own time. Where there is none it waits until a later pose has come, and
///   has the pose between the two, if they are no farther apart than
///   [`max_pose_gap_s`](AssemblerOptions::max_pose_gap_s) and both are OK; else the frame has [no
///   pose](Pose::LOST).
/// - It waits no longer than until some message was made 0.5 s after it; then the frame has no pose.
/// - A pose whose status is not `OK` says that there is none at its time. The status is the metadata
///   `TransformStatus` of a `TRANSFORM` and `<tool>Status` of a `TDATA`; without one the pose is OK.
/// - Frames leave in the order of their times. A contour that comes after the frame of a later one was made
///   is left out, and so is one of a time that was there already; of two poses with one time the first
///   counts.
/// - A time that lies more than 10 s before the one that came before it is of another clock: what was
///   remembered is forgotten. Poses from before a gap of more than 10 s are forgotten too.
/// - A contour without a time has the pose that came last, and the frame no time.
/// - A text is a frame by itself and leaves at once, with its own time.
///
/// Times of frames are seconds since the first pose or contour that has a time.
#[derive(Debug)]
pub struct FrameAssembler {
    options: AssemblerOptions,
    origin: Option<Timestamp>,
    /// Frames without contours; `None`: the tracker has no pose at that time.
    poses: BTreeMap<Timestamp, Option<Frame>>,
    /// The pose that came last.
    last_pose: Option<Frame>,
    last_pose_time: Option<Timestamp>,
    waiting: BTreeMap<Timestamp, Contour>,
    last_contour_time: Option<Timestamp>,
    /// The contour of the last frame that was made.
    last_made: Option<Timestamp>,
    largest_pixel: f64,
    counts: FrameCounts,
}

/// A contour, and its plane in the probe's coordinates where that is not the probe's own.
#[derive(Debug)]
struct Contour {
    points_mm: Vec<DVec2>,
    probe_from_plane: Option<Pose>,
}

impl FrameAssembler {
    /// An assembler that has seen nothing yet.
    ///
    /// # Errors
    /// [`Error::Setting`] where an option makes no sense.
    pub fn new(options: AssemblerOptions) -> Result<Self> {
        options.check()?;
        Ok(Self {
            options,
            origin: None,
            poses: BTreeMap::new(),
            last_pose: None,
            last_pose_time: None,
            waiting: BTreeMap::new(),
            last_contour_time: None,
            last_made: None,
            largest_pixel: 0.0,
            counts: FrameCounts::default(),
        })
    }

    /// What became of the messages so far.
    pub fn counts(&self) -> &FrameCounts {
        &self.counts
    }

    /// Takes a message and returns the frames that it completes, in the order of their times.
    ///
    /// # Errors
    /// [`Error::Recording`] where the message should have a pose, a contour or a frame and has none that can
    /// be used. It is then left out, and the next can be taken.
    pub fn push(&mut self, message: &Message) -> Result<Vec<Frame>> {
        /// Bytes of what a message says, in an error.
        const LONGEST: usize = 400;
        let named = |error: Error| match error {
            Error::Recording { field, found, expected } => {
                let found = format!("{}, from {:?}", cut(&found, LONGEST), message.device);
                Error::Recording { field, found, expected }
            }
            other => other,
        };
        match &message.content {
            Content::Transform(matrix) if is_named(&message.device, &self.options.pose_device) => {
                let is_ok = is_ok(message.metadata("TransformStatus"));
                self.take_pose(message.time, is_ok.then_some(matrix)).map_err(named)
            }
            Content::Tracking(tools) => match self.tool(tools) {
                Some(tool) => {
                    let is_ok = is_ok(message.metadata(&format!("{}Status", tool.name)));
                    self.take_pose(message.time, is_ok.then_some(&tool.matrix)).map_err(named)
                }
                None => Ok(self.pass_by(message)),
            },
            Content::Points(points) if self.is_contour(message) => {
                let contour = of_points(points.iter()).map_err(named)?;
                Ok(self.take_contour(message.time, contour))
            }
            Content::PolyData(data) if self.is_contour(message) => {
                let contour = of_poly_data(data).map_err(named)?;
                Ok(self.take_contour(message.time, contour))
            }
            Content::Image(image) if self.is_contour(message) && self.options.contour_device.is_some() => {
                let contour = self.of_image(image).map_err(named)?;
                Ok(self.take_contour(message.time, contour))
            }
            Content::Text(text) if self.is_contour(message) && text.trim_start().starts_with('{') => {
                let frame = Frame::from_json(text).map_err(named)?;
                self.counts.frames += 1;
                self.counts.as_text += 1;
                Ok(vec![frame])
            }
            Content::Status(_) | Content::GetStatus | Content::StartTracking(_) => Ok(Vec::new()),
            _ => Ok(self.pass_by(message)),
        }
    }

    /// Makes frames of all contours that wait. After the last message.
    pub fn flush(&mut self) -> Vec<Frame> {
        self.made(true)
    }

    fn is_contour(&self, message: &Message) -> bool {
        self.options.contour_device.as_ref().is_none_or(|name| is_named(&message.device, name))
    }

    fn tool<'a>(&self, tools: &'a [Tool]) -> Option<&'a Tool> {
        tools.iter().find(|tool| is_named(&tool.name, &self.options.pose_device))
    }

    fn pass_by(&mut self, message: &Message) -> Vec<Frame> {
        const LISTED: usize = 20;
        let devices = &mut self.counts.other_devices;
        if devices.len() < LISTED || devices.contains_key(&message.device) {
            *devices.entry(message.device.clone()).or_default() += 1;
        }
        Vec::new()
    }

    fn take_pose(&mut self, time: Timestamp, matrix: Option<&[[f32; 4]; 3]>) -> Result<Vec<Frame>> {
        let pose = match matrix {
            Some(matrix) => {
                let rows = std::array::from_fn(|row| match matrix.get(row) {
                    Some(row) => row.map(f64::from),
                    None => [0.0, 0.0, 0.0, 1.0],
                });
                let frame = Frame::from_matrix(&rows, Vec::new())?;
                Some(frame).filter(|frame| frame.world_from_sensor.is_finite())
            }
            None => None,
        };
        self.counts.poses += 1;
        self.last_pose.clone_from(&pose);
        if !time.is_known() {
            return Ok(Vec::new());
        }
        self.origin.get_or_insert(time);
        let mut frames = Vec::new();
        if let Some(last) = self.last_pose_time {
            let later_s = time.seconds_since(last);
            if later_s.abs() > NEW_CLOCK_S {
                self.counts.new_clocks += usize::from(later_s < 0.0);
                // Those that wait are of the time before.
                frames = self.made(later_s < 0.0);
                self.poses.clear();
            } else if later_s < 0.0 {
                self.counts.poses_out_of_order += 1;
            }
        }
        self.last_pose_time = Some(time);
        match self.poses.entry(time) {
            std::collections::btree_map::Entry::Occupied(_) => self.counts.poses_repeated += 1,
            std::collections::btree_map::Entry::Vacant(place) => drop(place.insert(pose)),
        }
        if self.poses.len() > MAX_POSES {
            self.poses.pop_first();
        }
        frames.extend(self.made(false));
        Ok(frames)
    }

    fn take_contour(&mut self, time: Timestamp, contour: Contour) -> Vec<Frame> {
        if !time.is_known() {
            let pose = self.last_pose.clone();
            self.counts.pose_missing += usize::from(pose.is_none());
            return vec![self.joined(pose, contour)];
        }
        self.origin.get_or_insert(time);
        let time = time.plus_s(-self.options.contour_delay_s);
        let mut frames = Vec::new();
        if let Some(last) = self.last_contour_time
            && time.seconds_since(last) < -NEW_CLOCK_S
        {
            self.counts.new_clocks += 1;
            frames = self.made(true);
            self.last_made = None;
        }
        self.last_contour_time = Some(time);
        match self.last_made {
            Some(made) if time == made => self.counts.contours_repeated += 1,
            Some(made) if time < made => self.counts.contours_late += 1,
            _ if self.waiting.contains_key(&time) => self.counts.contours_repeated += 1,
            _ => drop(self.waiting.insert(time, contour)),
        }
        frames.extend(self.made(false));
        frames
    }

    /// The frames of contours that have waited long enough, or of all.
    fn made(&mut self, all: bool) -> Vec<Frame> {
        let mut frames = Vec::new();
        while let Some((&time, _)) = self.waiting.first_key_value() {
            let waited = self
                .last_pose_time
                .max(self.last_contour_time)
                .is_some_and(|now| now.seconds_since(time) > MAX_WAIT_S || self.waiting.len() > MAX_WAITING);
            let after = self.poses.range(time..).next();
            let pose = match after {
                Some((at, pose)) if *at == time => {
                    self.counts.pose_not_ok += usize::from(pose.is_none());
                    pose.clone()
                }
                Some((at, after)) => {
                    let before = self.poses.range(..time).next_back();
                    let pose = before.and_then(|(before_at, before)| {
                        let gap_s = at.seconds_since(*before_at);
                        let (before, after) = (before.as_ref()?, after.as_ref()?);
                        let share = time.seconds_since(*before_at) / gap_s;
                        (gap_s <= self.options.max_pose_gap_s).then(|| between(before, after, share))
                    });
                    self.counts.interpolated += usize::from(pose.is_some());
                    self.counts.pose_missing += usize::from(pose.is_none());
                    pose
                }
                None if all || waited => {
                    self.counts.pose_missing += 1;
                    None
                }
                None => break,
            };
            let Some((_, contour)) = self.waiting.pop_first() else { break };
            let time_s = self.origin.map(|origin| time.seconds_since(origin));
            frames.push(self.joined(pose, contour).with_time_s(time_s));
            self.last_made = Some(time);
        }
        frames
    }

    fn joined(&mut self, pose: Option<Frame>, contour: Contour) -> Frame {
        self.counts.frames += 1;
        let mut frame = pose.unwrap_or_else(|| Frame::new(Pose::LOST, Vec::new()));
        if let Some(probe_from_plane) = contour.probe_from_plane {
            frame.world_from_sensor = frame.world_from_sensor * probe_from_plane;
        }
        frame.with_contour_mm(contour.points_mm)
    }

    fn of_image(&mut self, image: &ImageContent) -> Result<Contour> {
        let (image, probe_from_image) = image.plane()?;
        let finite = image.pixels.iter().filter(|p| p.is_finite());
        self.largest_pixel = finite.fold(self.largest_pixel, |largest, &p| largest.max(f64::from(p)));
        let mask = &self.options.mask;
        let threshold = mask.threshold.unwrap_or(self.largest_pixel / 2.0);
        // Where no pixel was above 0 yet, 0 is no lumen.
        let threshold = if threshold > 0.0 || mask.threshold.is_some() {
            threshold
        } else {
            f64::from(f32::MIN_POSITIVE)
        };
        let found = mask.contour_of(&image, threshold, &probe_from_image)?;
        let probe_from_plane = Some(found.probe_from_plane).filter(|pose| *pose != Pose::IDENTITY);
        Ok(Contour { points_mm: found.contour_mm, probe_from_plane })
    }
}

/// Whether a name that may have been cut is this one.
fn is_named(found: &str, name: &str) -> bool {
    found == name || (name.len() > DEVICE_BYTES && found == cut(name, DEVICE_BYTES))
}

fn is_ok(status: Option<&str>) -> bool {
    status.is_none_or(|status| status.trim().eq_ignore_ascii_case("OK"))
}

fn between(before: &Frame, after: &Frame, share: f64) -> Frame {
    let (a, b) = (before.world_from_sensor, after.world_from_sensor);
    let [p, q] = [a, b].map(|pose| DQuat::from_mat3(&pose.orthonormalised().rotation));
    let rotation = DMat3::from_quat(p.slerp(q, share).normalize());
    Frame::new(Pose { rotation, translation_mm: a.translation_mm.lerp(b.translation_mm, share) }, Vec::new())
}

/// Points in the probe's plane; NaN: no echo.
fn of_points<'a>(points: impl ExactSizeIterator<Item = &'a [f32; 3]>) -> Result<Contour> {
    if points.len() > MAX_POINTS {
        return Err(refused("contour", format!("{} points", points.len()), format!("at most {MAX_POINTS}")));
    }
    let mut points_mm = Vec::with_capacity(points.len());
    for (k, &[x, y, z]) in points.enumerate() {
        if z.abs() > MAX_OFF_PLANE_MM {
            let expected = format!("the probe's plane, z within {MAX_OFF_PLANE_MM} mm of 0");
            return Err(refused("contour", format!("z = {z} mm at point {k}"), expected));
        }
        points_mm.push(DVec2::new(f64::from(x), f64::from(y)));
    }
    Ok(Contour { points_mm, probe_from_plane: None })
}

/// The contour is the only line or polygon, or else all points in their order.
fn of_poly_data(data: &PolyData) -> Result<Contour> {
    let cells: Vec<&Vec<u32>> = data.lines.iter().chain(&data.polygons).collect();
    let mut cell: &[u32] = match cells[..] {
        [] if data.strips.is_empty() => return of_points(data.points_mm.iter()),
        [one] if data.strips.is_empty() => one,
        _ => {
            let found = format!(
                "{} lines, {} polygons and {} strips",
                data.lines.len(),
                data.polygons.len(),
                data.strips.len()
            );
            return Err(refused("contour", found, "one line or one polygon"));
        }
    };
    // A closed line may name its first point again.
    if let [first, middle @ .., last] = cell
        && first == last
        && !middle.is_empty()
    {
        cell = &cell[..cell.len() - 1];
    }
    let points = cell.iter().map(|&index| {
        data.points_mm
            .get(index as usize)
            .ok_or_else(|| refused("contour", format!("point {index}"), "one that is there"))
    });
    let points: Vec<&[f32; 3]> = points.collect::<Result<_>>()?;
    of_points(points.into_iter())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::openigtlink::ImageContent;
    use crate::recording::PixelType;

    /// A second of the test, as a time.
    fn at(time_s: f64) -> Timestamp {
        Timestamp::from_s(1_700_000_000.0).plus_s(time_s)
    }

    fn pose(time_s: f64, x_mm: f32) -> Message {
        let matrix = [[1.0, 0.0, 0.0, x_mm], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
        Message::new("ProbeToTracker", at(time_s), Content::Transform(matrix))
    }

    fn invalid(time_s: f64) -> Message {
        pose(time_s, 0.0).with_metadata("TransformStatus", "OUT_OF_VIEW")
    }

    fn contour(time_s: f64) -> Message {
        Message::new("Lumen", at(time_s), Content::Points(vec![[1.0, 0.0, 0.0], [f32::NAN, f32::NAN, 0.0]]))
    }

    fn assembler() -> FrameAssembler {
        FrameAssembler::new(AssemblerOptions::default()).unwrap()
    }

    /// Times of the frames, and where along x their sensors are; NaN: no pose.
    fn frames_of(assembler: &mut FrameAssembler, messages: &[Message]) -> Vec<(f64, f64)> {
        let mut frames: Vec<Frame> =
            messages.iter().flat_map(|message| assembler.push(message).unwrap()).collect();
        frames.extend(assembler.flush());
        let place = |frame: &Frame| (frame.time_s.unwrap(), frame.world_from_sensor.translation_mm.x);
        frames.iter().map(place).collect()
    }

    /// As `assert_eq!`, with NaN equal to itself.
    fn assert_frames(found: &[(f64, f64)], expected: &[(f64, f64)]) {
        assert_eq!(format!("{found:?}"), format!("{expected:?}"));
    }

    #[test]
    fn a_contour_has_the_pose_of_its_time_whichever_comes_first() {
        let mut assembler = assembler();
        let messages = [pose(0.0, 1.0), contour(0.0), contour(0.125), pose(0.125, 2.0)];
        assert_frames(&frames_of(&mut assembler, &messages), &[(0.0, 1.0), (0.125, 2.0)]);
        assert_eq!((assembler.counts().frames, assembler.counts().poses), (2, 2));
    }

    #[test]
    fn a_pose_between_two_is_interpolated_and_none_over_a_gap() {
        let mut assembler = assembler();
        let messages =
            [pose(0.0, 1.0), contour(0.015_625), pose(0.031_25, 3.0), contour(0.0625), pose(0.125, 5.0)];
        assert_frames(&frames_of(&mut assembler, &messages), &[(0.015_625, 2.0), (0.0625, f64::NAN)]);
        assert_eq!((assembler.counts().interpolated, assembler.counts().pose_missing), (1, 1));
    }

    #[test]
    fn an_invalid_pose_is_none_and_none_is_interpolated_with_it() {
        let mut assembler = assembler();
        let messages = [
            pose(0.0, 1.0),
            invalid(0.031_25),
            contour(0.015_625),
            contour(0.031_25),
            pose(0.0625, 2.0),
            contour(0.0625),
        ];
        let expected = [(0.015_625, f64::NAN), (0.031_25, f64::NAN), (0.0625, 2.0)];
        assert_frames(&frames_of(&mut assembler, &messages), &expected);
        assert_eq!((assembler.counts().pose_not_ok, assembler.counts().pose_missing), (1, 1));
    }

    #[test]
    fn a_contour_waits_for_half_a_second_of_other_messages_and_no_longer() {
        let mut assembler = assembler();
        assert!(assembler.push(&contour(0.0)).unwrap().is_empty());
        assert!(assembler.push(&contour(0.5)).unwrap().is_empty());
        assert_eq!(assembler.push(&contour(0.625)).unwrap().len(), 1);
        assert_eq!(assembler.flush().len(), 2);
        assert_eq!(assembler.counts().pose_missing, 3);
    }

    #[test]
    fn what_is_repeated_late_or_out_of_order_is_counted() {
        let mut assembler = assembler();
        let messages = [
            pose(0.0, 1.0),
            pose(0.0, 9.0),
            contour(0.0),
            contour(0.0),
            pose(0.25, 3.0),
            pose(0.125, 2.0),
            contour(0.25),
            contour(0.125),
        ];
        assert_frames(&frames_of(&mut assembler, &messages), &[(0.0, 1.0), (0.25, 3.0)]);
        let counts = assembler.counts();
        assert_eq!((counts.poses_repeated, counts.poses_out_of_order), (1, 1));
        assert_eq!((counts.contours_repeated, counts.contours_late), (1, 1));
        assert_eq!(
            counts.to_string(),
            "2 frames of 4 poses, 1 repeated poses, 1 poses out of order, \
                                        1 repeated contours, 1 late contours left out"
        );
    }

    #[test]
    fn a_clock_that_is_set_back_begins_anew_and_one_wrong_time_spoils_nothing() {
        let mut assembler = assembler();
        let messages = [
            pose(100.0, 1.0),
            contour(100.0),
            pose(0.0, 2.0),
            contour(0.0),
            pose(0.125, 3.0),
            contour(0.125),
        ];
        assert_frames(&frames_of(&mut assembler, &messages), &[(0.0, 1.0), (-100.0, 2.0), (-99.875, 3.0)]);
        assert_eq!(assembler.counts().new_clocks, 2);
        let mut assembler = self::assembler();
        let wrong = Message { time: Timestamp(u64::MAX), ..pose(0.0, 7.0) };
        let messages =
            [pose(0.0, 1.0), wrong, pose(0.125, 2.0), contour(0.125), contour(0.25), pose(0.25, 3.0)];
        assert_frames(&frames_of(&mut assembler, &messages), &[(0.125, 2.0), (0.25, 3.0)]);
    }

    #[test]
    fn without_a_time_the_pose_that_came_last_counts() {
        let mut assembler = assembler();
        let untimed = |message: Message| Message { time: Timestamp::UNKNOWN, ..message };
        assembler.push(&untimed(pose(0.0, 4.0))).unwrap();
        let frames = assembler.push(&untimed(contour(0.0))).unwrap();
        assert_eq!((frames[0].time_s, frames[0].world_from_sensor.translation_mm.x), (None, 4.0));
        assert!(frames[0].contour_mm[1].is_nan());
        assembler.push(&untimed(invalid(0.0))).unwrap();
        assert!(assembler.push(&untimed(contour(0.0))).unwrap()[0].world_from_sensor.translation_mm.is_nan());
    }

    #[test]
    fn contours_that_are_stamped_late_are_set_back() {
        let options = AssemblerOptions::default().with_contour_delay_s(0.25);
        let mut assembler = FrameAssembler::new(options).unwrap();
        let messages = [pose(0.0, 1.0), pose(0.25, 2.0), contour(0.25)];
        assert_frames(&frames_of(&mut assembler, &messages), &[(0.0, 1.0)]);
    }

    #[test]
    fn a_tool_of_tracking_data_is_found_by_its_name_and_has_its_own_status() {
        let options = AssemblerOptions::default().with_pose_device("CatheterProbeToTracker".into());
        let mut assembler = FrameAssembler::new(options).unwrap();
        let tool = |name: &str, x: f32| Tool {
            name: name.into(),
            kind: 2,
            matrix: [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
        };
        // A tool's name has 20 bytes.
        let tools = Content::Tracking(vec![tool("StylusToTracker", 8.0), tool("CatheterProbeToTrack", 1.0)]);
        let message = Message::new("Tracker", at(0.0), tools);
        let not_ok = Message { time: at(0.125), ..message.clone() }
            .with_metadata("StylusToTrackerStatus", "OK")
            .with_metadata("CatheterProbeToTrackStatus", "MISSING");
        let other = Message::new("Other", at(0.25), Content::Tracking(vec![tool("StylusToTracker", 8.0)]));
        let messages = [message, contour(0.0), not_ok, contour(0.125), other];
        assert_frames(&frames_of(&mut assembler, &messages), &[(0.0, 1.0), (0.125, f64::NAN)]);
        assert_eq!(assembler.counts().other_devices, BTreeMap::from([("Other".into(), 1)]));
    }

    #[test]
    fn texts_that_are_frames_leave_at_once_as_they_are() {
        let mut assembler = assembler();
        let frame = Frame::new(Pose::IDENTITY, vec![DVec2::new(0.1, 0.2), DVec2::new(1.0 / 3.0, 2.0)])
            .with_time_s(Some(7.3));
        let text = |text: &str| Message::new("Frames", at(0.0), Content::Text(text.into()));
        assert_eq!(assembler.push(&text(&frame.to_json())).unwrap(), [frame]);
        assert!(assembler.push(&text("hello")).unwrap().is_empty());
        let error = assembler.push(&text("{\"pose\": 3}")).unwrap_err().to_string();
        assert!(error.contains("from \"Frames\""), "{error}");
    }

    #[test]
    fn the_contour_of_poly_data_is_its_line_its_polygon_or_its_points() {
        let points_mm = vec![[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 2.0, 0.0], [0.0, 2.0, 0.0]];
        let of = |data: PolyData| {
            let message = Message::new("Lumen", Timestamp::UNKNOWN, Content::PolyData(data));
            assembler().push(&message).map(|frames| frames[0].contour_mm.clone())
        };
        let data = PolyData { points_mm, ..PolyData::default() };
        let square: Vec<DVec2> =
            data.points_mm.iter().map(|p| DVec2::new(p[0].into(), p[1].into())).collect();
        assert_eq!(of(data.clone()).unwrap(), square);
        let line = vec![3, 2, 1, 0, 3];
        let back: Vec<DVec2> = square.iter().rev().copied().collect();
        assert_eq!(of(PolyData { lines: vec![line.clone()], ..data.clone() }).unwrap(), back);
        assert_eq!(of(PolyData { polygons: vec![line.clone()], ..data.clone() }).unwrap(), back);
        assert!(of(PolyData { lines: vec![line.clone(), line], ..data.clone() }).is_err());
        let mut off = data.clone();
        off.points_mm[2][2] = 0.5;
        assert!(of(off).unwrap_err().to_string().contains("z = 0.5 mm at point 2"));
        let many = PolyData { points_mm: vec![[0.0; 3]; MAX_POINTS + 1], ..PolyData::default() };
        assert!(of(many).unwrap_err().to_string().contains("100001 points"));
    }

    /// A disc of radius 8 pixels about the middle.
    fn disc(kind: PixelType, big_endian: bool, inside: f64) -> ImageContent {
        const SIZE: u16 = 41;
        let mut pixels = Vec::new();
        for row in 0..SIZE {
            for column in 0..SIZE {
                let radius = (f64::from(row) - 20.0).hypot(f64::from(column) - 20.0);
                // A wide ramp at the edge, so that the outline lies between pixels.
                let value = inside * ((8.0 - radius) / 4.0 + 0.5).clamp(0.0, 1.0);
                let mut bytes = match kind {
                    PixelType::U8 => vec![value as u8],
                    PixelType::U16 => (value as u16).to_le_bytes().to_vec(),
                    _ => (value as f32).to_le_bytes().to_vec(),
                };
                if big_endian {
                    bytes.reverse();
                }
                pixels.extend(bytes);
            }
        }
        // Pixels of 0.5 mm; the middle of the image lies 1 mm beside the probe.
        let matrix = [[0.5, 0.0, 0.0, 1.0], [0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
        ImageContent { size: [SIZE, SIZE, 1], components: 1, kind, big_endian, matrix, pixels }
    }

    #[test]
    fn masks_of_any_kind_of_pixels_become_contours_where_they_lie() {
        let options = AssemblerOptions::default().with_contour_device(Some("Inference".into()));
        let with_pixel = options.clone().with_mask(MaskOptions::default().with_pixel_mm(Some([0.25; 2])));
        let of = |options: &AssemblerOptions, image: ImageContent| {
            let message = Message::new("Inference", Timestamp::UNKNOWN, Content::Image(image));
            let frames = FrameAssembler::new(options.clone()).unwrap().push(&message);
            frames.map(|frames| frames.first().map(|frame| frame.contour_mm.clone()))
        };
        for (kind, inside) in [(PixelType::U8, 255.0), (PixelType::U16, 40_000.0), (PixelType::F32, 0.9)] {
            for big_endian in [false, true] {
                let image = disc(kind, big_endian, inside);
                for (options, centre, radius_mm) in [(&options, 1.0, 4.0), (&with_pixel, 0.0, 2.0)] {
                    let contour = of(options, image.clone()).unwrap().unwrap();
                    assert_eq!(contour.len(), 128);
                    for p in contour {
                        let off = p.distance(DVec2::new(centre, 0.0)) - radius_mm;
                        assert!(off.abs() < 0.02, "{kind:?}: {off}");
                    }
                }
            }
        }
        let black = disc(PixelType::U8, false, 0.0);
        assert!(of(&options, black).unwrap().unwrap().is_empty());
        let mut colour = disc(PixelType::U8, false, 255.0);
        (colour.size[0], colour.components) = (1, 41);
        assert!(of(&options, colour).is_err());
        let unnamed = AssemblerOptions::default();
        assert_eq!(of(&unnamed, disc(PixelType::U8, false, 255.0)).unwrap(), None, "pictures are no masks");
    }

    #[test]
    fn options_that_make_no_sense_are_refused() {
        for options in [
            AssemblerOptions::default().with_pose_device(String::new()),
            AssemblerOptions::default().with_max_pose_gap_s(f64::NAN),
            AssemblerOptions::default().with_contour_delay_s(-61.0),
            AssemblerOptions::default().with_mask(MaskOptions::default().with_points(2)),
        ] {
            assert!(FrameAssembler::new(options).is_err());
        }
    }
}
