//! The first stages of a fit on the CPU, to find the stage in which a device diverges.

use super::FitWorkspace;
use crate::cylinders::fit::DeformedTube;
use crate::cylinders::fit::cpu::Deformation;
use crate::cylinders::passes::{NONE, Section, TriangleStatistic, grouped_point, listed_faces};
use crate::gpu::{Context, GpuError, checked};
use crate::settings::Settings;

/// How far a fit runs on the CPU before the device takes over.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum CpuStages {
    /// Not at all.
    #[default]
    None,
    /// Through `project`: the device gets points in tube coordinates.
    Project,
    /// Through `scatter`: the device gets points grouped by face.
    Group,
    /// Through so many iterations: the device gets radii too. After all of them only `support` is left to it.
    Iterations(u32),
}

impl CpuStages {
    /// The iterations among them.
    pub(super) fn iterations(self) -> u32 {
        match self {
            CpuStages::Iterations(count) => count,
            _ => 0,
        }
    }

    /// The same stages, with at most that many iterations.
    pub(super) fn up_to(self, iterations: u32) -> Self {
        match self {
            CpuStages::Iterations(count) => CpuStages::Iterations(count.min(iterations)),
            other => other,
        }
    }
}

/// The results of the CPU's iterations that the device does not compute again.
pub(super) struct CpuProgress {
    travel_mm: Vec<f64>,
    history_mm: Vec<Vec<f64>>,
}

impl CpuProgress {
    /// Copies the CPU's iterations into a tube that the device finished.
    pub(super) fn copy_into(self, tube: &mut DeformedTube) {
        for (of_device, of_cpu) in tube.travel_mm.iter_mut().zip(self.travel_mm) {
            *of_device = of_cpu;
        }
        for (of_device, of_cpu) in tube.history_mm.iter_mut().zip(self.history_mm) {
            *of_device = of_cpu;
        }
    }
}

/// Runs the stages on the sections of a workspace's cylinders and writes their results to the buffers that the
/// device's next pass reads.
pub(super) fn run_on_cpu(
    context: &Context,
    workspace: &FitWorkspace,
    stages: CpuStages,
    settings: &Settings,
    radii_mm: &[f64],
    history: bool,
    sections: &[Section<f32>],
) -> Result<Vec<CpuProgress>, GpuError> {
    let write = |name: &str, bytes: &[u8]| {
        checked(&context.device, name, || workspace.write(context, name, bytes)).flatten()
    };
    if stages == CpuStages::None {
        return Ok(Vec::new());
    }
    // A section has no more points than its cylinder has slots: the other slots keep no owner.
    let slots = workspace.parameters().slots as usize;
    let mut coordinates = vec![0.0_f32; 3 * slots];
    let mut first = 0;
    for section in sections {
        for (of_all, own) in [&section.r, &section.theta, &section.z].into_iter().enumerate() {
            coordinates[of_all * slots + first..][..own.len()].copy_from_slice(own);
        }
        first += section.len();
    }
    write("section", bytemuck::cast_slice(&coordinates))?;
    let gated: Vec<u32> = sections.iter().map(|s| s.gated as u32).collect();
    write("gated", bytemuck::cast_slice(&gated))?;
    if workspace.parameters().single == 0 {
        let mut owners = vec![NONE; slots];
        let cylinder_of_each = (0..).zip(sections).flat_map(|(c, s)| std::iter::repeat_n(c, s.len()));
        for (owner, cylinder) in owners.iter_mut().zip(cylinder_of_each) {
            *owner = cylinder;
        }
        write("owners", bytemuck::cast_slice(&owners))?;
    }
    if stages == CpuStages::Project {
        return Ok(Vec::new());
    }

    let mut progress = Vec::with_capacity(sections.len());
    let (mut offsets, mut points) = (vec![0_u32], Vec::new());
    let (mut radii, mut values, mut support) = (Vec::new(), Vec::new(), Vec::new());
    for (section, &radius_mm) in sections.iter().zip(radii_mm) {
        let mut deformation = Deformation::new(section, radius_mm, settings, history);
        for _ in 0..stages.iterations() {
            deformation.iterate();
        }
        let before = points.len() as u32;
        offsets.extend(deformation.groups.offsets.iter().skip(1).map(|offset| before + offset));
        let faces = progress.len() as u32 * workspace.parameters().faces..;
        for (face, ends) in faces.zip(deformation.groups.offsets.windows(2)) {
            let of_face = &deformation.groups.points[ends[0] as usize..ends[1] as usize];
            points.extend(of_face.iter().map(|p| grouped_point(*p, face)));
        }
        radii.extend_from_slice(&deformation.radii);
        let (bottoms, tops) = deformation.statistics.split_at(workspace.parameters().faces as usize);
        for triangle in bottoms.iter().zip(tops).flat_map(|(bottom, top)| [bottom, top]) {
            values.push(TriangleStatistic::value_word(triangle));
            support.push(TriangleStatistic::support_words(triangle));
        }
        progress.push(CpuProgress { travel_mm: deformation.travel_mm, history_mm: deformation.history_mm });
    }
    write("offsets", bytemuck::cast_slice(&offsets))?;
    let counts: Vec<u32> = offsets.windows(2).map(|ends| ends[1] - ends[0]).collect();
    let words = workspace.buffer("listed_faces").size() as usize / 4;
    let listed = listed_faces(&counts, workspace.parameters(), words);
    write("listed_faces", bytemuck::cast_slice(&listed))?;
    write("grouped", bytemuck::cast_slice(&points))?;
    if stages.iterations() > 0 {
        write("radii", bytemuck::cast_slice(&radii))?;
        write("triangle_values", bytemuck::cast_slice(&values))?;
        write("triangle_support", bytemuck::cast_slice(&support))?;
    }
    Ok(progress)
}
