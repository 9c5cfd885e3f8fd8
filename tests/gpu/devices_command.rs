//! The command `devices`.

use crate::sections::recording;
use lumenmesh::gpu::adapters;
use std::process::{Command, Output};

fn devices(arguments: &[&str], environment: &[(&str, &str)]) -> Output {
    let output = Command::new(env!("CARGO_BIN_EXE_lumenmesh"))
        .arg("devices")
        .args(arguments)
        .envs(environment.iter().copied())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output
}

#[test]
fn every_adapter_is_listed_and_one_is_chosen() {
    let found = adapters();
    let text = String::from_utf8(devices(&[], &[]).stdout).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&devices(&["--json"], &[]).stdout).unwrap();
    assert_eq!(json["adapters"].as_array().unwrap().len(), found.len());
    for (adapter, listed) in found.iter().zip(json["adapters"].as_array().unwrap()) {
        assert!(text.contains(&adapter.name) && text.contains(&adapter.driver), "{text}");
        assert_eq!(listed["name"], adapter.name);
        assert_eq!(listed["max_buffer_bytes"], adapter.max_buffer_bytes);
    }
    if let Some(best) = found.first() {
        assert_eq!(json["gpu"]["adapter"], best.name);
        assert_eq!(json["auto"]["adapter"].is_null(), best.is_software());
    }
}

#[test]
fn an_unknown_adapter_is_answered_with_those_that_are_there() {
    let folder = tempfile::tempdir().unwrap();
    let pullback = folder.path().join("pullback");
    recording(20, 50, 211).write(&pullback).unwrap();
    let mesh = folder.path().join("mesh.ply");
    let output = Command::new(env!("CARGO_BIN_EXE_lumenmesh"))
        .arg("reconstruct")
        .arg(&pullback)
        .args(["--method", "cylinders", "--backend", "gpu", "--adapter", "no such adapter", "-o"])
        .arg(&mesh)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(message.contains("no GPU adapter named \"no such adapter\"; found "), "{message}");
    for adapter in adapters() {
        assert!(message.contains(&adapter.name), "{message}");
    }
    assert!(!mesh.exists());
}

/// A Vulkan loader that is told of no driver finds none.
#[cfg(target_os = "linux")]
#[test]
fn no_adapter_is_said_and_is_no_failure() {
    let blind = [("VK_DRIVER_FILES", "/nonexistent"), ("VK_ICD_FILENAMES", "/nonexistent")];
    let text = String::from_utf8(devices(&[], &blind).stdout).unwrap();
    assert!(text.contains("no GPU adapter"), "{text}");
    assert!(text.contains("--backend gpu   fails"), "{text}");
    assert!(text.contains("--backend auto  stays on the CPU"), "{text}");
    let json: serde_json::Value = serde_json::from_slice(&devices(&["--json"], &blind).stdout).unwrap();
    assert!(json["adapters"].as_array().unwrap().is_empty() && json["gpu"]["adapter"].is_null());
}
