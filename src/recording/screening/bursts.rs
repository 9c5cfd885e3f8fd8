//! Bursts of wrong contours: the outline changes from one frame to the next, and changes back a few frames later.

use super::path::{Limits, Place, step_mm, usual};
use super::{LeftOut, Reason};
use crate::geometry::Pose;
use crate::recording::Frame;
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::array::from_fn;
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::ops::Range;

/// Directions about a contour's mean in which its radius is looked at. Half of them have to have echoes.
const DIRECTIONS: usize = 12;
/// Longer bursts may be anatomy.
pub(super) const LONGEST: usize = 24;
/// A change is looked for between the means of so many frames before and behind it: between many because contours are noisy,
/// between few because bursts are short.
pub(super) const WIDTHS: [usize; 3] = [1, 2, 5];
/// It is large where it exceeds so many usual ones …
const USUAL_RADII: [f64; 3] = [5.0, 4.2, 3.5];
const USUAL_OUTLINES: [f64; 3] = [3.0, 2.5, 2.0];
/// … and this: 9 % of the radius, or 13 % between a few frames. A segmentation that follows the media instead of the lumen is
/// off by some 15 %.
const LEAST_RADIUS: [f64; 3] = [0.12, 0.12, 0.09];
const LEAST_OUTLINE: [f64; 3] = [0.16, 0.16, 0.12];
/// Ends of bursts are looked for where the change is larger than this share of what is large; their mean has to be large.
const LEAST_END: f64 = 0.75;
/// Of that mean, the changes at both ends may differ by this share.
const MOST_UNLIKE: f64 = 0.5;
/// So much of the changes has to come about between [`ABRUPT_WIDTH`] frames before and behind them, on average and at either end:
/// anatomy changes gradually.
const ABRUPT_SHARE: f64 = 0.75;
const ABRUPT_END: f64 = 0.5;
const ABRUPT_WIDTH: usize = 2;
/// At an end of a recording nobody saw the other change: the one that was seen has to have this size.
const LEAST_AT_END: f64 = 1.1;
/// Of changes with one sign that are at most so many frames apart, the largest counts.
pub(super) const APART: usize = 3;
/// Contours that lie farther apart than this share of the median radius may differ as they like.
const WITHIN_RADII: f64 = 0.5;
/// Other passes of the catheter confirm a burst where so many times as many saw its outline as did not.
const LEAST_ALIKE: usize = 3;
/// Frames near a place are of different passes where so many others lie between them.
const PASS_GAP: usize = 80;
/// Largest number of a cell of frames.
const MAX_CELL: f64 = 1e15;

/// The mean logarithm of a contour's distances from its mean, or the change of that, by direction. NaN where there is no
/// echo. Logarithms, so that a few echoes from a branch do not count much.
type Outline = [f64; DIRECTIONS];

/// The frames, of those at `numbers`, whose contours are wrong for a while.
///
/// Both ends of a burst show in the mean outlines of the frames before and behind: these change by much more than usual, within
/// a few frames, and back again. The median over the directions counts, so that a branch in a few of them does not. Of all
/// bursts that may have been, those are chosen that explain the most changes with the fewest frames. What other passes of the
/// catheter saw at the same place too is anatomy.
pub(super) fn bursts(frames: &[Frame], numbers: &[usize], places: &[Place]) -> Vec<LeftOut> {
    let Some(limits) = Limits::of(places.iter()) else { return Vec::new() };
    let seen = seen(frames, numbers, places);
    let sequence = Sequence { seen: &seen, radius_mm: limits.radius_mm() };
    let stretches = sequence.stretches();
    let changes: Vec<Vec<Change>> = stretches.iter().map(|stretch| sequence.changes(stretch)).collect();
    let large = Large::among(changes.iter().flatten().map(|change| &change.sizes));
    let bursts = stretches.iter().zip(&changes);
    let bursts: Vec<Burst> =
        bursts.flat_map(|(stretch, changes)| sequence.bursts(stretch, [true; 2], changes, &large)).collect();
    if bursts.is_empty() {
        return Vec::new();
    }
    let passes = Passes::of(&sequence);
    let wrong = bursts.iter().filter(|burst| !passes.confirm(burst, &large));
    wrong.flat_map(|burst| burst.frames.clone().map(|i| burst.why(sequence.seen[i].number, &large))).collect()
}

/// Some frames that have an outline.
#[derive(Clone, Copy)]
pub(super) struct Sequence<'a> {
    pub seen: &'a [Seen],
    /// Median of the contours' radii, mm.
    pub radius_mm: f64,
}

/// A frame that has an outline.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Seen {
    pub number: usize,
    pub pose: Pose,
    /// How far the image is turned about the probe's axis since the first frame.
    pub roll_rad: f64,
    /// In directions that do not turn with the image.
    outline: Outline,
}

/// How the outline changes just before a frame.
pub(super) struct Change {
    pub at: usize,
    pub sizes: Sizes,
}

/// The sizes of a change between as many frames as [`WIDTHS`] says; `None` where too few directions have echoes.
pub(super) type Sizes = [Option<Size>; WIDTHS.len()];

/// The size of a change: of the median radius, and of the radii in the median.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(super) struct Size {
    radius: f64,
    outline: f64,
}

/// What changes are large, for each width.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Large([Size; WIDTHS.len()]);

/// A change that may be an end of a burst.
struct End {
    at: usize,
    by: Outline,
    /// In units of what is large, at the width where it is the largest.
    size: f64,
    /// The sum over the widths. Narrow ones tell where the change is, wide ones whether there is one.
    sum: f64,
}

/// Frames with another outline than those beside them.
pub(super) struct Burst {
    pub frames: Range<usize>,
    by: Outline,
    width: usize,
    /// In units of what is large.
    size: f64,
    /// How many of its ends were seen.
    ends: usize,
}

/// The roll of a pose, after another one, about the probe's axis.
pub(super) fn roll_rad(from: &Pose, to: &Pose) -> f64 {
    let turn = from.rotation.transpose() * to.rotation;
    (turn.x_axis.y - turn.y_axis.x).atan2(turn.x_axis.x + turn.y_axis.y)
}

fn outline(frame: &Frame, roll_rad: f64) -> Option<Outline> {
    let count = frame.echoes_mm().count();
    if count == 0 {
        return None;
    }
    // Not the centroid of the area, which a branch in a few directions moves.
    let centre = frame.echoes_mm().sum::<DVec2>() / count as f64;
    let roll = DVec2::from_angle(roll_rad);
    let (mut sums, mut counts) = ([0.0; DIRECTIONS], [0.0; DIRECTIONS]);
    for echo in frame.echoes_mm() {
        let from_centre = echo - centre;
        let d = direction(roll.rotate(from_centre));
        sums[d] += from_centre.length().ln();
        counts[d] += 1.0;
    }
    let outline: Outline = from_fn(|d| sums[d] / counts[d]);
    let seen = outline.iter().filter(|radius| radius.is_finite()).count();
    (2 * seen >= DIRECTIONS).then(|| outline.map(|radius| if radius.is_finite() { radius } else { f64::NAN }))
}

/// Which of the directions a vector has.
fn direction(v: DVec2) -> usize {
    let (quarter, x, y) = match (v.x >= 0.0, v.y >= 0.0) {
        (true, true) => (0, v.x, v.y),
        (false, true) => (1, v.y, -v.x),
        (false, false) => (2, -v.x, -v.y),
        (true, false) => (3, -v.y, v.x),
    };
    let third = if y * SQRT_3 < x { 0 } else { 1 + usize::from(y >= x * SQRT_3) };
    3 * quarter + third
}

const SQRT_3: f64 = 1.732_050_807_568_877_2;

fn minus(a: &Outline, b: &Outline) -> Outline {
    from_fn(|d| a[d] - b[d])
}

fn mean_of(a: &Outline, b: &Outline) -> Outline {
    from_fn(|d| (a[d] + b[d]) / 2.0)
}

/// The product of two changes over the directions that both have.
fn dot(a: &Outline, b: &Outline) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).filter(|product| !product.is_nan()).sum()
}

/// The mean of the two middle values of those that are numbers; `None` where these are fewer than half.
fn middle(values: &Outline) -> Option<f64> {
    let (mut sorted, mut count) = ([0.0; DIRECTIONS], 0);
    for &value in values.iter().filter(|value| !value.is_nan()) {
        let at = sorted[..count].iter().rposition(|other| *other <= value).map_or(0, |before| before + 1);
        sorted.copy_within(at..count, at + 1);
        sorted[at] = value;
        count += 1;
    }
    (2 * count >= DIRECTIONS).then(|| (sorted[(count - 1) / 2] + sorted[count / 2]) / 2.0)
}

impl Size {
    fn of(change: &Outline) -> Option<Self> {
        let outline = middle(&change.map(f64::abs))?;
        middle(change).map(|radius| Self { radius: radius.abs(), outline })
    }
}

impl Large {
    pub fn among<'a>(changes: impl Iterator<Item = &'a Sizes> + Clone) -> Self {
        Self(from_fn(|w| {
            let sizes = || changes.clone().filter_map(|sizes| sizes[w]);
            Size {
                radius: LEAST_RADIUS[w]
                    .max(USUAL_RADII[w] * usual(sizes().map(|size| size.radius).collect())),
                outline: LEAST_OUTLINE[w]
                    .max(USUAL_OUTLINES[w] * usual(sizes().map(|size| size.outline).collect())),
            }
        }))
    }

    /// The size of a change in units of what is large at a width.
    fn relative(&self, w: usize, size: Size) -> f64 {
        (size.radius / self.0[w].radius).max(size.outline / self.0[w].outline)
    }

    fn of(&self, w: usize, change: &Outline) -> f64 {
        Size::of(change).map_or(0.0, |size| self.relative(w, size))
    }

    /// Whether a change may be an end of a burst.
    pub fn may_be_end(&self, sizes: &Sizes) -> bool {
        let large =
            |(w, size): (usize, &Option<Size>)| size.is_some_and(|size| self.relative(w, size) >= LEAST_END);
        sizes.iter().enumerate().any(large)
    }
}

/// Those of the frames that have an outline.
fn seen(frames: &[Frame], numbers: &[usize], places: &[Place]) -> Vec<Seen> {
    let turn_rad = |i: usize| roll_rad(&places[i - 1].pose(), &places[i].pose());
    let turns_rad: Vec<f64> = (1..places.len()).into_par_iter().map(turn_rad).collect();
    let sum_rad = |sum: &mut f64, turn: f64| {
        *sum = (*sum + turn) % TAU;
        Some(*sum)
    };
    let rolls_rad: Vec<f64> = std::iter::once(0.0).chain(turns_rad).scan(0.0, sum_rad).collect();
    let seen = |i: usize| Seen::of(numbers[i], &frames[numbers[i]], rolls_rad[i]);
    (0..places.len()).into_par_iter().filter_map(seen).collect()
}

impl Seen {
    /// `None` where the contour has echoes in too few directions.
    pub fn of(number: usize, frame: &Frame, roll_rad: f64) -> Option<Self> {
        let outline = outline(frame, roll_rad)?;
        Some(Self { number, pose: frame.world_from_sensor, roll_rad, outline })
    }
}

impl Sequence<'_> {
    /// Runs of frames so near to each other that the wall cannot have changed from one to the next.
    pub fn stretches(&self) -> Vec<Range<usize>> {
        let mut stretches: Vec<Range<usize>> = Vec::new();
        for at in 0..self.seen.len() {
            let is_near = |before: &Seen| {
                step_mm(&before.pose, &self.seen[at].pose, self.radius_mm) <= WITHIN_RADII * self.radius_mm
            };
            match stretches.last_mut() {
                Some(last) if is_near(&self.seen[at - 1]) => last.end = at + 1,
                _ => stretches.push(at..at + 1),
            }
        }
        stretches
    }

    fn mean(&self, frames: Range<usize>) -> Outline {
        let (mut sums, mut counts) = ([0.0; DIRECTIONS], [0.0; DIRECTIONS]);
        for Seen { outline, .. } in &self.seen[frames] {
            for d in 0..DIRECTIONS {
                let is_seen = !outline[d].is_nan();
                sums[d] += if is_seen { outline[d] } else { 0.0 };
                counts[d] += if is_seen { 1.0 } else { 0.0 };
            }
        }
        from_fn(|d| sums[d] / counts[d])
    }

    /// The change at a frame, between at most `width` frames on either side, all of them within a range.
    fn change(&self, within: &Range<usize>, at: usize, width: usize) -> Outline {
        let [before, after] =
            [within.start.max(at.saturating_sub(width))..at, at..within.end.min(at + width)];
        minus(&self.mean(after), &self.mean(before))
    }

    pub fn changes(&self, stretch: &Range<usize>) -> Vec<Change> {
        (stretch.start + 1..stretch.end).into_par_iter().map(|at| self.change_at(stretch, at)).collect()
    }

    pub fn change_at(&self, stretch: &Range<usize>, at: usize) -> Change {
        Change { at, sizes: WIDTHS.map(|width| Size::of(&self.change(stretch, at, width))) }
    }

    /// Where bursts in a stretch may begin or end.
    fn ends(&self, stretch: &Range<usize>, changes: &[Change], large: &Large) -> Vec<End> {
        let end = |change: &Change| {
            let size = |w: usize| change.sizes[w].map_or(0.0, |size| large.relative(w, size));
            let sizes: [f64; WIDTHS.len()] = from_fn(size);
            let w = (0..WIDTHS.len()).max_by(|a, b| sizes[*a].total_cmp(&sizes[*b]))?;
            let by = || self.change(stretch, change.at, WIDTHS[w]);
            let end = || End { at: change.at, by: by(), size: sizes[w], sum: sizes.iter().sum() };
            (sizes[w] >= LEAST_END).then(end)
        };
        let ends: Vec<End> = changes.iter().filter_map(end).collect();
        let is_less = |one: &End, other: &End| {
            let is_less = other.sum > one.sum || (other.sum == one.sum && other.at < one.at);
            is_less && one.at.abs_diff(other.at) <= APART && dot(&one.by, &other.by) > 0.0
        };
        let is_least = |i: usize| {
            let near = ends[i.saturating_sub(APART)..].iter().take(2 * APART + 1);
            near.into_iter().any(|other| is_less(&ends[i], other))
        };
        let less: Vec<bool> = (0..ends.len()).map(is_least).collect();
        ends.into_iter().zip(less).filter(|(_, less)| !less).map(|(end, _)| end).collect()
    }

    /// The bursts of a stretch with these changes. At its start and at its end, if these are ends, there may be bursts of which
    /// one change is not seen.
    pub fn bursts(
        &self,
        stretch: &Range<usize>,
        are_ends: [bool; 2],
        changes: &[Change],
        large: &Large,
    ) -> Vec<Burst> {
        let ends = self.ends(stretch, changes, large);
        let mut candidates: Vec<Burst> = Vec::new();
        for (e, end) in ends.iter().enumerate() {
            let outer = [stretch.start..end.at, end.at..stretch.end].into_iter().zip(are_ends);
            candidates.extend(outer.filter(|(_, is_end)| *is_end).filter_map(|(frames, _)| {
                let is_short =
                    (ABRUPT_WIDTH..=LONGEST).contains(&frames.len()) && 2 * frames.len() < stretch.len();
                let step = self.change(stretch, end.at, ABRUPT_WIDTH);
                let is_abrupt = dot(&step, &end.by) >= ABRUPT_SHARE * dot(&end.by, &end.by);
                (is_short && is_abrupt && end.size >= LEAST_AT_END).then(|| {
                    let by = if frames.start == end.at { end.by } else { end.by.map(|change| -change) };
                    Burst { frames, by, width: WIDTHS.len() - 1, size: end.size, ends: 1 }
                })
            }));
            let within = ends[e + 1..].iter().take_while(|other| other.at - end.at <= LONGEST);
            candidates.extend(within.filter_map(|other| self.burst(stretch, end.at..other.at, large)));
        }
        candidates.sort_by_key(|burst| (burst.frames.end, burst.frames.start));
        best_of(candidates)
    }

    /// Frames that differ from those before and behind them, if they do.
    fn burst(&self, stretch: &Range<usize>, frames: Range<usize>, large: &Large) -> Option<Burst> {
        // The changes to the frames, and to those outside, from the other side.
        let both = |width: usize| {
            let to = self.change(&(stretch.start..frames.end), frames.start, width);
            let back = self.change(&(frames.start..stretch.end), frames.end, width);
            (to, back.map(|change| -change))
        };
        let width = WIDTHS.iter().rposition(|&width| width <= frames.len())?;
        let (to, back) = both(WIDTHS[WIDTHS.len() - 1]);
        let by = mean_of(&to, &back);
        let size = large.of(width, &by);
        let unlike = large.of(width, &minus(&by, &back));
        let (to, back) = both(ABRUPT_WIDTH);
        let share = |change: &Outline| dot(change, &by) / dot(&by, &by);
        let shares = [share(&to), share(&back)];
        let is_abrupt =
            shares.iter().all(|share| *share >= ABRUPT_END) && shares[0] + shares[1] >= 2.0 * ABRUPT_SHARE;
        let is_burst = size >= 1.0 && unlike <= MOST_UNLIKE * size && is_abrupt;
        is_burst.then_some(Burst { frames, by, width, size, ends: 2 })
    }
}

/// The bursts, with frames in between, that are worth the most. A change that is just large is worth one frame more than the
/// longest burst has, a larger one accordingly more; each frame costs one.
fn best_of(candidates: Vec<Burst>) -> Vec<Burst> {
    let worth = |burst: &Burst| (burst.ends * (LONGEST + 1)) as f64 * burst.size - burst.frames.len() as f64;
    // The worth of the best of the first few, and how many of these come before its last.
    let mut best: Vec<(f64, Option<usize>)> = vec![(0.0, None)];
    for (c, burst) in candidates.iter().enumerate() {
        let before = candidates[..c].partition_point(|other| other.frames.end < burst.frames.start);
        let with = best[before].0 + worth(burst);
        best.push(if with > best[c].0 { (with, Some(before)) } else { (best[c].0, None) });
    }
    let mut is_chosen = vec![false; candidates.len()];
    let mut first = candidates.len();
    while first > 0 {
        match best[first].1 {
            Some(before) => {
                is_chosen[first - 1] = true;
                first = before;
            }
            None => first -= 1,
        }
    }
    candidates
        .into_iter()
        .zip(is_chosen)
        .filter(|(_, is_chosen)| *is_chosen)
        .map(|(burst, _)| burst)
        .collect()
}

impl Burst {
    /// Why one of its frames is left out.
    pub fn why(&self, frame: usize, large: &Large) -> LeftOut {
        let percent = 100.0 * middle(&self.by.map(|change| change.exp_m1().abs())).unwrap_or(0.0);
        let most_percent = 100.0 * large.0[self.width].radius.exp_m1();
        let beside = match self.ends {
            2 => "before and after",
            _ => "beside it",
        };
        LeftOut {
            place: frame,
            frame,
            reason: Reason::OffShape,
            field: "contour",
            found: format!(
                "radii {percent:.0} % off those of the frames {beside}, for {} frames",
                self.frames.len()
            ),
            expected: format!("changes of at most {most_percent:.0} % within a few frames, or for good"),
        }
    }
}

/// The frames by place, to compare passes of the catheter.
struct Passes<'a> {
    sequence: &'a Sequence<'a>,
    /// The frames in each cell of a cubic grid, in order.
    cells: BTreeMap<[i64; 3], Vec<usize>>,
}

impl<'a> Passes<'a> {
    fn of(sequence: &'a Sequence<'a>) -> Self {
        let mut passes = Self { sequence, cells: BTreeMap::new() };
        for i in 0..sequence.seen.len() {
            passes.cells.entry(passes.cell(i)).or_default().push(i);
        }
        passes
    }

    /// Half of the lumen's radius wide.
    fn cell(&self, i: usize) -> [i64; 3] {
        let within_mm = (WITHIN_RADII * self.sequence.radius_mm).max(f64::MIN_POSITIVE);
        let cell = (self.sequence.seen[i].pose.translation_mm / within_mm).floor();
        // So that neighbours have numbers too, however small the lumen.
        cell.clamp(DVec3::splat(-MAX_CELL), DVec3::splat(MAX_CELL)).as_i64vec3().to_array()
    }

    /// Whether nearly all other passes saw the outlines of a burst at its places, for most of its frames, and those of the frames
    /// before and behind it at theirs. Anatomy repeats itself so, two wrong segmentations hardly do.
    fn confirm(&self, burst: &Burst, large: &Large) -> bool {
        let Range { start, end } = burst.frames;
        let beside = WIDTHS[WIDTHS.len() - 1];
        let before = start.saturating_sub(beside)..start;
        let after = end..self.sequence.seen.len().min(end + beside);
        let votes = |frames: &Range<usize>| {
            let votes = frames.clone().map(|i| self.votes(i, frames, burst, large));
            votes.fold([0, 0], |[a, b], [alike, other]| [a + alike, b + other])
        };
        let within = votes(&burst.frames);
        2 * within[0] >= burst.frames.len()
            && [within, votes(&before), votes(&after)].iter().all(|[a, b]| *a >= LEAST_ALIKE * b)
    }

    /// How many other passes saw the outline that a frame shows with those beside it, and how many saw another one.
    fn votes(&self, i: usize, beside: &Range<usize>, burst: &Burst, large: &Large) -> [usize; 2] {
        let seen = &self.sequence.seen;
        let cell = self.cell(i);
        let cells = (0..27).map(|k| [cell[0] + k % 3 - 1, cell[1] + k / 3 % 3 - 1, cell[2] + k / 9 - 1]);
        let mut near: Vec<(usize, f64)> = cells
            .filter_map(|cell| self.cells.get(&cell))
            .flatten()
            .map(|&j| (j, self.apart_mm(i, j)))
            .filter(|(_, apart_mm)| *apart_mm <= WITHIN_RADII * self.sequence.radius_mm)
            .collect();
        near.sort_unstable_by_key(|(j, _)| *j);
        let is_one_pass =
            |a: &(usize, f64), b: &(usize, f64)| seen[b.0].number - seen[a.0].number <= PASS_GAP;
        near.chunk_by(is_one_pass)
            .filter(|pass| pass.iter().all(|(j, _)| *j != i))
            .filter_map(|pass| pass.iter().min_by(|a, b| a.1.total_cmp(&b.1)))
            .fold([0, 0], |[alike, other], &(j, _)| {
                match large.of(burst.width, &self.difference(i, beside, j)) <= burst.size / 2.0 {
                    true => [alike + 1, other],
                    false => [alike, other + 1],
                }
            })
    }

    /// By how much the outlines about frame `i`, of those in a range, differ from those about frame `j`.
    fn difference(&self, i: usize, within: &Range<usize>, j: usize) -> Outline {
        let seen = &self.sequence.seen;
        let half = WIDTHS[WIDTHS.len() - 1] / 2;
        let about = |i: usize, within: &Range<usize>| {
            self.sequence.mean(within.start.max(i.saturating_sub(half))..within.end.min(i + half + 1))
        };
        let (here, there) = (about(i, within), about(j, &(0..seen.len())));
        let turn_rad = roll_rad(&seen[i].pose, &seen[j].pose) + seen[i].roll_rad - seen[j].roll_rad;
        let turn = (turn_rad / TAU * DIRECTIONS as f64).round().rem_euclid(DIRECTIONS as f64) as usize;
        from_fn(|d| here[(d + turn) % DIRECTIONS] - there[d])
    }

    /// How far a contour's points are from where another one's are, mm, turns about the probe's own axis left aside.
    fn apart_mm(&self, i: usize, j: usize) -> f64 {
        let [a, b] = [i, j].map(|k| &self.sequence.seen[k].pose);
        let tilt_rad = a.rotation.z_axis.angle_between(b.rotation.z_axis);
        a.translation_mm.distance(b.translation_mm) + self.sequence.radius_mm * tilt_rad
    }
}
