//! The device of these tests, and single passes run on it.

use lumenmesh::gpu::adapters;
use lumenmesh::low_level::cylinders::gpu::{FitWorkspace, GpuEngine};
use lumenmesh::low_level::sweep::gpu::{GpuWallEngine, WallWorkspace};
use std::io::Write;
use std::sync::OnceLock;

/// What a buffer holds before a pass writes it.
pub const POISON: u32 = 0x5a5a_5a5a;

/// An engine that runs single passes of a workspace.
pub trait RunPass {
    type Workspace;

    /// Runs one pass on given inputs and reads buffers back.
    fn run_pass(
        &self,
        workspace: &Self::Workspace,
        pass: &str,
        inputs: &[(&str, &[u8])],
        outputs: &[&str],
    ) -> lumenmesh::Result<Vec<Vec<u8>>>;
}

macro_rules! runs_passes {
    ($engine:ty, $workspace:ty) => {
        impl RunPass for $engine {
            type Workspace = $workspace;

            fn run_pass(
                &self,
                workspace: &$workspace,
                pass: &str,
                inputs: &[(&str, &[u8])],
                outputs: &[&str],
            ) -> lumenmesh::Result<Vec<Vec<u8>>> {
                self.run_pass(workspace, pass, inputs, outputs)
            }
        }
    };
}

runs_passes!(GpuEngine, FitWorkspace);
runs_passes!(GpuWallEngine, WallWorkspace);

/// An engine, and whether its device computes f32 exactly as the CPU does.
pub struct Device<E = GpuEngine> {
    pub engine: E,
    /// Mesa's software device rounds and fuses as the twins do, so that its results are theirs to the bit.
    pub exact: bool,
}

impl Device {
    /// Whether a subgroup measures a long face: on a device that is known to be a program.
    pub fn is_narrow(&self) -> bool {
        self.engine.adapter().is_some_and(|adapter| adapter.is_software())
            && self.engine.subgroup_width().is_some()
    }
}

/// Says something even where the test passes, when what `eprintln` writes is not shown.
pub fn say(text: &str) {
    let mut unseen_by_the_test_harness = std::io::stderr().lock();
    writeln!(unseen_by_the_test_harness, "{text}").unwrap();
}

/// The device, once for all tests; `None`, said loudly, where there is none.
pub fn device() -> Option<&'static Device> {
    static DEVICE: OnceLock<Option<Device>> = OnceLock::new();
    DEVICE.get_or_init(open).as_ref()
}

/// The same device without subgroups, once for all tests.
pub fn device_without_subgroups() -> Option<&'static Device> {
    static DEVICE: OnceLock<Option<Device>> = OnceLock::new();
    let without = |device: Device| Device { engine: device.engine.without_subgroups(), ..device };
    DEVICE.get_or_init(|| open().map(without)).as_ref()
}

/// The same device as a host's, once for all tests: the engine does not know that it is software, and takes the ways
/// that are for real devices.
pub fn device_of_a_host() -> Option<&'static Device> {
    static DEVICE: OnceLock<Option<Device>> = OnceLock::new();
    let of_host = |own: &Device| {
        let (device, queue) = (own.engine.device().clone(), own.engine.queue().clone());
        Device { engine: GpuEngine::on_device(device, queue).unwrap(), exact: own.exact }
    };
    DEVICE.get_or_init(|| device().map(of_host)).as_ref()
}

/// An engine of its own, for a test that does harm to its device.
pub fn open() -> Option<Device> {
    let found = adapters();
    for adapter in &found {
        say(&format!(
            "adapter: {} ({}, {}, {})",
            adapter.name, adapter.kind, adapter.backend, adapter.driver
        ));
    }
    if found.is_empty() {
        let required = std::env::var("LUMENMESH_REQUIRE_GPU").is_ok_and(|value| value == "1");
        assert!(!required, "no GPU adapter");
        say("SKIPPED: no GPU adapter (LUMENMESH_REQUIRE_GPU=1 makes that a failure)");
        return None;
    }
    let engine = GpuEngine::new(std::env::var("LUMENMESH_ADAPTER").ok().as_deref()).unwrap();
    let name = engine.adapter().unwrap().name.clone();
    say(&format!("these tests run on {name}"));
    // Asked to, the tests compare within rounding on the software device too, as they must on others.
    let within_rounding = std::env::var("LUMENMESH_WITHIN_ROUNDING").is_ok_and(|value| value == "1");
    Some(Device { engine, exact: name.contains("llvmpipe") && !within_rounding })
}

/// A buffer as a pass left it.
#[derive(Clone)]
pub struct Readback {
    /// What it held before the pass.
    pub before: Vec<u32>,
    /// What it holds after.
    pub words: Vec<u32>,
}

impl Readback {
    /// The words at some places, as if the buffer had only those.
    pub fn at(&self, places: &[usize]) -> Self {
        let pick = |words: &[u32]| places.iter().map(|&i| words[i]).collect();
        Self { before: pick(&self.before), words: pick(&self.words) }
    }

    /// The numbers in it.
    pub fn numbers(&self) -> Vec<f32> {
        self.words.iter().map(|&w| f32::from_bits(w)).collect()
    }
}

impl<E: RunPass> Device<E> {
    /// Runs one pass on given inputs and reads buffers back. Outputs that are not inputs too hold [`POISON`]
    /// before.
    pub fn run<const N: usize>(
        &self,
        workspace: &E::Workspace,
        pass: &str,
        inputs: &[(&str, &[u8])],
        outputs: [&str; N],
    ) -> [Readback; N] {
        let read = self.engine.run_pass(workspace, pass, inputs, &outputs).unwrap();
        let mut read = read.into_iter();
        outputs.map(|name| {
            let words: Vec<u32> = bytemuck::pod_collect_to_vec(&read.next().unwrap());
            let mut before = vec![POISON; words.len()];
            for (_, bytes) in inputs.iter().filter(|(input, _)| *input == name) {
                before[..bytes.len() / 4].copy_from_slice(&bytemuck::pod_collect_to_vec::<u8, u32>(bytes));
            }
            Readback { before, words }
        })
    }
}
