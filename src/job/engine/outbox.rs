//! Actions that are decided but not yet handed out, and their order. See it used through [`super::Engine::next_action`].

use std::collections::VecDeque;

use crate::device::Act;
use crate::job::{Action, JobState, Record};
use crate::link::message::Urgent;

/// Notices kept if the caller does not fetch them; the oldest is dropped.
const MAX_NOTICES: usize = 64;

/// Urgent orders go first, then records. Everything else waits until the records are on disk, except an act that parks the machine
/// when the disk is slow.
#[derive(Debug, Default)]
pub(super) struct Outbox {
    pub(super) urgent: Option<Urgent>,
    /// Why the session must end.
    pub(super) end_session: Option<String>,
    /// Why an abort needs a new session.
    pub(super) new_session: Option<String>,
    /// A handful at most: a step begins only after the records before it are on disk.
    records: VecDeque<Record>,
    record_in_flight: bool,
    order_in_flight: bool,
    /// A record could not be written: nothing more begins. The last records are tried nevertheless.
    pub(super) journal_broken: bool,
    pub(super) act: Option<(u64, Act)>,
    /// The act does not wait for records.
    pub(super) act_overtakes: bool,
    pub(super) query: bool,
    pub(super) need_from: Option<u32>,
    pub(super) upload: Option<(u32, u8)>,
    pub(super) finished: Option<(JobState, String)>,
    notices: VecDeque<String>,
}

impl Outbox {
    pub(super) fn next(&mut self) -> Option<Action> {
        if let Some(urgent) = self.urgent.take() {
            return Some(Action::Urgent(urgent));
        }
        if let Some(why) = self.end_session.take() {
            return Some(Action::EndSession(why));
        }
        if let Some(why) = self.new_session.take() {
            return Some(Action::NewSession(why));
        }
        if let Some(text) = self.notices.pop_front() {
            return Some(Action::Notice(text));
        }
        if self.act_overtakes
            && let Some((number, act)) = self.act.take()
        {
            return Some(Action::Act { number, act });
        }
        if self.record_in_flight {
            return None;
        }
        if let Some(record) = self.records.pop_front() {
            self.record_in_flight = true;
            self.order_in_flight = matches!(record, Record::Ordered(_));
            return Some(Action::Journal(record));
        }
        if let Some((number, act)) = self.act.take() {
            return Some(Action::Act { number, act });
        }
        if std::mem::take(&mut self.query) {
            return Some(Action::QueryState);
        }
        if let Some(from) = self.need_from.take() {
            return Some(Action::NeedLayers { from });
        }
        if let Some((exposure, slot)) = self.upload.take() {
            return Some(Action::Upload { exposure, slot });
        }
        self.finished.take().map(|(state, reason)| Action::Finished { state, reason })
    }

    pub(super) fn journal(&mut self, record: Record) {
        if !self.journal_broken || record.is_last() {
            self.records.push_back(record);
        }
    }

    /// Whether an order of the operator is still on its way to the disk.
    pub(super) fn order_unwritten(&self) -> bool {
        self.order_in_flight || self.records.iter().any(|record| matches!(record, Record::Ordered(_)))
    }

    /// Whether any record is not on disk yet.
    pub(super) fn has_unwritten(&self) -> bool {
        self.record_in_flight || !self.records.is_empty()
    }

    /// Notes that a record is on disk. Returns whether no other is waiting.
    pub(super) fn journalled(&mut self) -> bool {
        (self.record_in_flight, self.order_in_flight) = (false, false);
        self.records.is_empty()
    }

    /// Gives up journalling.
    pub(super) fn journal_failed(&mut self) {
        (self.record_in_flight, self.order_in_flight) = (false, false);
        self.journal_broken = true;
        self.records.clear();
    }

    pub(super) fn notice(&mut self, text: impl Into<String>) {
        if self.notices.len() == MAX_NOTICES {
            self.notices.pop_front();
        }
        self.notices.push_back(text.into());
    }

    /// Takes back what was decided for a session that is gone.
    pub(super) fn forget_session(&mut self) {
        self.act = None;
        self.query = false;
        self.need_from = None;
        self.upload = None;
    }
}
