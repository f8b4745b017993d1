//! What really happened to the parts, from the facts of the machines alone, and the invariants that follow from it.

mod powder;

use std::collections::{BTreeMap, BTreeSet};

use layerd::link::message::{ExposureId, Request, Urgent, VatRequest};

use crate::machine::{Fact, FactKind};
use crate::parts::{Kind, LAYER_UM, Layer, Part, Scanned};

pub(crate) use powder::{Bed, Marks, VECTOR_MS};

/// Everything that must hold, by name. The summary counts how often each was checked.
pub(crate) const INVARIANTS: &[&str] = &[
    "exposed once",
    "none left out",
    "order kept",
    "pictures as sliced",
    "vectors as sliced",
    "vectors once",
    "fresh powder",
    "light bounded",
    "dark after abort",
    "dark after silence",
    "plate above part",
    "no homing with a part",
    "journal reads",
    "journal true",
    "orders carried out",
    "orders recorded",
    "operators told the truth",
    "jobs end",
    "prints survive",
    "no disk on the loop",
    "all given back",
    "no panic",
];

/// Those that are checked of vats only.
const OF_VATS: [&str; 1] = ["pictures as sliced"];
/// Those that are checked of laser machines only.
const OF_LASERS: [&str; 3] = ["vectors as sliced", "vectors once", "fresh powder"];

/// Everything that must hold for machines of a kind.
pub(crate) fn invariants(is_laser: bool) -> impl Iterator<Item = &'static str> {
    let others: &[&str] = if is_laser { &OF_VATS } else { &OF_LASERS };
    INVARIANTS.iter().copied().filter(move |name| !others.contains(name))
}

/// Something that must not happen.
#[derive(Clone, Debug)]
pub(crate) struct Violation {
    pub(crate) at_us: u64,
    /// One of [`INVARIANTS`].
    pub(crate) invariant: &'static str,
    pub(crate) text: String,
}

/// A job's part as it really is.
#[derive(Clone, Debug, Default)]
pub(crate) struct Printed {
    /// The job's number in its spool.
    pub(crate) job: u32,
    /// Its part: an index into [`Kind::parts`].
    pub(crate) part: usize,
    /// Whole exposures of each layer.
    pub(crate) whole: BTreeMap<u32, u32>,
    /// Layers that had any light.
    pub(crate) lit: BTreeSet<u32>,
    /// How far each layer is marked by a laser.
    pub(crate) marks: BTreeMap<u32, Marks>,
    /// Layers that operators decided to expose again, and how often each may then be exposed whole in all.
    pub(crate) repeats: BTreeMap<u32, u32>,
    /// Layers that operators decided to take as exposed.
    pub(crate) assumed: BTreeSet<u32>,
    /// The layer whose light began last.
    pub(crate) last_lit: Option<u32>,
    /// Whether an abort of it was accepted without a warning.
    pub(crate) is_aborted: bool,
    /// When the first abort that was accepted was given.
    pub(crate) abort_given_us: Option<u64>,
    /// Since then no order from before that abort can reach the machine: it has answered the abort, or a new session began.
    pub(crate) dark_since_us: Option<u64>,
}

impl Printed {
    /// Whether the layer counts as exposed.
    pub(crate) fn has(&self, layer: u32) -> bool {
        self.whole.contains_key(&layer) || self.assumed.contains(&layer)
    }

    /// The first layer that is not exposed; `None` if all are.
    pub(crate) fn missing(&self, parts: &[Part]) -> Option<u32> {
        (0..parts[self.part].layers.len() as u32).find(|layer| !self.has(*layer))
    }
}

/// All parts.
#[derive(Debug)]
pub(crate) struct Truth {
    /// What the parts are.
    parts: &'static [Part],
    pub(crate) printed: BTreeMap<u64, Printed>,
    pub(crate) checks: BTreeMap<&'static str, u64>,
    /// The first thing that must not have happened.
    pub(crate) violation: Option<Violation>,
    pub(crate) layers: u64,
}

impl Truth {
    /// Of machines of a kind that have printed nothing.
    pub(crate) fn of(kind: Kind) -> Self {
        let parts = kind.parts();
        Self { parts, printed: BTreeMap::new(), checks: BTreeMap::new(), violation: None, layers: 0 }
    }

    /// Counts a check, and notes the first violation.
    pub(crate) fn check(&mut self, invariant: &'static str, at_us: u64, holds: bool, text: impl FnOnce() -> String) {
        debug_assert!(INVARIANTS.contains(&invariant), "{invariant}");
        *self.checks.entry(invariant).or_default() += 1;
        if !holds && self.violation.is_none() {
            self.violation = Some(Violation { at_us, invariant, text: text() });
        }
    }

    /// Whether the job with this key is known.
    pub(crate) fn knows(&self, key: u64) -> bool {
        self.printed.contains_key(&key)
    }

    /// Takes in a fact of a machine. `part_um` is the position of the plate for the part's last layer, micrometres; `bed` is its bed, if
    /// it has a laser. What a machine's lies can cause in a bed is judged only `if_honest`.
    pub(crate) fn fact(&mut self, fact: &Fact, part_um: &mut Option<i32>, bed: Option<&mut Bed>, if_honest: bool) {
        let at_us = fact.at_us;
        if let Some(bed) = bed {
            self.powder_fact(fact, bed, part_um.is_some(), if_honest);
        }
        match &fact.what {
            // Light that nobody commanded cures a film in the vat; nothing hangs on the plate by it.
            FactKind::LightOn { id: Some(id), .. } => {
                let height_um = (id.layer as i32 + 1) * LAYER_UM;
                *part_um = (*part_um).max(Some(height_um));
                self.light_on(*id, at_us);
            }
            FactKind::Urgent { urgent: Urgent::Abort, obeyed: true, .. } | FactKind::Hello { .. } => {
                for printed in self.printed.values_mut().filter(|printed| printed.is_aborted) {
                    printed.dark_since_us.get_or_insert(at_us);
                }
            }
            FactKind::ExposedWhole { id, picture, .. } => self.exposed(*id, picture.data(), at_us),
            FactKind::MarkedWhole { id, vectors } => self.marked_whole(*id, *vectors, if_honest, at_us),
            FactKind::Asked(Request::Vat(VatRequest::Home)) => {
                self.check("no homing with a part", at_us, part_um.is_none(), || {
                    format!("the plate is to be homed with a part on it, {part_um:?} µm high")
                });
            }
            FactKind::Asked(Request::Vat(VatRequest::Move { position_um, .. })) => {
                let holds = part_um.is_none_or(|part_um| *position_um >= part_um - LAYER_UM / 2);
                self.check("plate above part", at_us, holds, || {
                    format!("the plate is to move to {position_um} µm; the part on it needs {part_um:?} µm")
                });
            }
            _ => {}
        }
    }

    fn light_on(&mut self, id: ExposureId, at_us: u64) {
        let Some(printed) = self.printed.get_mut(&id.job) else {
            return self.check("journal true", at_us, false, || format!("light for a job without a journal: {id:?}"));
        };
        printed.lit.insert(id.layer);
        let before = printed.last_lit.replace(id.layer);
        let (dark_since_us, job) = (printed.dark_since_us, printed.job);
        self.check(
            "order kept",
            at_us,
            before.map_or(id.layer == 0, |before| before <= id.layer && id.layer <= before + 1),
            || format!("job {job}: layer {} has light after layer {before:?}", id.layer),
        );
        self.check("dark after abort", at_us, dark_since_us.is_none(), || {
            format!("job {job}: layer {} has light although its abort was answered at {dark_since_us:?}", id.layer)
        });
    }

    /// A machine that is not connected exposed a layer to its end: the next whole exposure on another machine is not the host's fault.
    pub(crate) fn exposed_unseen(&mut self, id: ExposureId) {
        if let Some(printed) = self.printed.get_mut(&id.job) {
            let times = printed.whole.get(&id.layer).copied().unwrap_or(0);
            let allowed = printed.repeats.entry(id.layer).or_insert(1);
            *allowed = (*allowed).max(times + 2);
        }
    }

    /// A layer had its whole light.
    fn count_whole(&mut self, id: ExposureId, at_us: u64) {
        self.layers += 1;
        let Some(printed) = self.printed.get_mut(&id.job) else { return };
        let times = printed.whole.entry(id.layer).or_default();
        *times += 1;
        let (times, job) = (*times, printed.job);
        let allowed = printed.repeats.get(&id.layer).copied().unwrap_or(1);
        self.check("exposed once", at_us, times <= allowed && id.pass == 0, || {
            format!("job {job}: layer {} was exposed whole {times} times", id.layer)
        });
    }

    fn exposed(&mut self, id: ExposureId, rows: &[u8], at_us: u64) {
        self.count_whole(id, at_us);
        let Some(printed) = self.printed.get(&id.job) else { return };
        let (job, expected) = (printed.job, self.parts[printed.part].layers.get(id.layer as usize));
        let holds = matches!(expected, Some(Layer::Picture(expected)) if expected == rows);
        self.check("pictures as sliced", at_us, holds, || {
            format!("job {job}: layer {} was exposed with another picture than the slicer's", id.layer)
        });
    }

    /// A layer of scan vectors as the slicer makes it.
    fn scanned(&self, id: ExposureId) -> Option<&'static Scanned> {
        let part = self.printed.get(&id.job)?.part;
        self.parts[part].layers.get(id.layer as usize)?.scanned()
    }
}
