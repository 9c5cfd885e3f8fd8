//! Points grouped by face: a counting sort, once per cylinder, since a node moves in r only and a point's face
//! never changes.

use crate::cylinders::passes::{Section, TubeGrid};
use crate::cylinders::tube::Tube;
use crate::numerics::Scalar;
use rayon::prelude::*;

/// Points that one task takes from the section.
const RUN: usize = 1 << 16;
/// Largest number of buckets: runs of faces that one task fills.
const BUCKETS: usize = 512;

/// A section's points, face after face.
#[derive(Debug, Clone, Default)]
pub struct Groups<T> {
    /// Where each face's points begin; one entry more than there are faces.
    pub offsets: Vec<u32>,
    /// r (mm), θ - θⱼ (rad) and z - zₗ (mm) of each point: measured from the face's corner a, so that they stay
    /// small, which preserves f32 precision.
    pub points: Vec<[T; 3]>,
}

impl<T: Scalar> Groups<T> {
    /// The points of a face.
    pub fn of_face(&self, face: usize) -> &[[T; 3]] {
        &self.points[self.offsets[face] as usize..self.offsets[face + 1] as usize]
    }
}

/// A run of points, bucket after bucket.
struct Sorted<T> {
    /// Where each bucket begins, and the end.
    starts: Vec<u32>,
    /// The face of each point, counted from the first of its bucket, and the point from the face's corner.
    points: Vec<(u32, [T; 3])>,
}

/// Groups a section's points by face; those of a face stay in the order of the section.
pub fn group<T: Scalar>(section: &Section<T>, tube: &Tube) -> Groups<T> {
    converted_and_grouped(section, tube)
}

/// As [`group`], of a section in numbers of another type, which are rounded first.
///
/// Two counting sorts: every run of points by bucket, then every bucket by face. Both work within a processor's cache,
/// and neither's tasks depend on the number of threads.
pub(super) fn converted_and_grouped<S: Scalar, T: Scalar>(section: &Section<S>, tube: &Tube) -> Groups<T> {
    let (faces, count) = (tube.face_count(), section.len());
    let grid = TubeGrid::<T>::new(tube);
    let in_bucket = faces.div_ceil(BUCKETS).max(1);
    let buckets = faces.div_ceil(in_bucket);
    let sort = |run: usize| {
        let run = run * RUN..count.min((run + 1) * RUN);
        let coordinates = section.r[run.clone()].iter().zip(&section.theta[run.clone()]).zip(&section.z[run]);
        let convert = |x: &S| T::from_f64(x.to_f64());
        let faced: Vec<(u32, [T; 3])> = coordinates
            .map(|((r, theta), z)| {
                let (theta, z) = (convert(theta), convert(z));
                let (level, node) = grid.face(theta, z);
                (level * grid.nodes + node, grid.from_corner([convert(r), theta, z], level, node))
            })
            .collect();
        let mut starts = vec![0_u32; buckets + 1];
        faced.iter().for_each(|(face, _)| starts[*face as usize / in_bucket + 1] += 1);
        add_up(&mut starts[1..], 0);
        let mut next = starts.clone();
        let mut points = vec![(0, [T::default(); 3]); faced.len()];
        for (face, point) in faced {
            let place = &mut next[face as usize / in_bucket];
            points[*place as usize] = (face % in_bucket as u32, point);
            *place += 1;
        }
        Sorted { starts, points }
    };
    let runs: Vec<Sorted<T>> = (0..count.div_ceil(RUN)).into_par_iter().map(sort).collect();

    let mut ends: Vec<u32> = (0..buckets)
        .map(|bucket| runs.iter().map(|run| run.starts[bucket + 1] - run.starts[bucket]).sum())
        .collect();
    add_up(&mut ends, 0);
    let mut offsets = vec![0_u32; faces + 1];
    let mut points = vec![[T::default(); 3]; count];
    let mut tasks = Vec::with_capacity(buckets);
    let (mut rest, mut first) = (&mut points[..], 0);
    for (bucket, (&end, offsets)) in ends.iter().zip(offsets[1..].chunks_mut(in_bucket)).enumerate() {
        let (own, others) = rest.split_at_mut((end - first) as usize);
        tasks.push((bucket, first, own, offsets));
        (rest, first) = (others, end);
    }
    tasks.into_par_iter().for_each(|(bucket, first, points, ends)| {
        let of_runs = || {
            runs.iter()
                .flat_map(|run| &run.points[run.starts[bucket] as usize..run.starts[bucket + 1] as usize])
        };
        of_runs().for_each(|(face, _)| ends[*face as usize] += 1);
        let mut next: Vec<u32> = ends.to_vec();
        add_up(ends, first);
        next.iter_mut().zip(&*ends).for_each(|(count, end)| *count = end - *count - first);
        for (face, point) in of_runs() {
            let place = &mut next[*face as usize];
            points[*place as usize] = *point;
            *place += 1;
        }
    });
    Groups { offsets, points }
}

/// Replaces counts by where they end, after `first`.
fn add_up(counts: &mut [u32], first: u32) {
    counts.iter_mut().fold(first, |end, count| {
        *count += end;
        *count
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cylinders::passes::{bin, scan_downsweep, scan_reduce, scan_spine, scatter};
    use rand::{RngExt, SeedableRng};

    #[test]
    fn points_are_grouped_as_by_the_passes_on_any_number_of_threads() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        for (nodes, levels, count) in
            [(3, 1, 0), (12, 5, 1), (12, 5, RUN - 1), (64, 9, RUN), (300, 200, 3 * RUN + 1)]
        {
            let tube = Tube { nodes, levels, height_mm: 10.0 };
            let mut section = Section::<f32>::default();
            for _ in 0..count {
                section.r.push(rng.random_range(5.0..15.0));
                // A third of the points in one face, others at the ends.
                let [theta, z] = [rng.random_range(0..3), rng.random_range(0..3)];
                section.theta.push([0.01, 6.25, rng.random_range(0.0..6.25)][theta]);
                section.z.push([-4.99, 5.0, rng.random_range(-5.0..5.0)][z]);
            }
            let grid = TubeGrid::<f32>::new(&tube);
            let mut counts = vec![0; tube.face_count()];
            let places = bin(&section, None, &grid, &mut counts);
            let mut block_sums = scan_reduce(&counts);
            scan_spine(&mut block_sums);
            let offsets = scan_downsweep(&counts, &block_sums);
            let mut points = vec![[0.0; 3]; count];
            scatter(&section, &places, &offsets, &grid, &mut points);
            for threads in [1, 2, 3, 8] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let found = pool.install(|| group(&section, &tube));
                assert_eq!(found.offsets, offsets);
                assert_eq!(found.points, points);
            }
        }
    }
}
