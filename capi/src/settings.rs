//! Settings by name, as in the TOML file.

use crate::handles::Handles;
use crate::memory::{check_place, copy_text, put, text};
use crate::status::{Failure, LumenmeshStatus, border};
use lumenmesh_core::settings::Settings;
use std::ffi::c_char;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Settings of a reconstruction, by the names of the TOML file.
pub struct LumenmeshSettings {
    _private: [u8; 0],
}

static SETTINGS: Handles<Mutex<Settings>> = Handles::new("settings");

/// A copy of the settings of a handle; the defaults where it is null.
pub fn settings_of(handle: *const LumenmeshSettings) -> Result<Settings, Failure> {
    match handle.is_null() {
        true => Ok(Settings::default()),
        false => Ok(SETTINGS.get(handle)?.lock().unwrap_or_else(PoisonError::into_inner).clone()),
    }
}

/// The default settings.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_settings_new(settings: *mut *mut LumenmeshSettings) -> LumenmeshStatus {
    border(|| {
        check_place("settings", settings)?;
        unsafe { put("settings", settings, SETTINGS.give(Mutex::default())) }
    })
}

/// Reads settings from a TOML file; those that it does not name are the defaults.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_settings_read(
    path: *const c_char,
    settings: *mut *mut LumenmeshSettings,
) -> LumenmeshStatus {
    border(|| {
        check_place("settings", settings)?;
        let read = Settings::read_toml(Path::new(unsafe { text("path", path)? }))?;
        unsafe { put("settings", settings, SETTINGS.give(Mutex::new(read))) }
    })
}

/// Sets one setting by its name, such as "method" to "cylinders", "sweep.nodes" to "64" or "gate" to "[0.5, 1.5]".
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_settings_set(
    settings: *mut LumenmeshSettings,
    name: *const c_char,
    value: *const c_char,
) -> LumenmeshStatus {
    border(|| {
        let settings = SETTINGS.get(settings)?;
        let (name, value) = unsafe { (text("name", name)?, text("value", value)?) };
        settings.lock().unwrap_or_else(PoisonError::into_inner).set(name, value)?;
        Ok(())
    })
}

/// All settings as TOML. `length` receives the size of the text with its zero; `buffer` may be null to ask for that alone.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_settings_toml(
    settings: *const LumenmeshSettings,
    buffer: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> LumenmeshStatus {
    border(|| {
        let toml = settings_of(settings)?.to_toml()?;
        unsafe { copy_text("settings", &toml, buffer, capacity, length) }
    })
}

/// Frees settings; null is left alone.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_settings_free(settings: *mut LumenmeshSettings) -> LumenmeshStatus {
    border(|| SETTINGS.free(settings))
}
