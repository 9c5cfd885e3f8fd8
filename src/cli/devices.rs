use super::print_json;
use crate::Result;
use crate::engine::{WORTH_A_DEVICE_S, choose};
use crate::gpu::{AdapterDescription, adapters};
use serde::Serialize;

/// Show the GPU adapters and which one would be used
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh devices
  lumenmesh devices --json | jq '.adapters[].name'
  lumenmesh reconstruct pullback.mat -o vessel.vtp --backend gpu --adapter llvmpipe

Exit status: 0 whether or not there is an adapter.")]
pub(super) struct Arguments {
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report {
    /// The best one first.
    adapters: Vec<AdapterDescription>,
    gpu: Choice,
    auto: Choice,
}

/// What a backend does on this machine.
#[derive(Serialize)]
struct Choice {
    /// None: the CPU engine, or no engine at all.
    adapter: Option<String>,
    why: String,
}

impl Report {
    fn new(adapters: Vec<AdapterDescription>) -> Self {
        let gpu = match &adapters[..] {
            [] => Choice { adapter: None, why: "there is no GPU adapter".into() },
            [only] => Choice { adapter: Some(only.name.clone()), why: "it is the only adapter".into() },
            [best, ..] => {
                let why = format!("its kind, {}, comes first; --adapter NAME takes another", best.kind);
                Choice { adapter: Some(best.name.clone()), why }
            }
        };
        let auto = match choose(&adapters) {
            Ok(best) => {
                let seconds = WORTH_A_DEVICE_S;
                let why = format!("for work that would take the CPU {seconds} s or more; less stays there");
                Choice { adapter: Some(best.name.clone()), why }
            }
            Err(reason) => Choice { adapter: None, why: reason.to_string() },
        };
        Self { adapters, gpu, auto }
    }
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        let report = Report::new(adapters());
        if self.json {
            return print_json(&report);
        }
        if report.adapters.is_empty() {
            println!("no GPU adapter (Vulkan, Metal or Direct3D 12)\n");
        }
        for adapter in &report.adapters {
            print_adapter(adapter);
        }
        print_choice("gpu", &report.gpu, "fails");
        print_choice("auto", &report.auto, "stays on the CPU");
        Ok(())
    }
}

fn print_adapter(adapter: &AdapterDescription) {
    println!("{}", adapter.name);
    println!("  kind       {}", adapter.kind);
    println!("  backend    {}, driver {}", adapter.backend, adapter.driver);
    let [buffer, binding] = [adapter.max_buffer_bytes, adapter.max_storage_binding_bytes].map(mebibytes);
    println!(
        "  memory     {buffer} MiB per buffer, {binding} MiB per binding ({} million points)",
        points(adapter)
    );
    println!(
        "  workgroup  {} invocations, {} KiB",
        adapter.max_workgroup_invocations,
        adapter.max_workgroup_bytes / 1024
    );
    println!("  timestamps {}\n", if adapter.timestamps { "yes" } else { "no" });
}

fn print_choice(backend: &str, choice: &Choice, otherwise: &str) {
    match &choice.adapter {
        Some(name) => println!("--backend {backend:<5} takes {name}: {}", choice.why),
        None => println!("--backend {backend:<5} {otherwise}: {}", choice.why),
    }
}

fn mebibytes(bytes: u64) -> u64 {
    bytes >> 20
}

/// Points that one tube can have, in millions: 16 bytes each, in one binding.
fn points(adapter: &AdapterDescription) -> u64 {
    adapter.max_storage_binding_bytes.min(adapter.max_buffer_bytes) / 16_000_000
}
