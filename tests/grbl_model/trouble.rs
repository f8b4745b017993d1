//! Faults that are armed, and when each is due.

use super::options::Fault;

/// A fault and the counts at which it was armed.
#[derive(Debug)]
struct Armed {
    fault: Fault,
    moves: usize,
    bytes: usize,
}

/// What happens in place of a line.
pub(super) enum Sudden {
    Reset,
    PowerLoss,
    Refuse(u8),
}

/// The faults of one machine.
#[derive(Debug, Default)]
pub(super) struct Trouble {
    armed: Vec<Armed>,
    moves: usize,
    bytes: usize,
}

impl Trouble {
    pub(super) fn new(faults: &[Fault]) -> Self {
        let mut trouble = Self::default();
        for fault in faults {
            trouble.arm(fault.clone());
        }
        trouble
    }

    /// Adds a fault. It counts from here.
    pub(super) fn arm(&mut self, fault: Fault) {
        self.armed.push(Armed { fault, moves: self.moves, bytes: self.bytes });
    }

    /// Takes all faults away.
    pub(super) fn clear(&mut self) {
        self.armed.clear();
    }

    /// A motion was accepted and answered.
    pub(super) fn moved(&mut self) {
        self.moves += 1;
    }

    /// What a byte of the host becomes on the line.
    pub(super) fn on_line(&mut self, byte: u8) -> Option<u8> {
        self.bytes += 1;
        let now = self.bytes;
        let is_hit = |armed: &Armed| matches!(armed.fault, Fault::LoseByte { nth } | Fault::FlipByte { nth, .. } if armed.bytes + nth == now);
        let Some(at) = self.armed.iter().position(is_hit) else { return Some(byte) };
        match self.armed.remove(at).fault {
            Fault::FlipByte { mask, .. } => Some(byte ^ mask),
            _ => None,
        }
    }

    /// The place of a fault of this kind that is due, by the motions that it waits for.
    fn due(&self, is_kind: impl Fn(&Fault) -> bool) -> Option<usize> {
        let is_due = |armed: &Armed| armed.fault.after_moves().is_some_and(|moves| self.moves >= armed.moves + moves);
        self.armed.iter().position(|armed| is_kind(&armed.fault) && is_due(armed))
    }

    /// Takes a fault of this kind away, if it is due.
    fn take_due(&mut self, is_kind: impl Fn(&Fault) -> bool) -> Option<Fault> {
        self.due(is_kind).map(|at| self.armed.remove(at).fault)
    }

    /// Something that happens in place of the next line; once.
    pub(super) fn sudden(&mut self) -> Option<Sudden> {
        let is_sudden =
            |fault: &Fault| matches!(fault, Fault::Reset { .. } | Fault::PowerLoss { .. } | Fault::Refuse { .. });
        Some(match self.take_due(is_sudden)? {
            Fault::PowerLoss { .. } => Sudden::PowerLoss,
            Fault::Refuse { error, .. } => Sudden::Refuse(error),
            _ => Sudden::Reset,
        })
    }

    pub(super) fn is_garbage(&self) -> bool {
        self.due(|fault| matches!(fault, Fault::Garbage { .. })).is_some()
    }

    pub(super) fn is_silent(&self) -> bool {
        self.due(|fault| matches!(fault, Fault::Silence { .. })).is_some()
    }

    pub(super) fn is_stalled(&self) -> bool {
        self.due(|fault| matches!(fault, Fault::Stall { .. })).is_some()
    }

    /// A reset ends a stall.
    pub(super) fn reset(&mut self) {
        self.take_due(|fault| matches!(fault, Fault::Stall { .. }));
    }

    /// The next `ok` is lost; once.
    pub(super) fn loses_ok(&mut self) -> bool {
        self.take_due(|fault| matches!(fault, Fault::LoseOk { .. })).is_some()
    }

    /// The port vanishes now; once. After how many ms it comes back, if ever.
    pub(super) fn disconnects(&mut self) -> Option<Option<u64>> {
        match self.take_due(|fault| matches!(fault, Fault::Disconnect { .. }))? {
            Fault::Disconnect { back_after_ms, .. } => Some(back_after_ms),
            _ => None,
        }
    }
}
