//! Measures a mesh of your own, by whatever method it was made, against a truth surface.
//!
//! ```sh
//! cargo run --release -- demo
//! cargo run --release --example evaluate_mesh -- lumenmesh-demo/vessel.vtp lumenmesh-demo/truth.vtp error.vtp
//! ```

use lumenmesh::evaluate::{Truth, evaluate};
use lumenmesh::surface::Surface;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let (Some(mesh), Some(truth), Some(output)) = (arguments.next(), arguments.next(), arguments.next())
    else {
        return Err("usage: evaluate_mesh MESH TRUTH MESH_WITH_ERRORS".into());
    };
    // Both are in millimetres and in the same frame of reference: nothing is registered.
    let mut mesh = Surface::read(&mesh)?;
    let truth = Truth::new(Surface::read(&truth)?)?;
    let evaluation = evaluate(&mesh, &truth)?;

    let distances = evaluation.mesh_to_truth;
    println!("mean distance of {} nodes from the truth: {:.4} mm", distances.nodes, distances.mean_mm);
    println!("95 % below {:.4} mm, largest {:.4} mm", distances.p95_mm, distances.max_mm);
    for warning in &evaluation.warnings {
        eprintln!("warning: {warning}");
    }
    // Node arrays `error_mm` and `signed_error_mm`, to be coloured by in ParaView.
    evaluation.colour(&mut mesh);
    mesh.write(&output)?;
    Ok(())
}
