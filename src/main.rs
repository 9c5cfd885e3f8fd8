//! The `lumenmesh` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    lumenmesh::cli::main()
}
