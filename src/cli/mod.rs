//! The command line: a thin layer over the library, one file per sub-command.

mod bench;
mod demo;
#[cfg(feature = "gpu")]
mod devices;
mod evaluate;
mod experiments;
mod import;
mod info;
mod progress;
mod reconstruct;
mod render;
mod report;
mod sections;
mod settings;
mod simulate;
mod study;
mod vessel;

use crate::{Error, Result};
use clap::{Parser, Subcommand};
use std::process::ExitCode;

#[derive(Parser)]
#[command(name = "lumenmesh", version, about, max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Reconstruct(reconstruct::Arguments),
    Evaluate(evaluate::Arguments),
    Sections(sections::Arguments),
    Info(info::Arguments),
    Import(import::Arguments),
    Demo(demo::Arguments),
    Bench(bench::Arguments),
    Simulate(simulate::Arguments),
    Experiments(experiments::Arguments),
    Study(study::Arguments),
    Render(render::Arguments),
    Report(report::Arguments),
    #[cfg(feature = "gpu")]
    Devices(devices::Arguments),
}

/// Runs the command line of this process. Exit status: 0 done, 1 the work failed, 2 the usage is wrong.
pub fn main() -> ExitCode {
    let done: Result<()> = match Arguments::parse().command {
        Command::Reconstruct(arguments) => arguments.run(),
        Command::Evaluate(arguments) => arguments.run(),
        Command::Sections(arguments) => arguments.run(),
        Command::Info(arguments) => arguments.run(),
        Command::Import(arguments) => arguments.run(),
        Command::Demo(arguments) => arguments.run(),
        Command::Bench(arguments) => arguments.run(),
        Command::Simulate(arguments) => arguments.run(),
        Command::Experiments(arguments) => arguments.run(),
        Command::Study(arguments) => arguments.run(),
        Command::Render(arguments) => arguments.run(),
        Command::Report(arguments) => arguments.run(),
        #[cfg(feature = "gpu")]
        Command::Devices(arguments) => arguments.run(),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("lumenmesh: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Prints a value as JSON on stdout.
fn print_json(value: &impl serde::Serialize) -> Result<()> {
    let mut out = std::io::stdout().lock();
    serde_json::to_writer_pretty(&mut out, value)
        .map_err(std::io::Error::from)
        .and_then(|()| std::io::Write::write_all(&mut out, b"\n"))
        .map_err(|source| Error::Write { path: "stdout".into(), source })
}

/// Prints text on stdout. A reader that has seen enough, such as `head`, closes the pipe.
fn print_text(text: &str) {
    let _closed = std::io::Write::write_all(&mut std::io::stdout().lock(), text.as_bytes());
}
