use super::space::SpaceArgument;
use super::{Shown, print_json, refuse_inputs};
use crate::evaluate::closed_volume_mm3;
use crate::flow::{EdgeLength, Extension, FaceKind, FlowFace, FlowMesh, FlowMeshSettings, MeshQuality};
use crate::surface::{self, Surface};
use crate::{Error, Result, output};
use clap::ValueEnum;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Make a mesh to simulate flow in: even triangles, flat ends, extensions, caps, numbered faces
///
/// The ends are cut flat across the vessel. A .vtp file has the cell array ModelFaceID (1 the wall, then the caps, then
/// filled holes), as SimVascular reads it, and measured (1 where the recording shows the wall). Beside it, a .faces.json file
/// names the faces. Nothing is written where the mesh would cross itself or have needles.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh mesh vessel.vtp --cap -o flow.vtp
  lumenmesh mesh vessel.vtp --cap --flow-extensions 5d --edge 0.8 -o flow.vtp --units cm   # for SimVascular
  lumenmesh mesh aorta.stl --cap --edge-per-radius 0.15 -o flow.stl --stl-per-face
  lumenmesh mesh vessel.vtp --cap -o flow.vtp --json | jq .quality.min_angle_deg")]
pub(super) struct Arguments {
    /// The vessel, open at its ends: .vtp, .ply, .stl, .obj, .mat, .vtk or .vtu
    vessel: PathBuf,
    /// Mesh to write: .vtp (which alone has the faces' numbers), .stl, .ply, .obj or .mat
    #[arg(short, long, visible_alias = "out", value_name = "MESH")]
    output: PathBuf,
    /// Close the ends by flat caps
    #[arg(long)]
    cap: bool,
    /// Prolong the ends, straight on and to a circle: a length in mm, or in diameters of the end, such as 5d
    #[arg(long, value_name = "LENGTH", value_parser = extension)]
    flow_extensions: Option<Extension>,
    /// Length of the triangles' edges, mm
    #[arg(long, value_name = "MM", conflicts_with = "edge_per_radius")]
    edge: Option<f64>,
    /// Length of the edges as a share of the vessel's radius at each place [default: 0.2]
    #[arg(long, value_name = "SHARE")]
    edge_per_radius: Option<f64>,
    /// Close holes in the wall, each by a face of its own; nobody has seen wall there
    #[arg(long)]
    fill_holes: bool,
    /// Unit of the files' coordinates
    #[arg(long, value_enum, default_value_t)]
    units: Units,
    /// Also write every face as an STL file of its own: flow_wall.stl, flow_cap_1.stl, …
    #[arg(long)]
    stl_per_face: bool,
    #[command(flatten)]
    space: SpaceArgument,
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, Default, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum Units {
    #[default]
    Mm,
    Cm,
    M,
}

impl Units {
    fn mm(self) -> f64 {
        match self {
            Units::Mm => 1.0,
            Units::Cm => 10.0,
            Units::M => 1000.0,
        }
    }
}

fn extension(text: &str) -> std::result::Result<Extension, String> {
    let number = |text: &str| {
        text.trim().parse::<f64>().map_err(|_| "a length in mm, or in diameters, such as 5d".to_owned())
    };
    match text.strip_suffix('d') {
        Some(diameters) => number(diameters).map(Extension::Diameters),
        None => number(text.strip_suffix("mm").unwrap_or(text)).map(Extension::Millimetres),
    }
}

/// What `--json` prints, and what the `.faces.json` file has.
#[derive(Serialize)]
struct Output<'a> {
    vessel: Shown<'a>,
    mesh: Shown<'a>,
    settings: FlowMeshSettings,
    /// Unit of the mesh's coordinates; all lengths here are in mm.
    units: Units,
    nodes: usize,
    triangles: usize,
    closed: bool,
    volume_mm3: Option<f64>,
    faces: &'a [FlowFace],
    quality: MeshQuality,
    /// Share of the wall's area that the recording shows, extensions left aside; null where the vessel does not say.
    measured_share: Option<f64>,
    /// Holes that were closed and, smaller than an edge, have no face.
    closed_holes: usize,
    /// Areas of the pieces that do not hang together with the largest, mm².
    left_out_mm2: &'a [f64],
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        let edge = match (self.edge, self.edge_per_radius) {
            (Some(mm), _) => EdgeLength::Uniform(mm),
            (None, Some(share)) => EdgeLength::OfRadius(share),
            (None, None) => EdgeLength::default(),
        };
        let settings = FlowMeshSettings::default()
            .with_edge(edge)
            .with_cap(self.cap)
            .with_extension(self.flow_extensions)
            .with_fill_holes(self.fill_holes);
        settings.validate()?;
        surface::check_ending(&self.output)?;
        refuse_inputs([Some(&*self.output)], [Some(&*self.vessel)])?;
        let vessel = Surface::read(&self.vessel)?;
        let mesh = FlowMesh::of(&vessel, &settings).map_err(|e| e.in_file(&self.vessel))?;
        let mm = self.units.mm();
        let faces_path = beside(&self.output, ".faces.json");
        let parts: Vec<(u32, PathBuf)> = mesh
            .faces
            .iter()
            .filter(|_| self.stl_per_face)
            .map(|face| (face.id, beside(&self.output, &format!("_{}.stl", face.name))))
            .collect();
        let beside_it: Vec<&Path> =
            [&*faces_path].into_iter().chain(parts.iter().map(|(_, path)| &**path)).collect();
        refuse_inputs(beside_it.iter().map(|path| Some(*path)), [Some(&*self.vessel)])?;
        mesh.write(&self.output, self.space.name(), mm)?;
        let topology = mesh.surface.topology();
        let shown = Output {
            vessel: Shown(&self.vessel),
            mesh: Shown(&self.output),
            settings,
            units: self.units,
            nodes: mesh.surface.nodes_mm.len(),
            triangles: mesh.surface.triangles.len(),
            closed: topology.is_closed(),
            volume_mm3: closed_volume_mm3(&mesh.surface).ok().filter(|_| topology.is_closed()),
            faces: &mesh.faces,
            quality: mesh.quality,
            measured_share: mesh.measured_share(),
            closed_holes: mesh.closed_holes,
            left_out_mm2: &mesh.left_out_mm2,
        };
        let text = serde_json::to_string_pretty(&shown).map_err(std::io::Error::from);
        let text = text.map_err(|source| Error::Output { target: "the faces", source })?;
        output::write_atomically(&faces_path, |w| writeln!(w, "{text}"))?;
        for (id, path) in &parts {
            mesh.face(*id, mm).write_in(path, self.space.name())?;
        }
        if self.json {
            return print_json(&shown);
        }
        shown.print();
        println!("mesh       {}", self.output.display());
        beside_it.iter().for_each(|path| println!("           {}", path.display()));
        Ok(())
    }
}

/// A file beside another, which has its name but for the ending.
fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(ending);
    path.with_file_name(name)
}

impl Output<'_> {
    fn print(&self) {
        println!("triangles  {}, {} nodes", self.triangles, self.nodes);
        let Self { quality, .. } = self;
        println!(
            "edges      {:.3} mm in the median; smallest angle {:.1}°, {:.2} % below 30°; largest aspect ratio {:.2}",
            quality.median_edge_mm,
            quality.min_angle_deg,
            100.0 * quality.below_30_deg,
            quality.max_aspect
        );
        println!(
            "wall       {:.4} mm from the given one in the mean, {:.4} at most",
            quality.mean_deviation_mm, quality.max_deviation_mm
        );
        for face in self.faces {
            print!("face {:<5} {}: {:.1} mm²", face.id, face.name, face.area_mm2);
            if let Some(diameter) = face.equivalent_diameter_mm {
                let [x, y, z] = face.centre_mm;
                print!(", {diameter:.2} mm across, at ({x:.1}, {y:.1}, {z:.1})");
            }
            match (face.kind, face.cut_off_mm) {
                (FaceKind::FilledHole, _) => print!("; NOT MEASURED: nobody has seen wall there"),
                (_, Some(cut)) => print!("; {cut:.1} mm were cut off to make it flat"),
                _ => {}
            }
            println!();
        }
        match self.closed_holes {
            0 => {}
            1 => println!("closed     a hole smaller than the edges, without a face of its own"),
            n => println!("closed     {n} holes smaller than the edges, without faces of their own"),
        }
        match self.volume_mm3 {
            Some(volume) => println!("volume     {volume:.1} mm³, closed"),
            None => println!("open       --cap closes the ends"),
        }
        match self.measured_share {
            Some(share) if share < 1.0 => println!(
                "MEASURED   {:.1} % of the given wall's area; the rest no echo supports (cell array measured)",
                100.0 * share
            ),
            Some(_) => {}
            None => println!("           the vessel does not say which wall was measured"),
        }
        if !self.left_out_mm2.is_empty() {
            println!(
                "left out   {} that do not hang together with it, {:.1} mm² in all",
                match self.left_out_mm2.len() {
                    1 => "a piece".to_owned(),
                    n => format!("{n} pieces"),
                },
                self.left_out_mm2.iter().sum::<f64>()
            );
        }
    }
}
