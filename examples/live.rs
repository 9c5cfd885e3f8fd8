//! A vessel that grows while the catheter moves: frames come one at a time, and each says which rings of the mesh changed.
//!
//! A host would take its frames from a tracker and a segmentation; here a simulator provides them.
//!
//! ```sh
//! cargo run --release --example live
//! ```

use lumenmesh::reconstruction::Live;
use lumenmesh::settings::Settings;
use lumenmesh::simulate::{Phantom, Shape, Simulation};
use std::time::Instant;

fn main() -> lumenmesh::Result<()> {
    let vessel = Phantom::from("arch".parse::<Shape>()?).vessel()?;
    let frames = Simulation::run(vessel, &Default::default())?.recording.frames;

    let mut live = Live::new(&Settings::default())?;
    let mut longest_ms: f64 = 0.0;
    for frame in &frames {
        let start = Instant::now();
        let change = live.push(frame)?;
        longest_ms = longest_ms.max(start.elapsed().as_secs_f64() * 1e3);
        for rings in change.changed {
            // The nodes and triangles of these rings alone: what a viewer has to update.
            let part = live.part(rings);
            assert!(part.check().is_ok());
        }
        if change.frame % 100 == 0 {
            println!("frame {:4}: {} rings of {} nodes", change.frame, change.rings, live.nodes());
        }
    }
    let mesh = live.surface();
    println!(
        "{} nodes after {} frames; the longest frame took {longest_ms:.1} ms",
        mesh.nodes_mm.len(),
        live.frames()
    );
    Ok(())
}
