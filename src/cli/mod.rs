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

mod axis;
mod batch;
mod bench;
mod compare;
mod conventions;
mod convert;
mod demo;
#[cfg(feature = "gpu")]
mod devices;
mod evaluate;
mod experiments;
mod faults;
mod import;
mod info;
mod interrupt;
mod live;
mod manual;
mod mask_options;
mod mesh;
mod messages;
mod progress;
mod reconstruct;
mod render;
mod replay;
mod report;
mod sections;
mod settings;
mod simulate;
mod space;
mod study;
mod vessel;
mod view;

use crate::output;
use crate::recording::{Recording, Screened, Screening};
use crate::settings::Settings;
use crate::{Error, Result};
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use serde::Serialize;
use std::io::IsTerminal;
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
    Axis(axis::Arguments),
    Sections(sections::Arguments),
    Compare(compare::Arguments),
    Mesh(mesh::Arguments),
    Info(info::Arguments),
    Import(import::Arguments),
    Convert(convert::Arguments),
    Batch(batch::Arguments),
    Demo(demo::Arguments),
    Bench(bench::Arguments),
    Simulate(Box<simulate::Arguments>),
    Experiments(experiments::Arguments),
    Study(study::Arguments),
    Live(Box<live::Arguments>),
    Replay(replay::Arguments),
    Render(render::Arguments),
    Report(report::Arguments),
    View(view::Arguments),
    #[cfg(feature = "gpu")]
    Devices(devices::Arguments),
    Completions(manual::Completions),
    Manual(manual::Manual),
}

/// Runs the command line of this process. Exit status: 0 done, 1 the work failed, 2 the usage is wrong; `live`
/// has more.
pub fn main() -> ExitCode {
    quiet_drivers();
    interrupt::watch();
    let arguments = match parsed() {
        Ok(arguments) => arguments,
        // clap ignores that they cannot be written.
        Err(asked) if !asked.use_stderr() => {
            let text = asked.render();
            match std::io::stdout().is_terminal() {
                true => print!("{}", text.ansi()),
                false => print!("{text}"),
            }
            return ExitCode::SUCCESS;
        }
        Err(wrong) => wrong.exit(),
    };
    let done = match arguments.command {
        Command::Reconstruct(arguments) => arguments.run(),
        Command::Evaluate(arguments) => arguments.run(),
        Command::Axis(arguments) => arguments.run(),
        Command::Sections(arguments) => arguments.run(),
        Command::Compare(arguments) => arguments.run(),
        Command::Mesh(arguments) => arguments.run(),
        Command::Info(arguments) => arguments.run(),
        Command::Import(arguments) => arguments.run(),
        Command::Convert(arguments) => arguments.run(),
        Command::Batch(arguments) => arguments.run(),
        Command::Demo(arguments) => arguments.run(),
        Command::Bench(arguments) => arguments.run(),
        Command::Simulate(arguments) => arguments.run(),
        Command::Experiments(arguments) => arguments.run(),
        Command::Study(arguments) => arguments.run(),
        Command::Live(arguments) => return status(arguments.run()),
        Command::Replay(arguments) => return status(arguments.run()),
        Command::Render(arguments) => arguments.run(),
        Command::Report(arguments) => arguments.run(),
        Command::View(arguments) => arguments.run(),
        Command::Completions(arguments) => arguments.run(),
        Command::Manual(arguments) => arguments.run(),
        #[cfg(feature = "gpu")]
        Command::Devices(arguments) => arguments.run(),
    };
    status(done.map(|()| ExitCode::SUCCESS))
}

/// The command line of this process.
fn parsed() -> clap::error::Result<Arguments> {
    let mut command = with_negative_numbers(Arguments::command());
    let found = command.try_get_matches_from_mut(std::env::args_os())?;
    Arguments::from_arg_matches(&found).map_err(|wrong| wrong.format(&mut command))
}

/// A command whose options take a negative number for their value: where it must not be one, the message names the option and
/// says what it takes.
fn with_negative_numbers(command: clap::Command) -> clap::Command {
    let argument = |argument: clap::Arg| match argument.get_action().takes_values() {
        true => argument.allow_negative_numbers(true),
        false => argument,
    };
    command.mut_args(argument).mut_subcommands(with_negative_numbers)
}

/// The exit status of a command; an error is told.
fn status(done: Result<ExitCode>) -> ExitCode {
    match done {
        Ok(code) => code,
        Err(error) => {
            eprintln!("lumenmesh: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Where no user is logged in, as on a server or in a container, Linux's graphics libraries complain on stderr that
/// `XDG_RUNTIME_DIR` is missing. The process starts itself again with one; a library call cannot do that for its host.
fn quiet_drivers() {
    #[cfg(all(target_os = "linux", feature = "gpu"))]
    if std::env::var_os("XDG_RUNTIME_DIR").is_none()
        && let Ok(program) = std::env::current_exe()
    {
        use std::os::unix::process::CommandExt;
        let mut again = std::process::Command::new(program);
        again.args(std::env::args_os().skip(1)).env("XDG_RUNTIME_DIR", std::env::temp_dir());
        // It returns only where it failed: then this process goes on, complaints and all.
        let _ = again.exec();
    }
}

/// Refuses outputs that are among the inputs of the same command.
fn refuse_inputs<'a>(
    outputs: impl IntoIterator<Item = Option<&'a Path>>,
    inputs: impl IntoIterator<Item = Option<&'a Path>>,
) -> Result<()> {
    let inputs: Vec<&Path> = inputs.into_iter().flatten().collect();
    outputs.into_iter().flatten().try_for_each(|output| output::refuse_inputs(output, inputs.iter().copied()))
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

/// A path in JSON. Bytes that are no UTF-8 are replaced.
struct Shown<'a>(&'a Path);

impl Shown<'_> {
    fn display(&self) -> std::path::Display<'_> {
        self.0.display()
    }
}

impl Serialize for Shown<'_> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&self.0.display())
    }
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
