//! Studies of the methods: the thesis's experiments, resolution against error and time, and benches of the engines.

pub mod bench;
pub mod experiments;
pub mod resolution;
