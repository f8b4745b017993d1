//! Limits the rate of a device's fault reports, so that a device that reports without end fills neither log nor events. The newest
//! report is never lost, only delayed by up to a second. `tests/strangers.rs` shows it on a device that reports without end.

use crate::link::message::Fault;

/// Changes that are passed on without delay.
const MAX_BURST: u64 = 4;
/// After a burst, one change is passed on in this time.
const REFILL_US: u64 = 1_000_000;
/// Fewer suppressed reports than this are not mentioned.
const WORTH_TELLING: u64 = 10;
/// The number of suppressed reports is told once in this time.
const TELL_US: u64 = 60_000_000;

/// Fault reports of the device, over all its sessions.
#[derive(Debug, Default)]
pub(crate) struct FaultNews {
    /// The report passed on last in this session.
    told: Option<Option<Fault>>,
    /// The newest report, if it was held back.
    held: Option<Option<Fault>>,
    used_until_us: u64,
    /// Reports suppressed since their number was last told.
    dropped: u64,
    tell_at_us: u64,
}

impl FaultNews {
    /// Begins a new session, whose welcome reports a present fault.
    pub(crate) fn connected(&mut self) {
        (self.told, self.held) = (None, None);
    }

    /// Takes a report (`None`: the device works again); returns the report to pass on now, if any.
    pub(crate) fn reported(&mut self, fault: Option<Fault>, now_us: u64) -> Option<Option<Fault>> {
        if self.held.as_ref().or(self.told.as_ref()) == Some(&fault) {
            self.dropped += 1;
            return None;
        }
        self.dropped += u64::from(self.held.replace(fault).is_some());
        self.due(now_us)
    }

    /// A report that was held back and is to be passed on now. Call it a few times a second.
    pub(crate) fn due(&mut self, now_us: u64) -> Option<Option<Fault>> {
        if self.used_until_us >= now_us + MAX_BURST * REFILL_US {
            return None;
        }
        let fault = self.held.take()?;
        if self.told.as_ref() == Some(&fault) {
            // It changed, and changed back.
            self.dropped += 1;
            return None;
        }
        self.used_until_us = self.used_until_us.max(now_us) + REFILL_US;
        self.told = Some(fault.clone());
        Some(fault)
    }

    /// Number of suppressed reports, at most once a minute and only if there were many.
    pub(crate) fn too_many(&mut self, now_us: u64) -> Option<u64> {
        if self.dropped < WORTH_TELLING || now_us < self.tell_at_us {
            return None;
        }
        self.tell_at_us = now_us + TELL_US;
        Some(std::mem::take(&mut self.dropped))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(code: u16) -> Option<Fault> {
        Some(Fault { code, text: "door open".into() })
    }

    #[test]
    fn a_flood_passes_as_a_few_reports_and_its_last_one_is_never_lost() {
        let mut news = FaultNews::default();
        let mut passed = Vec::new();
        // Ten seconds of 5000 reports a second, asked twice a second as by the heartbeat.
        for step in 0..50_000_u64 {
            let now_us = 200 * step;
            passed.extend(news.reported(if step % 2 == 0 { fault(1) } else { None }, now_us));
            if step % 2500 == 0 {
                passed.extend(news.due(now_us));
            }
        }
        assert!((10..=16).contains(&passed.len()), "{} passed", passed.len());
        let now_us = 10_000_000;
        passed.extend(news.reported(fault(2), now_us));
        passed.extend(news.due(now_us + REFILL_US));
        assert_eq!(passed.last(), Some(&fault(2)));
        let dropped = news.too_many(now_us).expect("many");
        assert!(dropped > 49_900, "{dropped}");
        for _ in 0..100 {
            assert_eq!(news.reported(fault(2), now_us), None);
        }
        assert_eq!(news.too_many(now_us + 1_000_000), None, "told a moment ago");
        assert_eq!(news.too_many(now_us + TELL_US), Some(100));
    }

    #[test]
    fn a_fault_that_comes_and_goes_is_passed_on_at_once_and_again_in_each_session() {
        let mut news = FaultNews::default();
        for (now_us, report) in [(0, fault(1)), (1000, None), (2000, fault(1)), (3000, None)] {
            assert_eq!(news.reported(report.clone(), now_us), Some(report));
        }
        assert_eq!(news.reported(None, 4000), None);
        news.connected();
        assert_eq!(news.reported(None, 10_000_000), Some(None));
    }
}
