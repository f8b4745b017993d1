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

    /// Whether a fault is due, by how many motions it waits for.
    fn due(&self, after: impl Fn(&Fault) -> Option<usize>) -> Option<usize> {
        let is_due = |armed: &Armed| after(&armed.fault).is_some_and(|moves| self.moves >= armed.moves + moves);
        self.armed.iter().position(is_due)
    }

    /// Something that happens in place of the next line; once.
    pub(super) fn sudden(&mut self) -> Option<Sudden> {
        let at = self.due(|fault| match fault {
            Fault::Reset { after_moves } | Fault::PowerLoss { after_moves } => Some(*after_moves),
            Fault::Refuse { after_moves, .. } => Some(*after_moves),
            _ => None,
        })?;
        Some(match self.armed.remove(at).fault {
            Fault::PowerLoss { .. } => Sudden::PowerLoss,
            Fault::Refuse { error, .. } => Sudden::Refuse(error),
            _ => Sudden::Reset,
        })
    }

    pub(super) fn is_garbage(&self) -> bool {
        self.due(|fault| if let Fault::Garbage { after_moves } = fault { Some(*after_moves) } else { None }).is_some()
    }

    pub(super) fn is_silent(&self) -> bool {
        self.due(|fault| if let Fault::Silence { after_moves } = fault { Some(*after_moves) } else { None }).is_some()
    }

    fn stalled(&self) -> Option<usize> {
        self.due(|fault| if let Fault::Stall { after_moves } = fault { Some(*after_moves) } else { None })
    }

    pub(super) fn is_stalled(&self) -> bool {
        self.stalled().is_some()
    }

    /// A reset ends a stall.
    pub(super) fn reset(&mut self) {
        if let Some(at) = self.stalled() {
            self.armed.remove(at);
        }
    }

    /// The next `ok` is lost; once.
    pub(super) fn loses_ok(&mut self) -> bool {
        let at = self.due(|fault| if let Fault::LoseOk { after_moves } = fault { Some(*after_moves) } else { None });
        at.map(|at| self.armed.remove(at)).is_some()
    }

    /// The port vanishes now; once. After how many ms it comes back, if ever.
    pub(super) fn disconnects(&mut self) -> Option<Option<u64>> {
        let at = self
            .due(|fault| if let Fault::Disconnect { after_moves, .. } = fault { Some(*after_moves) } else { None })?;
        match self.armed.remove(at).fault {
            Fault::Disconnect { back_after_ms, .. } => Some(back_after_ms),
            _ => None,
        }
    }
}
