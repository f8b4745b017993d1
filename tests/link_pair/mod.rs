//! A host and a device session joined by a line with a rate, a virtual clock and seeded faults.
#![allow(dead_code, reason = "each test file uses its part")]

use std::collections::VecDeque;

use layerd::link::message::{
    Capabilities, DeviceState, Encoding, HostMessage, MachineCapabilities, Urgent, VatCapabilities, Vats,
};
use layerd::link::session::{HostEvent, HostSession, HostSettings};
use layerd_wire::session::{DeviceEvent, DeviceSession, DeviceSettings, SendError, line_time_us};

/// How often a frame suffers.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Faults {
    /// Vanishes.
    pub(crate) lose: f64,
    /// Has one byte changed, possibly into or from a delimiter.
    pub(crate) corrupt: f64,
    /// Arrives twice.
    pub(crate) duplicate: f64,
    /// Arrives up to this much later; the order stays.
    pub(crate) delay_us: u64,
}

/// One direction. Like the driver, it takes frames while at most 10 ms of them wait.
struct Wire {
    baud: u32,
    busy_until_us: u64,
    on_the_way: VecDeque<(u64, Vec<u8>)>,
}

const BACKLOG_US: u64 = 10_000;

/// SplitMix64.
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    fn chance(&mut self, rate: f64) -> bool {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64 <= rate && rate > 0.0
    }
}

/// Queues a message; returns `false` if there is no room for it.
pub(crate) fn queue(host: &mut HostSession, message: &HostMessage) -> bool {
    match host.send(message) {
        Ok(()) => true,
        Err(SendError::Full) => false,
        Err(error) => panic!("{error}"),
    }
}

/// Host, device, and the line between them.
pub(crate) struct Pair {
    pub(crate) host: HostSession,
    pub(crate) device: DeviceSession,
    pub(crate) now_us: u64,
    /// Nothing arrives at either end.
    pub(crate) cut: bool,
    /// The most bytes of host frames there ever were on the way at once, control frames left out.
    pub(crate) peak_unread_bytes: usize,
    /// 0x11 or 0x13 was sent.
    pub(crate) saw_flow_control: bool,
    last_urgent: u32,
    settings: (HostSettings, DeviceSettings, Capabilities),
    faults: Faults,
    dice: Dice,
    to_device: Wire,
    to_host: Wire,
    device_events: Vec<DeviceEvent>,
    host_events: Vec<HostEvent>,
}

/// A small DLP.
pub(crate) fn capabilities(window_bytes: u32, largest_frame_bytes: u16) -> Capabilities {
    Capabilities {
        name: "test".into(),
        layer_slots: 2,
        window_bytes,
        largest_frame_bytes,
        encodings: vec![Encoding::RawBit],
        max_exposure_ms: 60_000,
        machine: MachineCapabilities::Vat(VatCapabilities {
            width_px: 1920,
            height_px: 1080,
            pixel_nm: [50_000; 2],
            max_position_um: 100_000,
            vats: Vats::ONE,
        }),
    }
}

impl Pair {
    pub(crate) fn new(seed: u64, baud: u32, window_bytes: u32, largest_frame_bytes: u16, faults: Faults) -> Self {
        let host = HostSettings { baud, escaped: false };
        let device = DeviceSettings { baud, escaped: false };
        let capabilities = capabilities(window_bytes, largest_frame_bytes);
        let wire = || Wire { baud, busy_until_us: 0, on_the_way: VecDeque::new() };
        Self {
            host: HostSession::new(0xC0FF_EE00 | seed as u32, host, 0),
            device: DeviceSession::new(capabilities.clone(), device, 0),
            now_us: 0,
            cut: false,
            peak_unread_bytes: 0,
            saw_flow_control: false,
            last_urgent: 0,
            settings: (host, device, capabilities),
            faults,
            dice: Dice(seed),
            to_device: wire(),
            to_host: wire(),
            device_events: Vec::new(),
            host_events: Vec::new(),
        }
    }

    /// Both ends as on a line with XON/XOFF.
    pub(crate) fn escape(&mut self) {
        self.settings.0.escaped = true;
        self.settings.1.escaped = true;
        self.host = HostSession::new(1, self.settings.0, self.now_us);
        self.reset_device();
    }

    /// The device starts anew and has forgotten everything.
    pub(crate) fn reset_device(&mut self) {
        self.device = DeviceSession::new(self.settings.2.clone(), self.settings.1, self.now_us);
    }

    /// The host sends an urgent order. Returns its number.
    pub(crate) fn send_urgent(&mut self, urgent: Urgent) -> u32 {
        self.last_urgent += 1;
        self.host.send_urgent(self.last_urgent, urgent, self.now_us);
        self.last_urgent
    }

    /// Steps until connected; a session that finds no answer is followed by another.
    pub(crate) fn connect(&mut self, limit_us: u64) {
        loop {
            self.step();
            let events = self.host_events();
            if events.iter().any(|event| matches!(event, HostEvent::Connected { .. })) {
                return;
            }
            if events.iter().any(|event| matches!(event, HostEvent::Lost(_))) {
                self.host = self.host.successor(self.dice.next() as u32, self.now_us);
            }
            assert!(self.now_us < limit_us, "not connected at {} us", self.now_us);
        }
    }

    pub(crate) fn run_for(&mut self, duration_us: u64) {
        let end_us = self.now_us + duration_us;
        while self.now_us < end_us {
            self.step();
        }
    }

    /// One millisecond. The device answers hellos by itself until the host is connected; then its events wait to be asked for.
    pub(crate) fn step(&mut self) {
        self.now_us += 1_000;
        let now_us = self.now_us;
        self.host.handle_timeout(now_us);
        self.device.handle_timeout(now_us);
        while self.to_device.has_room(now_us) {
            let Some(frame) = self.host.transmit(now_us) else { break };
            self.saw_flow_control |= frame.iter().any(|byte| matches!(byte, 0x11 | 0x13));
            self.to_device.put(frame, now_us, self.faults, &mut self.dice, self.cut);
        }
        // Control frames have 25 bytes at most; what is longer is data in these tests.
        let unread = self.to_device.on_the_way.iter().map(|(_, frame)| frame.len()).filter(|length| *length > 25).sum();
        self.peak_unread_bytes = self.peak_unread_bytes.max(unread);
        for bytes in self.to_device.arrived(now_us) {
            // In two pieces, to show that the split does not matter.
            let (front, back) = bytes.split_at(bytes.len() / 3);
            self.device.receive(front, now_us);
            self.device.receive(back, now_us);
        }
        if !self.host.is_connected() {
            self.take_device_events();
        }
        while self.to_host.has_room(now_us) {
            let Some(frame) = self.device.transmit(now_us) else { break };
            self.saw_flow_control |= frame.iter().any(|byte| matches!(byte, 0x11 | 0x13));
            self.to_host.put(frame, now_us, self.faults, &mut self.dice, self.cut);
        }
        for bytes in self.to_host.arrived(now_us) {
            self.host.receive(&bytes, now_us);
        }
        self.host_events.extend(std::iter::from_fn(|| self.host.event()));
    }

    /// Answers hellos and keeps the other events for the test.
    fn take_device_events(&mut self) {
        while let Some(event) = self.device.event() {
            match event {
                DeviceEvent::Hello { .. } => self.device.welcome(&DeviceState::default(), self.now_us),
                other => self.device_events.push(other),
            }
        }
    }

    pub(crate) fn device_events(&mut self) -> Vec<DeviceEvent> {
        self.take_device_events();
        std::mem::take(&mut self.device_events)
    }

    pub(crate) fn host_events(&mut self) -> Vec<HostEvent> {
        std::mem::take(&mut self.host_events)
    }
}

impl Wire {
    fn has_room(&self, now_us: u64) -> bool {
        self.busy_until_us < now_us + BACKLOG_US
    }

    fn put(&mut self, mut frame: Vec<u8>, now_us: u64, faults: Faults, dice: &mut Dice, cut: bool) {
        self.busy_until_us = self.busy_until_us.max(now_us) + line_time_us(frame.len(), self.baud);
        if cut || dice.chance(faults.lose) {
            return;
        }
        if dice.chance(faults.corrupt) {
            let at = dice.next() as usize % frame.len();
            frame[at] = frame[at].wrapping_add(1 + (dice.next() % 255) as u8);
        }
        let copies = if dice.chance(faults.duplicate) { 2 } else { 1 };
        let delay_us = if faults.delay_us > 0 { dice.next() % faults.delay_us } else { 0 };
        let earliest_us = self.on_the_way.back().map_or(0, |(at_us, _)| *at_us);
        for _ in 0..copies {
            self.on_the_way.push_back(((self.busy_until_us + delay_us).max(earliest_us), frame.clone()));
        }
    }

    fn arrived(&mut self, now_us: u64) -> Vec<Vec<u8>> {
        let count = self.on_the_way.iter().take_while(|(at_us, _)| *at_us <= now_us).count();
        self.on_the_way.drain(..count).map(|(_, frame)| frame).collect()
    }
}
