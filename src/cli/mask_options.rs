use super::numbers;
use crate::recording::MaskOptions;

/// How images of the lumen become contours.
#[derive(clap::Args, Default)]
pub(super) struct MaskOptionArguments {
    /// Pixels at or above it are lumen [default: half of the largest pixel]
    #[arg(long, value_name = "VALUE")]
    threshold: Option<f64>,
    /// Width and height of a pixel in mm, or one number for both [default: of ImageToProbe]
    #[arg(long, value_name = "MM[,MM]", value_parser = pixel_size)]
    pixel_size: Option<[f64; 2]>,
    /// The probe in the image, in pixels from the centre of the first [default: of ImageToProbe, or the middle]
    #[arg(long, value_name = "X,Y", value_parser = numbers::<2>, allow_hyphen_values = true)]
    centre: Option<[f64; 2]>,
    /// Points of a contour [default: 128]
    #[arg(long, value_name = "N")]
    points: Option<usize>,
    /// Take the largest region where none contains the probe
    #[arg(long)]
    largest: bool,
}

impl MaskOptionArguments {
    /// The options, with defaults for what was not given.
    pub(super) fn options(&self) -> MaskOptions {
        let options = MaskOptions::default();
        let points = self.points.unwrap_or(options.points);
        options
            .with_threshold(self.threshold)
            .with_points(points)
            .with_pixel_mm(self.pixel_size)
            .with_centre_px(self.centre)
            .with_largest(self.largest)
    }
}

fn pixel_size(text: &str) -> Result<[f64; 2], String> {
    match text.contains(',') {
        true => numbers::<2>(text),
        false => numbers::<1>(text).map(|[size]| [size, size]),
    }
}
