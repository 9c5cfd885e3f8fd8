//! Vessels, catheters and probes that exist only here: recordings whose truth is known.
