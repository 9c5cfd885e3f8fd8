//! One smooth vessel from all echoes: a tube swept along the estimated centreline, its wall found by penalised least
//! squares (`docs/method.md`).
//!
//! Contours and poses are all it needs. Data flows one way: outlines of the contours → `centreline` → `axis` → echoes about the
//! axis → `wall` → support of every node → surface. Where settings ask for it, `tracker`
//! moves the poses in between.

mod live;
mod prepare;
mod support;
mod tracker;
pub(crate) mod wall;

pub(crate) use live::LiveSweep;
pub use prepare::axis::Axis;
pub use support::Support;
pub use tracker::Tracker;

use crate::engine::EngineDescription;
use crate::geometry::Pose;
use crate::recording::FRAME_INTERVAL_S;
use crate::recording::{Frame, Recording};
use crate::settings::Settings;
use crate::surface::Surface;
use crate::surface::face_triangles;
use crate::{Error, Result};

use glam::{DVec2, DVec3};
use prepare::contour::Outline;
use prepare::{centreline, contour};
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::{PI, TAU};
use std::ops::Range;
use std::time::Instant;
use tracker::Scene;
use wall::echo::Echo;
#[cfg(feature = "gpu")]
pub use wall::gpu::SweepEngine;
use wall::grid::Grid;
use wall::{Wall, engine};

/// A vessel swept along its centreline.
///
/// Node j of ring k has index `k·nodes + j` and lies at `θ = 2πj/nodes` of the axis's frame k.
#[derive(Debug, Clone)]
pub struct Sweep {
    /// What the section was swept along.
    pub axis: Axis,
    /// N: nodes a ring.
    pub nodes: usize,
    /// Radius at every node, mm.
    pub radii_mm: Vec<f64>,
    /// What the radii rest on, node by node.
    pub support: Support,
    /// What was done, in numbers.
    pub report: Report,
}

/// A sweep in numbers.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// What fitted the wall.
    pub engine: EngineDescription,
    /// Threads that it could use.
    pub threads: usize,
    /// Frames of the recording.
    pub frames: usize,
    /// Frames that were left out, since their contours are not star-shaped about their centres.
    pub folded_frames: Vec<usize>,
    /// Wall points in the recording.
    pub echoes: usize,
    /// Rays without an echo.
    pub missing: usize,
    /// Echoes beyond the ends of the axis.
    pub beyond_ends: usize,
    /// Echoes too far from the wall to have been seen on it: branches, wrong echoes.
    pub off_wall: usize,
    /// Length of the axis between the outermost supported rings, mm.
    pub length_mm: f64,
    /// Median radius of the contours, mm.
    pub contour_radius_mm: f64,
    /// Rings.
    pub rings: usize,
    /// Nodes, and how many of them are supported.
    pub nodes: usize,
    /// Supported nodes.
    pub supported: usize,
    /// Standard deviation of an echo about the wall within the image plane, mm.
    pub noise_mm: f64,
    /// The part of it along the wall, mm, as far as the contours show it.
    pub tangential_noise_mm: f64,
    /// λ: weight of the wall's bending against the echoes, mm².
    pub smoothness_mm2: f64,
    /// Robust reweightings.
    pub iterations: usize,
    /// Steps of the solver, summed over the iterations.
    pub solver_steps: usize,
    /// Errors of the tracker, where settings ask for them.
    pub tracker: Option<Tracker>,
    /// How long each stage took.
    pub seconds: StageSeconds,
}

/// Wall-clock time of each stage, in seconds.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct StageSeconds {
    /// Finding the axis.
    pub axis: f64,
    /// Placing the echoes about it.
    pub place: f64,
    /// Fitting the wall.
    pub fit: f64,
    /// Correcting what the tracker got wrong.
    pub tracker: f64,
    /// Weighing its support.
    pub support: f64,
}

/// The axis is prolonged by so many contour radii at both ends: echoes of tilted frames lie there.
const BEYOND_RADII: f64 = 1.5;
/// Echoes that a node stands for on average: few where they are exact, more where noise hides what lies between.
const ECHOES_PER_NODE: std::ops::RangeInclusive<f64> = 1.0..=4.0;
/// Nodes that a machine holds without trouble.
const MOST_NODES: f64 = 5e7;
/// Nodes a ring, where the recording decides.
const NODES_PER_RING: std::ops::RangeInclusive<usize> = 16..=256;

impl Sweep {
    /// Reconstructs the vessel of a recording; cylinder models in it are not looked at.
    ///
    /// # Errors
    /// Where settings are invalid, a frame cannot be used, or the contours cover no length of a vessel.
    pub fn of(recording: &Recording, settings: &Settings) -> Result<Self> {
        Self::fitted(recording, settings, |grid, echoes| engine::fit(grid, echoes, settings))
    }

    /// As [`Sweep::of`], the wall fitted by an engine on a device, whatever the settings' backend.
    ///
    /// # Errors
    /// As [`Sweep::of`], and [`Error::Gpu`] where the device fails.
    #[cfg(feature = "gpu")]
    pub fn on_device(recording: &Recording, settings: &Settings, device: &SweepEngine) -> Result<Self> {
        Self::fitted(recording, settings, |grid, echoes| {
            engine::fit_on_device(grid, echoes, settings, device).map(|wall| (wall, device.describe()))
        })
    }

    fn fitted(
        recording: &Recording,
        settings: &Settings,
        fit: impl FnOnce(&Grid, &mut [Echo]) -> Result<(Wall, EngineDescription)>,
    ) -> Result<Self> {
        settings.validate()?;
        recording.check()?;
        let start = Instant::now();
        let sensor_from_probe = settings.calibration.sensor_from_probe();
        let mut outlines: Vec<Option<Outline>> = recording.frames.par_iter().map(Outline::of).collect();
        let folded = folded_frames(&outlines)?;
        let without_folded: Vec<Frame>;
        let frames = match folded.is_empty() {
            true => &recording.frames,
            false => {
                folded.iter().for_each(|&k| outlines[k] = None);
                without_folded = without(&recording.frames, &folded);
                &without_folded
            }
        };
        let poses: Vec<_> = frames.iter().map(|f| f.world_from_sensor * sensor_from_probe).collect();
        let mut radii_mm: Vec<f64> = outlines.iter().flatten().map(|o| o.radius_mm).collect();
        let radius_mm = median(&mut radii_mm);
        let centres_mm: Vec<DVec3> = outlines
            .iter()
            .zip(&poses)
            .filter_map(|(outline, pose)| Some(pose.transform_point(outline.as_ref()?.centre_mm.extend(0.0))))
            .collect();
        let curve = (radius_mm > 0.0).then(|| centreline::centreline(&centres_mm, radius_mm)).flatten();
        let Some(curve) = curve else {
            return Err(Error::Frame {
                frame: 0,
                field: "centreline",
                found: format!("contours in {} frames that cover no length", centres_mm.len()),
                expected: "contours along at least a lumen's radius of the vessel".into(),
            });
        };
        let length_mm = centreline::lengths(&curve).last().copied().unwrap_or(0.0);
        let noise_mm = median(&mut outlines.iter().flatten().map(|o| o.noise_mm).collect::<Vec<_>>());
        let (nodes, step_mm) = resolution(frames, length_mm, radius_mm, noise_mm, settings)?;
        let axis = Axis::along(&curve, step_mm, BEYOND_RADII * radius_mm);
        let axis_seconds = start.elapsed().as_secs_f64();

        let start = Instant::now();
        let place = |poses: &[Pose]| {
            let mut echoes = placed(frames, poses, &axis, nodes);
            if let Some(half_life_s) = settings.sweep.half_life_s {
                age(&mut echoes, &times_s(frames), half_life_s);
            }
            echoes
        };
        let mut echoes = place(&poses);
        let place_seconds = start.elapsed().as_secs_f64();

        let start = Instant::now();
        let grid = Grid::new(axis.rings(), nodes, axis.step_mm, radius_mm);
        let (mut wall, engine) = fit(&grid, &mut echoes)?;
        let fit_seconds = start.elapsed().as_secs_f64();

        let start = Instant::now();
        let tracker = match settings.sweep.correct_poses || settings.sweep.estimate_offset {
            true => {
                let place = |sensors: &[Pose]| {
                    place(&sensors.iter().map(|&sensor| sensor * sensor_from_probe).collect::<Vec<_>>())
                };
                let scene = Scene { grid: &grid, axis: &axis, frames, place: &place };
                Some(Tracker::correct(&scene, &settings.sweep, &mut echoes, &mut wall)?)
            }
            false => None,
        };
        let tracker_seconds = start.elapsed().as_secs_f64();
        // Noise along a round wall moves echoes outwards: half its variance times the wall's curvature.
        let tangential_noise_mm = tangential_noise_mm(frames).min(wall.noise_mm);
        for radius in &mut wall.radii_mm {
            *radius -= bulge_mm(*radius, tangential_noise_mm);
        }

        let start = Instant::now();
        let support = Support::of(&grid, &echoes, &wall);
        let supported_rings =
            || (0..grid.rings).filter(|&k| support.supported[k * nodes..(k + 1) * nodes].contains(&true));
        let length_mm = match (supported_rings().next(), supported_rings().next_back()) {
            (Some(first), Some(last)) => (last - first) as f64 * axis.step_mm,
            _ => 0.0,
        };
        let report = Report {
            engine,
            threads: rayon::current_num_threads(),
            frames: frames.len(),
            folded_frames: folded,
            echoes: echo_count(&recording.frames),
            missing: recording.frames.iter().map(Frame::missing_echoes).sum(),
            beyond_ends: echo_count(frames) - echoes.len(),
            off_wall: echoes.iter().filter(|e| !e.is_inlier(wall.noise_mm)).count(),
            length_mm,
            contour_radius_mm: radius_mm,
            rings: grid.rings,
            nodes: grid.node_count(),
            supported: support.supported.iter().filter(|s| **s).count(),
            noise_mm: wall.noise_mm,
            tangential_noise_mm,
            smoothness_mm2: wall.smoothness_mm2,
            iterations: wall.iterations,
            solver_steps: wall.solver_steps,
            tracker,
            seconds: StageSeconds {
                axis: axis_seconds,
                place: place_seconds,
                fit: fit_seconds,
                tracker: tracker_seconds,
                support: start.elapsed().as_secs_f64(),
            },
        };
        Ok(Self { axis, nodes, radii_mm: wall.radii_mm, support, report })
    }

    /// The vessel as a triangle surface, normals outward, open at its ends; without the nodes that are not
    /// supported unless `keep_unsupported`. Arrays: `support` (echoes), `residual_mm`, `standard_error_mm`, `frame`
    /// (last seen), `supported` (1 or 0).
    pub fn surface(&self, keep_unsupported: bool) -> Surface {
        let rings = 0..self.axis.rings();
        mesh(&self.axis, self.nodes, rings, &self.support, |node| self.radii_mm[node], keep_unsupported)
    }
}

/// The frames whose contours no radius about their centre can hold.
fn folded_frames(outlines: &[Option<Outline>]) -> Result<Vec<usize>> {
    let share = |k: usize| outlines[k].map_or(0.0, |outline| outline.folded_share);
    let folded: Vec<usize> = (0..outlines.len()).filter(|&k| share(k) > contour::MOST_FOLDED).collect();
    let seen = outlines.iter().flatten().count();
    match folded.first() {
        Some(&frame) if 2 * folded.len() > seen => Err(Error::Frame {
            frame,
            field: "contour",
            found: format!(
                "one that turns back about its centre ({:.0} % of the area that it goes round), as do {} of {seen}",
                100.0 * share(frame),
                folded.len()
            ),
            expected: "star-shaped lumens: every ray from the centre meets the wall once".into(),
        }),
        _ => Ok(folded),
    }
}

/// Frames of which some have lost their contours.
fn without(frames: &[Frame], blind: &[usize]) -> Vec<Frame> {
    let mut frames = frames.to_vec();
    blind.iter().for_each(|&k| frames[k].contour_mm.clear());
    frames
}

/// Some rings as [`Sweep::surface`] has them: all nodes, or the triangles that are supported.
fn mesh(
    axis: &Axis,
    nodes: usize,
    rings: Range<usize>,
    support: &Support,
    radius_mm: impl Fn(usize) -> f64,
    keep_unsupported: bool,
) -> Surface {
    let first = rings.start * nodes;
    let mut triangles: Vec<[u32; 3]> = (0..rings.len().saturating_sub(1))
        .flat_map(|ring| (0..nodes).map(move |j| (ring * nodes + j, ring * nodes + (j + 1) % nodes)))
        .flat_map(|(a, b)| face_triangles(a as u32, b as u32, (b + nodes) as u32, (a + nodes) as u32))
        .filter(|triangle| {
            keep_unsupported || triangle.iter().all(|&n| support.supported[first + n as usize])
        })
        .collect();
    let mut index = vec![if keep_unsupported { 0 } else { u32::MAX }; rings.len() * nodes];
    triangles.iter().flatten().for_each(|&n| index[n as usize] = 0);
    let kept: Vec<usize> = (0..index.len()).filter(|&n| index[n] == 0).collect();
    kept.iter().zip(0..).for_each(|(&n, new)| index[n] = new);
    triangles.iter_mut().flatten().for_each(|n| *n = index[*n as usize]);
    let kept: Vec<usize> = kept.into_iter().map(|n| first + n).collect();
    let position =
        |&n: &usize| axis.point_mm(n / nodes, TAU * (n % nodes) as f64 / nodes as f64, radius_mm(n));
    let mut surface =
        Surface { nodes_mm: kept.iter().map(position).collect(), triangles, arrays: Vec::new() };
    let Support { echoes, residual_mm, standard_error_mm, last_frame, supported } = support;
    let mut array = |name, value: &dyn Fn(usize) -> f64| {
        surface.set_array(name, kept.iter().map(|&n| value(n)).collect());
    };
    array("support", &|n| f64::from(echoes[n]));
    array("residual_mm", &|n| residual_mm[n]);
    array("standard_error_mm", &|n| standard_error_mm[n]);
    array("frame", &|n| last_frame[n].map_or(f64::NAN, f64::from));
    array("supported", &|n| f64::from(u8::from(supported[n])));
    surface
}

/// Wall points of all frames.
fn echo_count(frames: &[Frame]) -> usize {
    frames.iter().map(|f| f.echoes_mm().count()).sum()
}

/// Nodes a ring, and the distance of two rings in mm, that the echoes along a vessel can bear.
fn resolution(
    frames: &[Frame],
    length_mm: f64,
    radius_mm: f64,
    noise_mm: f64,
    settings: &Settings,
) -> Result<(usize, f64)> {
    let seen = frames.iter().filter(|f| f.echoes_mm().next().is_some()).count();
    // More than two rings for each frame would have nothing to rest on.
    let least_step_mm = length_mm / seen as f64 / 2.0;
    let nodes = match settings.sweep.nodes {
        Some(nodes) => nodes as usize,
        None => {
            let nodes = |echoes_per_node: f64| {
                let affordable = echo_count(frames) as f64 / echoes_per_node;
                let even = (affordable * TAU * radius_mm / length_mm).sqrt();
                even.max(affordable * least_step_mm / length_mm)
            };
            // Triangles that deviate from the wall by less than the noise need not be smaller.
            let wanted = TAU * radius_mm * wall::CELL_NOISE * settings.sweep.roughness / noise_mm;
            let rays = median(&mut frames.iter().map(|f| f.contour_mm.len() as f64).collect::<Vec<_>>());
            let least = nodes(*ECHOES_PER_NODE.end()).min(rays);
            let most = nodes(*ECHOES_PER_NODE.start()).min(2.0 * rays);
            (wanted.min(most).max(least) as usize & !1).clamp(*NODES_PER_RING.start(), *NODES_PER_RING.end())
        }
    };
    let step_mm = (TAU * radius_mm / nodes as f64).max(least_step_mm);
    if length_mm / step_mm * nodes as f64 > MOST_NODES {
        return Err(Error::Setting {
            name: "sweep.nodes",
            found: format!("{nodes} a ring of {radius_mm:.3} mm radius along {length_mm:.0} mm"),
            expected: format!("at most {MOST_NODES} in all"),
        });
    }
    Ok((nodes, step_mm))
}

/// The echoes about the axis, in its order; those beyond its ends are left out.
fn placed(frames: &[Frame], poses: &[Pose], axis: &Axis, nodes: usize) -> Vec<Echo> {
    let mut echoes: Vec<Echo> = frames
        .par_iter()
        .zip(poses)
        .enumerate()
        .flat_map_iter(|(k, (frame, pose))| {
            let to_world = |p: DVec2| pose.transform_point(p.extend(0.0));
            let centre = frame.centroid_mm().or_else(|| frame.echoes_mm().next());
            let near = centre.map_or(0, |centre| axis.nearest_ring(to_world(centre)));
            frame.echoes_mm().filter_map(move |echo| {
                let place = axis.place(to_world(echo), near)?;
                Some(Echo::new(&place, pose.rotation.z_axis, k as u32, nodes))
            })
        })
        .collect();
    echoes.par_sort_by(|a, b| a.ring().total_cmp(&b.ring()));
    echoes
}

/// When the frames were taken, s; without a time, [`FRAME_INTERVAL_S`] after the one before.
fn times_s(frames: &[Frame]) -> Vec<f64> {
    let times = frames.iter().scan(-FRAME_INTERVAL_S, |clock, frame| {
        *clock = frame.time_s.unwrap_or(*clock + FRAME_INTERVAL_S);
        Some(*clock)
    });
    times.collect()
}

/// Lets echoes, sorted along the axis, count less the more time lies between them and the newest of those between the
/// same two rings.
fn age(echoes: &mut [Echo], times_s: &[f64], half_life_s: f64) {
    let time = |echo: &Echo| times_s[echo.frame as usize];
    for level in echoes.chunk_by_mut(|a, b| a.ring() as usize == b.ring() as usize) {
        let newest = level.iter().map(time).fold(f64::NEG_INFINITY, f64::max);
        level.iter_mut().for_each(|echo| echo.weight = ((time(echo) - newest) / half_life_s).exp2());
    }
}

/// Noise of the contours along the wall, mm.
///
/// A probe looks along rays at even angles; so do points that were drawn on its image, in pieces. Second differences
/// of the angle from point to point therefore show the noise across the rays alone: they have six times its variance.
fn tangential_noise_mm(frames: &[Frame]) -> f64 {
    TANGENTIAL_PER_JUMP * median(&mut frames.iter().flat_map(jumps_mm).collect::<Vec<_>>())
}

/// How far noise along a round wall moves echoes outwards on average, mm.
fn bulge_mm(radius_mm: f64, tangential_noise_mm: f64) -> f64 {
    if tangential_noise_mm == 0.0 {
        return 0.0;
    }
    tangential_noise_mm * tangential_noise_mm / (2.0 * radius_mm.abs().max(tangential_noise_mm))
}

/// Standard deviation along the wall by the median jump.
const TANGENTIAL_PER_JUMP: f64 = 1.4826 / 2.449_489_742_783_178;

/// Second differences of the angle from point to point, as lengths at the wall, mm.
fn jumps_mm(frame: &Frame) -> impl Iterator<Item = f64> + '_ {
    frame.contour_mm.windows(3).filter_map(|triple| {
        let [a, b, c] = [triple[0], triple[1], triple[2]];
        if a.is_nan() || b.is_nan() || c.is_nan() {
            return None;
        }
        let turn = |d: f64| (d + PI).rem_euclid(TAU) - PI;
        let [a, b_angle, c] = [a, b, c].map(|p| p.y.atan2(p.x));
        Some((turn(c - b_angle) - turn(b_angle - a)).abs() * b.length())
    })
}

/// The upper median; 0 of nothing. Reorders the values.
fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
