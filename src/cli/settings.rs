use crate::Result;
use crate::settings::{Backend, Method, Outliers, Settings, Statistic};
use std::path::PathBuf;

/// The settings as flags, one for each; they override a settings file, which overrides the defaults.
#[derive(clap::Args, Default)]
#[command(next_help_heading = "Settings")]
pub(super) struct SettingsArguments {
    /// Read settings from a TOML file; flags override it
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// How the wall is reconstructed [default: cylinders]
    #[arg(long, value_enum)]
    method: Option<Method>,
    /// Where it is computed [default: auto]
    #[arg(long, value_enum)]
    backend: Option<Backend>,
    /// Adapter of the backend gpu, and of auto for large work, by name or a part of it [default: the best;
    /// see lumenmesh devices]
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
    /// Nodes a ring [default: 12]
    #[arg(long, value_name = "N")]
    nodes: Option<u32>,
    /// Levels of faces a cylinder [default: 5]
    #[arg(long, value_name = "L")]
    levels: Option<u32>,
    /// Height of a cylinder [default: 10]
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    height: Option<f64>,
    /// Iterations of the fit [default: 3]
    #[arg(long, value_name = "COUNT")]
    iterations: Option<u32>,
    /// Radial gate, in radii of the cylinder [default: 0.5,1.5]
    #[arg(long, value_name = "LOW,HIGH", value_parser = numbers::<2>, allow_hyphen_values = true)]
    gate: Option<[f64; 2]>,
    /// Which distances of a triangle count [default: iqr]
    #[arg(long, value_enum)]
    outliers: Option<Outliers>,
    /// What stands for the distances of a triangle [default: mean]
    #[arg(long, value_enum)]
    statistic: Option<Statistic>,
    /// Fit and merge a cylinder every so many frames [default: 10]
    #[arg(long, value_name = "FRAMES")]
    every: Option<u32>,
    /// Nodes a ring of the method sweep [default: one for each ray, as far as echoes suffice]
    #[arg(long, value_name = "N")]
    sweep_nodes: Option<u32>,
    /// How much the method sweep expects a wall to bend within its own size [default: 0.125]
    #[arg(long, value_name = "TAU")]
    roughness: Option<f64>,
    /// Keep the parts of a swept vessel that no echo supports
    #[arg(long)]
    keep_unsupported: bool,
    /// For a vessel that moves: let an echo's weight in the method sweep halve in so many seconds of newer ones about it
    /// [default: all count alike]
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    half_life: Option<f64>,
    /// Probe in the tracker sensor's frame: position in mm and unit quaternion [default: 0,0,0,0,0,0,1]
    #[arg(long, value_name = "X,Y,Z,QX,QY,QZ,QW", value_parser = numbers::<7>, allow_hyphen_values = true)]
    calibration: Option<[f64; 7]>,
}

impl SettingsArguments {
    /// The settings of the file, or the defaults, with the flags on top.
    pub(super) fn settings(&self) -> Result<Settings> {
        let mut settings = match &self.config {
            Some(path) => Settings::read_toml(path)?,
            None => Settings::default(),
        };
        fn set<T: Copy>(field: &mut T, flag: Option<T>) {
            if let Some(value) = flag {
                *field = value;
            }
        }
        set(&mut settings.method, self.method);
        set(&mut settings.backend, self.backend);
        if self.adapter.is_some() {
            settings.adapter.clone_from(&self.adapter);
        }
        set(&mut settings.nodes, self.nodes);
        set(&mut settings.levels, self.levels);
        set(&mut settings.height_mm, self.height);
        set(&mut settings.iterations, self.iterations);
        set(&mut settings.gate, self.gate);
        set(&mut settings.outliers, self.outliers);
        set(&mut settings.statistic, self.statistic);
        set(&mut settings.every, self.every);
        if self.sweep_nodes.is_some() {
            settings.sweep.nodes = self.sweep_nodes;
        }
        set(&mut settings.sweep.roughness, self.roughness);
        settings.sweep.keep_unsupported |= self.keep_unsupported;
        if self.half_life.is_some() {
            settings.sweep.half_life_s = self.half_life;
        }
        if let Some([x, y, z, qx, qy, qz, qw]) = self.calibration {
            settings.calibration.position_mm = [x, y, z];
            settings.calibration.quaternion = [qx, qy, qz, qw];
        }
        settings.validate()?;
        Ok(settings)
    }
}

/// So many numbers with commas between them.
fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let parts = text
        .split(',')
        .map(|part| part.trim().parse::<f64>().map_err(|_| format!("{part:?} is not a number")))
        .collect::<Result<Vec<_>, _>>()?;
    parts.try_into().map_err(|parts: Vec<f64>| format!("found {} numbers, expected {N}", parts.len()))
}
