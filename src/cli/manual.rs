use super::Arguments as CommandLine;
use crate::{Error, Result};
use clap::CommandFactory;
use clap_complete::Shell;
use std::path::PathBuf;

/// Print the completions of a shell
///
/// They go where the shell looks for them, or are read by it when it starts.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh completions bash > ~/.local/share/bash-completion/completions/lumenmesh
  lumenmesh completions zsh > ~/.zfunc/_lumenmesh
  lumenmesh completions fish > ~/.config/fish/completions/lumenmesh.fish")]
pub(super) struct Completions {
    /// The shell
    shell: Shell,
}

impl Completions {
    pub(super) fn run(self) -> Result<()> {
        let mut text = Vec::new();
        clap_complete::generate(self.shell, &mut CommandLine::command(), "lumenmesh", &mut text);
        print!("{}", String::from_utf8_lossy(&text));
        Ok(())
    }
}

/// Write the manual as man pages, one for each command
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh manual --out ~/.local/share/man/man1
  man lumenmesh-reconstruct")]
pub(super) struct Manual {
    /// The folder that they go to; it is made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

impl Manual {
    pub(super) fn run(self) -> Result<()> {
        let failed = |source| Error::write(&self.out, source);
        std::fs::create_dir_all(&self.out).map_err(failed)?;
        clap_mangen::generate_to(CommandLine::command(), &self.out).map_err(failed)
    }
}
