//! Second moments of residuals: how alike they are along a contour and from frame to frame.

use super::process::Seen;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Sectors of a contour.
const SECTORS: usize = 24;
/// Distances along a contour, in sectors, and in time, in frames, over which residuals are compared.
const APART: [usize; 6] = [0, 1, 2, 4, 7, 12];
const LAGS: [usize; 7] = [1, 2, 4, 8, 16, 32, 64];
/// Stretches of the recording whose scatter tells how well a moment is known.
const STRETCHES: usize = 8;

/// Sums of products of residuals, per moment and stretch of the recording.
pub(super) type Sums = Vec<[f64; STRETCHES]>;

/// The echoes of a recording, by frames and sectors of their contours.
pub(super) struct Sectors {
    /// Frame and sector of each echo, as one index; `None` for an echo off the wall.
    cells: Vec<Option<u32>>,
    frames: usize,
    counts: Vec<f64>,
    /// Number of products behind each moment.
    pairs: Sums,
}

impl Sectors {
    /// The cells of echoes; those that are not on the wall have none.
    pub(super) fn of(echoes: &[Seen], is_on_wall: &[bool], frames: usize) -> Self {
        let cell = |(echo, is_on_wall): (&Seen, &bool)| {
            let turns = (echo.theta_rad / TAU).rem_euclid(1.0);
            let sector = (turns * SECTORS as f64) as usize % SECTORS;
            is_on_wall.then_some((echo.frame as usize * SECTORS + sector) as u32)
        };
        let cells: Vec<Option<u32>> = echoes.par_iter().zip(is_on_wall).map(cell).collect();
        let mut counts = vec![0.0; frames * SECTORS];
        cells.iter().flatten().for_each(|&cell| counts[cell as usize] += 1.0);
        let pairs = products(&counts, &counts, frames);
        Self { cells, frames, counts, pairs }
    }

    /// Moments of the residuals of the echoes.
    pub(super) fn sums(&self, residuals_mm: &[f64]) -> Sums {
        let (mut sums, mut squares) = (vec![0.0; self.counts.len()], vec![0.0; self.counts.len()]);
        for (cell, residual) in self.cells.iter().zip(residuals_mm) {
            if let Some(cell) = cell {
                sums[*cell as usize] += residual;
                squares[*cell as usize] += residual * residual;
            }
        }
        products(&sums, &squares, self.frames)
    }

    /// Means of the products that were summed, without those of one stretch.
    fn means_without(&self, sums: &Sums, left_out: Option<usize>) -> Vec<f64> {
        let total = |of: &[f64; STRETCHES]| {
            of.iter().enumerate().filter(|(k, _)| Some(*k) != left_out).map(|(_, x)| x).sum::<f64>()
        };
        sums.iter().zip(&self.pairs).map(|(sums, pairs)| total(sums) / total(pairs).max(1.0)).collect()
    }

    /// Means of the products that were summed.
    pub(super) fn means(&self, sums: &Sums) -> Vec<f64> {
        self.means_without(sums, None)
    }

    /// Standard deviations of the means, by the jackknife over the stretches.
    pub(super) fn errors(&self, sums: &Sums) -> Vec<f64> {
        let without: Vec<Vec<f64>> = (0..STRETCHES).map(|k| self.means_without(sums, Some(k))).collect();
        let scatter = |m: usize| {
            let mean = without.iter().map(|w| w[m]).sum::<f64>() / STRETCHES as f64;
            let squares = without.iter().map(|w| (w[m] - mean).powi(2)).sum::<f64>();
            (squares * (STRETCHES - 1) as f64 / STRETCHES as f64).sqrt()
        };
        (0..sums.len()).map(scatter).collect()
    }
}

/// Sums of products: of each residual with itself, then within frames, then between frames. `own` are the products of the
/// residuals of a cell with themselves, which do not count as pairs within a frame.
fn products(sums: &[f64], own: &[f64], frames: usize) -> Sums {
    let stretch = |frame: usize| frame * STRETCHES / frames.max(1);
    let row = |of: &[f64], frame: usize| -> [f64; SECTORS] {
        std::array::from_fn(|sector| of[frame * SECTORS + sector])
    };
    let mut all = Sums::new();
    let mut squares = [0.0; STRETCHES];
    for frame in 0..frames {
        squares[stretch(frame)] += row(own, frame).iter().sum::<f64>();
    }
    all.push(squares);
    let of_lag = |lag: usize| -> Sums {
        let mut sums_at = vec![[0.0; STRETCHES]; APART.len()];
        for frame in 0..frames.saturating_sub(lag) {
            let (here, there) = (row(sums, frame), row(sums, frame + lag));
            for (at, apart) in sums_at.iter_mut().zip(APART) {
                let product = |sector: usize| {
                    let [after, before] =
                        [sector + apart, sector + SECTORS - apart].map(|s| there[s % SECTORS]);
                    0.5 * here[sector] * (after + before)
                };
                let mut sum: f64 = (0..SECTORS).map(product).sum();
                if lag == 0 && apart == 0 {
                    sum -= row(own, frame).iter().sum::<f64>();
                }
                at[stretch(frame)] += sum;
            }
        }
        sums_at
    };
    let lags: Vec<usize> = std::iter::once(0).chain(LAGS).collect();
    let by_lag: Vec<Sums> = lags.par_iter().map(|&lag| of_lag(lag)).collect();
    all.extend(by_lag.into_iter().flatten());
    all
}
