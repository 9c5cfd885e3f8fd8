//! Second moments of residuals: how alike they are along a contour and from frame to frame.

use super::process::Seen;
use crate::numerics::vectorized;
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
    /// Frame and sector of each echo, as one index; one behind the last for an echo off the wall.
    cells: Vec<u32>,
    frames: usize,
    /// Number of products behind each moment.
    pairs: Sums,
}

impl Sectors {
    /// The cells of echoes; those that are not on the wall have none.
    pub(super) fn of(echoes: &[Seen], is_on_wall: &[bool], frames: usize) -> Self {
        let off_wall = (frames * SECTORS) as u32;
        let cell = |(echo, is_on_wall): (&Seen, &bool)| {
            let sector = (f64::from(echo.theta_rad) / TAU * SECTORS as f64) as usize % SECTORS;
            if *is_on_wall { echo.frame * SECTORS as u32 + sector as u32 } else { off_wall }
        };
        let cells: Vec<u32> = echoes.par_iter().zip(is_on_wall).map(cell).collect();
        // Residuals of 1 count the pairs.
        let mut sectors = Self { cells, frames, pairs: Sums::new() };
        sectors.pairs = sectors.sums(std::iter::repeat_n(1.0, echoes.len()));
        sectors
    }

    /// Moments of the residuals of the echoes.
    pub(super) fn sums(&self, residuals_mm: impl IntoIterator<Item = f64>) -> Sums {
        let mut sums = vec![[0.0; 2]; self.frames * SECTORS + 1];
        for (cell, residual) in self.cells.iter().zip(residuals_mm) {
            let [sum, square] = &mut sums[*cell as usize];
            *sum += residual;
            *square += residual * residual;
        }
        let row = |of: usize, frame: usize| -> [f64; SECTORS] {
            std::array::from_fn(|sector| sums[frame * SECTORS + sector][of])
        };
        let [sums, squares] =
            [0, 1].map(|of| (0..self.frames).map(|frame| row(of, frame)).collect::<Vec<_>>());
        products(&sums, &squares)
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

/// Sums of products: of each residual with itself, then within frames, then between frames; of the sums over the sectors of
/// every frame. `squares` are the sums of the residuals' own squares, which do not count as pairs within a frame.
fn products(sums: &[[f64; SECTORS]], squares: &[[f64; SECTORS]]) -> Sums {
    let frames = sums.len();
    let stretch = |frame: usize| frame * STRETCHES / frames.max(1);
    let mut own = [0.0; STRETCHES];
    for (frame, squares) in squares.iter().enumerate() {
        own[stretch(frame)] += squares.iter().sum::<f64>();
    }
    let of_lag = |lag: usize| -> Sums {
        let mut sums_at = vec![[0.0; STRETCHES]; APART.len()];
        let mut first = 0;
        while first + lag < frames {
            let here = stretch(first);
            let next = (first + 1..frames - lag).find(|&k| stretch(k) != here).unwrap_or(frames - lag);
            let (from, to) = (&sums[first..next], &sums[first + lag..next + lag]);
            let of_stretch = vectorized(
                #[inline(always)]
                || products_apart(from, to),
            );
            sums_at.iter_mut().zip(of_stretch).for_each(|(at, sum)| at[here] = sum);
            first = next;
        }
        if lag == 0 {
            sums_at[0].iter_mut().zip(own).for_each(|(sum, own)| *sum -= own);
        }
        sums_at
    };
    let lags: Vec<usize> = std::iter::once(0).chain(LAGS).collect();
    let by_lag: Vec<Sums> = lags.par_iter().map(|&lag| of_lag(lag)).collect();
    std::iter::once(own).chain(by_lag.into_iter().flatten()).collect()
}

/// Sums over pairs of frames of the products of sectors that are [`APART`], in either direction.
#[inline(always)]
fn products_apart(from: &[[f64; SECTORS]], to: &[[f64; SECTORS]]) -> [f64; APART.len()] {
    let mut by_sector = [[0.0; SECTORS]; APART.len()];
    for (here, there) in from.iter().zip(to) {
        let mut round = [0.0; 2 * SECTORS];
        round[..SECTORS].copy_from_slice(there);
        round[SECTORS..].copy_from_slice(there);
        for (sums, apart) in by_sector.iter_mut().zip(APART) {
            let (after, before) = (&round[apart..][..SECTORS], &round[SECTORS - apart..][..SECTORS]);
            for (((sum, here), after), before) in sums.iter_mut().zip(here).zip(after).zip(before) {
                *sum += 0.5 * here * (after + before);
            }
        }
    }
    by_sector.map(|sums| sums.iter().sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_pair_after_pair() {
        // Some sectors of 150 frames have two echoes, some none; every seventh echo is off the wall.
        let (seen, residuals_mm): (Vec<Seen>, Vec<f64>) = (0..2400_u32)
            .map(|i| (Seen::new(1.7 * f64::from(i), i / 16), (0.9 * f64::from(i * i % 811)).sin()))
            .unzip();
        let is_on_wall: Vec<bool> = (0..2400).map(|i| i % 7 > 0).collect();
        let sectors = Sectors::of(&seen, &is_on_wall, 150);
        let means = sectors.means(&sectors.sums(residuals_mm.iter().copied()));
        let mut expected = vec![[0.0; 2]; 1 + (1 + LAGS.len()) * APART.len()];
        let mut add = |moment: usize, product: f64, pairs: f64| {
            expected[moment][0] += product;
            expected[moment][1] += pairs;
        };
        let sector = |i: usize| (f64::from(seen[i].theta_rad) / TAU * SECTORS as f64) as usize;
        let on_wall: Vec<usize> = (0..2400).filter(|&i| is_on_wall[i]).collect();
        for &i in &on_wall {
            add(0, residuals_mm[i] * residuals_mm[i], 1.0);
            for &j in &on_wall {
                let lag = (seen[j].frame as usize).wrapping_sub(seen[i].frame as usize);
                let Some(lag) = std::iter::once(0).chain(LAGS).position(|l| l == lag) else { continue };
                for (k, apart) in APART.into_iter().enumerate() {
                    let (from, to) = (sector(i), sector(j));
                    let ways = [from + apart, from + SECTORS - apart];
                    let pairs = 0.5 * ways.iter().filter(|way| *way % SECTORS == to).count() as f64;
                    if i != j && pairs > 0.0 {
                        add(1 + lag * APART.len() + k, pairs * residuals_mm[i] * residuals_mm[j], pairs);
                    }
                }
            }
        }
        assert_eq!(means.len(), expected.len());
        for (mean, [product, pairs]) in means.iter().zip(expected) {
            assert!(pairs > 0.0 && (mean - product / pairs).abs() < 1e-12, "{mean} {product} {pairs}");
        }
    }
}
