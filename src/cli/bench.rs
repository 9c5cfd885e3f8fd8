use super::print_json;
use crate::Result;
use crate::study::bench::{BenchRow, Case, EndToEnd, Parity, SweepCase, SweepRow, Times, run, run_sweep};
use serde::Serialize;

/// Measure how fast the engines are on this machine
///
/// Each size is fitted on the CPU and on the device, cylinders first, then sweeps; the results are compared before
/// anything is timed.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh bench
  lumenmesh bench --sizes 12x5x1e4,512x512x1e6,512x512x1e6:crowded --repeats 9
  lumenmesh bench --sweeps 512x1e6,512x1e7
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
    /// Sweeps as NODESxECHOES, along a vessel 500 mm long
    #[arg(long, value_name = "SIZE,...", value_delimiter = ',', default_value = "90x1e5")]
    sweeps: Vec<SweepCase>,
    /// How often each is timed
    #[arg(long, value_name = "COUNT", default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..))]
    repeats: u16,
    /// Only the CPU
    #[arg(long)]
    no_device: bool,
    /// Do not time the cylinders on the CPU, which computes what the device is compared with all the same
    #[arg(long)]
    no_cpu: bool,
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
    pass_copy_gb_per_s: Option<f64>,
    cold_start_s: Option<f64>,
    rows: Vec<BenchRow>,
    sweeps: Vec<SweepRow>,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        let mut output = Output {
            version: env!("CARGO_PKG_VERSION"),
            threads: rayon::current_num_threads(),
            adapter: None,
            copy_gb_per_s: None,
            pass_copy_gb_per_s: None,
            cold_start_s: None,
            rows: Vec::new(),
            sweeps: Vec::new(),
        };
        #[cfg(feature = "gpu")]
        let device = self.device(&mut output)?;
        if !self.json {
            match (&output.adapter, output.copy_gb_per_s, output.pass_copy_gb_per_s, output.cold_start_s) {
                (Some(adapter), Some(copy), Some(pass), Some(cold)) => {
                    println!("device     {adapter}");
                    println!(
                        "           {copy:.1} GB/s copying (read + written), {pass:.1} by a pass; {:.0} ms cold start",
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
                !self.no_cpu,
                #[cfg(feature = "gpu")]
                device.as_ref(),
            )?;
            if !self.json {
                print_row(&row);
            }
            output.rows.push(row);
        }
        #[cfg(feature = "gpu")]
        let engine = match &device {
            Some(_) if !self.sweeps.is_empty() => {
                Some(crate::sweep::wall::gpu::GpuWallEngine::new(self.adapter.as_deref())?)
            }
            _ => None,
        };
        for &case in &self.sweeps {
            let row = run_sweep(
                case,
                usize::from(self.repeats),
                #[cfg(feature = "gpu")]
                engine.as_ref(),
            )?;
            if !self.json {
                print_sweep(&row);
            }
            output.sweeps.push(row);
        }
        if self.json { print_json(&output) } else { Ok(()) }
    }

    #[cfg(feature = "gpu")]
    fn device(&self, output: &mut Output) -> Result<Option<crate::study::bench::device::Device>> {
        use crate::gpu::adapters;
        if self.no_device || (self.adapter.is_none() && adapters().is_empty()) {
            return Ok(None);
        }
        let device = crate::study::bench::device::Device::new(self.adapter.as_deref())?;
        output.adapter = device.engine.describe().adapter;
        output.copy_gb_per_s = Some(device.copy_bytes_per_s * 1e-9);
        output.pass_copy_gb_per_s = Some(device.pass_copy_bytes_per_s * 1e-9);
        output.cold_start_s = Some(device.cold_start_s);
        Ok(Some(device))
    }
}

fn times(t: &Times) -> String {
    format!("{:>10.3} ms  ({:.3} to {:.3})", t.median_ms, t.min_ms, t.max_ms)
}

fn print_parity(parity: &Parity) {
    println!(
        "  {} = {}: {} of {} nodes differ, median {:.1e} mm, 99 % below {:.1e} mm",
        parity.engines[0], parity.engines[1], parity.differing, parity.nodes, parity.median_mm, parity.p99_mm
    );
}

fn print_sweep(row: &SweepRow) {
    println!();
    println!(
        "{}: {} rings, {} iterations, {} solver steps",
        row.case, row.rings, row.iterations, row.solver_steps
    );
    if let Some(device) = &row.device {
        print_parity(&device.parity);
    }
    println!("  cpu, fitting            {:>10.3} ms", row.cpu_ms);
    let Some(device) = &row.device else { return };
    println!("  device, fitting         {}", times(&device.fit));
    println!("    the first             {:>10.3} ms", device.first_ms);
    print_end_to_end(&device.of_it);
    for pass in &device.passes {
        println!("      {:<20}{:>10.3} ms", pass.name, pass.ms);
    }
}

fn print_end_to_end(parts: &EndToEnd) {
    println!("    of it: kept memory    {}", times(&parts.memory));
    println!("           filling        {}", times(&parts.filling));
    println!("           recording      {}", times(&parts.recording));
    println!("           waiting        {}  {} times", times(&parts.waiting), parts.waits);
    println!("           reading        {}", times(&parts.reading));
}

fn print_row(row: &BenchRow) {
    println!();
    println!("{}, 3 iterations", row.case);
    print_parity(&row.parity);
    if let Some(cpu) = &row.cpu {
        println!("  cpu, 1 thread           {}", times(&cpu.one_thread));
        println!("  cpu, {} threads          {}", cpu.threads, times(&cpu.all_threads));
    }
    let Some(device) = &row.device else { return };
    println!("  device, end to end      {}", times(&device.end_to_end));
    print_end_to_end(&device.of_it);
    println!("    making memory         {}", times(&device.making_memory));
    println!("    upload                {}", times(&device.upload));
    println!("    passes, resident      {}", times(&device.resident));
    println!("    radii back            {}", times(&device.readback));
    if let Some(iteration) = &device.iteration {
        println!("    one more iteration    {}", times(iteration));
    }
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
