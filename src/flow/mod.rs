//! Meshes to simulate flow in: even triangles, flat ends that are prolonged and capped, and numbered faces.
//!
//! 1. The largest piece of the vessel is taken (`openings.rs`); holes in its wall are filled, or refused.
//! 2. Its ends are cut flat, prolonged and capped.
//! 3. All of it is remeshed, face by face (`surface::remesh`).
//! 4. It is checked: closed, and without crossing triangles (`surface::crossing`).

mod openings;

use crate::evaluate::Locator;
use crate::numerics::robust::median;
use crate::setters::setters;
use crate::surface::crossing::crossings;
use crate::surface::remesh::{Patches, remeshed, smallest_angle_rad};
use crate::surface::{PolyData, Space, Surface};
use crate::{Error, Result, output};
use glam::DVec3;
use openings::{FlatEnd, Opening, Piece, Stub, cap, cut_flat, fill, place, prolong};
use serde::Serialize;
use std::f64::consts::PI;
use std::path::Path;

/// Rounds of remeshing.
const ROUNDS: usize = 10;

/// The number of the wall among the faces.
pub const WALL: u32 = 1;

/// How long the edges of a mesh should be.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EdgeLength {
    /// The same everywhere, mm.
    Uniform(f64),
    /// A share of the vessel's radius at each place, as the wall's distance from its axis shows it.
    OfRadius(f64),
}

impl Default for EdgeLength {
    /// A fifth of the radius.
    fn default() -> Self {
        Self::OfRadius(0.2)
    }
}

/// A length along a vessel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Extension {
    /// In mm.
    Millimetres(f64),
    /// In diameters of the end.
    Diameters(f64),
}

/// What to make of a vessel.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[non_exhaustive]
pub struct FlowMeshSettings {
    /// Length of the edges.
    pub edge: EdgeLength,
    /// Whether the ends are closed by caps.
    pub cap: bool,
    /// By how much the ends are prolonged.
    pub extension: Option<Extension>,
    /// Whether holes in the wall are closed, by faces of their own.
    pub fill_holes: bool,
}

setters!(FlowMeshSettings {
    with_edge => edge: EdgeLength,
    with_cap => cap: bool,
    with_extension => extension: Option<Extension>,
    with_fill_holes => fill_holes: bool,
});

impl FlowMeshSettings {
    /// # Errors
    /// [`Error::Setting`] for values out of their ranges.
    pub fn validate(&self) -> Result<()> {
        let check = |name, value: f64, low: f64, high: f64| match (low..=high).contains(&value) {
            true => Ok(()),
            false => Err(Error::setting(name, value.to_string(), format!("{low} to {high}"))),
        };
        match self.edge {
            EdgeLength::Uniform(mm) => check("edge", mm, 0.001, 1000.0)?,
            EdgeLength::OfRadius(share) => check("edge_per_radius", share, 0.02, 1.0)?,
        }
        match self.extension {
            Some(Extension::Millimetres(mm)) => check("flow_extensions", mm, 0.01, 10_000.0),
            Some(Extension::Diameters(count)) => check("flow_extensions", count, 0.1, 100.0),
            None => Ok(()),
        }
    }
}

/// What a face of a mesh is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum FaceKind {
    /// The vessel's wall and its prolongations.
    Wall,
    /// A flat end.
    Cap,
    /// A hole in the wall that was closed. Nobody has seen wall there.
    FilledHole,
}

/// A face of a mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct FlowFace {
    /// Its `ModelFaceID`.
    pub id: u32,
    /// Its name: `wall`, `cap_1`, …, `filled_hole_1`, …
    pub name: String,
    /// What it is.
    pub kind: FaceKind,
    /// Its triangles.
    pub triangles: usize,
    /// Area, mm².
    pub area_mm2: f64,
    /// Centroid, mm.
    pub centre_mm: [f64; 3],
    /// Unit normal outward, the mean over its area; of a cap that of its plane.
    pub normal: [f64; 3],
    /// Diameter of the circle of the same area, mm; of the wall none.
    pub equivalent_diameter_mm: Option<f64>,
    /// Length that was cut off the vessel at this end to make it flat, mm.
    pub cut_off_mm: Option<f64>,
}

/// How good the triangles are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct MeshQuality {
    /// Smallest angle, degrees.
    pub min_angle_deg: f64,
    /// Share of the triangles with an angle below 30°.
    pub below_30_deg: f64,
    /// Largest aspect ratio: longest side over 2√3 times the radius of the inscribed circle, 1 of an equilateral triangle.
    pub max_aspect: f64,
    /// Median length of an edge, mm.
    pub median_edge_mm: f64,
    /// Mean distance of the given wall's nodes from the mesh, mm.
    pub mean_deviation_mm: f64,
    /// Largest distance of the given wall's nodes from the mesh, mm.
    pub max_deviation_mm: f64,
}

/// A mesh to simulate flow in.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct FlowMesh {
    /// The triangles, normals outward. Node arrays of the vessel are carried over to the wall that was given, NaN elsewhere.
    pub surface: Surface,
    /// Of each triangle: the face that it belongs to.
    pub face_of: Vec<u32>,
    /// Of each triangle: whether it is wall that the recording shows, by the vessel's array `supported` or `support`. Caps,
    /// prolongations and filled holes are not. `None` where the vessel has no such array.
    pub measured: Option<Vec<bool>>,
    /// Of each triangle: whether it stands for wall that was given, rather than for an extension, a cap or a filled hole.
    pub is_given: Vec<bool>,
    /// The faces, the wall first.
    pub faces: Vec<FlowFace>,
    /// How good the triangles are.
    pub quality: MeshQuality,
    /// Holes that were closed and, smaller than an edge, have no face.
    pub closed_holes: usize,
    /// Area of pieces of the vessel that do not hang together with the largest one, and were left out, mm².
    pub left_out_mm2: Vec<f64>,
}

/// Refused: a mesh with a smaller angle would only trouble those who use it.
const LEAST_ANGLE_DEG: f64 = 2.0;
/// Rounds in which the vessel's radius is smoothed over neighbouring nodes.
const SMOOTHING_ROUNDS: usize = 10;
/// The wall, as a patch.
const GIVEN_WALL: u32 = 0;

impl FlowMesh {
    /// The mesh of a vessel: of its largest piece, where it has several.
    ///
    /// # Errors
    /// [`Error::Setting`] as [`FlowMeshSettings::validate`]; [`Error::Surface`], with the place, where the vessel is no oriented
    /// manifold, where its wall has holes that are not to be filled, where it has no closed outline at an end, and where the
    /// mesh would cross itself or have needles.
    pub fn of(vessel: &Surface, settings: &FlowMeshSettings) -> Result<Self> {
        settings.validate()?;
        vessel.check()?;
        let vessel = vessel.clone().joined();
        let Piece { surface: mut wall, original, left_out_mm2 } = Piece::largest_of(&vessel)?;
        for array in &vessel.arrays {
            wall.set_array(&array.name, original.iter().map(|&n| array.values[n as usize]).collect());
        }
        let given = Locator::new(&wall)?;
        let (holes, ends) = holes_and_ends(&wall);
        if !holes.is_empty() && !settings.fill_holes {
            let of = |hole: &Opening| {
                format!("{:.1} mm across at {}", 2.0 * hole.radius_mm(), place(hole.centre_mm))
            };
            return Err(Error::Surface {
                what: "wall".into(),
                found: match &holes[..] {
                    [hole] => format!("a hole, {}", of(hole)),
                    holes => format!("{} holes: {}", holes.len(), holes.iter().map(of).collect::<Vec<_>>().join("; ")),
                },
                expected: "none: --fill-holes closes them by faces of their own, and reconstruct --keep-unsupported goes on \
                           with the wall there"
                    .into(),
            });
        }
        let mut patches = Patches { patch: vec![GIVEN_WALL; wall.triangles.len()], ..Patches::default() };
        (patches.nodes_mm, patches.triangles) = (wall.nodes_mm.clone(), wall.triangles.clone());
        let mut kinds = vec![PatchKind { kind: FaceKind::Wall, cut_off_mm: None }];
        let add = |kinds: &mut Vec<PatchKind>, kind, cut_off_mm| {
            kinds.push(PatchKind { kind, cut_off_mm });
            kinds.len() as u32 - 1
        };
        for hole in &holes {
            fill(&mut patches, hole, add(&mut kinds, FaceKind::FilledHole, None))?;
        }
        let flat = ends.iter().map(|end| cut_flat(&mut patches, end)).collect::<Result<Vec<FlatEnd>>>()?;
        let kept_mm = patches.nodes_of(GIVEN_WALL);
        let radius_mm = radii_mm(&wall, &given);
        let edge_mm = |p: DVec3| match settings.edge {
            EdgeLength::Uniform(mm) => mm,
            EdgeLength::OfRadius(share) => {
                let nodes = wall.triangles[given.closest(p).triangle as usize];
                share * nodes.iter().map(|&n| radius_mm[n as usize]).sum::<f64>() / 3.0
            }
        };
        let length_mm = |end: &Opening| match settings.extension {
            Some(Extension::Millimetres(mm)) => mm,
            Some(Extension::Diameters(count)) => count * 2.0 * end.radius_mm(),
            None => 0.0,
        };
        let areas = wall.triangle_areas_mm2().into_iter().enumerate();
        let of_wall = areas.map(|(t, area_mm2)| (area_mm2, wall.corners_mm(t)[0]));
        let of_ends = ends.iter().map(|end| (2.0 * PI * end.radius_mm() * length_mm(end), end.centre_mm));
        refuse_too_many(of_wall.chain(of_ends).map(|(area, at)| triangles_in(area, edge_mm(at))).sum())?;
        for (end, opening) in flat.into_iter().zip(&ends) {
            let mut last = end;
            if settings.extension.is_some() {
                let (length_mm, edge_mm) = (length_mm(opening), edge_mm(opening.centre_mm));
                last =
                    prolong(&mut patches, &last, length_mm, edge_mm, add(&mut kinds, FaceKind::Wall, None));
            }
            if settings.cap {
                cap(&mut patches, &last, add(&mut kinds, FaceKind::Cap, Some(last.cut_mm)))?;
            }
        }
        let mut patches = remeshed(&patches, &edge_mm, ROUNDS)?;
        for patch in (0..).zip(&kinds).filter(|(_, kind)| kind.kind == FaceKind::Cap).map(|(patch, _)| patch)
        {
            openings::dome(&mut patches, patch);
        }
        let mesh = Self::from_patches(patches, &kinds, &wall, &given, &kept_mm, left_out_mm2)?;
        mesh.refuse_faults(settings.cap)?;
        Ok(mesh)
    }

    fn from_patches(
        patches: Patches,
        kinds: &[PatchKind],
        wall: &Surface,
        given: &Locator,
        kept_mm: &[DVec3],
        left_out_mm2: Vec<f64>,
    ) -> Result<Self> {
        let mut triangles = vec![0; kinds.len()];
        patches.patch.iter().for_each(|&patch| triangles[patch as usize] += 1);
        // The wall with its extensions, the caps, and the filled holes; of small holes remeshing leaves nothing.
        let of_kind = |kind: FaceKind| (0..kinds.len()).filter(move |&p| kinds[p].kind == kind);
        let left = |kind| of_kind(kind).filter(|&p| triangles[p] > 0);
        let numbered: Vec<usize> = left(FaceKind::Cap).chain(left(FaceKind::FilledHole)).collect();
        let id = |patch: u32| {
            let place = numbered.iter().position(|&p| p == patch as usize);
            place.map_or(WALL, |place| WALL + 1 + place as u32)
        };
        let closed_holes = of_kind(FaceKind::FilledHole).count() - left(FaceKind::FilledHole).count();
        let face_of: Vec<u32> = patches.patch.iter().map(|&patch| id(patch)).collect();
        let mut surface = patches.surface();
        let mut is_given = vec![false; surface.nodes_mm.len()];
        for (corners, _) in patches.triangles.iter().zip(&patches.patch).filter(|(_, p)| **p == GIVEN_WALL) {
            corners.iter().for_each(|&n| is_given[n as usize] = true);
        }
        carry_arrays(&mut surface, &is_given, wall, given);
        let is_measured: Option<Vec<bool>> =
            wall.array("supported").or_else(|| wall.array("support")).map(|values| {
                wall.triangles.iter().map(|t| t.iter().all(|&n| values[n as usize] > 0.0)).collect()
            });
        let centres: Vec<DVec3> =
            (0..surface.triangles.len()).map(|t| surface.corners_mm(t).iter().sum::<DVec3>() / 3.0).collect();
        let measured = is_measured.map(|is_measured| {
            let closest = given.closest_all(&centres);
            let of = |(patch, closest): (&u32, crate::evaluate::Closest)| {
                *patch == GIVEN_WALL && is_measured[closest.triangle as usize]
            };
            patches.patch.iter().zip(closest).map(of).collect()
        });

        let mut faces = vec![face(&surface, &face_of, WALL, "wall".into(), kinds[0])];
        let (mut caps, mut filled) = (0, 0);
        for &patch in &numbered {
            let (name, count) = match kinds[patch].kind {
                FaceKind::FilledHole => ("filled_hole", &mut filled),
                _ => ("cap", &mut caps),
            };
            *count += 1;
            faces.push(face(&surface, &face_of, id(patch as u32), format!("{name}_{count}"), kinds[patch]));
        }
        let quality = MeshQuality::of(&surface, kept_mm)?;
        let is_given = patches.patch.iter().map(|patch| *patch == GIVEN_WALL).collect();
        Ok(Self { surface, face_of, measured, is_given, faces, quality, closed_holes, left_out_mm2 })
    }

    fn refuse_faults(&self, is_closed: bool) -> Result<()> {
        let topology = self.surface.topology();
        if is_closed && !topology.is_closed() {
            return Err(Error::Surface {
                what: "mesh".into(),
                found: format!("{} open edges", topology.boundary_edges),
                expected: "none".into(),
            });
        }
        if let Some([s, t]) = crossings(&self.surface).first().copied() {
            let [a, b] = [s, t].map(|t| self.surface.corners_mm(t as usize).iter().sum::<DVec3>() / 3.0);
            return Err(Error::Surface {
                what: format!("mesh at {}", place(0.5 * (a + b))),
                found: "wall that crosses itself".into(),
                expected: "none; if an extension runs into the vessel, make it shorter, and where the vessel is folded, look \
                           at it there"
                    .into(),
            });
        }
        if self.quality.min_angle_deg < LEAST_ANGLE_DEG {
            let angle = |t: &usize| smallest_angle_rad(self.surface.corners_mm(*t));
            let worst =
                (0..self.surface.triangles.len()).min_by(|s, t| angle(s).total_cmp(&angle(t))).unwrap_or(0);
            return Err(Error::Surface {
                what: format!("mesh at {}", place(self.surface.corners_mm(worst)[0])),
                found: format!("a triangle with an angle of {:.2}°", self.quality.min_angle_deg),
                expected: format!(
                    "at least {LEAST_ANGLE_DEG}°; a shorter edge may follow the wall better there"
                ),
            });
        }
        Ok(())
    }

    /// Writes the mesh. A `.vtp` file carries the cell arrays `ModelFaceID` and, where the vessel says what was measured,
    /// `measured`, and the node arrays. `mm_per_unit` is 10 for a file in cm.
    ///
    /// # Errors
    /// As [`Surface::write_in`].
    pub fn write(&self, path: &Path, space: Space, mm_per_unit: f64) -> Result<()> {
        let scaled = self.scaled(|_| true, mm_per_unit);
        if output::ending(path) != "vtp" {
            return scaled.write_in(path, space);
        }
        let nodes: Vec<DVec3> = scaled.nodes_mm.iter().map(|p| space.swapped(*p)).collect();
        let faces: Vec<i32> = self.face_of.iter().map(|&id| id as i32).collect();
        let measured: Option<Vec<i32>> =
            self.measured.as_ref().map(|measured| measured.iter().map(|&m| i32::from(m)).collect());
        let mut cell_arrays: Vec<(&str, &[i32])> = vec![("ModelFaceID", &faces)];
        cell_arrays.extend(measured.as_ref().map(|measured| ("measured", &measured[..])));
        let file = PolyData {
            nodes_mm: &nodes,
            triangles: &scaled.triangles,
            node_arrays: scaled.arrays.iter().map(|a| (a.name.as_str(), 1, a.values.as_slice())).collect(),
            cell_arrays,
            ..PolyData::default()
        };
        output::write_atomically(path, |w| file.write(space, w))
    }

    /// Share of the area of the given wall, extensions left aside, that was measured; `None` where the vessel does not say.
    pub fn measured_share(&self) -> Option<f64> {
        let measured = self.measured.as_ref()?;
        let areas = self.surface.triangle_areas_mm2();
        let sum = |is: &dyn Fn(usize) -> bool| -> f64 {
            (0..areas.len()).filter(|&t| is(t)).map(|t| areas[t]).sum()
        };
        Some(sum(&|t| measured[t]) / sum(&|t| self.is_given[t]))
    }

    /// The triangles of one face, with the nodes that they use.
    pub fn face(&self, id: u32, mm_per_unit: f64) -> Surface {
        self.scaled(|t| self.face_of[t] == id, mm_per_unit)
    }

    fn scaled(&self, has: impl Fn(usize) -> bool, mm_per_unit: f64) -> Surface {
        let mut number = vec![u32::MAX; self.surface.nodes_mm.len()];
        let mut part = Surface::default();
        let mut nodes = Vec::new();
        for (_, corners) in self.surface.triangles.iter().enumerate().filter(|(t, _)| has(*t)) {
            part.triangles.push(corners.map(|n| {
                let number = &mut number[n as usize];
                if *number == u32::MAX {
                    *number = nodes.len() as u32;
                    nodes.push(n as usize);
                }
                *number
            }));
        }
        part.nodes_mm = nodes.iter().map(|&n| self.surface.nodes_mm[n] / mm_per_unit).collect();
        for array in &self.surface.arrays {
            part.set_array(&array.name, nodes.iter().map(|&n| array.values[n]).collect());
        }
        part
    }
}

/// Equilateral triangles that fill an area.
fn triangles_in(area_mm2: f64, edge_mm: f64) -> f64 {
    area_mm2 / (0.25 * 3.0_f64.sqrt() * edge_mm * edge_mm)
}

/// Most triangles of a mesh: far more than solvers are given.
const MAX_TRIANGLES: f64 = 3e7;

fn refuse_too_many(triangles: f64) -> Result<()> {
    match triangles <= MAX_TRIANGLES {
        true => Ok(()),
        false => Err(Error::setting(
            "edge",
            match triangles.is_finite() {
                true => format!("{:.0} million triangles", triangles / 1e6),
                false => "no wall opposite to another, whose distance would be the vessel's radius".into(),
            },
            format!("a length with which the vessel has at most {:.0} million", MAX_TRIANGLES / 1e6),
        )),
    }
}

/// What a patch of the mesh is.
#[derive(Debug, Clone, Copy)]
struct PatchKind {
    kind: FaceKind,
    /// Length that was cut off the vessel at a cap, mm.
    cut_off_mm: Option<f64>,
}

/// The openings of a vessel: holes in its wall, and ends. An end that cannot be cut flat without cutting off another one, as
/// at a branch that was hardly entered, counts as a hole; a hole that is cut off with an end does not count.
fn holes_and_ends(wall: &Surface) -> (Vec<Opening>, Vec<Opening>) {
    let (mut holes, ends): (Vec<Opening>, Vec<Opening>) =
        Opening::all_of(wall).into_iter().partition(|opening| opening.is_hole);
    let stub = |end: &Opening| Stub::of(&wall.nodes_mm, &wall.triangles, end);
    let cuts_off_another = |end: &Opening| {
        let stub = stub(end);
        ends.iter().any(|other| other.nodes != end.nodes && stub.holds(other))
    };
    let (mouths, ends): (Vec<Opening>, Vec<Opening>) = ends.iter().cloned().partition(cuts_off_another);
    for end in &ends {
        let stub = stub(end);
        holes.retain(|hole| !stub.holds(hole));
    }
    holes.extend(mouths);
    holes.sort_by_key(|hole| hole.nodes[0]);
    (holes, ends)
}

fn face(
    surface: &Surface,
    face_of: &[u32],
    id: u32,
    name: String,
    PatchKind { kind, cut_off_mm }: PatchKind,
) -> FlowFace {
    let (mut triangles, mut area, mut centre, mut normal) = (0, 0.0, DVec3::ZERO, DVec3::ZERO);
    for t in (0..face_of.len()).filter(|&t| face_of[t] == id) {
        let [a, b, c] = surface.corners_mm(t);
        let twice = (b - a).cross(c - a);
        triangles += 1;
        area += 0.5 * twice.length();
        centre += 0.5 * twice.length() * (a + b + c) / 3.0;
        normal += twice;
    }
    FlowFace {
        id,
        name,
        kind,
        triangles,
        area_mm2: area,
        centre_mm: (centre / area).to_array(),
        normal: normal.normalize_or_zero().to_array(),
        equivalent_diameter_mm: (kind != FaceKind::Wall).then(|| 2.0 * (area / PI).sqrt()),
        cut_off_mm,
    }
}

/// Carries the node arrays of the wall over: lengths are interpolated, others are those of the nearest node.
fn carry_arrays(surface: &mut Surface, is_given: &[bool], wall: &Surface, given: &Locator) {
    let closest = given.closest_all(&surface.nodes_mm);
    let shares: Vec<([u32; 3], [f64; 3])> = closest
        .iter()
        .map(|closest| {
            let t = closest.triangle as usize;
            let [a, b, c] = wall.corners_mm(t);
            let part = |p: DVec3, q: DVec3| (p - closest.point_mm).cross(q - closest.point_mm).length();
            let parts = [part(b, c), part(c, a), part(a, b)];
            let whole = parts.iter().sum::<f64>().max(f64::MIN_POSITIVE);
            (wall.triangles[t], parts.map(|p| p / whole))
        })
        .collect();
    for array in &wall.arrays {
        let at = |n: u32| array.values[n as usize];
        let value = |(nodes, shares): &([u32; 3], [f64; 3])| {
            if array.name.ends_with("_mm") {
                return nodes.iter().zip(shares).filter(|(_, s)| **s > 0.0).map(|(&n, s)| at(n) * s).sum();
            }
            let nearest = (0..3).max_by(|&i, &j| shares[i].total_cmp(&shares[j]).then(j.cmp(&i)));
            at(nodes[nearest.unwrap_or(0)])
        };
        let elsewhere = if ["support", "supported"].contains(&array.name.as_str()) { 0.0 } else { f64::NAN };
        let values = shares.iter().zip(is_given).map(|(s, &given)| if given { value(s) } else { elsewhere });
        surface.set_array(&array.name, values.collect());
    }
}

/// The vessel's radius at each node of its wall: half the distance to the wall opposite, smoothed over neighbouring nodes.
fn radii_mm(wall: &Surface, given: &Locator) -> Vec<f64> {
    let size = wall.bounding_box_mm().map_or(0.0, |[low, high]| high.distance(low));
    let normals = wall.node_normals();
    let across = |(&p, &normal): (&DVec3, &DVec3)| {
        let from = p - normal * (1e-6 * size);
        given.cast(from, -normal, size).map(|(_, distance)| 0.5 * distance)
    };
    let radii: Vec<Option<f64>> = wall.nodes_mm.iter().zip(&normals).map(across).collect();
    let typical = median(&mut radii.iter().copied().flatten().collect::<Vec<_>>());
    // Where rays leave the vessel through an end, and where they meet a fold, neighbours know better.
    let sane =
        |radius: Option<f64>| radius.filter(|r| (0.1..10.0).contains(&(r / typical))).unwrap_or(typical);
    let mut radii: Vec<f64> = radii.into_iter().map(sane).collect();
    for _ in 0..SMOOTHING_ROUNDS {
        let mut sums = vec![(0.0, 0.0); radii.len()];
        for triangle in &wall.triangles {
            let sum: f64 = triangle.iter().map(|&n| radii[n as usize]).sum();
            for &n in triangle {
                let of_node = &mut sums[n as usize];
                *of_node = (of_node.0 + sum, of_node.1 + 3.0);
            }
        }
        radii.iter_mut().zip(sums).filter(|(_, sum)| sum.1 > 0.0).for_each(|(r, sum)| *r = sum.0 / sum.1);
    }
    radii
}

impl MeshQuality {
    /// Of a mesh, and the nodes of the wall that it stands for.
    fn of(surface: &Surface, wall_mm: &[DVec3]) -> Result<Self> {
        let mut edges = Vec::with_capacity(3 * surface.triangles.len());
        let (mut least, mut below, mut aspect) = (f64::INFINITY, 0, 0.0_f64);
        for t in 0..surface.triangles.len() {
            let corners @ [a, b, c] = surface.corners_mm(t);
            let angle = smallest_angle_rad(corners).to_degrees();
            least = least.min(angle);
            below += usize::from(angle < 30.0);
            let sides = [a.distance(b), b.distance(c), c.distance(a)];
            let longest = sides.iter().copied().fold(0.0, f64::max);
            let twice_area = (b - a).cross(c - a).length();
            aspect = aspect.max(longest * sides.iter().sum::<f64>() / (2.0 * 3.0_f64.sqrt() * twice_area));
            edges.extend(sides);
        }
        let mesh = Locator::new(surface)?;
        let deviations: Vec<f64> = mesh.closest_all(wall_mm).iter().map(|c| c.distance_mm).collect();
        Ok(Self {
            min_angle_deg: least,
            below_30_deg: below as f64 / surface.triangles.len() as f64,
            max_aspect: aspect,
            median_edge_mm: median(&mut edges),
            mean_deviation_mm: deviations.iter().sum::<f64>() / deviations.len() as f64,
            max_deviation_mm: deviations.iter().copied().fold(0.0, f64::max),
        })
    }
}
