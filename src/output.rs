//! Files are written as a whole or not at all.

use crate::{Error, Result};
use std::fs::{File, Metadata, Permissions};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Writes `path` through a temporary file beside it, which takes its name once everything is written.
///
/// A symbolic link is followed. A file that is replaced keeps its permissions; a new one has those that the system gives
/// to new files. What is no regular file, such as a pipe, is written to directly.
///
/// # Errors
/// [`Error::Write`] where the folder cannot be written or `content` fails; `path` is then untouched.
pub fn write_atomically(
    path: &Path,
    content: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
) -> Result<()> {
    let write = || -> std::io::Result<()> {
        let target = followed(path)?;
        let old = std::fs::metadata(&target).ok();
        if old.as_ref().is_some_and(|old| !old.is_file() && !old.is_dir()) {
            let mut file = File::options().write(true).open(&target)?;
            content(&mut file)?;
            return file.flush();
        }
        let folder = folder_of(&target);
        // Otherwise the message would name the temporary file, whose name differs at every run.
        std::fs::metadata(folder)?;
        let file = new_file(folder).map_err(|e| std::io::Error::from(e.kind()))?;
        let _unfinished = Unfinished::new(file.path());
        let mut buffered = BufWriter::with_capacity(1 << 16, file.as_file());
        content(&mut buffered)?;
        buffered.flush()?;
        drop(buffered);
        if let Some(permissions) = old.as_ref().map(Metadata::permissions) {
            file.as_file().set_permissions(permissions)?;
        }
        let _committing = lock();
        file.persist(&target).map_err(|e| e.error)?;
        Ok(())
    };
    write().map_err(|source| Error::Write { path: path.to_owned(), source })
}

/// The folder that holds a file.
pub(crate) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Where a path leads once symbolic links are followed; the last one may lead to no file yet.
fn followed(path: &Path) -> std::io::Result<PathBuf> {
    const MAX_LINKS: usize = 40;
    let mut path = path.to_owned();
    for _ in 0..MAX_LINKS {
        match std::fs::read_link(&path) {
            Ok(target) => path = folder_of(&path).join(target),
            Err(_) => return Ok(path),
        }
    }
    Err(std::io::Error::other("too many symbolic links"))
}

/// A temporary file with the permissions of any new file, rather than private.
fn new_file(folder: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".lumenmesh-").suffix(".tmp");
    if let Some(permissions) = permissions_of_new(0o666) {
        builder.permissions(permissions);
    }
    builder.tempfile_in(folder)
}

/// Permissions of a new file or folder before the user's mask is taken off them; `None` where the system has none.
pub(crate) fn permissions_of_new(mode: u32) -> Option<Permissions> {
    #[cfg(unix)]
    {
        Some(std::os::unix::fs::PermissionsExt::from_mode(mode))
    }
    #[cfg(not(unix))]
    {
        let _ = mode;
        None
    }
}

/// Temporary files and folders that are being written, so that an interrupted process leaves none behind.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// While it is held, no [`remove_unfinished`] comes between the steps of a replacement.
pub(crate) fn lock() -> MutexGuard<'static, Vec<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A temporary file or folder that is being written.
pub(crate) struct Unfinished(PathBuf);

impl Unfinished {
    pub(crate) fn new(path: &Path) -> Self {
        lock().push(path.to_owned());
        Self(path.to_owned())
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        lock().retain(|path| *path != self.0);
    }
}

/// Removes the temporary files of all outputs that are being written: for a process that is about to end.
pub fn remove_unfinished() {
    for path in lock().drain(..) {
        // What cannot be removed now can not be mended here.
        let _ = if path.is_dir() { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
    }
}

/// Refuses an output that is one of the inputs, by whatever name, or lies in a folder that is one.
///
/// # Errors
/// [`Error::Input`] about the output.
pub fn refuse_inputs<'a>(output: &Path, inputs: impl IntoIterator<Item = &'a Path>) -> Result<()> {
    let Ok(output_path) = output.canonicalize() else { return Ok(()) };
    for input in inputs {
        let Ok(input_path) = input.canonicalize() else { continue };
        let within = input_path.is_dir() && output_path.parent() == Some(&input_path);
        if output_path == input_path || within {
            return Err(Error::input(output, "output", "an input of the same command", "another file"));
        }
    }
    Ok(())
}

/// The ending of a file's name in lower case, without the dot; empty where there is none.
pub fn ending(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_nothing_and_keeps_the_old_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh.obj");
        write_atomically(&path, |w| w.write_all(b"old")).unwrap();
        let failed = write_atomically(&path, |w| {
            w.write_all(b"half of the new")?;
            Err(std::io::Error::other("disk on fire"))
        });
        assert!(failed.unwrap_err().to_string().contains("mesh.obj: cannot write: disk on fire"));
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_missing_folder_is_said_in_the_same_words_every_time() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("nowhere/mesh.obj");
        let message = write_atomically(&path, |_| Ok(())).unwrap_err().to_string();
        assert!(
            message.contains("mesh.obj: cannot write: ") && !message.contains(".lumenmesh-"),
            "{message}"
        );
    }

    #[test]
    fn an_input_is_not_written_to() {
        let folder = tempfile::tempdir().unwrap();
        let (file, sub) = (folder.path().join("mesh.obj"), folder.path().join("recording"));
        std::fs::write(&file, "v 0 0 0").unwrap();
        std::fs::create_dir(&sub).unwrap();
        std::fs::write(sub.join("poses.csv"), "frame").unwrap();
        let refused = |output: &Path, input: &Path| refuse_inputs(output, [input]).is_err();
        assert!(refused(&file, &file) && refused(&sub.join("../mesh.obj"), &file));
        assert!(refused(&sub.join("poses.csv"), &sub) && refused(&sub, &sub));
        assert!(!refused(&folder.path().join("new.obj"), &file) && !refused(&file, &sub));
    }

    #[cfg(unix)]
    #[test]
    fn permissions_are_kept_and_links_followed() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("mesh.obj"), folder.path().join("link.obj"));
        std::os::unix::fs::symlink("mesh.obj", &link).unwrap();
        // A link that leads nowhere yet.
        write_atomically(&link, |w| w.write_all(b"one")).unwrap();
        assert_eq!(std::fs::read(&file).unwrap(), b"one");
        std::fs::set_permissions(&file, Permissions::from_mode(0o600)).unwrap();
        write_atomically(&link, |w| w.write_all(b"two")).unwrap();
        assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(std::fs::read(&file).unwrap(), b"two");
        assert_eq!(std::fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
    }
}
