//! The example of a host with a device of its own.

#[path = "../../examples/host_device.rs"]
#[expect(dead_code, reason = "its main function is for the command line")]
mod host_device;

use crate::cylinders::{assert_agree, fitted_section};
use crate::device::device;
use crate::sections::RADIUS_MM;

#[test]
fn the_host_s_example_agrees_with_the_cpu() {
    let Some(device) = device() else { return };
    let compared = host_device::run(None).unwrap();
    println!("{}: {:e} mm", compared.adapter, compared.largest_difference_mm);
    assert_eq!((compared.radii_mm.len(), host_device::RADIUS_MM), (24 * 9, RADIUS_MM));
    let (section, settings) = (host_device::points(), host_device::settings());
    let expected = fitted_section(&section, &settings);
    let mut found = expected.clone();
    found.radii_mm = compared.radii_mm;
    assert_agree(device, &found, &expected, &section, &settings);
}
