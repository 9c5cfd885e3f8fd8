use super::settings::SettingsArguments;
use super::space::SpaceArgument;
use super::{print_json, progress};
use crate::output::write_atomically;
use crate::reconstruction::{Reconstructor, Summary};
use crate::settings::Settings;
use crate::{Error, Result, surface};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Reconstruct every recording in a folder
///
/// Each recording NAME gives DIR/NAME.vtp and DIR/NAME.json, as `reconstruct --json` prints it. A recording that fails is
/// named and the others go on; what an earlier run made of it is removed. DIR/batch.csv has a line for each. Run again, only
/// recordings are done that are new, have changed or failed, or that were made with other settings.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh batch recordings --out meshes
  lumenmesh batch recordings --out meshes --format ply --method cylinders
  lumenmesh batch recordings --out meshes --json | jq '.[] | select(.error)'

Exit status: 0 all are done, 1 some failed, 2 wrong usage.")]
pub(super) struct Arguments {
    /// Folder of .mat files, and of folders with poses.csv and contours.csv
    folder: PathBuf,
    /// Where the meshes go; it is made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Format of the meshes: vtp, ply, stl, obj or mat
    #[arg(long, value_name = "ENDING", default_value = "vtp")]
    format: String,
    /// Print the table as JSON instead of text
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    space: SpaceArgument,
    #[command(flatten)]
    settings: SettingsArguments,
}

/// A line of the table.
#[derive(Debug, Clone, Serialize)]
struct Line {
    recording: String,
    /// Frames of the recording, and those that were left out.
    frames: Option<usize>,
    left_out: Option<usize>,
    nodes: Option<usize>,
    triangles: Option<usize>,
    /// Why there is no mesh.
    error: Option<String>,
    /// Whether the mesh was there already.
    #[serde(skip)]
    resumed: bool,
}

/// What a mesh was made of, and its line of the table: it says whether it has to be made again.
#[derive(Serialize, Deserialize)]
struct Made {
    /// Checksum of the recording's files.
    input_crc32: u32,
    /// Settings and format, as text.
    how: String,
    frames: usize,
    left_out: usize,
    nodes: usize,
    triangles: usize,
}

impl Made {
    /// The ending of the mesh.
    fn format(&self) -> Option<&str> {
        self.how.lines().find_map(|line| line.strip_prefix("format = "))
    }
}

/// A report as `reconstruct --json` prints it, with what it was made of.
#[derive(Serialize)]
struct Report<'a> {
    batch: &'a Made,
    #[serde(flatten)]
    summary: Summary<'a>,
}

/// What of a report says whether it has to be made again.
#[derive(Deserialize)]
struct Before {
    batch: Made,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        let settings = self.settings.settings()?;
        surface::check_ending(Path::new("mesh").with_extension(&self.format).as_path())?;
        let recordings = recordings(&self.folder)?;
        std::fs::create_dir_all(&self.out).map_err(|source| Error::write(&self.out, source))?;
        if same_folder(&self.folder, &self.out) {
            let found = format!("{}, the recordings' folder", self.out.display());
            return Err(Error::setting("out", found, "another folder"));
        }
        let how = format!(
            "{}\nformat = {}\nspace = {}\n{}",
            settings.to_toml()?,
            self.format,
            self.space.name(),
            self.settings.reading()
        );
        let bar = progress::bar("reconstructing", recordings.len());
        let lines: Vec<Line> = recordings
            .par_iter()
            .map(|path| {
                let line = self.line(path, &settings, &how);
                bar.inc(1);
                line
            })
            .collect();
        bar.finish_and_clear();
        self.write_table(&lines)?;
        let failed = lines.iter().filter(|line| line.error.is_some()).count();
        if self.json {
            print_json(&lines)?;
        } else {
            print_lines(&lines);
            println!("wrote {}", self.table().display());
        }
        match failed {
            0 => Ok(()),
            _ => {
                let found = format!("{failed} of {} that failed", lines.len());
                Err(Error::input(&self.folder, "recordings", found, "a mesh of each"))
            }
        }
    }

    fn table(&self) -> PathBuf {
        self.out.join("batch.csv")
    }

    /// Reconstructs one recording, unless that was done before.
    fn line(&self, path: &Path, settings: &Settings, how: &str) -> Line {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let line = |made: &Made, resumed| Line {
            recording: name.clone(),
            frames: Some(made.frames),
            left_out: Some(made.left_out),
            nodes: Some(made.nodes),
            triangles: Some(made.triangles),
            error: None,
            resumed,
        };
        match self.made(path, settings, how) {
            Ok((made, resumed)) => line(&made, resumed),
            Err(error) => Line {
                recording: name.clone(),
                frames: None,
                left_out: None,
                nodes: None,
                triangles: None,
                error: Some(error.to_string()),
                resumed: false,
            },
        }
    }

    fn made(&self, path: &Path, settings: &Settings, how: &str) -> Result<(Made, bool)> {
        let stem = path.file_stem().unwrap_or_default();
        let file = |ending: &str| self.out.join(stem).with_added_extension(ending);
        let (mesh, report) = (file(&self.format), file("json"));
        let input_crc32 = checksum(path)?;
        let before =
            std::fs::read(&report).ok().and_then(|text| serde_json::from_slice::<Before>(&text).ok());
        let mut before = before.map(|before| before.batch);
        let is_done = |before: &Made| before.input_crc32 == input_crc32 && before.how == how && mesh.exists();
        if let Some(before) = before.take_if(|before| is_done(before)) {
            return Ok((before, true));
        }
        // From here on the earlier results are those of another recording, or of other settings.
        if let Some(before) = before {
            let old = before.format().map(file);
            remove(old.iter().chain([&mesh, &report]))?;
        }
        let recording = self.settings.read(path)?;
        let lumen = Reconstructor::new(settings.clone()).run(&recording).map_err(|e| e.in_file(path))?;
        let surface = lumen.surface();
        self.space.write(&surface, &mesh)?;
        let now = Made {
            input_crc32,
            how: how.to_owned(),
            frames: recording.frames.len(),
            left_out: lumen.screening().left_out.len(),
            nodes: surface.nodes_mm.len(),
            triangles: surface.triangles.len(),
        };
        // Last: it says that all is done.
        write_json(&Report { batch: &now, summary: lumen.summary() }, &report)?;
        Ok((now, false))
    }

    fn write_table(&self, lines: &[Line]) -> Result<()> {
        let path = self.table();
        let mut writer = csv::Writer::from_writer(Vec::new());
        for line in lines {
            writer.serialize(line).map_err(|e| Error::write(&path, std::io::Error::other(e)))?;
        }
        let bytes =
            writer.into_inner().map_err(|e| Error::write(&path, std::io::Error::other(e.to_string())))?;
        write_atomically(&path, |w| w.write_all(&bytes))
    }
}

/// Removes files where they are there.
fn remove<'a>(files: impl IntoIterator<Item = &'a PathBuf>) -> Result<()> {
    for file in files {
        match std::fs::remove_file(file) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(Error::write(file, e)),
            _ => (),
        }
    }
    Ok(())
}

fn write_json(value: &impl Serialize, path: &Path) -> Result<()> {
    let text = serde_json::to_string_pretty(value).map_err(|e| Error::write(path, e.into()))?;
    write_atomically(path, |w| w.write_all(text.as_bytes()))
}

fn print_lines(lines: &[Line]) {
    for line in lines {
        match (&line.error, line.nodes) {
            (Some(error), _) => println!("{}: failed: {error}", line.recording),
            (None, nodes) => println!(
                "{}: {} nodes, {} triangles, {} of {} frames left out{}",
                line.recording,
                nodes.unwrap_or(0),
                line.triangles.unwrap_or(0),
                line.left_out.unwrap_or(0),
                line.frames.unwrap_or(0),
                if line.resumed { " (was there)" } else { "" }
            ),
        }
    }
}

/// The recordings in a folder, by their names.
fn recordings(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|source| Error::read(folder, source))?;
    let mut found = Vec::new();
    for entry in entries {
        let path = entry.map_err(|source| Error::read(folder, source))?.path();
        let is_file = matches!(crate::output::ending(&path).as_str(), "mat" | "mha" | "mhd" | "nrrd");
        if is_file || path.join("poses.csv").exists() {
            found.push(path);
        }
    }
    found.sort();
    // Two of one name would have one mesh.
    if let Some([a, b]) = found.array_windows::<2>().find(|[a, b]| a.file_stem() == b.file_stem()) {
        let found = format!("{} and {}", a.display(), b.display());
        return Err(Error::input(folder, "recordings", found, "names that differ before their endings"));
    }
    match found.is_empty() {
        true => Err(Error::input(
            folder,
            "recordings",
            "none",
            "a .mat or sequence file, or a folder with poses.csv",
        )),
        false => Ok(found),
    }
}

fn same_folder(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// The checksum of a recording's files.
fn checksum(path: &Path) -> Result<u32> {
    let mut hasher = crc32fast::Hasher::new();
    let mut add = |file: &Path| -> Result<()> {
        hasher.update(&std::fs::read(file).map_err(|source| Error::read(file, source))?);
        Ok(())
    };
    match path.is_dir() {
        false => add(path)?,
        true => {
            for name in ["poses.csv", "contours.csv", "cylinders.csv"] {
                let file = path.join(name);
                if file.exists() {
                    add(&file)?;
                }
            }
        }
    }
    Ok(hasher.finalize())
}
