//! The example of a host with a device of its own.

#[path = "../../examples/host_device.rs"]
#[expect(dead_code, reason = "its main function is for the command line")]
mod host_device;

use crate::device::device;

#[test]
fn the_host_s_example_agrees_with_the_cpu() {
    let Some(device) = device() else { return };
    let compared = host_device::run(None).unwrap();
    println!("{compared:?}");
    assert_eq!(compared.nodes, 24 * 9);
    if device.exact {
        assert_eq!(compared.largest_difference_mm, 0.0);
    }
    assert!(compared.largest_difference_mm < 1e-3);
}
