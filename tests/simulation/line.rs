//! The serial line in virtual time: two directions with a rate and a latency, and what may go wrong with them.
//!
//! Bytes keep their order, as on a real line. Each frame arrives as one piece when its last byte arrives, so that a run costs one
//! step a frame and not one a byte; [`LineFault::Split`] cuts frames into small pieces, [`LineFault::Merge`] joins them.
#![allow(dead_code, unreachable_pub, reason = "the test and the example each use a part")]

use std::collections::VecDeque;

use layerd_wire::session::{line_bytes, line_time_us};

use super::rng::Rng;

/// The kernel's buffer for what the host writes, as on Linux.
pub const KERNEL_BYTES: usize = 4096;
/// With so many bytes left, the kernel tells a writer that waits that there is room, as on Linux.
const WAKE_WRITER_BYTES: usize = 256;
/// What the kernel keeps for a host that does not read, as on Linux. Later frames are lost.
const MAX_UNREAD_BYTES: usize = 65_536;
/// Longest piece of a frame on a line that splits.
const MAX_PIECE_BYTES: u64 = 7;

/// What goes wrong with the line. A fault replaces one of its kind that is still there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineFault {
    /// Frames are lost, damaged or doubled, each with its own probability.
    Noise {
        /// Frames of a million that vanish, whole or some of their bytes.
        loss_per_million: u32,
        /// Frames of a million of which a bit is wrong.
        corrupt_per_million: u32,
        /// Frames of a million that arrive twice.
        duplicate_per_million: u32,
        /// For so long.
        for_us: u64,
    },
    /// Frames arrive up to `extra_us` later.
    Delay {
        /// Most additional latency.
        extra_us: u64,
        /// For so long.
        for_us: u64,
    },
    /// Frames arrive in pieces of 1 to 7 bytes.
    Split {
        /// For so long.
        for_us: u64,
    },
    /// What arrives is held and handed over every `hold_us`, as some converters do.
    Merge {
        /// Time between two deliveries.
        hold_us: u64,
        /// For so long.
        for_us: u64,
    },
    /// Nothing moves; nothing is lost.
    Stall {
        /// For so long.
        for_us: u64,
    },
    /// The converter is pulled out: what is on its way is lost, the host's port fails and cannot be opened.
    Unplugged {
        /// For so long.
        for_us: u64,
    },
}

impl LineFault {
    /// How long it is felt: bytes keep their order, so what was held back holds back what is sent later.
    pub fn felt_us(self) -> u64 {
        match self {
            Self::Delay { extra_us, for_us } => extra_us + for_us,
            Self::Merge { hold_us, for_us } => hold_us + for_us,
            Self::Noise { for_us, .. }
            | Self::Split { for_us }
            | Self::Stall { for_us }
            | Self::Unplugged { for_us } => for_us,
        }
    }
}

/// Faults that last, each with the time when it ends.
#[derive(Debug, Default)]
struct Faults {
    loss: u32,
    corrupt: u32,
    duplicate: u32,
    noise_until_us: u64,
    delay_us: u64,
    delay_until_us: u64,
    split_until_us: u64,
    hold_us: u64,
    hold_until_us: u64,
}

/// One direction.
#[derive(Debug)]
struct Pipe {
    baud: u32,
    latency_us: u64,
    /// When the last byte that was given to it leaves its sender.
    busy_until_us: u64,
    /// Nothing moves before.
    stalled_until_us: u64,
    /// When the newest piece arrives: no later one overtakes it.
    newest_us: u64,
    pieces: VecDeque<(u64, Vec<u8>)>,
    held_bytes: usize,
    rng: Rng,
}

/// Both directions.
#[derive(Debug)]
pub struct Line {
    to_device: Pipe,
    to_host: Pipe,
    faults: Faults,
    /// 0 unless it was unplugged.
    back_at_us: u64,
    unpluggings: u64,
    host_waits: bool,
}

impl Line {
    /// A line of this rate. The seed determines its latency, 50 µs to 2 ms, and what its faults hit.
    pub fn new(baud: u32, seed: u64) -> Self {
        let mut rng = Rng::new(seed);
        Self {
            to_device: Pipe::new(baud, rng.fork()),
            to_host: Pipe::new(baud, rng.fork()),
            faults: Faults::default(),
            back_at_us: 0,
            unpluggings: 0,
            host_waits: false,
        }
    }

    /// The host writes. Returns how many bytes the kernel takes: 0 if its buffer is full or the line is unplugged.
    pub fn host_writes(&mut self, bytes: &[u8], now_us: u64) -> usize {
        if !self.is_up(now_us) {
            return 0;
        }
        let count = bytes.len().min(KERNEL_BYTES - self.unsent_bytes(now_us));
        self.host_waits = count < bytes.len();
        for frame in bytes[..count].split_inclusive(|byte| *byte == 0) {
            self.to_device.send(frame, &self.faults, now_us);
        }
        count
    }

    /// Bytes that the kernel has taken from the host and not sent yet.
    pub fn unsent_bytes(&self, now_us: u64) -> usize {
        let left_us = self.to_device.busy_until_us.saturating_sub(now_us.max(self.to_device.stalled_until_us));
        line_bytes(left_us, self.to_device.baud).min(KERNEL_BYTES)
    }

    /// Whether the last write of the host did not fit and there is room again by now, so that it may try again.
    pub fn host_may_write(&self, now_us: u64) -> bool {
        !self.host_waits || self.unsent_bytes(now_us) <= WAKE_WRITER_BYTES
    }

    /// Whether the device's last frame has left it. A device sends into an unplugged line as into any other.
    pub fn device_may_send(&self, now_us: u64) -> bool {
        self.to_host.busy_until_us <= now_us
    }

    /// The device sends a frame.
    pub fn device_sends(&mut self, frame: &[u8], now_us: u64) {
        if !self.is_up(now_us) {
            self.to_host.busy_until_us = now_us + line_time_us(frame.len(), self.to_host.baud);
        } else if self.to_host.held_bytes < MAX_UNREAD_BYTES {
            self.to_host.send(frame, &self.faults, now_us);
        }
    }

    /// The next piece that has arrived at the device.
    pub fn device_reads(&mut self, now_us: u64) -> Option<Vec<u8>> {
        self.to_device.arrived(now_us)
    }

    /// What has arrived at the host, at most `max` bytes; the rest stays. Empty if there is nothing.
    pub fn host_reads(&mut self, max: usize, now_us: u64) -> Vec<u8> {
        let mut read = Vec::new();
        while read.len() < max {
            let Some(mut piece) = self.to_host.arrived(now_us) else { break };
            if piece.len() > max - read.len() {
                let rest = piece.split_off(max - read.len());
                self.to_host.put_back(rest, now_us);
            }
            read.append(&mut piece);
        }
        read
    }

    /// Whether something has arrived at the host.
    pub fn host_may_read(&self, now_us: u64) -> bool {
        self.to_host.pieces.front().is_some_and(|(at_us, _)| *at_us <= now_us)
    }

    /// The host opens its port: what arrived before is dropped, and nothing waits for room.
    pub fn host_opens(&mut self, now_us: u64) {
        while self.to_host.arrived(now_us).is_some() {}
        self.host_waits = false;
    }

    /// The first time after `now_us` at which something arrives, a sender gets room, or the line comes back.
    pub fn next_us(&self, now_us: u64) -> Option<u64> {
        let room_us = self.to_device.busy_until_us.saturating_sub(line_time_us(WAKE_WRITER_BYTES, self.to_device.baud));
        let times = [
            self.to_device.next_arrival_us(now_us),
            self.to_host.next_arrival_us(now_us),
            Some(self.to_host.busy_until_us),
            Some(room_us.max(now_us + 1)).filter(|_| self.host_waits && !self.host_may_write(now_us)),
            Some(self.back_at_us),
        ];
        times.into_iter().flatten().filter(|at_us| *at_us > now_us).min()
    }

    /// Something goes wrong with the line.
    pub fn fault(&mut self, fault: LineFault, now_us: u64) {
        let faults = &mut self.faults;
        match fault {
            LineFault::Noise { loss_per_million, corrupt_per_million, duplicate_per_million, for_us } => {
                (faults.loss, faults.corrupt) = (loss_per_million, corrupt_per_million);
                (faults.duplicate, faults.noise_until_us) = (duplicate_per_million, now_us + for_us);
            }
            LineFault::Delay { extra_us, for_us } => {
                (faults.delay_us, faults.delay_until_us) = (extra_us, now_us + for_us);
            }
            LineFault::Split { for_us } => faults.split_until_us = now_us + for_us,
            LineFault::Merge { hold_us, for_us } => {
                (faults.hold_us, faults.hold_until_us) = (hold_us.max(1), now_us + for_us);
            }
            LineFault::Stall { for_us } => {
                self.to_device.stall(for_us, now_us);
                self.to_host.stall(for_us, now_us);
            }
            LineFault::Unplugged { for_us } => {
                self.to_device.clear(now_us);
                self.to_host.clear(now_us);
                self.back_at_us = self.back_at_us.max(now_us + for_us);
                self.unpluggings += 1;
                self.host_waits = false;
            }
        }
    }

    /// Whether the host can open and use its port.
    pub fn is_up(&self, now_us: u64) -> bool {
        now_us >= self.back_at_us
    }

    /// How often the line was unplugged: a port that was opened before the last time has failed for good.
    pub fn unpluggings(&self) -> u64 {
        self.unpluggings
    }
}

impl Pipe {
    fn new(baud: u32, mut rng: Rng) -> Self {
        let latency_us = rng.range(50..=2_000);
        Self {
            baud,
            latency_us,
            busy_until_us: 0,
            stalled_until_us: 0,
            newest_us: 0,
            pieces: VecDeque::new(),
            held_bytes: 0,
            rng,
        }
    }

    /// Sends a frame, or a part of one.
    fn send(&mut self, frame: &[u8], faults: &Faults, now_us: u64) {
        let begins_us = self.busy_until_us.max(now_us);
        self.busy_until_us = begins_us + line_time_us(frame.len(), self.baud);
        if now_us >= faults.noise_until_us {
            return self.carry(frame, begins_us, faults, now_us);
        }
        let (damaged, copies) = self.damage(frame, faults);
        for _ in 0..copies {
            self.carry(&damaged, begins_us, faults, now_us);
        }
    }

    /// What noise leaves of a frame, and how often it arrives.
    fn damage(&mut self, frame: &[u8], faults: &Faults) -> (Vec<u8>, usize) {
        let mut frame = frame.to_vec();
        let copies = 1 + usize::from(self.rng.per_million(faults.duplicate));
        if self.rng.per_million(faults.loss) {
            if self.rng.chance(0.5) {
                return (frame, copies - 1);
            }
            let begin = self.rng.below(frame.len() as u64) as usize;
            let end = begin + 1 + self.rng.below((frame.len() - begin) as u64) as usize;
            frame.drain(begin..end);
        }
        if self.rng.per_million(faults.corrupt) && !frame.is_empty() {
            let place = self.rng.below(frame.len() as u64) as usize;
            frame[place] ^= 1 << self.rng.below(8);
        }
        (frame, copies)
    }

    fn carry(&mut self, frame: &[u8], begins_us: u64, faults: &Faults, now_us: u64) {
        let mut rest = frame;
        while !rest.is_empty() {
            let piece_bytes = match now_us < faults.split_until_us {
                true => rest.len().min(self.rng.range(1..=MAX_PIECE_BYTES) as usize),
                false => rest.len(),
            };
            let (piece, behind) = rest.split_at(piece_bytes);
            rest = behind;
            let mut at_us = begins_us + line_time_us(frame.len() - rest.len(), self.baud) + self.latency_us;
            if now_us < faults.delay_until_us {
                at_us += self.rng.range(0..=faults.delay_us);
            }
            if now_us < faults.hold_until_us {
                at_us = at_us.next_multiple_of(faults.hold_us);
            }
            self.newest_us = self.newest_us.max(at_us);
            self.held_bytes += piece.len();
            self.pieces.push_back((self.newest_us, piece.to_vec()));
        }
    }

    fn arrived(&mut self, now_us: u64) -> Option<Vec<u8>> {
        self.pieces.front().filter(|(at_us, _)| *at_us <= now_us)?;
        let (_, piece) = self.pieces.pop_front()?;
        self.held_bytes -= piece.len();
        Some(piece)
    }

    fn put_back(&mut self, piece: Vec<u8>, now_us: u64) {
        self.held_bytes += piece.len();
        self.pieces.push_front((now_us, piece));
    }

    fn next_arrival_us(&self, now_us: u64) -> Option<u64> {
        let begin = self.pieces.partition_point(|(at_us, _)| *at_us <= now_us);
        self.pieces.get(begin).map(|(at_us, _)| *at_us)
    }

    fn stall(&mut self, for_us: u64, now_us: u64) {
        self.busy_until_us = self.busy_until_us.max(now_us) + for_us;
        self.stalled_until_us = self.stalled_until_us.max(now_us) + for_us;
        let begin = self.pieces.partition_point(|(at_us, _)| *at_us <= now_us);
        for (at_us, _) in self.pieces.range_mut(begin..) {
            *at_us += for_us;
        }
        self.newest_us = self.newest_us.max(now_us) + for_us;
    }

    fn clear(&mut self, now_us: u64) {
        self.pieces.clear();
        self.held_bytes = 0;
        (self.busy_until_us, self.stalled_until_us, self.newest_us) = (now_us, now_us, now_us);
    }
}
