use super::axis::tree_of;
use super::report::{check_page_ending, name_of, typed};
use super::space::{SpaceArgument, can_carry_arrays};
use super::{Shown, print_json, refuse_inputs};
use crate::anatomy::{Overlap, places};
use crate::evaluate::{Distances, Truth, evaluate};
use crate::output::write_atomically;
use crate::report::{Comparison, comparison_page};
use crate::surface::Surface;
use crate::{Error, Result};
use serde::Serialize;
use std::path::PathBuf;

/// Compare two vessels: before and after a stent, diastole and systole, two methods
///
/// Distances from each vessel's nodes to the other's wall, areas in planes across the axis of the first, and Dice's
/// coefficient of the lumens over the planes in which both are closed. Nothing is registered: both must be in the same
/// frame of reference.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh compare before.vtp after.vtp
  lumenmesh compare sweep.vtp cylinders.vtp --step 0.5 --out difference.vtp
  lumenmesh compare before.vtp after.vtp --page stent.html
  lumenmesh compare diastole.stl systole.stl --json | jq .overlap.dice

The colour map of --out is A with the distance to B as node arrays error_mm and signed_error_mm (positive: A lies outside
of B): lumenmesh render difference.vtp -o difference.png --array error_mm")]
pub(super) struct Arguments {
    /// The first vessel: .vtp, .ply, .stl, .obj, .mat, .vtk or .vtu
    a: PathBuf,
    /// The second
    b: PathBuf,
    /// The common axis, as polylines in mm; found from A where none is given
    #[arg(long, value_name = "VTP")]
    axis: Option<PathBuf>,
    /// A plane every so many mm
    #[arg(long, value_name = "MM", default_value_t = 1.0)]
    step: f64,
    /// Write A with its distances to B: .vtp, .ply or .mat
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Write all of it as one page: .html
    #[arg(long, value_name = "HTML")]
    page: Option<PathBuf>,
    #[command(flatten)]
    space: SpaceArgument,
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Output<'a> {
    a: Shown<'a>,
    b: Shown<'a>,
    a_to_b: Distances,
    b_to_a: Distances,
    /// Mean of A's nodes, positive where A lies outside of B.
    signed_mean_mm: f64,
    /// The largest distance of both ways.
    hausdorff_mm: f64,
    overlap: &'a Overlap,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        self.out.as_deref().map_or(Ok(()), can_carry_arrays)?;
        self.page.as_deref().map_or(Ok(()), check_page_ending)?;
        refuse_inputs(
            [self.out.as_deref(), self.page.as_deref()],
            [Some(&*self.a), Some(&*self.b), self.axis.as_deref()],
        )?;
        let read = |path| Surface::read(path).map(Surface::joined);
        let (mut surface_a, surface_b) = (read(&self.a)?, read(&self.b)?);
        let tree_a = tree_of(&surface_a, &self.a, self.axis.as_deref())?;
        let tree_b = tree_of(&surface_b, &self.b, None)?;
        let axis = &tree_a.axes[0];
        let at = places(0.0, axis.length_mm(), self.step)?;
        let overlap = Overlap::of((&surface_a, &tree_a), (&surface_b, &tree_b), axis, &at)?;
        let truth_a = Truth::new(surface_a.clone()).map_err(|e| e.in_file(&self.a))?;
        let truth_b = Truth::new(surface_b.clone()).map_err(|e| e.in_file(&self.b))?;
        let forth = evaluate(&surface_a, &truth_b).map_err(|e| e.in_file(&self.a))?;
        let back = evaluate(&surface_b, &truth_a).map_err(|e| e.in_file(&self.b))?;
        if overlap.compared == 0 {
            let found =
                format!("no plane across the axis of {} in which both lumens are closed", self.a.display());
            let expected = "two vessels in the same place, in the same frame of reference";
            return Err(Error::input(&self.b, "lumen", found, expected));
        }
        forth.colour(&mut surface_a);
        if let Some(out) = &self.out {
            self.space.write(&surface_a, out)?;
        }
        if let Some(path) = &self.page {
            let [a, b] = [&self.a, &self.b].map(|path| name_of(path));
            let distances = [forth.mesh_to_truth, back.mesh_to_truth];
            let command = typed();
            let content =
                Comparison::new([&a, &b], &surface_a, distances, forth.signed_mean_mm, &overlap, &command);
            let page = comparison_page(&content)?;
            write_atomically(path, |w| w.write_all(page.as_bytes()))?;
        }
        let output = Output {
            a: Shown(&self.a),
            b: Shown(&self.b),
            a_to_b: forth.mesh_to_truth,
            b_to_a: back.mesh_to_truth,
            signed_mean_mm: forth.signed_mean_mm,
            hausdorff_mm: forth.mesh_to_truth.max_mm.max(back.mesh_to_truth.max_mm),
            overlap: &overlap,
        };
        if self.json {
            return print_json(&output);
        }
        let mut text = String::from("  at mm     A mm²     B mm²  both mm²  difference\n");
        for pair in &overlap.areas {
            text += &format!(
                "{:7.2}  {:8.3}  {:8.3}  {:8.3}  {:+8.2} %{}\n",
                pair.at_mm,
                pair.a_mm2,
                pair.b_mm2,
                pair.both_mm2,
                pair.difference_percent,
                pair.remark.as_ref().map_or(String::new(), |remark| format!("  {remark}"))
            );
        }
        for (name, d) in [("A to B", &output.a_to_b), ("B to A", &output.b_to_a)] {
            text += &format!(
                "{name:<19} mean {:.3} mm, median {:.3}, 95 % below {:.3}, largest {:.3}\n",
                d.mean_mm, d.median_mm, d.p95_mm, d.max_mm
            );
        }
        text += &format!(
            "A outside of B by   {:.3} mm (signed mean)\nHausdorff           {:.3} mm\n\
             Dice                {:.4}, over {} of {} planes\nareas               {:.2} % (median of |difference|)\n\
             volume              {:+.2} % from A to B\n",
            output.signed_mean_mm,
            output.hausdorff_mm,
            overlap.dice,
            overlap.compared,
            overlap.areas.len(),
            overlap.median_absolute_difference_percent,
            overlap.volume_difference_percent
        );
        print!("{text}");
        if let Some(out) = &self.out {
            println!("colour map          {}", out.display());
        }
        if let Some(page) = &self.page {
            println!("page                {}", page.display());
        }
        Ok(())
    }
}
