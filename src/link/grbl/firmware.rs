//! The part of a powder machine's firmware that a grbl controller does not have, played by the host: layers, acts, and what was marked.
//! It answers the requests of `docs/protocol.md`, "Powder machines". It outlives sessions, as a device's memory does.
//! `tests/grbl/main.rs` prints with it.

mod acts;
mod requests;
mod rest;
mod watch;

use std::collections::VecDeque;

use layerd_wire::powder::LayerBuffer;

use super::answer::{State, Status};
use super::gcode::Power;
use super::marking::{Broken, Marking};
use super::sender::Sender;
use super::settings::{Controller, GrblMachine, capabilities};
use super::texts::{HOMING_REQUIRED, alarm_text, error_text, loses_position};
use crate::link::message::{
    Capabilities, DeviceMessage, DeviceState, ExposureId, Fault, MachineCapabilities, PowderState, Reply, Report,
    Request,
};
use acts::Running;
use rest::{Interrupted, Reset};

/// How long a fault lasts that is over at once, microseconds: more than a second, because a host may ignore reports that come more
/// often.
const FAULT_US: u64 = 2_000_000;
/// Code of a fault of the controller.
const FAULT_CONTROLLER: u16 = 1;
/// Most messages that wait for the host: each request causes one or two, and each status answers at most sixteen questions.
const MAX_MESSAGES: usize = 256;

/// Whether acts begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Readiness {
    Ready,
    /// Until Release; at most one request waits.
    Held,
    /// Aborted: nothing begins until a new session.
    Aborted,
}

/// Layers, acts and memory of the machine.
#[derive(Debug)]
pub(super) struct Firmware {
    machine: GrblMachine,
    capabilities: Capabilities,
    boot_id: u32,
    controller: Option<Controller>,
    pub(super) sender: Sender,
    buffer: LayerBuffer,
    readiness: Readiness,
    fault: Option<Fault>,
    fault_ends_us: Option<u64>,
    last_exposed: Option<ExposureId>,
    cut_short: Option<(ExposureId, u32)>,
    /// Of the layer that was cut short: its first vector that is not marked whole, and whether part of that may be marked.
    next_vector: u32,
    broken: Option<Broken>,
    recoated: bool,
    /// Where the axes are in G54, micrometres, as last reported; and whether that can be relied on.
    position_um: Option<[i32; 3]>,
    knows_position: bool,
    /// Where a move went whose end was not seen because its session ended, micrometres.
    unseen_to_um: Option<i32>,
    /// Sum of all offsets, and what G92 has set of it, micrometres, as last reported.
    offset_um: Option<[i32; 3]>,
    shift_um: Option<[i32; 3]>,
    /// Whether the beam may have moved in a recoating whose end was not seen.
    beam_unseen: bool,
    /// What the controller told of its modes.
    modes: String,
    /// Whether modes and offsets are set since the controller was reset.
    is_prepared: bool,
    /// Whether the controller must be unlocked before it moves.
    is_locked: bool,
    running: Option<Running>,
    reset: Option<Reset>,
    /// A marking that a session's end or a reset has interrupted, until it is known how far it came.
    interrupted: Option<Interrupted>,
    /// The request that came during a hold.
    waiting: Option<(u32, Request)>,
    /// Requests for the state that wait for the controller's status.
    questions: Vec<u32>,
    /// For the host.
    messages: VecDeque<DeviceMessage>,
    /// Urgent orders that are carried out: their numbers, and whether the light is on.
    done: VecDeque<u32>,
    now_us: u64,
}

impl Firmware {
    /// Before the first session, of a machine whose state is not known. `boot_id` tells it from that of an earlier process.
    pub(super) fn new(machine: GrblMachine, boot_id: u32) -> Self {
        let capabilities = capabilities(&machine, "grbl");
        let buffer = match &capabilities.machine {
            MachineCapabilities::Powder(powder) => LayerBuffer::new(powder.clone(), capabilities.layer_slots.into()),
            MachineCapabilities::Vat(_) => {
                unreachable!("the capabilities of a grbl machine are those of a powder machine")
            }
        };
        Self {
            machine,
            capabilities,
            boot_id,
            controller: None,
            sender: Sender::default(),
            buffer,
            readiness: Readiness::Ready,
            fault: None,
            fault_ends_us: None,
            last_exposed: None,
            cut_short: None,
            next_vector: 0,
            broken: None,
            recoated: false,
            position_um: None,
            knows_position: false,
            unseen_to_um: None,
            offset_um: None,
            shift_um: None,
            beam_unseen: false,
            modes: String::new(),
            is_prepared: false,
            is_locked: false,
            running: None,
            reset: None,
            interrupted: None,
            waiting: None,
            questions: Vec::new(),
            messages: VecDeque::new(),
            done: VecDeque::new(),
            now_us: 0,
        }
    }

    pub(super) fn machine(&self) -> &GrblMachine {
        &self.machine
    }

    pub(super) fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    /// The next message for the host.
    pub(super) fn message(&mut self) -> Option<DeviceMessage> {
        self.messages.pop_front()
    }

    /// The number of the next urgent order that was carried out.
    pub(super) fn urgent_done(&mut self) -> Option<u32> {
        self.done.pop_front()
    }

    /// Whether the laser is commanded on.
    pub(super) fn light_on(&self) -> bool {
        self.marking().is_some_and(|marking| !marking.is_starved())
    }

    fn marking(&self) -> Option<&Marking> {
        self.running.as_ref().and_then(Running::marking)
    }

    /// The state, as a powder machine reports it.
    pub(super) fn state(&self) -> DeviceState {
        let marking = self.marking();
        let next_vector = marking.map_or(self.next_vector, Marking::next_vector);
        DeviceState {
            boot_id: self.boot_id,
            last_exposed: self.last_exposed,
            exposing: marking.map(|marking| marking.id),
            cut_short: self.cut_short,
            light_on: self.light_on(),
            position_um: self.position_um.filter(|_| self.knows_position).map(|[_, _, z]| -z),
            moving: self.running.as_ref().is_some_and(Running::moves_plate),
            slots: self.buffer.slot_ids(),
            fault: self.fault.clone(),
            vats: None,
            powder: Some(PowderState {
                next_vector,
                broken: marking.is_none() && self.broken.is_some(),
                recoated: self.recoated,
            }),
        }
    }

    /// The controller has taken a line.
    pub(super) fn line_taken(&mut self, now_us: u64) {
        self.now_us = now_us;
        if self.reset.is_some() {
            return;
        }
        match self.sender.answered() {
            None => self.fail("the controller answers lines that it was not sent: bytes are lost or changed on the line. Check the cable".into()),
            Some(kind) => self.act_answered(kind),
        }
        self.go_on();
    }

    /// The controller has refused a line.
    pub(super) fn line_refused(&mut self, error: u16, now_us: u64) {
        self.now_us = now_us;
        if self.reset.is_none() {
            self.knows_position &= error != HOMING_REQUIRED;
            if let Some(marking) = self.running.as_mut().and_then(Running::marking_mut) {
                marking.refused();
            }
            self.fail(error_text(error));
        }
    }

    /// The controller has locked itself.
    pub(super) fn alarmed(&mut self, alarm: u16, now_us: u64) {
        self.now_us = now_us;
        if loses_position(alarm) {
            self.knows_position = false;
        }
        // A reset while it moves is answered with an alarm.
        if self.reset.is_none() {
            self.fail(alarm_text(alarm));
        }
    }

    /// The controller has said something that no grbl controller says.
    pub(super) fn garbage(&mut self, line: &str, now_us: u64) {
        self.now_us = now_us;
        if self.running.is_some() && self.reset.is_none() {
            self.fail(format!("the controller sent `{line}`, which is no answer: check cable and `baud`"));
        }
    }

    /// The controller has told its status.
    pub(super) fn status(&mut self, status: &Status, now_us: u64) {
        self.now_us = now_us;
        self.sender.heard_status();
        let before_um = self.position_um;
        let Some(at_um) = self.locate(status) else { return };
        self.position_um = Some(at_um);
        self.is_locked = status.state == State::Alarm;
        if self.reset.is_some() {
            self.at_rest_after_reset(status.state, at_um);
        } else {
            self.act_status(status.state, at_um, before_um);
        }
        if !self.questions.is_empty() {
            let state = self.state();
            for number in std::mem::take(&mut self.questions) {
                self.reply(number, Reply::State(state.clone()));
            }
        }
        self.go_on();
    }

    /// The controller has told its modes.
    pub(super) fn modes(&mut self, modes: String) {
        self.modes = modes;
    }

    /// Whether a reset is under way.
    pub(super) fn is_resetting(&self) -> bool {
        self.reset.is_some()
    }

    /// Whether more messages wait than any controller causes.
    pub(super) fn is_flooded(&self) -> bool {
        self.messages.len() > MAX_MESSAGES
    }

    /// The controller has told what G92 has set.
    pub(super) fn shifted(&mut self, shift_um: [i32; 3]) {
        self.shift_um = Some(shift_um);
    }

    /// The position in G54; `None` if the status does not tell it. A controller tells its offsets only now and then.
    fn locate(&mut self, status: &Status) -> Option<[i32; 3]> {
        self.offset_um = status.offset_um.or(self.offset_um);
        let machine_um = status.machine_um.or_else(|| Some(sum(status.work_um?, self.offset_um?)))?;
        let g54_um = self.controller.as_ref()?.offset_um;
        Some(sum(machine_um, g54_um.map(|um| -um)))
    }

    /// When [`Self::tick`] must be called.
    pub(super) fn next_timeout_us(&self) -> u64 {
        let reset_us = self.reset.as_ref().map(Reset::due_us);
        // A reset has its own times.
        let act_us = self.running.as_ref().filter(|_| self.reset.is_none()).map(Running::due_us);
        [reset_us, act_us, self.fault_ends_us].into_iter().flatten().min().unwrap_or(u64::MAX)
    }

    /// Handles what is due. Returns `false` if the controller does not answer a reset.
    pub(super) fn tick(&mut self, now_us: u64) -> bool {
        self.now_us = now_us;
        if self.fault_ends_us.take_if(|ends_us| *ends_us <= now_us).is_some() {
            self.fault = None;
            self.send(DeviceMessage::Report(Report::Fault(None)));
        }
        if !self.press_reset() {
            return false;
        }
        self.act_due();
        self.go_on();
        true
    }

    /// Something is wrong: the laser goes off, and the act under way ends. The text tells the operator.
    fn fail(&mut self, text: String) {
        tracing::warn!("{text}");
        self.reset("fault", Some(text), None);
    }

    fn report_fault(&mut self, text: String) {
        let fault = Fault { code: FAULT_CONTROLLER, text };
        self.fault = Some(fault.clone());
        self.fault_ends_us = Some(self.now_us + FAULT_US);
        self.send(DeviceMessage::Report(Report::Fault(Some(fault))));
    }

    fn power(&self) -> Power {
        let max_s = self.controller.as_ref().map_or(1000.0, |controller| controller.max_s);
        Power { max_s, max_power_mw: self.machine.max_power_mw }
    }

    fn reply(&mut self, number: u32, reply: Reply) {
        self.send(DeviceMessage::Reply { number, reply });
    }

    fn send(&mut self, message: DeviceMessage) {
        self.messages.push_back(message);
    }

    /// Makes lines of what is to be marked, and tells the host of room in the buffer.
    fn go_on(&mut self) {
        self.make_lines();
        if let Some(taken_bytes) = self.buffer.report() {
            self.send(DeviceMessage::Report(Report::Room { taken_bytes }));
        }
    }
}

fn sum(a_um: [i32; 3], b_um: [i32; 3]) -> [i32; 3] {
    [0, 1, 2].map(|axis| a_um[axis].saturating_add(b_um[axis]))
}
