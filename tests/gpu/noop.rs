//! Every pipeline is valid within WebGPU's default limits, on a device that validates but computes nothing.

use lumenmesh::gpu::Requirements;
use lumenmesh::low_level::cylinders::gpu::GpuEngine;
use lumenmesh::low_level::sweep::gpu::GpuWallEngine;

#[test]
fn every_pipeline_is_valid_within_the_default_limits() {
    let requirements = Requirements::new();
    assert_eq!(requirements.limits, wgpu::Limits::default());
    assert!(requirements.features.is_empty());
    let (device, queue) = wgpu::Device::noop(&requirements.merged_into(wgpu::DeviceDescriptor::default()));
    GpuEngine::on_device(device.clone(), queue.clone()).unwrap().warm_up().unwrap();
    GpuWallEngine::on_device(device, queue).unwrap().warm_up().unwrap();
}

#[test]
fn a_device_with_less_refuses_with_the_pass_s_name() {
    let mut descriptor = wgpu::DeviceDescriptor::default();
    descriptor.required_limits.max_compute_invocations_per_workgroup = 128;
    let (device, queue) = wgpu::Device::noop(&descriptor);
    let refused = GpuEngine::on_device(device, queue).and_then(|engine| engine.warm_up()).unwrap_err();
    assert!(refused.to_string().starts_with("the device refuses bin: "), "{refused}");
}
