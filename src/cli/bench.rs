use super::print_json;
use crate::Result;
use crate::bench::{Case, Row, Times, run};
use serde::Serialize;

/// Measure how fast the engines are on this machine
///
/// Each size is fitted on the CPU and on the device; the results are compared before anything is timed.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh bench
  lumenmesh bench --sizes 12x5x1e4,512x512x1e6,512x512x1e6:crowded --repeats 9
  lumenmesh bench --no-device --json > bench.json")]
pub(super) struct Arguments {
    /// Sizes as NODESxLEVELSxPOINTS, with :crowded (all points in 1 % of the faces) or :half (half the
    /// faces empty)
    #[arg(
        long,
        value_name = "SIZE,...",
        value_delimiter = ',',
        default_value = "12x5x1e4,12x5x1e6,512x512x1e6"
    )]
    sizes: Vec<Case>,
    /// How often each is timed
    #[arg(long, value_name = "COUNT", default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..))]
    repeats: u16,
    /// Only the CPU
    #[arg(long)]
    no_device: bool,
    /// Adapter, by name or a part of it [default: the best; see lumenmesh devices]
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Output {
    version: &'static str,
    threads: usize,
    adapter: Option<String>,
    copy_gb_per_s: Option<f64>,
    cold_start_s: Option<f64>,
    rows: Vec<Row>,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        let mut output = Output {
            version: env!("CARGO_PKG_VERSION"),
            threads: rayon::current_num_threads(),
            adapter: None,
            copy_gb_per_s: None,
            cold_start_s: None,
            rows: Vec::new(),
        };
        #[cfg(feature = "gpu")]
        let device = self.device(&mut output)?;
        if !self.json {
            match (&output.adapter, output.copy_gb_per_s, output.cold_start_s) {
                (Some(adapter), Some(copy), Some(cold)) => {
                    println!("device     {adapter}");
                    println!(
                        "           {copy:.1} GB/s copying (read + written), {:.0} ms cold start",
                        cold * 1e3
                    );
                }
                _ => println!("device     none"),
            }
            println!("cpu        {} threads", output.threads);
        }
        for &case in &self.sizes {
            let row = run(
                case,
                usize::from(self.repeats),
                #[cfg(feature = "gpu")]
                device.as_ref(),
            )?;
            if !self.json {
                print_row(&row);
            }
            output.rows.push(row);
        }
        if self.json { print_json(&output) } else { Ok(()) }
    }

    #[cfg(feature = "gpu")]
    fn device(&self, output: &mut Output) -> Result<Option<crate::bench::device::Device>> {
        use crate::fit::Engine;
        use crate::gpu::adapters;
        if self.no_device || (self.adapter.is_none() && adapters().is_empty()) {
            return Ok(None);
        }
        let device = crate::bench::device::Device::new(self.adapter.as_deref())?;
        output.adapter = device.engine.describe().adapter;
        output.copy_gb_per_s = Some(device.copy_bytes_per_s * 1e-9);
        output.cold_start_s = Some(device.cold_start_s);
        Ok(Some(device))
    }
}

fn print_row(row: &Row) {
    let times = |t: &Times| format!("{:>10.3} ms  ({:.3} to {:.3})", t.median_ms, t.min_ms, t.max_ms);
    println!();
    println!("{}, 3 iterations", row.case);
    let parity = &row.parity;
    println!(
        "  {} = {}: {} of {} nodes differ, median {:.1e} mm, 99 % below {:.1e} mm",
        parity.engines[0], parity.engines[1], parity.differing, parity.nodes, parity.median_mm, parity.p99_mm
    );
    println!("  cpu, 1 thread           {}", times(&row.cpu.one_thread));
    println!("  cpu, {} threads          {}", row.cpu.threads, times(&row.cpu.all_threads));
    let Some(device) = &row.device else { return };
    println!("  device, end to end      {}", times(&device.end_to_end));
    println!("    upload                {}", times(&device.upload));
    println!("    passes, resident      {}", times(&device.resident));
    println!("    radii back            {}", times(&device.readback));
    for pass in &device.passes {
        println!(
            "      {:<20}{:>10.3} ms  {:>8.2} MB, {:>5.1} % of copy bandwidth{}",
            pass.name,
            pass.median_ms,
            pass.bytes as f64 * 1e-6,
            pass.share_of_copy_bandwidth * 100.0,
            match pass.flops {
                0 => String::new(),
                flops => format!(", {:.2} Gflop", flops as f64 * 1e-9),
            }
        );
    }
}
