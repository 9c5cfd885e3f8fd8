//! What Ctrl-C and its like do.

use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};

/// Whether the command ends in order by itself when it is asked to.
static ENDS_ITSELF: AtomicBool = AtomicBool::new(false);
/// The signal that asked; 0 for none.
static ASKED: AtomicU8 = AtomicU8::new(0);

/// Ends an interrupted process as usual, but without its temporary files.
pub(super) fn watch() {
    #[cfg(unix)]
    {
        use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
        // Without the handler the process ends as well, but leaves its temporary files.
        let Ok(mut signals) = signal_hook::iterator::Signals::new([SIGHUP, SIGINT, SIGTERM]) else { return };
        std::thread::spawn(move || {
            for signal in signals.forever() {
                let number = u8::try_from(signal).unwrap_or(0);
                if ENDS_ITSELF.load(Ordering::SeqCst) && ASKED.swap(number, Ordering::SeqCst) == 0 {
                    continue;
                }
                crate::output::remove_unfinished();
                // Ends the process.
                let _ = signal_hook::low_level::emulate_default_handler(signal);
            }
        });
    }
}

/// From now on the first signal only asks for the end; a second one ends the process at once.
pub(super) fn end_in_order() {
    ENDS_ITSELF.store(true, Ordering::SeqCst);
}

/// The signal that asked for the end, if one did.
pub(super) fn asked() -> Option<u8> {
    Some(ASKED.load(Ordering::SeqCst)).filter(|signal| *signal != 0)
}
