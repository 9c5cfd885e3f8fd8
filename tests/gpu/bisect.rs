//! Stages on the CPU: the result must not depend on where the device takes over.

use crate::cylinders::{assert_agree, assert_all_agree, assert_same};
use crate::device::{device, open};
use crate::sections::{RADIUS_MM, recording, wall};
use lumenmesh::cylinders::{Engine, FitRequest, Track};
use lumenmesh::low_level::cylinders::gpu::CpuStages;
use lumenmesh::settings::{Settings, Statistic};

const STAGES: [CpuStages; 7] = [
    CpuStages::None,
    CpuStages::Project,
    CpuStages::Group,
    CpuStages::Iterations(1),
    CpuStages::Iterations(2),
    CpuStages::Iterations(3),
    CpuStages::Iterations(99),
];

#[test]
fn the_device_may_take_over_after_any_stage() {
    let (Some(device), Some(mut other)) = (device(), open()) else { return };
    let recording = recording(40, 150, 113);
    for statistic in [Statistic::Mean, Statistic::Median] {
        let settings = Settings::default().with_nodes(24).with_levels(8).with_statistic(statistic);
        let track = Track::of(&recording, &settings).unwrap();
        let request = FitRequest::new(&track, &[9, 19, 29, 39], &settings).with_history(true);
        let expected = device.engine.fit(&request).unwrap().cylinders;
        let section = wall(5_000, 127);
        let expected_tube = device.engine.fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
        for stages in STAGES {
            other.engine = other.engine.with_cpu_stages(stages);
            let found = other.engine.fit(&request).unwrap().cylinders;
            assert_all_agree(device, &found, &expected, &recording, &settings);
            let tube = other.engine.fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
            assert_agree(device, &tube, &expected_tube, &section, &settings);
        }
    }
}

#[test]
fn the_cpu_s_stages_do_take_part() {
    let Some(mut device) = open() else { return };
    let settings = Settings::default().with_iterations(1);
    let section = wall(2_000, 131);
    device.engine = device.engine.with_cpu_stages(CpuStages::Iterations(1));
    // With every iteration on the CPU a device that has no iteration to do gives the CPU's, to the bit.
    let tube = device.engine.fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
    let cpu = lumenmesh::cylinders::CpuEngine::<f32>::new()
        .fit_section(&section, RADIUS_MM, &settings)
        .unwrap()
        .tube;
    assert_eq!(tube.radii_mm, cpu.radii_mm);
    assert_eq!(tube.travel_mm, cpu.travel_mm);
    if device.exact {
        assert_same(&tube, &cpu);
    }
}
