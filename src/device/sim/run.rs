//! The process of a simulated device: pseudo-terminal, pacing, faults, the real clock, the log.
//!
//! One loop: it handles what is due, passes messages from the session to the firmware, carries out the firmware's actions and sends
//! what the line can carry. Then it sleeps until the line or a timer wakes it. `layerctl simulate` and `demo` call [`run`].

mod wait;

use std::collections::VecDeque;
use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher, Hasher};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Instant;

use tokio::io::unix::AsyncFd;

use super::fault::{Dice, FaultSpec, FrameFaults, Incident, Incidents};
use super::pace::Pace;
use super::pty::{Claim, Pty};
use super::{ActLog, CoreAction, DeviceCore, MeltSettings, Statistics};
use crate::device::host_us;
use crate::link::message::{Capabilities, DeviceMessage, Fault};
use crate::link::session::SendError;
use crate::text::eprint;
use layerd_wire::session::{DeviceEvent, DeviceSession, DeviceSettings};
use wait::{Wait, Woken};

/// The options of the command line.
#[derive(Clone, Debug)]
pub struct SimulateOptions {
    /// The symlink hosts open.
    pub link: PathBuf,
    /// Where acts and pictures go; nowhere if `None`.
    pub directory: Option<PathBuf>,
    /// Rate of the line; unlimited if `None`.
    pub baud: Option<u32>,
    /// Faults to inject.
    pub faults: Vec<FaultSpec>,
    /// Whether XON/XOFF is in use on the line, so that both bytes are escaped.
    pub escaped: bool,
    /// Seed of faults and identities.
    pub seed: u64,
    /// How many times faster than real the device's clock runs.
    pub time_scale: f64,
    /// The capabilities that the device reports.
    pub capabilities: Capabilities,
    /// How pictures of melted layers are drawn; with `None`, a powder machine draws none. A vat always writes what it exposed.
    pub melt: Option<MeltSettings>,
}

/// Messages that may wait for room in the session. Beyond this, a host that sends requests but acknowledges nothing is not read.
const MAX_WAITING_MESSAGES: usize = 64;
/// Most bytes of one read: a pseudo-terminal holds no more.
const READ_BYTES: usize = 4096;
/// Longest sleep of the loop.
const IDLE_US: u64 = 1_000_000;
/// A pseudo-terminal that failed is opened again after this time.
const REOPEN_US: u64 = 500_000;
/// Fault code of a log that cannot be written.
const FAULT_LOG: u16 = 1;
/// Rate for the session's timers if the line is unlimited: the highest rate that a machine file allows.
const UNLIMITED_BAUD: u32 = 12_000_000;

/// Runs a device until `stop` is ready and returns its counts. `ready` is called once hosts can open the line.
///
/// # Errors
/// Where the pseudo-terminal or the directory cannot be made, or another simulated device serves that link.
pub async fn run(
    options: SimulateOptions,
    ready: impl FnOnce(),
    stop: impl Future<Output = ()>,
) -> io::Result<Statistics> {
    // First, so that the log of another device in the same directory is not overwritten.
    let _claim = Claim::new(&options.link)?;
    let mut device = Device::new(options)?;
    ready();
    let mut stop = std::pin::pin!(stop);
    let mut buffer = [0; READ_BYTES];
    loop {
        let now_us = device.now_us();
        device.due(now_us)?;
        device.pump(now_us);
        device.transmit(now_us);
        let wait = Wait {
            pty: device.pty.as_ref(),
            readable: device.readable_bytes(now_us),
            writable: &device.outgoing[..device.writable_bytes(now_us)],
            sleep_us: device.next_wake_us(now_us).saturating_sub(now_us),
        };
        let woken = tokio::select! {
            () = &mut stop => return Ok(device.core.statistics()),
            woken = wait.wait(&mut buffer) => woken,
        };
        device.woken(woken, &buffer);
    }
}

struct Device {
    options: SimulateOptions,
    started: Instant,
    session: DeviceSession,
    core: DeviceCore,
    log: Option<ActLog>,
    pty: Option<AsyncFd<Pty>>,
    receive_pace: Pace,
    transmit_pace: Pace,
    receive_faults: FrameFaults,
    transmit_faults: FrameFaults,
    incidents: Incidents,
    /// Incidents with the line's time at which they happen, the earliest first; at most as many as were planned.
    coming: VecDeque<(u64, Incident)>,
    /// Interlocks whose exposure had ended when they were to open. They open at the next exposure.
    missed: Vec<Incident>,
    stalled_until_us: u64,
    reopen_us: Option<u64>,
    /// On its way to the host, possibly damaged: one frame, or two if it was duplicated.
    outgoing: Vec<u8>,
    waiting: VecDeque<DeviceMessage>,
    dice: Dice,
}

impl Device {
    fn new(options: SimulateOptions) -> io::Result<Self> {
        let log = options.directory.as_deref().map(ActLog::create).transpose()?;
        let pty = Some(open_line(&options.link)?);
        let (faults, seed, baud) = (&options.faults, options.seed, options.baud);
        // Not from the seed alone: each start of the device must have another boot id.
        let mut dice = Dice::new(seed ^ RandomState::new().build_hasher().finish());
        let core = DeviceCore::new(options.capabilities.clone(), dice.next_u64() as u32);
        Ok(Self {
            started: Instant::now(),
            session: new_session(&options, 0),
            core: if let Some(melt) = options.melt { core.drawing(melt) } else { core },
            log,
            pty,
            receive_pace: Pace::new(baud, 0),
            transmit_pace: Pace::new(baud, 0),
            receive_faults: FrameFaults::new(faults, seed, 1),
            transmit_faults: FrameFaults::new(faults, seed, 2),
            incidents: Incidents::new(faults, seed),
            coming: VecDeque::new(),
            missed: Vec::new(),
            stalled_until_us: 0,
            reopen_us: None,
            outgoing: Vec::new(),
            waiting: VecDeque::new(),
            dice,
            options,
        })
    }

    /// The line's time.
    fn now_us(&self) -> u64 {
        self.started.elapsed().as_micros() as u64
    }

    /// The device's time.
    fn device_us(&self, now_us: u64) -> u64 {
        (now_us as f64 * self.options.time_scale) as u64
    }

    /// A duration of the device's clock as one of the line's.
    fn line_us(&self, device_us: u64) -> u64 {
        host_us(device_us, self.options.time_scale)
    }

    /// Handles everything that is due.
    fn due(&mut self, now_us: u64) -> io::Result<()> {
        self.core.advance(self.device_us(now_us));
        self.session.handle_timeout(now_us);
        if self.reopen_us.is_some_and(|at_us| at_us <= now_us) {
            self.pty = Some(open_line(&self.options.link)?);
            self.reopen_us = None;
            eprint(&format!("the line is back at {}", self.options.link.display()));
        }
        while let Some((at_us, incident)) = self.coming.front().copied()
            && at_us <= now_us
        {
            self.coming.pop_front();
            self.happen(incident, now_us);
        }
        Ok(())
    }

    fn happen(&mut self, incident: Incident, now_us: u64) {
        match incident {
            Incident::Stall { duration_ms } => {
                eprint(&format!("fault: the line stands still for {duration_ms} ms"));
                self.stalled_until_us = now_us + u64::from(duration_ms) * 1000;
            }
            Incident::Disconnect { duration_ms } => {
                eprint(&format!("fault: the line is gone for {duration_ms} ms"));
                self.lose_line(now_us + u64::from(duration_ms) * 1000);
            }
            Incident::Reset => {
                eprint("fault: the device restarts");
                self.session = new_session(&self.options, now_us);
                self.outgoing.clear();
                self.waiting.clear();
                let (boot_id, device_us) = (self.dice.next_u64() as u32, self.device_us(now_us));
                self.core.reset(boot_id, device_us);
            }
            Incident::Opens { .. } if self.core.exposure().is_none() => self.missed.push(incident),
            Incident::Opens { interlock, open_ms } => {
                let fault = interlock.fault();
                eprint(&format!("fault: {}", fault.text));
                self.plan(now_us + self.line_us(u64::from(open_ms) * 1000), Incident::Closes(interlock));
                let device_us = self.device_us(now_us);
                self.core.set_fault(Some(fault), device_us);
            }
            Incident::Closes(interlock) => {
                // A device that was restarted, or cannot write its log, has no such fault any more.
                if self.core.state().fault == Some(interlock.fault()) {
                    eprint("the interlock is closed again");
                    let device_us = self.device_us(now_us);
                    self.core.set_fault(None, device_us);
                }
            }
        }
    }

    /// An exposure began: what is to happen during it.
    fn exposure_began(&mut self, now_us: u64) {
        let due = self.missed.pop().map(|incident| (incident, 0)).or_else(|| self.incidents.exposure_began());
        let Some((incident, after_ms)) = due else { return };
        let after_us = match incident {
            // The device's clock times exposures, so it also times what is to happen during one.
            Incident::Opens { .. } => self.line_us(after_ms * 1000),
            _ => after_ms * 1000,
        };
        self.plan(now_us + after_us, incident);
    }

    /// Lets an incident happen at a time of the line.
    fn plan(&mut self, at_us: u64, incident: Incident) {
        let place = self.coming.partition_point(|(other_us, _)| *other_us <= at_us);
        self.coming.insert(place, (at_us, incident));
    }

    fn lose_line(&mut self, until_us: u64) {
        self.pty = None;
        self.outgoing.clear();
        self.reopen_us = Some(until_us);
    }

    /// Passes messages from the session to the firmware, and from the firmware to the session.
    fn pump(&mut self, now_us: u64) {
        loop {
            self.act(now_us);
            while let Some(message) = self.waiting.front() {
                if self.session.send(message) == Err(SendError::Full) {
                    break;
                }
                // Sent, or void because its session has ended.
                self.waiting.pop_front();
            }
            if self.waiting.len() >= MAX_WAITING_MESSAGES {
                return;
            }
            let Some(event) = self.session.event() else { return };
            let device_us = self.device_us(now_us);
            match event {
                DeviceEvent::Hello { session_id } => {
                    eprint(&format!("a host says hello (session {session_id:08x})"));
                    self.waiting.clear();
                    let state = self.core.hello(device_us);
                    self.session.welcome(&state, now_us);
                }
                DeviceEvent::Message(message) => self.core.handle(message, device_us),
                DeviceEvent::Urgent { number, urgent } => {
                    let light_on = self.core.urgent(urgent, device_us);
                    self.session.urgent_done(number, light_on);
                }
                DeviceEvent::HostSilent => {
                    eprint("the host is silent: nothing begins until a hello");
                    self.core.host_silent(device_us);
                    if let Some(pty) = &self.pty {
                        pty.get_ref().release();
                    }
                }
            }
        }
    }

    /// Carries out the firmware's actions.
    fn act(&mut self, now_us: u64) {
        while let Some(action) = self.core.action() {
            let written = match action {
                CoreAction::Send(message) => {
                    self.waiting.push_back(message);
                    continue;
                }
                CoreAction::Record(record) => {
                    if matches!(record.event, "light_on" | "laser_on") {
                        self.exposure_began(now_us);
                    }
                    self.log.as_mut().map_or(Ok(()), |log| log.append(&record))
                }
                CoreAction::Picture(id, picture) => self.log.as_ref().map_or(Ok(()), |log| log.picture(id, &picture)),
                // This process did not ask for them.
                CoreAction::Vector(_) => continue,
            };
            if let Err(error) = written {
                self.log_failed(&error, now_us);
            }
        }
    }

    /// A device that cannot write its log reports a fault and stops working. It does not try again.
    fn log_failed(&mut self, error: &io::Error, now_us: u64) {
        let text = error.to_string();
        eprint(&text);
        self.log = None;
        let device_us = self.device_us(now_us);
        self.core.set_fault(Some(Fault { code: FAULT_LOG, text }), device_us);
    }

    fn is_stalled(&self, now_us: u64) -> bool {
        now_us < self.stalled_until_us
    }

    /// Puts the next frame on the line once the one before has gone.
    fn transmit(&mut self, now_us: u64) {
        // Injected faults may drop frames. The limit keeps the loop turning.
        for _ in 0..8 {
            let busy = self.pty.is_none() || self.is_stalled(now_us) || self.transmit_pace.allowance_bytes(now_us) == 0;
            if busy || !self.outgoing.is_empty() {
                return;
            }
            let Some(frame) = self.session.transmit(now_us) else { return };
            self.transmit_faults.pass(&frame, &mut self.outgoing);
        }
    }

    fn readable_bytes(&self, now_us: u64) -> usize {
        if self.is_stalled(now_us) { 0 } else { self.receive_pace.allowance_bytes(now_us).min(READ_BYTES) }
    }

    fn writable_bytes(&self, now_us: u64) -> usize {
        if self.is_stalled(now_us) {
            return 0;
        }
        self.transmit_pace.allowance_bytes(now_us).min(self.outgoing.len())
    }

    fn next_wake_us(&self, now_us: u64) -> u64 {
        let device_us = self.core.next_timeout_us();
        let core_us = device_us.map(|at_us| (at_us as f64 / self.options.time_scale).ceil() as u64);
        let mut wake_us = now_us + IDLE_US;
        let stalled = self.is_stalled(now_us).then_some(self.stalled_until_us);
        let reading = (self.receive_pace.allowance_bytes(now_us) == 0).then(|| self.receive_pace.next_us());
        let writing = (self.transmit_pace.allowance_bytes(now_us) == 0).then(|| self.transmit_pace.next_us());
        let incident = self.coming.front().map(|(at_us, _)| *at_us);
        let timers = [core_us, self.session.next_timeout_us(), stalled, reading, writing, incident, self.reopen_us];
        for at_us in timers.into_iter().flatten() {
            wake_us = wake_us.min(at_us);
        }
        wake_us
    }

    fn woken(&mut self, woken: Woken, buffer: &[u8]) {
        let now_us = self.now_us();
        match woken {
            Woken::Timer => {}
            Woken::Read(Ok(bytes)) => {
                self.receive_pace.take(bytes, now_us);
                let mut passed = Vec::with_capacity(bytes);
                self.receive_faults.pass(&buffer[..bytes], &mut passed);
                self.session.receive(&passed, now_us);
            }
            Woken::Written(Ok(bytes)) => {
                self.transmit_pace.take(bytes, now_us);
                self.outgoing.drain(..bytes);
            }
            Woken::Read(Err(error)) | Woken::Written(Err(error)) => {
                eprint(&format!("the pseudo-terminal failed and is opened again: {error}"));
                self.lose_line(now_us + REOPEN_US);
            }
        }
    }
}

#[allow(
    deprecated,
    reason = "its successor is unsafe for what `Pty` keeps: one descriptor, its own, as long as it lives"
)]
fn open_line(link: &Path) -> io::Result<AsyncFd<Pty>> {
    AsyncFd::new(Pty::open(link)?)
}

fn new_session(options: &SimulateOptions, now_us: u64) -> DeviceSession {
    let settings = DeviceSettings { baud: options.baud.unwrap_or(UNLIMITED_BAUD), escaped: options.escaped };
    DeviceSession::new(options.capabilities.clone(), settings, now_us)
}
