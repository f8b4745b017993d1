//! What happens in a run, drawn from its seed before it begins: a list, so that a failing run can be made smaller by leaving parts out.

use crate::line::LineFault;
use crate::machine::{Character, Draw, Incident, Interlock, all, of_lasers};
use crate::parts::{Filling, Kind};
use crate::rng::Rng;

const SECOND_US: u64 = 1_000_000;
/// Faults and orders at random moments happen within this time, for each of the parts: its print takes about as long.
const BUSY_US: [u64; 3] = [32 * SECOND_US, 18 * SECOND_US, 15 * SECOND_US];
/// The same for a laser machine.
const LASER_BUSY_US: [u64; 3] = [60 * SECOND_US, 36 * SECOND_US, 28 * SECOND_US];
/// Longest wait for light: a layer is lowered and recoated in less.
pub(crate) const MAX_DARK_US: u64 = 12 * SECOND_US;
/// Seeds from here on have a laser machine, those below a vat. So a seed means the same run as before there were laser machines.
pub(crate) const LASER_SEEDS: u64 = 1_000_000_000;

/// A run.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    pub(crate) seed: u64,
    pub(crate) kind: Kind,
    pub(crate) character: Character,
    /// Whether the machine asks for a confirmation of the empty plate. If not, it changes plates by itself.
    pub(crate) confirms_plate: bool,
    /// In order of time.
    pub(crate) events: Vec<Planned>,
}

/// One thing that happens.
#[derive(Clone, Debug)]
pub(crate) struct Planned {
    pub(crate) at_us: u64,
    /// It waits until there was light for so long, but at most [`MAX_DARK_US`].
    pub(crate) lit_us: Option<u64>,
    pub(crate) what: What,
}

impl Planned {
    /// What happens at a time, whatever the machine does then.
    pub(crate) fn at(at_us: u64, what: What) -> Self {
        Self { at_us, lit_us: None, what }
    }
}

/// What happens.
#[derive(Clone, Debug)]
pub(crate) enum What {
    /// An operator gives an order.
    Order(Wish),
    /// Something happens to the machine.
    Machine(Incident),
    /// Another machine is in its place for so long.
    OtherMachine { for_us: u64 },
    /// Something goes wrong with the line.
    Line(LineFault),
    /// Other programs leave so little room on the disk.
    DiskFull { free_bytes: u64, for_us: u64 },
    /// So many of a million writing calls fail.
    DiskBroken { per_million: u32, for_us: u64 },
    /// So many of a million calls fail that read a file or directory of the spool; with `name`, only of those that are called so.
    DiskUnreadable { name: Option<&'static str>, per_million: u32, for_us: u64 },
    /// Every access takes so much longer.
    DiskSlow { slow_us: u64, for_us: u64 },
    /// The disk answers nobody.
    DiskHangs { for_us: u64 },
    /// The daemon is killed, at once or after so many calls to the disk; it is back after a while.
    Kill { after_calls: Option<u32>, down_us: u64 },
    /// The host's power fails, at once or after so many calls to the disk.
    PowerCut { after_calls: Option<u32>, down_us: u64 },
    /// The daemon is asked to end; it is started again after a while.
    End { down_us: u64 },
    /// The host stands still.
    StandStill { for_us: u64 },
    /// The wall clock is set.
    WallClock { by_ms: i64 },
    /// Somebody moves the spool aside; with `while_down`, while the daemon is down.
    SpoolReplaced { while_down: bool },
}

/// What an operator wants. `pick` chooses among the jobs that there are then.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Wish {
    Submit { part: usize },
    Again { pick: usize },
    Pause { pick: usize },
    Resume { pick: usize },
    Stop { pick: usize },
    Abort { pick: Option<usize> },
    Remove { pick: usize },
    Raise,
}

impl What {
    /// A short name, the same for all parameters.
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::Order(wish) => wish.name(),
            Self::Machine(Incident::Reset) => "machine resets",
            Self::Machine(Incident::PowerCut { .. }) => "machine loses power",
            Self::Machine(Incident::InterlockOpens(Interlock::Cover)) => "cover opens",
            Self::Machine(Incident::InterlockOpens(Interlock::Oxygen)) => "too much oxygen",
            Self::Machine(Incident::InterlockOpens(Interlock::LaserPower)) => "laser without power",
            Self::Machine(Incident::InterlockCloses(_)) => "interlock closes",
            Self::Machine(Incident::PlateMovedByHand { .. }) => "plate moved by hand",
            Self::OtherMachine { .. } => "another machine",
            Self::Line(LineFault::Noise { .. }) => "line: noise",
            Self::Line(LineFault::Delay { .. }) => "line: delay",
            Self::Line(LineFault::Split { .. }) => "line: pieces",
            Self::Line(LineFault::Merge { .. }) => "line: bursts",
            Self::Line(LineFault::Stall { .. }) => "line: stands still",
            Self::Line(LineFault::Unplugged { .. }) => "line: unplugged",
            Self::DiskFull { .. } => "disk full",
            Self::DiskBroken { .. } => "disk fails",
            Self::DiskUnreadable { .. } => "disk cannot be read",
            Self::DiskSlow { .. } => "disk slow",
            Self::DiskHangs { .. } => "disk hangs",
            Self::Kill { after_calls: None, .. } => "host: killed",
            Self::Kill { .. } => "host: killed in a disk access",
            Self::PowerCut { after_calls: None, .. } => "host: loses power",
            Self::PowerCut { .. } => "host: loses power in a disk access",
            Self::End { .. } => "host: asked to end",
            Self::StandStill { .. } => "host: stands still",
            Self::WallClock { .. } => "wall clock set",
            Self::SpoolReplaced { .. } => "spool replaced",
        }
    }

    /// Whether light may last longer for it: neither orders nor a disk are an excuse for that.
    pub(crate) fn disturbs_light(&self) -> bool {
        let is_disk = matches!(
            self,
            Self::DiskFull { .. }
                | Self::DiskBroken { .. }
                | Self::DiskUnreadable { .. }
                | Self::DiskSlow { .. }
                | Self::DiskHangs { .. }
        );
        !is_disk && !matches!(self, Self::Order(_) | Self::WallClock { .. })
    }

    /// Whether records find their place on the disk nevertheless, if need be in the space that is set aside for them.
    pub(crate) fn spares_records(&self) -> bool {
        !matches!(self, Self::DiskBroken { .. } | Self::DiskUnreadable { .. } | Self::SpoolReplaced { .. })
    }

    /// Whether a print must survive it: what happens to the host and the line, and a slow disk.
    pub(crate) fn is_gentle(&self) -> bool {
        matches!(
            self,
            Self::Order(_)
                | Self::Line(_)
                | Self::DiskSlow { .. }
                | Self::Kill { .. }
                | Self::PowerCut { .. }
                | Self::End { .. }
                | Self::StandStill { .. }
                | Self::WallClock { .. }
        )
    }
}

impl Wish {
    fn name(self) -> &'static str {
        match self {
            Self::Submit { .. } => "order: submit",
            Self::Again { .. } => "order: again",
            Self::Pause { .. } => "order: pause",
            Self::Resume { .. } => "order: resume",
            Self::Stop { .. } => "order: stop",
            Self::Abort { .. } => "order: abort",
            Self::Remove { .. } => "order: remove",
            Self::Raise => "order: raise",
        }
    }
}

/// Every kind of fault, with a way to draw one.
const FAULTS: &[fn(&mut Rng) -> What] = &[
    |_| What::Machine(Incident::Reset),
    |rng| What::Machine(Incident::PowerCut { off_us: rng.range(100_000..=20 * SECOND_US) }),
    |_| What::Machine(Incident::InterlockOpens(Interlock::Cover)),
    |rng| What::Machine(Incident::PlateMovedByHand { to_um: rng.range(0..=30_000) as i32 }),
    |rng| What::OtherMachine { for_us: rng.range(SECOND_US..=15 * SECOND_US) },
    |rng| {
        let share = rng.pick(&[1_000, 20_000, 100_000, 300_000]);
        let of = |rng: &mut Rng| if rng.chance(0.5) { share } else { 0 };
        What::Line(LineFault::Noise {
            loss_per_million: of(rng),
            corrupt_per_million: of(rng),
            duplicate_per_million: of(rng),
            for_us: rng.range(100_000..=15 * SECOND_US),
        })
    },
    |rng| {
        let extra_us = rng.pick(&[1_000, 20_000, 200_000, 1_500_000]);
        What::Line(LineFault::Delay { extra_us, for_us: rng.range(100_000..=15 * SECOND_US) })
    },
    |rng| What::Line(LineFault::Split { for_us: rng.range(100_000..=2 * SECOND_US) }),
    |rng| {
        let hold_us = rng.pick(&[1_000, 16_000, 100_000]);
        What::Line(LineFault::Merge { hold_us, for_us: rng.range(100_000..=15 * SECOND_US) })
    },
    |rng| What::Line(LineFault::Stall { for_us: rng.range(10_000..=5 * SECOND_US) }),
    |rng| What::Line(LineFault::Unplugged { for_us: rng.range(10_000..=10 * SECOND_US) }),
    |rng| What::DiskFull {
        free_bytes: rng.pick(&[0, 100, 5_000, 1 << 20]),
        for_us: rng.range(500_000..=10 * SECOND_US),
    },
    |rng| What::DiskBroken {
        per_million: rng.pick(&[1_000_000, 300_000, 50_000]),
        for_us: rng.range(10_000..=5 * SECOND_US),
    },
    |rng| What::DiskUnreadable {
        name: rng.pick(&[None, None, Some("journal"), Some("part.layerd"), Some("recipe.toml"), Some("jobs")]),
        per_million: rng.pick(&[1_000_000, 300_000, 50_000]),
        for_us: rng.range(100_000..=20 * SECOND_US),
    },
    |rng| What::DiskSlow { slow_us: rng.range(10_000..=SECOND_US), for_us: rng.range(500_000..=10 * SECOND_US) },
    |rng| What::DiskHangs { for_us: rng.range(100_000..=10 * SECOND_US) },
    |rng| What::Kill { after_calls: None, down_us: down_us(rng) },
    |rng| What::Kill { after_calls: Some(rng.range(1..=60) as u32), down_us: down_us(rng) },
    |rng| What::PowerCut { after_calls: None, down_us: down_us(rng) },
    |rng| What::PowerCut { after_calls: Some(rng.range(1..=60) as u32), down_us: down_us(rng) },
    |rng| What::End { down_us: down_us(rng) },
    |rng| What::StandStill { for_us: rng.range(200_000..=60 * SECOND_US) },
    |rng| What::WallClock { by_ms: rng.pick(&[-2_000_000_000_000, -3_600_000, -1, 1, 86_400_000, 9_000_000_000_000]) },
    |rng| What::SpoolReplaced { while_down: rng.chance(0.5) },
];

/// What happens to laser machines only. A plate that is moved by a few layers stays within the height of a part.
const LASER_FAULTS: &[fn(&mut Rng) -> What] = &[
    |_| What::Machine(Incident::InterlockOpens(Interlock::Oxygen)),
    |_| What::Machine(Incident::InterlockOpens(Interlock::LaserPower)),
    |rng| What::Machine(Incident::PlateMovedByHand { to_um: rng.range(0..=500) as i32 }),
];

/// Every kind of fault of a machine.
fn faults(kind: Kind) -> Vec<fn(&mut Rng) -> What> {
    let own: &[_] = if kind.is_laser() { LASER_FAULTS } else { &[] };
    FAULTS.iter().chain(own).copied().collect()
}

/// The name of every kind of fault of a machine.
pub(crate) fn fault_names(kind: Kind) -> Vec<&'static str> {
    faults(kind).iter().map(|draw| draw(&mut Rng::new(0)).name()).collect()
}

/// The characters that a machine can have, the honest one first.
pub(crate) fn characters(kind: Kind) -> Vec<(&'static str, Draw)> {
    let own: &[_] = if kind.is_laser() { of_lasers() } else { &[] };
    all().iter().chain(own).copied().collect()
}

fn down_us(rng: &mut Rng) -> u64 {
    rng.pick(&[50_000, 300_000, 1_500_000, 3_000_000, 20_000_000])
}

fn wish(rng: &mut Rng) -> Wish {
    let pick = rng.below(4) as usize;
    match rng.below(16) {
        0 => Wish::Submit { part: rng.below(3) as usize },
        1 => Wish::Again { pick },
        2..=4 => Wish::Pause { pick },
        5..=8 => Wish::Resume { pick },
        9 | 10 => Wish::Stop { pick },
        11 | 12 => Wish::Abort { pick: rng.chance(0.7).then_some(pick) },
        13 => Wish::Remove { pick },
        _ => Wish::Raise,
    }
}

impl Plan {
    /// The kind of machine of a seed.
    pub(crate) fn kind(seed: u64) -> Kind {
        match seed.checked_sub(LASER_SEEDS) {
            None => Kind::Vat,
            Some(number) if number % 2 == 0 => Kind::Laser(Filling::Zigzag),
            Some(_) => Kind::Laser(Filling::Chessboard),
        }
    }

    /// A print of the first part in which nothing goes wrong and nobody interferes.
    pub(crate) fn calm(seed: u64) -> Self {
        let what = What::Order(Wish::Submit { part: 0 });
        let kind = Self::kind(seed);
        Self { seed, kind, character: Character::Honest, confirms_plate: true, events: vec![Planned::at(10_000, what)] }
    }

    /// Draws a run.
    pub(crate) fn draw(seed: u64) -> Self {
        let kind = Self::kind(seed);
        let mut rng = Rng::new(seed);
        let part = rng.pick(&[0, 1, 2, 2, 2, 2]);
        let first = What::Order(Wish::Submit { part });
        let busy_us = if kind.is_laser() { LASER_BUSY_US[part] } else { BUSY_US[part] };
        let mut events = vec![Planned::at(rng.range(10_000..=2 * SECOND_US), first)];
        let mut character = Character::Honest;
        if rng.chance(0.4) {
            let characters = characters(kind);
            let (_, draw) = characters[1 + rng.below(characters.len() as u64 - 1) as usize];
            character = draw(&mut rng);
        }
        let count = 1 + rng.below(5);
        // Some runs have one fault again and again.
        let faults = faults(kind);
        let again = rng.chance(0.2).then(|| rng.pick(&faults));
        for _ in 0..count {
            let draw = again.unwrap_or_else(|| rng.pick(&faults));
            let what = draw(&mut rng);
            let at_us = rng.below(busy_us);
            if let What::Machine(Incident::InterlockOpens(interlock)) = what {
                let closes = What::Machine(Incident::InterlockCloses(interlock));
                events.push(Planned::at(at_us + rng.range(10_000..=5 * SECOND_US), closes));
            }
            if let What::DiskUnreadable { for_us, .. } = what {
                // A daemon reads most when it starts, and when it takes in a part or opens a job.
                let within_us = at_us + rng.below(for_us);
                let reads = match rng.below(4) {
                    0 => What::Kill { after_calls: None, down_us: 50_000 },
                    1 => What::Order(Wish::Submit { part: 2 }),
                    2 => What::Order(Wish::Again { pick: 0 }),
                    _ => What::Order(Wish::Resume { pick: 0 }),
                };
                events.push(Planned::at(within_us, reads));
            }
            events.push(Planned::at(at_us, what));
        }
        for _ in 0..rng.below(6) {
            let at_us = rng.below(busy_us);
            events.push(Planned::at(at_us, What::Order(wish(&mut rng))));
            if rng.chance(0.3) {
                // Several operators at once.
                let at_us = at_us + rng.below(3_000);
                events.push(Planned::at(at_us, What::Order(wish(&mut rng))));
            }
        }
        events.sort_by_key(|event| event.at_us);
        if kind.is_laser() {
            // Most of the time powder is spread; most of what can go wrong goes wrong while a layer is marked.
            for event in &mut events[1..] {
                event.lit_us = rng.chance(0.5).then(|| rng.below(2 * SECOND_US));
            }
        }
        // Nobody looks at the plate of a machine that changes plates by itself: such a machine must be honest.
        let confirms_plate = character != Character::Honest || rng.chance(0.7);
        Self { seed, kind, character, confirms_plate, events }
    }
}
