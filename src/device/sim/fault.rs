//! Faults that are injected between pseudo-terminal and session, drawn from a seeded random sequence.
//! `layerctl simulate --fault` takes them.

use std::str::FromStr;

use crate::link::message::Fault;
use crate::random::SplitMix;

/// What `--fault` accepts, for help and errors.
pub const FAULT_HELP: &str = "\
drop=P         lose a frame with probability P (0 to 0.5), both ways, such as drop=0.01
corrupt=P      flip a bit of a frame with probability P
duplicate=P    send a frame twice with probability P
stall=NxMS     N times in the print, let the line stand still for MS milliseconds, such as stall=2x1500 (stall=N: 1000 ms)
disconnect=N   N times in the print, take the pseudo-terminal away and bring a new one after a while
reset=N        N times in the print, restart the device: it keeps the layers exposed and cut short last, and the position of a resting plate
oxygen=N       N times in the print, while a laser machine marks, report too much oxygen in the chamber: the laser goes off at once,
               and the fault lasts 2 to 6 seconds of the device's clock
door=N         the same with an open door
power=N        the same with a laser without power";

/// An invalid `--fault`.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{found}` is not a fault ({why}); known are:\n{FAULT_HELP}")]
pub struct BadFault {
    found: String,
    why: &'static str,
}

/// One `--fault` of the command line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultSpec {
    /// Share of frames lost.
    Drop(f64),
    /// Share of frames with a flipped bit.
    Corrupt(f64),
    /// Share of frames doubled.
    Duplicate(f64),
    /// How often the line stands still, and for how long.
    Stall(u32, u32),
    /// How often the line is taken away.
    Disconnect(u32),
    /// How often the device restarts.
    Reset(u32),
    /// Which interlock opens while a laser machine marks, and how often.
    Interlock(Interlock, u32),
}

/// What keeps the laser off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interlock {
    /// Too much oxygen in the chamber.
    Oxygen,
    /// An open door.
    Door,
    /// A laser without power.
    Power,
}

impl Interlock {
    /// The fault that the device reports while the interlock is open.
    pub(super) fn fault(self) -> Fault {
        let (code, text) = match self {
            Self::Oxygen => (10, "oxygen at 1.2 %: above 0.5 %"),
            Self::Door => (11, "the door of the chamber is open"),
            Self::Power => (12, "the laser has no power"),
        };
        Fault { code, text: text.into() }
    }
}

impl FromStr for FaultSpec {
    type Err = BadFault;

    fn from_str(text: &str) -> Result<Self, BadFault> {
        let bad = |why| BadFault { found: text.into(), why };
        let (name, value) = text.split_once('=').ok_or(bad("it has no `=`"))?;
        let share = || {
            let share = value.parse().ok().filter(|share| (0.0..=0.5).contains(share));
            share.ok_or(bad("the value must be a probability from 0 to 0.5"))
        };
        let count = |digits: &str| {
            let count = digits.parse().ok().filter(|count| *count <= 1000);
            count.ok_or(bad("the value must be a count from 0 to 1000"))
        };
        match name {
            "drop" => share().map(Self::Drop),
            "corrupt" => share().map(Self::Corrupt),
            "duplicate" => share().map(Self::Duplicate),
            "stall" => {
                let (times, stall_ms) = value.split_once('x').unwrap_or((value, "1000"));
                let stall_ms = stall_ms.trim_end_matches("ms").parse().ok().filter(|ms| *ms <= 60_000);
                Ok(Self::Stall(count(times)?, stall_ms.ok_or(bad("the stall must last 0 to 60000 ms"))?))
            }
            "disconnect" => count(value).map(Self::Disconnect),
            "reset" => count(value).map(Self::Reset),
            "oxygen" => count(value).map(|times| Self::Interlock(Interlock::Oxygen, times)),
            "door" => count(value).map(|times| Self::Interlock(Interlock::Door, times)),
            "power" => count(value).map(|times| Self::Interlock(Interlock::Power, times)),
            _ => Err(bad("the name is unknown")),
        }
    }
}

/// Something that happens to the whole device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Incident {
    /// The line stands still.
    Stall {
        /// For how long.
        duration_ms: u32,
    },
    /// The line goes away.
    Disconnect {
        /// For how long.
        duration_ms: u32,
    },
    /// The device restarts.
    Reset,
    /// An interlock opens.
    Opens {
        /// Which.
        interlock: Interlock,
        /// For how long, by the device's clock.
        open_ms: u32,
    },
    /// An interlock closes.
    Closes(Interlock),
}

/// Random numbers: the same seed gives the same faults on every machine.
#[derive(Clone, Debug)]
pub(super) struct Dice(SplitMix);

impl Dice {
    /// A sequence for a seed.
    pub(super) fn new(seed: u64) -> Self {
        Self(SplitMix::new(seed))
    }

    /// The next 64 bits.
    pub(super) fn next_u64(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// A number from 0 to below `limit`, which is not 0.
    pub(super) fn below(&mut self, limit: u64) -> u64 {
        self.next_u64() % limit
    }

    fn happens(&mut self, share: f64) -> bool {
        share > 0.0 && ((self.next_u64() >> 11) as f64) < share * (1u64 << 53) as f64
    }
}

/// Damages frames on their way; one for each direction.
#[derive(Clone, Debug)]
pub(super) struct FrameFaults {
    dice: Dice,
    drop: f64,
    corrupt: f64,
    duplicate: f64,
    /// Bytes of a frame whose delimiter has not come yet.
    partial: Vec<u8>,
}

/// Bytes without a delimiter are passed on at this length. No frame is longer.
const MAX_FRAME_BYTES: usize = 8192;

impl FrameFaults {
    /// Faults as specified. `stream` distinguishes the two directions.
    pub(super) fn new(specs: &[FaultSpec], seed: u64, stream: u64) -> Self {
        let mut faults =
            Self { dice: Dice::new(seed ^ stream << 32), drop: 0.0, corrupt: 0.0, duplicate: 0.0, partial: Vec::new() };
        for spec in specs {
            match *spec {
                FaultSpec::Drop(share) => faults.drop = share,
                FaultSpec::Corrupt(share) => faults.corrupt = share,
                FaultSpec::Duplicate(share) => faults.duplicate = share,
                FaultSpec::Stall(..) | FaultSpec::Disconnect(_) | FaultSpec::Reset(_) | FaultSpec::Interlock(..) => {}
            }
        }
        faults
    }

    /// Takes bytes from one side and appends what reaches the other.
    pub(super) fn pass(&mut self, bytes: &[u8], out: &mut Vec<u8>) {
        if self.drop + self.corrupt + self.duplicate == 0.0 {
            out.extend_from_slice(bytes);
            return;
        }
        for &byte in bytes {
            self.partial.push(byte);
            if byte == 0 || self.partial.len() >= MAX_FRAME_BYTES {
                self.pass_frame(out);
            }
        }
    }

    fn pass_frame(&mut self, out: &mut Vec<u8>) {
        let mut frame = std::mem::take(&mut self.partial);
        let copies = 1 + usize::from(self.dice.happens(self.duplicate)) - usize::from(self.dice.happens(self.drop));
        if self.dice.happens(self.corrupt) {
            let place = self.dice.below(frame.len() as u64) as usize;
            frame[place] ^= 1 << self.dice.below(8);
        }
        for _ in 0..copies {
            out.extend_from_slice(&frame);
        }
        frame.clear();
        self.partial = frame;
    }
}

/// Planned incidents. The seed determines their order and the exposures at which they happen.
#[derive(Clone, Debug)]
pub(super) struct Incidents {
    /// Each with the number of exposures begun after which it happens; the last comes first.
    planned: Vec<(u64, Incident)>,
    dice: Dice,
    exposures: u64,
}

impl Incidents {
    /// Plans all incidents of a print: 1 to 5 exposures lie between one and the next.
    pub(super) fn new(specs: &[FaultSpec], seed: u64) -> Self {
        let mut dice = Dice::new(seed ^ 0x1ac1_de27);
        let mut incidents = Vec::new();
        for spec in specs {
            let mut add = |count: u32, make: &dyn Fn(&mut Dice) -> Incident| {
                incidents.extend((0..count).map(|_| make(&mut dice)));
            };
            match *spec {
                FaultSpec::Stall(count, duration_ms) => add(count, &|_| Incident::Stall { duration_ms }),
                FaultSpec::Disconnect(count) => {
                    add(count, &|dice| Incident::Disconnect { duration_ms: 200 + dice.below(1300) as u32 });
                }
                FaultSpec::Reset(count) => add(count, &|_| Incident::Reset),
                FaultSpec::Interlock(interlock, count) => {
                    add(count, &|dice| Incident::Opens { interlock, open_ms: 2000 + dice.below(4000) as u32 });
                }
                FaultSpec::Drop(_) | FaultSpec::Corrupt(_) | FaultSpec::Duplicate(_) => {}
            }
        }
        // Shuffled, so that incidents of one kind do not come in a row.
        for last in (1..incidents.len()).rev() {
            incidents.swap(last, dice.below(last as u64 + 1) as usize);
        }
        let mut after = 0;
        let mut planned: Vec<_> = incidents
            .into_iter()
            .map(|incident| {
                after += 1 + dice.below(5);
                (after, incident)
            })
            .collect();
        planned.reverse();
        Self { planned, dice, exposures: 0 }
    }

    /// An exposure began: the incident that is due with it, and after how many milliseconds of the line's time.
    pub(super) fn exposure_began(&mut self) -> Option<(Incident, u64)> {
        self.exposures += 1;
        let (_, incident) = self.planned.pop_if(|(after, _)| *after <= self.exposures)?;
        Some((incident, self.dice.below(300)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn specs_are_read_and_errors_name_what_is_known() {
        assert_eq!("drop=0.01".parse(), Ok(FaultSpec::Drop(0.01)));
        assert_eq!("stall=2x1500ms".parse(), Ok(FaultSpec::Stall(2, 1500)));
        assert_eq!("stall=3".parse(), Ok(FaultSpec::Stall(3, 1000)));
        assert_eq!("reset=1".parse(), Ok(FaultSpec::Reset(1)));
        assert_eq!("oxygen=2".parse(), Ok(FaultSpec::Interlock(Interlock::Oxygen, 2)));
        assert_eq!("door=1".parse(), Ok(FaultSpec::Interlock(Interlock::Door, 1)));
        assert_eq!("power=3".parse(), Ok(FaultSpec::Interlock(Interlock::Power, 3)));
        for wrong in ["drop", "drop=2", "drop=nan", "fire=1", "disconnect=-1", "stall=1x99999999", "reset=1001"] {
            let message = wrong.parse::<FaultSpec>().expect_err(wrong).to_string();
            assert!(message.starts_with(&format!("`{wrong}` is not a fault")), "{message}");
            assert!(message.contains("disconnect=N"), "{message}");
        }
    }

    #[test]
    fn frames_are_lost_doubled_and_damaged_at_the_given_rates() {
        let specs = [FaultSpec::Drop(0.1), FaultSpec::Duplicate(0.2)];
        let mut faults = FrameFaults::new(&specs, 7, 0);
        let mut out = Vec::new();
        let frame = [1, 2, 3, 0];
        for _ in 0..10_000 {
            // In two pieces: a frame is a frame however it arrives.
            faults.pass(&frame[..2], &mut out);
            faults.pass(&frame[2..], &mut out);
        }
        let frames = out.len() / 4;
        assert!((10_700..11_300).contains(&frames), "10 % lost and 20 % doubled of 10000 are about 11000: {frames}");
        let mut corrupt = FrameFaults::new(&[FaultSpec::Corrupt(0.5)], 7, 1);
        let mut damaged = Vec::new();
        for _ in 0..1000 {
            corrupt.pass(&frame, &mut damaged);
        }
        let wrong = damaged.chunks(4).filter(|found| *found != frame).count();
        assert!(damaged.len() == 4000 && (400..600).contains(&wrong), "{wrong} of 1000");
    }

    #[test]
    fn all_incidents_happen_in_the_same_places_for_the_same_seed() {
        let specs = [
            FaultSpec::Disconnect(3),
            FaultSpec::Reset(1),
            FaultSpec::Stall(2, 70),
            FaultSpec::Interlock(Interlock::Door, 1),
        ];
        let run = |seed| {
            let mut incidents = Incidents::new(&specs, seed);
            (0..40).map(|_| incidents.exposure_began()).collect::<Vec<_>>()
        };
        assert_eq!(run(1), run(1));
        assert_ne!(run(1), run(2));
        let all: Vec<_> = run(3).into_iter().flatten().map(|(incident, _)| incident).collect();
        assert_eq!(all.len(), 7);
        let opens = |incident: &&Incident| matches!(incident, Incident::Opens { interlock: Interlock::Door, .. });
        assert_eq!(all.iter().filter(opens).count(), 1);
        assert_eq!(all.iter().filter(|i| **i == Incident::Stall { duration_ms: 70 }).count(), 2);
        assert_eq!(all.iter().filter(|i| **i == Incident::Reset).count(), 1);
    }
}
