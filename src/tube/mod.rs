//! Ring topology.
