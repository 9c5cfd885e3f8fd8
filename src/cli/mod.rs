//! The command line: a thin layer over the library, one file per sub-command.

/// The standard macro panics where stdout is a closed pipe (`| head`) or a full disk; this one ends the process.
macro_rules! print {
    ($($text:tt)*) => { $crate::cli::say(format_args!($($text)*)) };
}

/// As [`print!`], with an end of line.
macro_rules! println {
    () => { print!("\n") };
    ($($text:tt)*) => { print!("{}\n", format_args!($($text)*)) };
}

mod bench;
mod conventions;
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
mod replay;
mod report;
mod sections;
mod settings;
mod simulate;
mod study;
mod vessel;

use crate::recording::{Recording, Screened, Screening};
use crate::settings::Settings;
use crate::{Error, Result};
use clap::{Parser, Subcommand};
use std::path::Path;
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
    Replay(replay::Arguments),
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
        Command::Replay(arguments) => arguments.run(),
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

/// Reads a recording and prepares it as [`Reconstructor::run`](crate::reconstruction::Reconstructor::run) does.
fn read_screened(path: &Path, settings: &Settings) -> Result<(Recording, Screening)> {
    let read = Recording::read_unchecked(path)?;
    let screened =
        Screened::of(&read, &settings.conventions, settings.unfit_frames).map_err(|e| e.in_file(path))?;
    screened.recording.check().map_err(|e| e.in_file(path))?;
    let screening = screened.screening;
    Ok((screened.recording.into_owned(), screening))
}

/// N numbers separated by commas.
fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let parts = text
        .split(',')
        .map(|part| part.trim().parse::<f64>().map_err(|_| format!("{part:?} is not a number")))
        .collect::<Result<Vec<_>, _>>()?;
    parts.try_into().map_err(|parts: Vec<f64>| format!("found {} numbers, expected {N}", parts.len()))
}

/// Prints a value as JSON on stdout.
fn print_json(value: &impl serde::Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value)
        .map_err(|e| Error::Output { target: "stdout", source: e.into() })?;
    println!("{text}");
    Ok(())
}

/// Writes to stdout, or ends the process where that fails: silently where the reader has closed the pipe, as `head` does,
/// else with status 1.
fn say(text: std::fmt::Arguments) {
    match std::io::Write::write_fmt(&mut std::io::stdout().lock(), text) {
        Ok(()) => {}
        Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => std::process::exit(0),
        Err(source) => {
            eprintln!("lumenmesh: {}", Error::Output { target: "stdout", source });
            std::process::exit(1);
        }
    }
}
