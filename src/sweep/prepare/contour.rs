//! The outline of a single contour: its points without wrong echoes, and whether it is star-shaped about its centre.

use crate::numerics::robust::median;
use crate::numerics::vectorized;
use crate::recording::Frame;
use crate::{Error, Result};
use glam::DVec2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::time::Instant;

/// The lumen's outline in a frame, without wrong echoes and noise.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct Outline {
    /// Centroid of its area in the probe's plane, mm.
    pub centre_mm: DVec2,
    /// Radius of the circle with its area, mm.
    pub radius_mm: f64,
    /// See [`folded_share`].
    pub folded_share: f64,
    /// See [`noise_mm`].
    pub noise_mm: f64,
}

impl Outline {
    /// `None` for a contour that encloses no area.
    pub(crate) fn of(frame: &Frame) -> Option<Self> {
        let points = without_spikes(&frame.contour_mm);
        let noise_mm = noise_mm(&points);
        let outline = Frame { contour_mm: smoothed(&points, noise_mm), ..*frame };
        let centre_mm = outline.centroid_mm()?;
        let folded_share = folded_share(&outline.contour_mm, centre_mm);
        let first = *outline.contour_mm.first()?;
        let pairs = outline.contour_mm.windows(2).map(|pair| [pair[0] - first, pair[1] - first]);
        let twice_area: f64 = pairs.map(|[a, b]| a.perp_dot(b)).sum();
        Some(Self { centre_mm, radius_mm: (twice_area.abs() / TAU).sqrt(), folded_share, noise_mm })
    }

    /// Whether every ray from the centre meets the wall once, nearly.
    pub(crate) fn is_star_shaped(&self) -> bool {
        self.folded_share <= MAX_FOLDED
    }
}

/// The outlines of the contours of some frames, `None` for those that enclose no area, and the seconds that finding them took.
#[derive(Debug, Clone)]
pub(crate) struct Outlines {
    pub of_frames: Vec<Option<Outline>>,
    pub seconds: f64,
}

impl Outlines {
    pub fn of(frames: &[Frame]) -> Self {
        let start = Instant::now();
        let of_frames = frames.par_iter().map(Outline::of).collect();
        Self { of_frames, seconds: start.elapsed().as_secs_f64() }
    }

    /// Those of some of the frames; they take no further time.
    pub fn part(&self, frames: &[usize]) -> Self {
        Self { of_frames: frames.iter().map(|&k| self.of_frames[k]).collect(), seconds: 0.0 }
    }
}

/// Points on either side that a point is compared with: wrong echoes occur alone or in twos and threes.
const NEIGHBOURS: usize = 4;
/// Points farther from the median of their neighbourhood than this many times the usual distance are wrong echoes.
const MAX_DISTANCES: f64 = 6.0;

/// The echoes of a contour in ray order, without those far from the median of their neighbours: one spike as long as the
/// probe's range moves the centroid of a small lumen by more than its radius.
fn without_spikes(contour_mm: &[DVec2]) -> Vec<DVec2> {
    let points: Vec<DVec2> = contour_mm.iter().copied().filter(|p| !p.is_nan()).collect();
    let count = points.len();
    if count <= 2 * NEIGHBOURS {
        return points;
    }
    let round: Vec<DVec2> = wrapped(&points, NEIGHBOURS);
    let [x, y] = [|p: &DVec2| p.x, |p: &DVec2| p.y].map(|part| {
        let of_round: Vec<f64> = round.iter().map(part).collect();
        medians_of_nine(&of_round)
    });
    let middles = x.into_iter().zip(y).map(|(x, y)| DVec2::new(x, y));
    let distances: Vec<f64> = points.iter().zip(middles).map(|(p, middle)| p.distance(middle)).collect();
    // Where a contour bends, the median of 9 points may be as far from it as they are from each other.
    let mut steps: Vec<f64> = (0..count).map(|i| points[i].distance(points[(i + 1) % count])).collect();
    let max = MAX_DISTANCES * median(&mut distances.clone()) + NEIGHBOURS as f64 * median(&mut steps);
    points.into_iter().zip(distances).filter(|(_, distance)| *distance <= max).map(|(p, _)| p).collect()
}

/// The points of a closed contour, with so many of its last ones before them and of its first ones after them.
fn wrapped(points: &[DVec2], beyond: usize) -> Vec<DVec2> {
    let before = &points[points.len() - beyond..];
    [before, points, &points[..beyond]].concat()
}

/// The medians of every nine successive numbers.
fn medians_of_nine(numbers: &[f64]) -> Vec<f64> {
    let count = numbers.len().saturating_sub(8);
    let mut medians = vec![0.0; count];
    vectorized(
        #[inline(always)]
        || {
            for (block, medians) in medians.chunks_mut(SIDE_BY_SIDE).enumerate() {
                let first = block * SIDE_BY_SIDE;
                let of_nine = |k: usize| {
                    let here = &numbers[first + k..];
                    here.first_chunk().copied().unwrap_or_else(|| {
                        let mut padded = [0.0; SIDE_BY_SIDE];
                        padded[..here.len()].copy_from_slice(here);
                        padded
                    })
                };
                let middle = median_of_nine(std::array::from_fn(of_nine));
                medians.copy_from_slice(&middle[..medians.len()]);
            }
        },
    );
    medians
}

/// Medians that are found side by side, in the registers of a processor.
const SIDE_BY_SIDE: usize = 8;

/// The median of nine numbers, for several nines, by a network that compares and swaps (*Median finding on a 3 × 3 grid*, Graphics
/// Gems, 1990).
#[inline(always)]
fn median_of_nine(mut x: [[f64; SIDE_BY_SIDE]; 9]) -> [f64; SIDE_BY_SIDE] {
    // One instruction each, which `f64::min` is not: it minds NaN.
    let (least, greatest) = (|a: f64, b| if a < b { a } else { b }, |a: f64, b| if a > b { a } else { b });
    let mut swap = |low: usize, high: usize| {
        let (a, b) = (x[low], x[high]);
        x[low] = std::array::from_fn(|lane| least(a[lane], b[lane]));
        x[high] = std::array::from_fn(|lane| greatest(a[lane], b[lane]));
    };
    // One after the other, not in a loop: so all numbers stay in registers.
    swap(1, 2);
    swap(4, 5);
    swap(7, 8);
    swap(0, 1);
    swap(3, 4);
    swap(6, 7);
    swap(1, 2);
    swap(4, 5);
    swap(7, 8);
    swap(0, 3);
    swap(5, 8);
    swap(4, 7);
    swap(3, 6);
    swap(1, 4);
    swap(2, 5);
    swap(4, 7);
    swap(4, 2);
    swap(6, 4);
    swap(4, 2);
    x[4]
}

/// Largest accepted folded share: the carina of a bifurcation may reach past the centre of the contour about it.
pub(in crate::sweep) const MAX_FOLDED: f64 = 0.2;

/// Standard deviation of a closed contour's points in either direction, mm.
///
/// Fourth differences of noise have seventy times its variance; those of a smooth curve are almost 0.
fn noise_mm(points: &[DVec2]) -> f64 {
    let next = points.iter().copied().cycle();
    let round: Vec<DVec2> = next.take(if points.is_empty() { 0 } else { points.len() + 4 }).collect();
    let bend = |p: &[DVec2; 5]| (p[0] + p[4] - (p[1] + p[3]) * 4.0 + p[2] * 6.0).length();
    let mut bends: Vec<f64> = round.array_windows().map(bend).collect();
    // The median length of a vector of two standard normal numbers is 1.18.
    median(&mut bends) / 1.18 / 70.0_f64.sqrt()
}

/// A closed contour without its noise: each point is averaged with a number of neighbours that grows with the noise, none
/// without noise. Noise makes a contour of many points cross itself everywhere, so that its area has no centre.
fn smoothed(points: &[DVec2], noise: f64) -> Vec<DVec2> {
    let count = points.len();
    if count < 3 {
        return points.to_vec();
    }
    // From point to point, noise moves the mean of 2h + 1 points by noise·√2/(2h + 1); a circle advances by its length
    // over the number of points. The window makes the former a quarter of the latter.
    let mean = points.iter().sum::<DVec2>() / count as f64;
    let radius = (points.iter().map(|p| p.distance_squared(mean)).sum::<f64>() / count as f64).sqrt();
    let step = radius * TAU / count as f64;
    let width = 4.0 * 2.0_f64.sqrt() * noise / step.max(f64::MIN_POSITIVE);
    let reach = ((width - 1.0) / 2.0).ceil().clamp(0.0, count as f64 / 8.0) as usize;
    let width = (2 * reach + 1) as f64;
    let round = wrapped(points, reach);
    // Such means of a circle's points lie on a circle that is smaller by this factor.
    let half = TAU / count as f64 / 2.0;
    let shrink = (width * half).sin() / (width * half.sin());
    round
        .windows(2 * reach + 1)
        .map(|window| mean + (window.iter().sum::<DVec2>() / width - mean) / shrink)
        .collect()
}

/// How much a contour turns back about its centroid: the area that the ray from there to the contour sweeps backwards, as
/// a share of the area that it sweeps forwards. 0 where the lumen is star-shaped about the centroid: every ray from there
/// meets the wall once.
fn folded_share(contour_mm: &[DVec2], centroid_mm: DVec2) -> f64 {
    let next = contour_mm.iter().cycle().skip(1);
    let (mut forwards, mut backwards) = (0.0, 0.0);
    for (a, b) in contour_mm.iter().zip(next) {
        let area = (a - centroid_mm).perp_dot(b - centroid_mm);
        if area > 0.0 { forwards += area } else { backwards -= area }
    }
    forwards.min(backwards) / forwards.max(backwards).max(f64::MIN_POSITIVE)
}

/// The frames whose contours are not star-shaped about their centres.
pub(in crate::sweep) fn folded_frames(outlines: &[Option<Outline>]) -> Result<Vec<usize>> {
    let share = |k: usize| outlines[k].map_or(0.0, |outline| outline.folded_share);
    let folded: Vec<usize> = (0..outlines.len()).filter(|&k| share(k) > MAX_FOLDED).collect();
    let with_outline = outlines.iter().flatten().count();
    match folded.first() {
        Some(&frame) if 2 * folded.len() > with_outline => Err(Error::Frame {
            frame,
            field: "contour",
            found: format!(
                "one that turns back about its centre ({:.0} % of the area that it goes round), as do {} of {with_outline}",
                100.0 * share(frame),
                folded.len()
            ),
            expected: "star-shaped lumens: every ray from the centre meets the wall once".into(),
        }),
        _ => Ok(folded),
    }
}

/// Wall points of all contours.
pub(in crate::sweep) fn echo_count(contours_mm: &[&[DVec2]]) -> usize {
    contours_mm.iter().map(|contour_mm| contour_mm.iter().filter(|p| !p.is_nan()).count()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// 120 points at `r(θ)`, each moved by noise.
    fn contour(r: impl Fn(f64) -> f64, noise: f64) -> Vec<DVec2> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut shake =
            || (rng.random::<f64>() + rng.random::<f64>() + rng.random::<f64>() - 1.5) * 2.0 * noise;
        (0..120)
            .map(|i| f64::from(i) / 120.0 * TAU)
            .map(|a| DVec2::from_angle(a) * r(a) + DVec2::new(shake(), shake()))
            .collect()
    }

    /// A lumen bent round the origin, from 2 to 3 mm away from it, over `angle` rad.
    fn horseshoe(angle: f64) -> Vec<DVec2> {
        let arc = |radius: f64, j: i32| DVec2::from_angle(f64::from(j) / 60.0 * angle) * radius;
        (0..60).map(|j| arc(3.0, j)).chain((0..60).rev().map(|j| arc(2.0, j))).collect()
    }

    fn share(contour: &[DVec2]) -> f64 {
        let frame = Frame::new(crate::geometry::Pose::IDENTITY, contour.to_vec());
        Outline::of(&frame).unwrap().folded_share
    }

    #[test]
    fn the_median_of_nine_is_the_middle_one() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(9);
        for count in [8, 9, 15, 16, 17, 1000] {
            // Few different values, so that some are equal.
            let numbers: Vec<f64> = (0..count).map(|_| (12.0 * rng.random::<f64>()).floor()).collect();
            let middle = |nine: &[f64; 9]| {
                let mut sorted = *nine;
                sorted.sort_by(f64::total_cmp);
                sorted[4]
            };
            let expected: Vec<f64> = numbers.array_windows().map(middle).collect();
            assert_eq!(medians_of_nine(&numbers), expected, "{count}");
        }
    }

    #[test]
    fn what_is_star_shaped_is_not_folded() {
        let slit = |a: f64| 1.0 / (a.cos() / 3.5).hypot(a.sin() / 0.5);
        let lobes = |a: f64| 3.0 + (3.0 * a).cos();
        assert_eq!(share(&contour(|_| 3.0, 0.0)), 0.0);
        assert_eq!(share(&contour(slit, 0.0)), 0.0);
        assert_eq!(share(&contour(lobes, 0.0)), 0.0);
        let mut reversed = contour(lobes, 0.0);
        reversed.reverse();
        assert_eq!(share(&reversed), 0.0);
    }

    #[test]
    fn an_outline_keeps_centre_and_size() {
        let away = DVec2::new(40.0, -7.0);
        for noise in [0.0, 0.3, 1.0] {
            let noisy: Vec<DVec2> = contour(|_| 3.0, noise).into_iter().map(|p| p + away).collect();
            let outline = smoothed(&noisy, noise_mm(&noisy));
            let radii: Vec<f64> = outline.iter().map(|p| p.distance(away)).collect();
            let mean = radii.iter().sum::<f64>() / 120.0;
            assert!((mean - 3.0).abs() < 0.01 + 0.3 * noise, "{noise}: {mean}");
            let found = noise_mm(&noisy);
            assert!((found - noise).abs() < 0.25 * noise + 0.01, "{noise}: {found}");
            assert_eq!(noise == 0.0, outline.iter().zip(&noisy).all(|(a, b)| a.distance(*b) < 1e-12));
        }
    }

    #[test]
    fn noise_folds_no_contour() {
        // Points 0.16 mm apart that noise moves by up to three times that.
        for noise in [0.05, 0.2, 0.5] {
            let share = share(&contour(|_| 3.0, noise));
            assert!(share < MAX_FOLDED / 4.0, "{noise}: {share}");
        }
    }

    #[test]
    fn a_horseshoe_is_folded_whichever_way_it_is_drawn() {
        for angle in [4.0, 5.0, 6.0] {
            let mut contour = horseshoe(angle);
            assert!(share(&contour) > MAX_FOLDED, "{angle}: {}", share(&contour));
            contour.reverse();
            assert!(share(&contour) > MAX_FOLDED, "{angle}");
        }
    }

    #[test]
    fn spikes_are_dropped_and_nothing_else() {
        let slit = |a: f64| 1.0 / (a.cos() / 3.5).hypot(a.sin() / 0.5);
        // The tips of a slit are steep.
        for (clean, lost) in [(contour(|_| 3.0, 0.0), 0), (contour(|_| 3.0, 0.3), 1), (contour(slit, 0.0), 8)]
        {
            let kept = without_spikes(&clean);
            assert!(kept.len() >= clean.len() - lost, "{}", kept.len());
            let mut spiked = clean.clone();
            for i in (0..120).step_by(12) {
                spiked[i] *= 9.0;
                spiked[i + 1] = DVec2::NAN;
            }
            let left = without_spikes(&spiked);
            let far = left.iter().filter(|p| !clean.contains(p)).count();
            assert!(far == 0 && left.len() >= 100 - lost, "{far} {}", left.len());
        }
        assert_eq!(without_spikes(&[DVec2::X, DVec2::NAN]), [DVec2::X]);
    }

    #[test]
    fn too_few_points_fold_nowhere() {
        assert_eq!(folded_share(&[], DVec2::ZERO), 0.0);
        assert_eq!(folded_share(&smoothed(&[], 0.0), DVec2::ZERO), 0.0);
        assert_eq!(folded_share(&smoothed(&[DVec2::X; 9], 0.0), DVec2::X), 0.0);
    }
}
