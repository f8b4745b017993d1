//! What a machine does otherwise than a right one. A lie is told on some occasions only, so that a run has honest parts, too.

use layerd::link::message::{PowderRequest, Refusal, Request, VatRequest};

use super::super::rng::Rng;

/// Whether, how and when a machine lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Character {
    /// Never.
    Honest,
    /// On `count` occasions in a row from the `first` on, which are counted from 1.
    Liar {
        /// How. Its kind says what counts as an occasion.
        lie: Lie,
        /// The first occasion.
        first: u32,
        /// How often.
        count: u32,
    },
}

/// What a request asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked {
    /// The state.
    State,
    /// To take a layer.
    Layer,
    /// Light.
    Exposure,
    /// A move, a homing or powder.
    Plate,
}

/// What a machine does wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lie {
    /// It is dark and says that its light is on. Occasions: states told while dark.
    LitWhenDark,
    /// Its lamp goes out later than the exposure ends, and nobody can change it; it says that it is dark. Occasions: exposures.
    DarkWhenLit {
        /// How much later.
        extra_us: u64,
    },
    /// Its lamp stays on after an exposure, until a light-off or an abort; it says so. Occasions: exposures.
    LampStays {
        /// How much longer at most.
        extra_us: u64,
    },
    /// It reports another light time than there was. Occasions: reported exposures.
    WrongDose {
        /// What it reports, in percent of the truth.
        percent: u32,
    },
    /// It reports another position than the plate has, until the next move ends. Occasions: reported moves.
    WrongPosition {
        /// Reported less true position.
        offset_um: i32,
    },
    /// It moves the plate elsewhere and says where it is. Occasions: moves.
    MovesElsewhere {
        /// True less commanded position, within the machine's travel.
        offset_um: i32,
    },
    /// It answers an act before the act ends. Occasions: acts.
    RepliesEarly {
        /// How much earlier at most.
        by_us: u64,
    },
    /// It answers late. Occasions: answers to such requests, as for the lies below.
    RepliesLate {
        /// Which.
        of: Asked,
        /// How much later.
        by_us: u64,
    },
    /// It answers twice.
    RepliesTwice {
        /// Which.
        of: Asked,
    },
    /// It does not answer.
    RepliesNever {
        /// Which.
        of: Asked,
    },
    /// Its answer has the number of another request.
    WrongNumber {
        /// Which.
        of: Asked,
        /// Given less right number.
        offset: i32,
    },
    /// It reports the exposure of another layer. Occasions: reported exposures.
    WrongLayer {
        /// Named less true layer.
        offset: i32,
    },
    /// It refuses a request. Occasions: such requests.
    Refuses {
        /// Which.
        of: Asked,
        /// What it says.
        refusal: Refusal,
        /// Whether it carries the request out all the same.
        obeys: bool,
    },
    /// Its clock is wrong, so that acts take longer or shorter. Occasions: acts.
    WrongClock {
        /// True time of an act in percent of the right time.
        percent: u32,
    },
    /// From the `first` act on it sends messages that nobody asked for. Occasions: messages.
    Floods {
        /// With states, numbered as answers; otherwise reports of a fault that is gone.
        states: bool,
        /// Time between two.
        every_us: u64,
    },
    /// It restarts by itself. Occasions: every `every_us`.
    Reboots {
        /// Time between two.
        every_us: u64,
    },
    /// Its memory does not survive a restart: it knows of no exposure, and is not homed. Occasions: restarts, of any cause.
    LosesMemory,
    /// Its lamp is on when a session begins, until a light-off or an abort; it says so. Occasions: hellos.
    BackWithLight {
        /// How long at most.
        for_us: u64,
    },
    /// It is another machine. Occasions: hellos.
    OtherGeometry {
        /// Pixels a row more.
        wider_px: u32,
        /// Travel more.
        higher_um: i32,
    },
    /// It does not carry out an urgent order. Occasions: urgent orders.
    IgnoresUrgent {
        /// Whether it answers, with its light as it is.
        answers: bool,
    },
    /// It carries an urgent order out and does not answer. Occasions: urgent orders.
    SilentUrgent,
    /// Its state does not name the exposures that ended last. Occasions: states that should.
    ForgetsExposed,
    /// Its state names no layer in any slot. Occasions: states that should.
    ForgetsSlots,
    /// Its state has another boot id. Occasions: states.
    OtherBoot,
    /// Its recoater passes without powder, and it says that it has recoated. Occasions: recoatings.
    NoPowder,
    /// It forgets that powder was spread. Occasions: states that should tell it.
    ForgetsPowder,
    /// It says that fewer or more vectors are marked than there are. Occasions: states that name a layer that was cut short.
    WrongNextVector {
        /// Told less true number.
        offset: i32,
    },
    /// It reports another number of vectors in a layer. Occasions: layers that are marked.
    WrongCount {
        /// Reported less true number.
        offset: i32,
    },
    /// It says that there is more or less room in its buffer than there is. Occasions: reports of room.
    WrongRoom {
        /// Told less true count of bytes that have left the buffer.
        offset: i32,
    },
    /// It marks a layer once more before it reports it, and reports the time of both. Occasions: layers that are marked.
    MarksTwice,
    /// Its state names layers of another job. Occasions: states that name layers that were marked.
    OtherJob,
}

/// Draws the parameters of a character.
pub type Draw = fn(&mut Rng) -> Character;

/// The characters of any machine, each under its [name](Character::name).
pub fn all() -> &'static [(&'static str, Draw)] {
    ALL
}

/// The characters that only a laser machine has.
pub fn of_lasers() -> &'static [(&'static str, Draw)] {
    OF_LASERS
}

const ALL: &[(&str, Draw)] = &[
    ("honest", |_| Character::Honest),
    ("lit when dark", |rng| liar(Lie::LitWhenDark, 60, 6, rng)),
    ("dark when lit", |rng| liar(Lie::DarkWhenLit { extra_us: rng.range(1_000..=5_000_000) }, 10, 3, rng)),
    ("lamp stays", |rng| liar(Lie::LampStays { extra_us: rng.range(1_000..=60_000_000) }, 10, 3, rng)),
    ("wrong dose", |rng| liar(Lie::WrongDose { percent: rng.pick(&[0, 10, 90, 110, 400]) }, 10, 3, rng)),
    ("wrong position", |rng| liar(Lie::WrongPosition { offset_um: offset_um(rng) }, 20, 3, rng)),
    ("moves elsewhere", |rng| liar(Lie::MovesElsewhere { offset_um: offset_um(rng) }, 20, 3, rng)),
    ("replies early", |rng| liar(Lie::RepliesEarly { by_us: rng.range(1_000..=10_000_000) }, 20, 3, rng)),
    ("replies late", |rng| {
        liar(Lie::RepliesLate { of: asked(rng), by_us: rng.range(10_000..=20_000_000) }, 20, 3, rng)
    }),
    ("replies twice", |rng| liar(Lie::RepliesTwice { of: asked(rng) }, 20, 3, rng)),
    ("replies never", |rng| liar(Lie::RepliesNever { of: asked(rng) }, 20, 6, rng)),
    ("wrong number", |rng| liar(Lie::WrongNumber { of: asked(rng), offset: rng.pick(&[-2, -1, 1, 1000]) }, 20, 3, rng)),
    ("wrong layer", |rng| liar(Lie::WrongLayer { offset: rng.pick(&[-1, 1, 1000]) }, 10, 3, rng)),
    ("refuses", |rng| {
        let obeys = rng.chance(0.3);
        liar(Lie::Refuses { of: asked(rng), refusal: rng.pick(&REFUSALS), obeys }, 20, 3, rng)
    }),
    ("slow", |rng| liar(Lie::WrongClock { percent: rng.range(101..=2_000) as u32 }, 20, 3, rng)),
    ("hasty", |rng| liar(Lie::WrongClock { percent: rng.range(1..=99) as u32 }, 20, 3, rng)),
    ("floods", |rng| liar(Lie::Floods { states: rng.chance(0.5), every_us: rng.range(200..=20_000) }, 20, 2_000, rng)),
    ("reboots", |rng| liar(Lie::Reboots { every_us: rng.range(1_000_000..=30_000_000) }, 3, 4, rng)),
    ("loses memory", |rng| liar(Lie::LosesMemory, 2, 4, rng)),
    ("back with light", |rng| liar(Lie::BackWithLight { for_us: rng.range(100_000..=60_000_000) }, 3, 2, rng)),
    ("other geometry", |rng| {
        let (wider_px, higher_um) = rng.pick(&[(8, 0), (0, 5_000), (1, 1)]);
        liar(Lie::OtherGeometry { wider_px, higher_um }, 3, 2, rng)
    }),
    ("ignores urgent", |rng| liar(Lie::IgnoresUrgent { answers: rng.chance(0.5) }, 2, 4, rng)),
    ("silent urgent", |rng| liar(Lie::SilentUrgent, 2, 4, rng)),
    ("forgets exposed", |rng| liar(Lie::ForgetsExposed, 30, 6, rng)),
    ("forgets slots", |rng| liar(Lie::ForgetsSlots, 30, 6, rng)),
    ("other boot", |rng| liar(Lie::OtherBoot, 60, 6, rng)),
];

const OF_LASERS: &[(&str, Draw)] = &[
    ("no powder", |rng| liar(Lie::NoPowder, 4, 2, rng)),
    ("forgets powder", |rng| liar(Lie::ForgetsPowder, 20, 6, rng)),
    ("wrong next vector", |rng| {
        liar(Lie::WrongNextVector { offset: rng.pick(&[i32::MIN, -20, -1, 1, 20, 1_000_000]) }, 3, 6, rng)
    }),
    ("wrong count", |rng| liar(Lie::WrongCount { offset: rng.pick(&[-1, 1, 1000]) }, 4, 2, rng)),
    ("wrong room", |rng| liar(Lie::WrongRoom { offset: rng.pick(&[-300, -1, 1, 300, 2000]) }, 12, 4, rng)),
    ("marks twice", |rng| liar(Lie::MarksTwice, 4, 1, rng)),
    ("other job", |rng| liar(Lie::OtherJob, 20, 6, rng)),
];

const REFUSALS: [Refusal; 12] = [
    Refusal::NotReady,
    Refusal::AlreadyExposed,
    Refusal::BadDuration,
    Refusal::NoSuchLayer,
    Refusal::SlotBusy,
    Refusal::BadLayer,
    Refusal::BadEncoding,
    Refusal::BadMove,
    Refusal::NotHomed,
    Refusal::Busy,
    Refusal::CutShort,
    Refusal::Unknown,
];

fn liar(lie: Lie, latest_first: u64, most: u64, rng: &mut Rng) -> Character {
    Character::Liar { lie, first: rng.range(1..=latest_first) as u32, count: rng.range(1..=most) as u32 }
}

fn asked(rng: &mut Rng) -> Asked {
    rng.pick(&[Asked::State, Asked::Layer, Asked::Exposure, Asked::Plate])
}

fn offset_um(rng: &mut Rng) -> i32 {
    rng.pick(&[-3_000, -60, -1, 1, 60, 3_000])
}

impl Character {
    /// A short name, the same for all parameters.
    pub fn name(&self) -> &'static str {
        let Self::Liar { lie, .. } = self else { return "honest" };
        match lie {
            Lie::LitWhenDark => "lit when dark",
            Lie::DarkWhenLit { .. } => "dark when lit",
            Lie::LampStays { .. } => "lamp stays",
            Lie::WrongDose { .. } => "wrong dose",
            Lie::WrongPosition { .. } => "wrong position",
            Lie::MovesElsewhere { .. } => "moves elsewhere",
            Lie::RepliesEarly { .. } => "replies early",
            Lie::RepliesLate { .. } => "replies late",
            Lie::RepliesTwice { .. } => "replies twice",
            Lie::RepliesNever { .. } => "replies never",
            Lie::WrongNumber { .. } => "wrong number",
            Lie::WrongLayer { .. } => "wrong layer",
            Lie::Refuses { .. } => "refuses",
            Lie::WrongClock { percent } if *percent < 100 => "hasty",
            Lie::WrongClock { .. } => "slow",
            Lie::Floods { .. } => "floods",
            Lie::Reboots { .. } => "reboots",
            Lie::LosesMemory => "loses memory",
            Lie::BackWithLight { .. } => "back with light",
            Lie::OtherGeometry { .. } => "other geometry",
            Lie::IgnoresUrgent { .. } => "ignores urgent",
            Lie::SilentUrgent => "silent urgent",
            Lie::ForgetsExposed => "forgets exposed",
            Lie::ForgetsSlots => "forgets slots",
            Lie::OtherBoot => "other boot",
            Lie::NoPowder => "no powder",
            Lie::ForgetsPowder => "forgets powder",
            Lie::WrongNextVector { .. } => "wrong next vector",
            Lie::WrongCount { .. } => "wrong count",
            Lie::WrongRoom { .. } => "wrong room",
            Lie::MarksTwice => "marks twice",
            Lie::OtherJob => "other job",
        }
    }

    /// How it lies, if it does.
    pub fn lie(&self) -> Option<Lie> {
        match self {
            Self::Honest => None,
            Self::Liar { lie, .. } => Some(*lie),
        }
    }
}

impl Asked {
    /// What a request asks for.
    pub fn of(request: &Request) -> Self {
        match request {
            Request::State => Self::State,
            Request::LayerBegin { .. } => Self::Layer,
            Request::Vat(VatRequest::Expose { .. }) | Request::Powder(PowderRequest::Mark { .. }) => Self::Exposure,
            Request::Vat(VatRequest::Home | VatRequest::Move { .. } | VatRequest::Change { .. })
            | Request::Powder(PowderRequest::Home | PowderRequest::Move { .. } | PowderRequest::Recoat) => Self::Plate,
        }
    }
}

/// A character and how far it has come.
#[derive(Debug)]
pub(super) struct Liar {
    pub(super) character: Character,
    occasions: u32,
    /// Lies told.
    pub(super) told: u32,
}

impl Liar {
    pub(super) fn new(character: Character) -> Self {
        Self { character, occasions: 0, told: 0 }
    }

    /// On how many occasions it lies.
    pub(super) fn count(&self) -> u32 {
        match self.character {
            Character::Honest => 0,
            Character::Liar { count, .. } => count,
        }
    }

    /// The lie, if this is an occasion for it (`is_one`) and it is due.
    pub(super) fn due(&mut self, is_one: impl Fn(Lie) -> bool) -> Option<Lie> {
        let Character::Liar { lie, first, count } = self.character else { return None };
        if !is_one(lie) {
            return None;
        }
        self.occasions = self.occasions.saturating_add(1);
        let is_due = self.occasions >= first && self.occasions - first < count;
        self.told += u32::from(is_due);
        is_due.then_some(lie)
    }
}
