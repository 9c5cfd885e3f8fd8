//! Snapshots of live vessels.

use crate::mutate::{File, inputs, mutated};
use glam::{DMat3, DVec2, DVec3};
use lumenmesh::geometry::Pose;
use lumenmesh::reconstruction::Live;
use lumenmesh::recording::Frame;
use lumenmesh::settings::{Backend, Method, Settings};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Bytes before the content: the magic number and the version, then the checksum and the length.
const HEADER: usize = 32;

fn frame(k: usize) -> Frame {
    let contour =
        (0..12).map(|j| DVec2::from_angle(f64::from(j) / 12.0 * std::f64::consts::TAU) * 4.0).collect();
    let pose = Pose { rotation: DMat3::IDENTITY, translation_mm: DVec3::new(0.0, 0.0, 0.7 * k as f64) };
    Frame::new(pose, contour)
}

fn seeds(file: &File) -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for (method, frames) in [(Method::Sweep, 20), (Method::Sweep, 3), (Method::Cylinders, 20)] {
        let settings = Settings::default().with_method(method).with_backend(Backend::Cpu).with_every(5);
        let mut live = Live::new(&settings).unwrap();
        live.keep_frames().unwrap();
        (0..frames).for_each(|k| drop(live.push(&frame(k)).unwrap()));
        let path = file.holding(&[]);
        live.snapshot(path).unwrap();
        seeds.push(std::fs::read(path).unwrap());
    }
    seeds
}

/// Half of them have a valid checksum, so that what stands behind it is reached.
#[test]
fn snapshots() {
    let file = File::new("live.state");
    let seeds = seeds(&file);
    let contents: Vec<Vec<u8>> = seeds.iter().map(|seed| seed[HEADER..].to_vec()).collect();
    let read = |bytes: &[u8]| {
        let Ok(mut live) = Live::restore(file.holding(bytes)) else { return false };
        // It goes on, whatever it holds.
        for k in 20..24 {
            let _ = live.push(&frame(k));
        }
        let _ = (live.surface(), live.part(0..live.rings()), live.flush());
        true
    };
    let good = (0..inputs()).filter(|&number| {
        let bytes = match number % 2 {
            0 => mutated(&seeds, &[], number),
            _ => {
                let content = mutated(&contents, &[], number);
                let mut bytes = seeds[0][..20].to_vec();
                bytes.extend(crc32fast::hash(&content).to_le_bytes());
                bytes.extend((content.len() as u64).to_le_bytes());
                [bytes, content].concat()
            }
        };
        catch_unwind(AssertUnwindSafe(|| read(&bytes))).unwrap_or_else(|_| panic!("snapshot {number} panics"))
    });
    let good = good.count() as u64;
    assert!(0 < good && good < inputs() / 2, "{good}");
}
