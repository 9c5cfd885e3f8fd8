use super::mask_options::MaskOptionArguments;
use crate::openigtlink::{AssemblerOptions, SourceOptions};

/// How frames come out of messages of OpenIGTLink.
#[derive(clap::Args, Default)]
#[command(next_help_heading = "OpenIGTLink")]
pub(super) struct MessageArguments {
    /// Device whose transforms are the pose, or the tool's name in TDATA [default: ProbeToTracker]
    #[arg(long, value_name = "NAME")]
    pose_device: Option<String>,
    /// Device of the contours or masks [default: any, but no masks]
    #[arg(long, value_name = "NAME")]
    contour_device: Option<String>,
    /// Contours are stamped so much later than their image was taken, s [default: 0]
    #[arg(long, value_name = "S")]
    contour_delay: Option<f64>,
    /// Longest time between two poses over which a contour's pose is interpolated, s [default: 0.05]
    #[arg(long, value_name = "S")]
    max_pose_gap: Option<f64>,
    /// Ask servers for TDATA, at most every so many ms
    #[arg(long, value_name = "MS")]
    tdata: Option<u32>,
    #[command(flatten)]
    mask: MaskOptionArguments,
}

impl MessageArguments {
    /// The options, with defaults for what was not given.
    pub(super) fn options(&self, until_disconnected: bool) -> SourceOptions {
        let defaults = AssemblerOptions::default();
        let (gap_s, delay_s) = (defaults.max_pose_gap_s, defaults.contour_delay_s);
        let device = self.pose_device.clone().unwrap_or(defaults.pose_device.clone());
        let assembler = defaults
            .with_pose_device(device)
            .with_contour_device(self.contour_device.clone())
            .with_mask(self.mask.options())
            .with_max_pose_gap_s(self.max_pose_gap.unwrap_or(gap_s))
            .with_contour_delay_s(self.contour_delay.unwrap_or(delay_s));
        SourceOptions::default()
            .with_assembler(assembler)
            .with_tracking_interval_ms(self.tdata)
            .with_until_disconnected(until_disconnected)
    }

    /// Whether any was given.
    pub(super) fn is_given(&self) -> bool {
        self.options(false) != SourceOptions::default()
    }
}
