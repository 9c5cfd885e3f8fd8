//! Reconstructs the lumen of a recording in a file and writes it as a mesh.
//!
//! ```sh
//! cargo run --release -- simulate --vessel aorta -o pullback.mat
//! cargo run --release --example reconstruct_file -- pullback.mat vessel.vtp
//! ```

use lumenmesh::reconstruction::{LumenReport, Reconstructor};
use lumenmesh::recording::{Recording, Summary};
use lumenmesh::settings::Settings;
use std::ops::ControlFlow;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let (Some(input), Some(output)) = (arguments.next(), arguments.next()) else {
        return Err("usage: reconstruct_file RECORDING MESH".into());
    };
    let recording = Recording::read(&input)?;
    print!("{}", Summary::of(&recording));

    let reconstructor = Reconstructor::new(Settings::default()).on_progress(|progress| {
        eprintln!("{}: {} of {}", progress.stage, progress.done, progress.total);
        // Break, and run ends with Error::Cancelled.
        ControlFlow::Continue(())
    });
    let lumen = reconstructor.run(&recording)?;
    let mesh = lumen.surface();
    mesh.write(&output)?;

    if let LumenReport::Sweep(report) = lumen.report() {
        println!("{} of {} nodes are supported by echoes", report.supported, report.nodes);
    }
    println!("{} triangles in {}", mesh.triangles.len(), output.display());
    Ok(())
}
