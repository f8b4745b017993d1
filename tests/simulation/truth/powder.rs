//! What really happens in a bed of powder, and the invariants of a laser machine that follow from it.

use layerd::link::message::{ExposureId, PowderRequest, Request, Urgent};

use super::Truth;
use crate::machine::{Fact, FactKind};
use crate::parts::LAYER_UM;

/// Longest time beyond its longest time in which a laser ends the vector that it is on, milliseconds, as `docs/protocol.md` says.
pub(crate) const VECTOR_MS: u32 = 10_000;

/// The bed of powder of a machine, as it really is.
#[derive(Debug, Default)]
pub(crate) struct Bed {
    /// Depth of the plate, micrometres.
    plate_um: i32,
    /// When somebody moved it by hand, unless it was moved by order since.
    pub(crate) pushed_us: Option<u64>,
    /// Whether powder was spread since the plate moved, and the machine can know it.
    is_spread: bool,
    /// Whether the host can know that: the machine said so in the welcome, or answered an order of this session.
    is_spread_known: bool,
    /// Whether this session has ordered powder.
    is_asked: bool,
    /// Whether somebody moved the plate since the machine was asked to spread powder.
    is_disturbed: bool,
    /// Whether the host can know where the plate is.
    pub(crate) is_told: bool,
    /// Since when there must be no light at all: an abort, a light-off, a fault, a start.
    dark_us: Option<u64>,
    /// Since when no vector may begin: the host is silent, or has begun another session.
    ending_us: Option<u64>,
}

impl Bed {
    /// Powder that was spread does not count any more.
    fn spoil(&mut self) {
        (self.is_spread, self.is_spread_known) = (false, false);
    }
}

/// How far a layer is marked.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Marks {
    /// The first vector that is not marked to its end.
    pub(crate) next: u32,
    /// The laser went off within that vector, and no operator has decided that it may be marked again.
    pub(crate) is_broken: bool,
}

impl Truth {
    /// Takes in a fact of a laser machine. `has_part` says whether a part is in the powder. What the machine's own lies can cause is
    /// judged only `if_honest`.
    pub(super) fn powder_fact(&mut self, fact: &Fact, bed: &mut Bed, has_part: bool, if_honest: bool) {
        let at_us = fact.at_us;
        match &fact.what {
            FactKind::PlateLeaves { .. } => bed.spoil(),
            FactKind::PlateAt { um, .. } => {
                bed.spoil();
                (bed.plate_um, bed.pushed_us) = (*um, None);
            }
            FactKind::PlatePushed { to_um, .. } => {
                bed.spoil();
                (bed.plate_um, bed.is_disturbed, bed.pushed_us) = (*to_um, true, Some(at_us));
            }
            FactKind::Recoated => {
                bed.is_spread = !bed.is_disturbed;
                bed.is_spread_known = bed.is_spread && bed.is_asked;
            }
            FactKind::Started { .. } => {
                bed.spoil();
                bed.dark_us = Some(at_us);
            }
            FactKind::Fault(Some(_))
            | FactKind::PowerOff
            | FactKind::Urgent { urgent: Urgent::Abort | Urgent::LightOff, obeyed: true, .. } => {
                bed.dark_us = Some(at_us);
            }
            FactKind::HostSilent => bed.ending_us = Some(at_us),
            FactKind::Hello { .. } => {
                bed.ending_us = Some(at_us);
                (bed.is_spread_known, bed.is_asked) = (bed.is_spread, false);
            }
            FactKind::LightOn { id: Some(id), .. } => {
                (bed.dark_us, bed.ending_us) = (None, None);
                if if_honest {
                    self.marking_begins(*id, bed, at_us);
                }
            }
            FactKind::Asked(Request::Powder(request)) => {
                self.powder_asked(*request, bed, (has_part, if_honest), at_us);
            }
            FactKind::Vector { began_us, ended_us, .. } => {
                let (dark_us, ending_us) = (bed.dark_us, bed.ending_us);
                self.check("light bounded", at_us, dark_us.is_none_or(|dark_us| *ended_us <= dark_us), || {
                    format!("the laser must be off since {dark_us:?} µs, and was on a vector until {ended_us}")
                });
                self.check("dark after silence", at_us, ending_us.is_none_or(|end_us| *began_us <= end_us), || {
                    format!("the laser must stop since {ending_us:?} µs, and began a vector at {began_us}")
                });
                self.vector(&fact.what, if_honest, at_us);
            }
            _ => {}
        }
    }

    fn powder_asked(&mut self, request: PowderRequest, bed: &mut Bed, (has_part, if_honest): (bool, bool), at_us: u64) {
        match request {
            PowderRequest::Home => self.check("no homing with a part", at_us, !has_part, || {
                format!("the plate is to be homed from {} µm with a part on it", bed.plate_um)
            }),
            PowderRequest::Move { position_um, .. } => {
                let holds = !has_part || !bed.is_told || position_um >= bed.plate_um - LAYER_UM / 2;
                self.check("plate above part", at_us, holds, || {
                    format!("the plate is to go up from {} to {position_um} µm with a part on it", bed.plate_um)
                });
            }
            PowderRequest::Recoat => {
                if if_honest {
                    self.check("fresh powder", at_us, !bed.is_spread_known, || {
                        format!("powder is to be spread twice, with the plate {} µm deep", bed.plate_um)
                    });
                }
                bed.spoil();
                (bed.is_disturbed, bed.is_asked) = (false, true);
            }
            PowderRequest::Mark { id, most_ms, .. } => {
                let scanned = self.scanned(id);
                let longest_ms =
                    scanned.map_or(0, |scanned| scanned.times.mark_ms + scanned.times.mark_ms / 10 + 5_000);
                self.check("light bounded", at_us, most_ms <= longest_ms, || {
                    format!("layer {} may be marked for {most_ms} ms; {longest_ms} ms are enough", id.layer)
                });
            }
        }
    }

    /// Marking of a layer begins, or goes on.
    fn marking_begins(&mut self, id: ExposureId, bed: &Bed, at_us: u64) {
        let depth_um = (id.layer as i32 + 1) * LAYER_UM;
        let holds = bed.is_spread && bed.plate_um.abs_diff(depth_um) <= LAYER_UM as u32 / 2;
        self.check("fresh powder", at_us, holds, || {
            let (plate_um, spread) = (bed.plate_um, if bed.is_spread { "is" } else { "is not" });
            format!("layer {} is marked {plate_um} µm deep instead of {depth_um}, and powder {spread} spread", id.layer)
        });
    }

    /// The laser was on a vector.
    fn vector(&mut self, fact: &FactKind, if_honest: bool, at_us: u64) {
        let FactKind::Vector { id, vector, laser, is_whole, .. } = fact else { return };
        let expected = self.scanned(*id).and_then(|scanned| scanned.vectors.get(vector.number as usize));
        let holds = expected.is_some_and(|expected| *expected == (*vector, *laser));
        self.check("vectors as sliced", at_us, holds, || {
            format!("layer {}: {vector:?} was marked with {laser:?}, and is {expected:?}", id.layer)
        });
        let Some(printed) = self.printed.get_mut(&id.job) else { return };
        let marks = printed.marks.entry(id.layer).or_default();
        let (before, job) = (*marks, printed.job);
        *marks = if *is_whole {
            Marks { next: before.next.max(vector.number + 1), is_broken: false }
        } else {
            Marks { is_broken: true, ..before }
        };
        if !if_honest {
            return;
        }
        self.check("vectors once", at_us, vector.number >= before.next && !before.is_broken, || {
            format!("job {job}: vector {} of layer {} is marked again: {before:?}", vector.number, id.layer)
        });
        self.check("vectors as sliced", at_us, vector.number <= before.next, || {
            format!("job {job}: vectors from {} to {} of layer {} are left out", before.next, vector.number, id.layer)
        });
    }

    /// A layer was marked from its first vector to its last.
    pub(super) fn marked_whole(&mut self, id: ExposureId, vectors: u32, if_honest: bool, at_us: u64) {
        self.count_whole(id, at_us);
        let Some(printed) = self.printed.get(&id.job) else { return };
        let (marks, job) = (printed.marks.get(&id.layer).copied().unwrap_or_default(), printed.job);
        let all = self.scanned(id).map(|scanned| scanned.times.vectors);
        if if_honest {
            self.check("vectors as sliced", at_us, all == Some(vectors) && marks.next == vectors, || {
                format!(
                    "job {job}: layer {} has {all:?} vectors; {vectors} are reported, marked is {marks:?}",
                    id.layer
                )
            });
        }
    }
}
