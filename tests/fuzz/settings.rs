//! Settings in TOML.

use crate::mutate::{File, fuzz, inputs};
use lumenmesh::settings::Settings;

#[test]
fn settings() {
    let seeds = [Settings::default().to_toml().unwrap().into_bytes(), b"method = \"cylinders\"\n".to_vec()];
    let tokens: [&[u8]; 10] =
        [b"nan", b"inf", b"-1", b"1e308", b"1e-308", b"18446744073709551616", b"[[", b"\"", b"= 0\n", b"{}"];
    let file = File::new("settings.toml");
    let accepted = fuzz(&seeds, &tokens, |bytes| {
        Settings::read_toml(file.holding(bytes)).is_ok_and(|s| s.validate().is_ok())
    });
    assert!(0 < accepted && accepted < inputs(), "{accepted} accepted");
}
