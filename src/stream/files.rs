//! The mesh and a snapshot every so often.

use super::update::{Sink, Update};
use crate::output::write_atomically;
use crate::reconstruction::Live;
use crate::surface::Space;
use crate::{Error, Result};
use std::path::PathBuf;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Writes files while the run goes on, on a thread of its own, each as a whole or not at all. Where the disk is
/// slower than the interval, fewer are written.
pub(crate) struct Files {
    every: Duration,
    mesh: Option<(PathBuf, Space)>,
    snapshot: Option<PathBuf>,
    last: Instant,
    writing: Option<JoinHandle<Result<()>>>,
}

impl Files {
    pub(crate) fn new(every: Duration, mesh: Option<(PathBuf, Space)>, snapshot: Option<PathBuf>) -> Self {
        Self { every, mesh, snapshot, last: Instant::now(), writing: None }
    }

    /// Waits for what is being written.
    fn written(&mut self) -> Result<()> {
        let Some(writing) = self.writing.take() else { return Ok(()) };
        let panicked =
            |_| Error::Output { target: "files", source: std::io::Error::other("the writer failed") };
        writing.join().map_err(panicked)?
    }
}

impl Sink for Files {
    fn take(&mut self, update: &Update) -> Result<()> {
        let is_busy = self.writing.as_ref().is_some_and(|writing| !writing.is_finished());
        if self.last.elapsed() < self.every || is_busy {
            return Ok(());
        }
        let before = self.written();
        self.last = Instant::now();
        let surface = self.mesh.as_ref().map(|_| update.live.surface());
        let state = self.snapshot.as_ref().map(|_| update.live.state()).transpose()?;
        let (mesh, snapshot) = (self.mesh.clone(), self.snapshot.clone());
        self.writing = Some(std::thread::spawn(move || {
            // A vessel that has not begun has no mesh.
            if let (Some(surface), Some((path, space))) = (surface.filter(|s| !s.triangles.is_empty()), mesh)
            {
                surface.write_in(&path, space)?;
            }
            if let (Some(state), Some(path)) = (state, snapshot) {
                write_atomically(&path, |file| file.write_all(&state))?;
            }
            Ok(())
        }));
        before
    }

    /// The last snapshot goes on where the frames ended.
    fn last_frame(&mut self, live: &Live) -> Result<()> {
        let before = self.written();
        if let Some(path) = &self.snapshot {
            live.snapshot(path)?;
        }
        before
    }
}
