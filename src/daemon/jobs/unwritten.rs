//! Orders that an engine carries out, and whose records are not on disk yet. `tests/orders.rs` and `tests/disk.rs` test it.

use crate::daemon::handle::Reply;
use crate::job::EndOrder;

/// The slowest memory cards flush within a second; an operator who aborts is not kept waiting longer for a disk.
pub(crate) const MAX_WRITE_US: u64 = 1_500_000;
/// An order that is being carried out, and whose record is not on disk yet.
#[derive(Debug)]
pub(crate) struct Unwritten {
    /// The job.
    pub job: u32,
    /// The order.
    pub order: EndOrder,
    /// Who gave it.
    pub reply: Reply,
    /// The order is answered at this time even if its record is not on disk.
    pub until_us: u64,
}

impl Unwritten {
    /// An order that was just given to an engine.
    pub(crate) fn new(job: u32, order: EndOrder, reply: Reply, now_us: u64) -> Self {
        Self { job, order, reply, until_us: now_us + MAX_WRITE_US }
    }
}
