//! The vessel to 3D Slicer and whoever else speaks OpenIGTLink.

use super::update::{End, Sink, Update};
use crate::Result;
use crate::openigtlink::Server;
use std::sync::Arc;

/// Sends the vessel, as often as those who look can take it, and the catheter's tip after every frame.
pub(crate) struct Slicer {
    server: Arc<Server>,
    /// Whether the vessel has changed since it was sent.
    is_stale: bool,
}

impl Slicer {
    pub(crate) fn new(server: Arc<Server>) -> Self {
        Self { server, is_stale: false }
    }
}

impl Sink for Slicer {
    fn take(&mut self, update: &Update) -> Result<()> {
        let Update { live, change, frame, .. } = update;
        self.is_stale |= !change.changed.is_empty();
        if self.is_stale && self.server.wants_vessel() {
            self.server.send_vessel(&live.surface());
            self.is_stale = false;
        }
        if let Some(frame) = frame {
            let sensor_from_probe = live.settings().calibration.sensor_from_probe();
            self.server.send_tip(frame.world_from_sensor * sensor_from_probe, frame.time_s);
        }
        Ok(())
    }

    fn say(&mut self, text: &str) {
        self.server.send_status(text);
    }

    fn end(&mut self, end: &End) {
        if let Some(mesh) = end.mesh {
            self.server.send_vessel(mesh);
        }
        self.server.send_status(end.text);
    }
}
