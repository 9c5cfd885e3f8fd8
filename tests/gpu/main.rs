//! The device's passes against their twins, one module a concern.
//!
//! The tests run on the adapter that `LUMENMESH_ADAPTER` names, or on the best one. Without an adapter they say
//! so and pass, unless `LUMENMESH_REQUIRE_GPU` is 1.
#![expect(clippy::unwrap_used, reason = "a test may fail")]

mod bisect;
mod compare;
mod cylinders;
mod device;
mod devices_command;
mod edges;
mod failures;
mod grouping;
mod host;
mod instance;
mod large;
mod live;
mod measure;
mod noop;
mod nudge;
mod order;
mod project;
mod record;
mod recordings;
mod sections;
mod shaders;
mod sweep_order;
mod sweep_passes;
mod sweep_walls;
mod update;
