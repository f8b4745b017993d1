//! Notifies systemd (`Type=notify`): ready, status line, watchdog, stopping. Without systemd nothing happens.
//! `systemd/layerd.service` is the unit.

use std::time::Duration;

use sd_notify::NotifyState;

/// The daemon serves its socket.
pub(crate) fn ready() {
    tell(&[NotifyState::Ready]);
}

/// One line for `systemctl status`.
pub(crate) fn status(text: &str) {
    tell(&[NotifyState::Status(text)]);
}

/// The daemon is making the machine safe and will end.
pub(crate) fn stopping() {
    tell(&[NotifyState::Stopping]);
}

/// The printer's loop is alive. Call it from that loop, not from a separate timer: the watchdog must notice a loop that hangs.
pub(crate) fn alive() {
    tell(&[NotifyState::Watchdog]);
}

/// How often to call [`alive`]: half of systemd's limit (sd_watchdog_enabled(3)). `None` without a watchdog.
pub(crate) fn alive_interval() -> Option<Duration> {
    sd_notify::watchdog_enabled().map(|allowed| allowed / 2)
}

fn tell(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        tracing::warn!(%error, "systemd could not be notified");
    }
}
