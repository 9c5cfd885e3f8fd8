use super::{Shown, print_json, refuse_inputs};
use crate::Result;
use crate::report::render::{Style, View, check_ending, render};
use crate::surface::Surface;
use std::path::PathBuf;

/// Draw a mesh as a PNG picture
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh render vessel.vtp -o vessel.png
  lumenmesh render error.vtp -o error.png --array error_mm --range 0,2 --view front
  lumenmesh render vessel.ply -o small.png --array residual_mm --size 800x600")]
pub(super) struct Arguments {
    /// Mesh: .vtp, .ply, .stl, .obj, .vtk or .vtu
    mesh: PathBuf,
    /// Picture to write: .png
    #[arg(short, long, value_name = "PNG")]
    output: PathBuf,
    /// Show this array of the mesh in colours
    #[arg(long, value_name = "NAME")]
    array: Option<String>,
    /// Values at both ends of the colour bar [default: those of the array, at most 10 times their mean]
    #[arg(long, value_name = "LOW,HIGH", value_parser = range, allow_hyphen_values = true, requires = "array")]
    range: Option<[f64; 2]>,
    /// Direction of view
    #[arg(long, value_enum, default_value = "three")]
    view: View,
    /// Size of the picture in pixels
    #[arg(long, value_name = "WxH", value_parser = size, default_value = "1600x1000")]
    size: [u32; 2],
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        check_ending(&self.output)?;
        refuse_inputs([Some(&*self.output)], [Some(&*self.mesh)])?;
        let surface = Surface::read(&self.mesh)?;
        let style = Style { array: self.array, range: self.range, view: self.view, size: self.size };
        let picture = render(&surface, &style).map_err(|e| e.in_file(&self.mesh))?;
        picture.write(&self.output)?;
        if self.json {
            return print_json(&serde_json::json!({
                "mesh": Shown(&self.mesh),
                "picture": Shown(&self.output),
                "triangles": surface.triangles.len(),
                "arrays": surface.arrays.iter().map(|a| &a.name).collect::<Vec<_>>(),
                "size": style.size,
            }));
        }
        let names: Vec<&str> = surface.arrays.iter().map(|a| a.name.as_str()).collect();
        let names = if names.is_empty() { "none".into() } else { names.join(", ") };
        println!("mesh       {} triangles; arrays: {names}", surface.triangles.len());
        println!("picture    {}", self.output.display());
        Ok(())
    }
}

fn range(text: &str) -> Result<[f64; 2], String> {
    let number = |part: &str| part.trim().parse().map_err(|_| format!("{part:?} is not a number"));
    let (low, high) = text.split_once(',').ok_or("expected two numbers with a comma between them")?;
    Ok([number(low)?, number(high)?])
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let number = |part: &str| part.trim().parse().map_err(|_| format!("{part:?} is not a whole number"));
    let (width, height) = text.split_once('x').ok_or("expected two whole numbers with an x between them")?;
    Ok([number(width)?, number(height)?])
}
