//! Light that lasts although host, line and machine work.

use super::{End, SECOND_US, World};
use crate::machine::{Character, Lie};

/// How long light may last beyond its time while nothing disturbs: two queries of the state, the limit of an order's round trip, and
/// the grace that `docs/protocol.md` gives.
const LIGHT_GRACE_US: u64 = 5 * SECOND_US;
/// How long light may last after an abort was given while nothing disturbs host, line and machine. The disk may be full, slow or hang.
const ABORT_GRACE_US: u64 = SECOND_US / 2;

impl World {
    /// Whether a machine never lied.
    pub(super) fn is_honest(&self, index: usize) -> bool {
        index > 0 || self.plan.character == Character::Honest
    }

    /// Light that lasts although host, line and machine work.
    pub(super) fn watch_light(&mut self) {
        let now_us = self.now_us;
        let is_exchanged = self.ends.values().any(|end| matches!(end, End::OtherMachine));
        let host_works = self.host.is_some() && self.frozen_until_us.is_none() && !is_exchanged;
        let is_connected = self.host.as_ref().is_some_and(|host| host.handle.snapshot().device.connected);
        if !host_works || !is_connected {
            self.disturbed_us = now_us;
        }
        self.disturbed_us = self.disturbed_us.max(self.line_faulty_until_us.min(now_us));
        let station = &self.stations[self.connected];
        let Some(lit) = station.lit else { return };
        let may_obey = !matches!(
            station.machine.character().lie(),
            Some(
                Lie::DarkWhenLit { .. }
                    | Lie::IgnoresUrgent { .. }
                    | Lie::WrongClock { .. }
                    | Lie::RepliesNever { .. }
                    | Lie::RepliesLate { .. }
            )
        );
        if !may_obey {
            return;
        }
        let due_us = lit.since_us + self.longest_us(&lit);
        let holds = now_us < due_us.max(self.disturbed_us) + LIGHT_GRACE_US;
        self.check("light bounded", holds, || {
            format!("light since {} µs, commanded for {} ms, is still on", lit.since_us, lit.commanded_ms)
        });
        let printed = lit.job.and_then(|key| self.truth.printed.get(&key));
        if let Some((job, aborted_us)) = printed.and_then(|printed| Some((printed.job, printed.abort_given_us?))) {
            let holds = now_us < aborted_us.max(self.disturbed_us) + ABORT_GRACE_US;
            self.check("dark after abort", holds, || {
                format!("job {job}: an abort was given at {aborted_us} µs, and its light is still on")
            });
        }
    }
}
