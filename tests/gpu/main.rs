//! The device's passes against their twins.
#![cfg(feature = "gpu")]
#![expect(clippy::unwrap_used, reason = "a test may fail")]

use lumenmesh::fit::gpu::GpuEngine;
use lumenmesh::fit::{CpuEngine, Engine, Job, Track, merged_frames};
use lumenmesh::recording::Recording;
use lumenmesh::settings::{Outliers, Settings, Statistic};

#[test]
fn end_to_end() {
    let gpu = GpuEngine::new(None).unwrap();
    println!("{:?}", gpu.adapter());
    for r in ["clean", "noisy"] {
        let rec = Recording::read(format!("../shared/recordings/adult_aorta_{r}.mat").as_ref()).unwrap();
        for (nodes, levels) in [(12, 5), (24, 8), (3, 1), (64, 64)] {
            for outliers in [Outliers::Iqr, Outliers::Deviation, Outliers::None] {
                for statistic in [Statistic::Mean, Statistic::Median] {
                    let s = Settings { nodes, levels, outliers, statistic, ..Settings::default() };
                    let track = Track::of(&rec, &s).unwrap();
                    let frames = merged_frames(track.len(), &s);
                    let job = Job { history: true, ..Job::new(&track, &frames, &s) };
                    let t0 = std::time::Instant::now();
                    let a = CpuEngine::<f32>::new().fit(&job).unwrap();
                    let t1 = std::time::Instant::now();
                    let b = gpu.fit(&job).unwrap();
                    let t2 = std::time::Instant::now();
                    let mut worst = 0.0f64;
                    let mut differ = 0;
                    for (x, y) in a.iter().zip(&b) {
                        for (p, q) in x.tube.radii_mm.iter().zip(&y.tube.radii_mm) {
                            worst = worst.max((p - q).abs());
                            differ += usize::from(p != q);
                        }
                    }
                    let same = a.iter().zip(&b).all(|(x, y)| {
                        x.tube.points == y.tube.points
                            && x.tube.gated == y.tube.gated
                            && x.tube.rejected == y.tube.rejected
                            && x.tube.support == y.tube.support
                            && x.tube.travel_mm == y.tube.travel_mm
                            && x.tube.history_mm == y.tube.history_mm
                            && x.tube
                                .residual_mm
                                .iter()
                                .zip(&y.tube.residual_mm)
                                .all(|(a, b)| a.to_bits() == b.to_bits())
                    });
                    println!(
                        "{r} {nodes}x{levels} {outliers:?} {statistic:?}: {differ} differ, worst {worst:e}, all same {same}; cpu {:?} gpu {:?}",
                        t1 - t0,
                        t2 - t1
                    );
                }
            }
        }
    }
}

#[test]
fn debug_passes() {
    use lumenmesh::fit::passes::{Section, group};
    use lumenmesh::tube::Tube;
    let gpu = GpuEngine::new(None).unwrap();
    let rec = Recording::read("../shared/recordings/adult_aorta_noisy.mat".as_ref()).unwrap();
    let s = Settings::default();
    let track = Track::of(&rec, &s).unwrap();
    let frames = [499];
    let job = Job::new(&track, &frames, &s);
    let w = &gpu.prepare_job(&job).unwrap()[0];
    let out = gpu.run_pass(w, "project", &[], &["section", "owners"]).unwrap();
    let sec: Vec<f32> = bytemuck::pod_collect_to_vec(&out[0]);
    let own: Vec<u32> = bytemuck::pod_collect_to_vec(&out[1]);
    let cpu: Section<f32> = track.section(499, &s).unwrap();
    let mut k = 0;
    let mut diff = [0usize; 3];
    let mut gpu_section = Section::<f32>::default();
    for (i, o) in own.iter().enumerate() {
        if *o == u32::MAX || 3 * i + 2 >= sec.len() {
            continue;
        }
        if k >= cpu.len() {
            break;
        }
        gpu_section.r.push(sec[3 * i]);
        gpu_section.theta.push(sec[3 * i + 1]);
        gpu_section.z.push(sec[3 * i + 2]);
        if sec[3 * i] != cpu.r[k] {
            diff[0] += 1;
            if diff[0] < 4 {
                println!("r {} {}", sec[3 * i], cpu.r[k]);
            }
        }
        if sec[3 * i + 1] != cpu.theta[k] {
            diff[1] += 1;
            if diff[1] < 4 {
                println!("t {} {}", sec[3 * i + 1], cpu.theta[k]);
            }
        }
        if sec[3 * i + 2] != cpu.z[k] {
            diff[2] += 1;
        }
        k += 1;
    }
    println!("section {} {} diff {:?}", k, cpu.len(), diff);
    {
        let mut slot = 0;
        let mut counts = [0usize; 8];
        for near in track.near(499, &s).unwrap() {
            let t = lumenmesh::fit::passes::TubeTransform::<f32>::new(&near.cylinder_from_probe);
            for p in &track.echoes_mm()[near.echoes.clone()] {
                let (px, py) = (p.x as f32, p.y as f32);
                let g = sec[3 * slot + 2];
                let (a, b, o) = (t.x[2], t.y[2], t.origin[2]);
                let c = [
                    a * px + b * py + o,
                    a * px + (b * py + o),
                    b * py + (a * px + o),
                    a.mul_add(px, b * py) + o,
                    b.mul_add(py, a * px) + o,
                    a.mul_add(px, b.mul_add(py, o)),
                    b.mul_add(py, a.mul_add(px, o)),
                    a.mul_add(px, b * py + o),
                ];
                for i in 0..8 {
                    counts[i] += usize::from(c[i] != g);
                }
                slot += 1;
            }
        }
        println!("{slot} {counts:?}");
    }
    let tube = Tube::new(&s);
    let w = gpu.prepare(cpu.len() as u32, 13.0, &s).unwrap();
    let groups = group(&cpu, &tube);
    let radii: Vec<f32> = (0..tube.node_count()).map(|i| 13.0 + (i as f32 * 0.7).sin()).collect();
    let out = gpu
        .run_pass(
            &w,
            "measure_short",
            &[
                ("offsets", bytemuck::cast_slice(&groups.offsets)),
                ("grouped", bytemuck::cast_slice(&groups.points)),
                ("radii", bytemuck::cast_slice(&radii)),
            ],
            &["statistics"],
        )
        .unwrap();
    let words: Vec<u32> = bytemuck::pod_collect_to_vec(&out[0]);
    let filter = lumenmesh::fit::passes::Filter::<f32>::new(&s, 13.0);
    let mut bad = 0;
    for f in 0..tube.face_count() {
        let (row, j) = (f - f % tube.nodes, f % tube.nodes);
        let kk = tube.next(j);
        let a = radii[row + j];
        let face = lumenmesh::fit::passes::Face {
            b: radii[row + kk] - a,
            b_above: radii[row + tube.nodes + kk] - a,
            a_above: radii[row + tube.nodes + j] - a,
            step_theta: (std::f64::consts::TAU / 12.0) as f32,
            step_z: 2.0f32,
        };
        let mut lists = [vec![], vec![]];
        for p in groups.of_face(f) {
            let (d, t) = lumenmesh::fit::passes::distance([p[0] - a, p[1], p[2]], &face);
            lists[usize::from(t)].push(d);
        }
        for t in 0..2 {
            let st = lumenmesh::fit::passes::filter(&lists[t], &filter, &mut Vec::new());
            let at = 3 * (t * tube.face_count() + f);
            let g = (f32::from_bits(words[at]), words[at + 1], f32::from_bits(words[at + 2]));
            if g != (st.value, st.kept, st.residual) {
                bad += 1;
                if bad < 6 {
                    println!("face {f} tri {t} n {}: cpu {:?} gpu {:?}", lists[t].len(), st, g);
                }
            }
        }
    }
    println!("bad {bad}");
}
