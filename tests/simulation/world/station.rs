//! The machines, what is on their plates, and what their facts mean.

use layerd::link::message::{MachineCapabilities, PowderRequest, Request};

use super::{INTERRUPTED, SECOND_US, STREAMED, WENT_ON, World};
use crate::machine::{Character, Fact, FactKind, KnownLayer, Machine};
use crate::parts::{BAUD, CLEAR_UM, Kind, Layer};
use crate::truth::{Bed, VECTOR_MS};

/// A part on a plate at most so deep is in sight of an operator, micrometres. The daemon is stricter.
const LEVEL_UM: i32 = 100;

/// A machine and what hangs on its plate.
#[derive(Debug)]
pub(super) struct Station {
    pub(super) machine: Machine,
    /// Position of the plate for the last layer of the part on it, micrometres; `None` for an empty plate.
    pub(super) part_um: Option<i32>,
    /// The bed of a laser machine; `None` of a vat.
    pub(super) bed: Option<Bed>,
    pub(super) lit: Option<Lit>,
}

impl Station {
    /// A machine with an empty plate.
    pub(super) fn new(kind: Kind, character: Character, seed: u64) -> Self {
        let layers = kind.parts().iter().flat_map(|part| &part.layers).filter_map(Layer::scanned);
        let known = layers.map(|layer| KnownLayer {
            crc32: layer.crc32,
            vectors: layer.times.vectors,
            laser_ms: layer.times.laser_ms,
        });
        let machine = Machine::new(kind.capabilities(), BAUD, character, seed).knowing(known.collect());
        Self { machine, part_um: None, bed: kind.is_laser().then(Bed::default), lit: None }
    }

    /// Whether it is a laser machine.
    pub(super) fn is_laser(&self) -> bool {
        self.bed.is_some()
    }

    /// Whether a part on its plate is in sight: the plate is clear of the resin, or about level with the powder.
    pub(super) fn is_clear(&self) -> bool {
        let plate_um = self.machine.plate_um();
        if self.is_laser() { plate_um <= LEVEL_UM } else { plate_um >= CLEAR_UM - 200 }
    }
}

/// Light that is on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lit {
    pub(super) since_us: u64,
    pub(super) commanded_ms: u32,
    /// Key of its job, if it was commanded.
    pub(super) job: Option<u64>,
}

impl World {
    pub(super) fn serve_machines(&mut self) {
        let now_us = self.now_us;
        for index in 0..self.stations.len() {
            let station = &mut self.stations[index];
            if index == self.connected {
                station.machine.serve(&mut self.shared.line(), now_us);
            } else {
                station.machine.handle_timeout(now_us);
            }
            let facts: Vec<_> = station.machine.facts().collect();
            for fact in facts {
                self.fact(index, &fact);
            }
        }
    }

    fn fact(&mut self, index: usize, fact: &Fact) {
        if self.trace.is_some() {
            let shown = match &fact.what {
                FactKind::ExposedWhole { id, duration_ms, .. } => {
                    format!("exposed whole: layer {} of {:016x}, {duration_ms} ms", id.layer, id.job)
                }
                what => format!("{what:?}"),
            };
            self.note(|| format!("machine {index}: {shown}"));
        }
        match &fact.what {
            FactKind::LightOn { id, commanded_ms } => {
                if let Some(id) = id {
                    if !self.truth.knows(id.job) {
                        self.learn_jobs();
                    }
                    self.check_pause(*id);
                }
                let job = id.map(|id| id.job);
                self.stations[index].lit = Some(Lit { since_us: fact.at_us, commanded_ms: *commanded_ms, job });
                let silent_us = fact.at_us.saturating_sub(self.stations[index].machine.heard_us());
                let holds = silent_us <= 2 * SECOND_US || !self.is_honest(index);
                self.check("dark after silence", holds, || {
                    format!("light begins {silent_us} µs after the host was heard")
                });
            }
            FactKind::LightOff { lit_us, .. } => {
                if let Some(lit) = self.stations[index].lit.take().filter(|_| self.is_honest(index)) {
                    let holds = *lit_us <= self.longest_us(&lit);
                    self.check("light bounded", holds, || format!("{lit_us} µs of light for {} ms", lit.commanded_ms));
                }
            }
            FactKind::Started { .. } | FactKind::PowerOff | FactKind::Hello { .. } => self.disturbed_us = self.now_us,
            _ => {}
        }
        if let FactKind::ExposedWhole { id, .. } | FactKind::MarkedWhole { id, .. } = &fact.what
            && index != self.connected
        {
            self.truth.exposed_unseen(*id);
        }
        self.count_effects(&fact.what);
        // Nobody knows how far a layer is marked that was continued on another machine.
        let if_honest = self.is_honest(index) && self.stations.len() == 1;
        let (now_us, disturbed_us) = (self.now_us, self.disturbed_us);
        let station = &mut self.stations[index];
        if let Some(bed) = &mut station.bed {
            // The host asks for the state every half second.
            bed.is_told = bed.pushed_us.is_none_or(|us| us.max(disturbed_us) + 3 * SECOND_US / 2 < now_us);
        }
        self.truth.fact(fact, &mut station.part_um, station.bed.as_mut(), if_honest);
    }

    /// Counts what faults came to on a laser machine.
    fn count_effects(&mut self, fact: &FactKind) {
        match fact {
            FactKind::Vector { is_whole: false, .. } => self.happen(INTERRUPTED),
            FactKind::Asked(Request::Powder(PowderRequest::Mark { from_vector: 1.., .. })) => self.happen(WENT_ON),
            FactKind::Asked(Request::LayerBegin { encoded_bytes, .. }) => {
                let MachineCapabilities::Powder(powder) = self.plan.kind.capabilities().machine else { return };
                if *encoded_bytes > powder.buffer_bytes {
                    self.happen(STREAMED);
                }
            }
            _ => {}
        }
    }

    /// How long light that was commanded may last: a laser may end its vector.
    pub(super) fn longest_us(&self, lit: &Lit) -> u64 {
        let vector_ms = if self.plan.kind.is_laser() { VECTOR_MS } else { 0 };
        u64::from(lit.commanded_ms + vector_ms) * 1000
    }
}
