//! A disk that is slow to take the journal's records. No layer is exposed before its record is on disk. The act that parks the
//! machine does not wait: a part may take harm meanwhile, and parking is safe whatever the records say. Tested by
//! `tests/job_engine/disk.rs`.

use super::{Engine, Intent, Phase, SECOND_US};
use crate::deadline::Deadline;

/// Longest wait for the disk before the machine is parked. The slowest memory cards flush within a second.
const SLOW_DISK_US: u64 = 2 * SECOND_US;

pub(super) const WAITS_FOR_DISK: &str = "waiting for the disk, which has not taken the journal's last record";

/// How long a record has been on its way to the disk.
#[derive(Debug, Default)]
pub(super) struct DiskWatch {
    /// When the record is overdue.
    due: Option<Deadline>,
    is_slow: bool,
    /// The operator was told.
    told: bool,
}

impl DiskWatch {
    /// The disk took a record, or refused it.
    pub(super) fn answered(&mut self) {
        (self.due, self.is_slow) = (None, false);
    }

    /// Whether a record is overdue.
    pub(super) fn is_slow(&self) -> bool {
        self.is_slow
    }

    /// When the record on its way becomes overdue.
    pub(super) fn due_us(&self) -> Option<u64> {
        self.due.map(Deadline::at_us)
    }
}

impl Engine {
    /// Checks whether the record on its way is overdue.
    pub(super) fn look_at_disk(&mut self, now_us: u64) {
        if !self.disk.due.as_mut().is_some_and(|due| due.is_over(now_us)) {
            return;
        }
        (self.disk.due, self.disk.is_slow) = (None, true);
        if !std::mem::replace(&mut self.disk.told, true) {
            let meanwhile = self.cycle.slow_disk_text();
            self.out.notice(format!(
                "the disk has not taken the journal's last record for 2 s: no layer is exposed before it is on disk. {meanwhile}"
            ));
        }
    }

    /// Called after every event: parks the machine if only a slow disk keeps it from that.
    pub(super) fn park_without_disk(&mut self, now_us: u64) {
        if self.disk.is_slow && self.intent != Intent::Print {
            match self.phase {
                Phase::Confirming => self.advance(now_us),
                Phase::Commanding => self.withdraw(now_us),
                Phase::Parking => {}
                _ if self.out.act.is_some() => self.withdraw(now_us),
                _ => {}
            }
        }
        self.out.act_overtakes = self.disk.is_slow && self.phase == Phase::Parking;
        if self.out.has_unwritten() && !self.disk.is_slow {
            self.disk.due.get_or_insert(Deadline::at(now_us + SLOW_DISK_US));
        }
    }
}
