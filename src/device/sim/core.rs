//! The firmware of a simulated machine, on top of the device's session: messages and the time go in, actions come out. This file has
//! what every machine does; `plate` moves the plate of any machine, `vat` exposes pictures, and `powder` spreads and melts powder.
//!
//! Times are microseconds of the device's own clock. The end of an act is stamped with the time when it was due, however late
//! [`DeviceCore::advance`] is called. The light is on only during an exposure. An exposure ends by the device's clock, by an urgent
//! light-off or abort, by a fault, or by a reset. `tests/device_core/` and `tests/powder_core/` show every reply.

mod board;
mod plate;
mod powder;
mod statistics;
mod vat;

use board::{Board, Readiness};
use powder::Powder;
use vat::Vat;

pub use powder::{MarkedVector, MeltSettings};
pub use statistics::Statistics;

use super::log::ActRecord;
use crate::layer::Bitmap;
use crate::link::message::{
    Capabilities, DeviceMessage, DeviceState, Encoding, ExposureId, Fault, HostMessage, MachineCapabilities, Refusal,
    Reply, Request, Urgent,
};

/// What the owner of the core must do, in order.
#[derive(Clone, Debug, PartialEq)]
pub enum CoreAction {
    /// Send to the host; void without a session.
    Send(DeviceMessage),
    /// Write a line of the log.
    Record(ActRecord),
    /// Keep the picture of an exposure that ended: what was lit, or what was melted.
    Picture(ExposureId, Bitmap),
    /// The laser was on this vector. See [`DeviceCore::telling_vectors`].
    Vector(MarkedVector),
}

/// A layer that is announced.
#[derive(Clone, Copy, Debug)]
struct LayerBegin {
    slot: u8,
    id: ExposureId,
    encoding: Encoding,
    encoded_bytes: u32,
    decoded_crc32: u32,
}

/// What differs between kinds of machines.
#[derive(Debug)]
enum Machine {
    Vat(Box<Vat>),
    Powder(Box<Powder>),
}

/// The state of the firmware.
#[derive(Debug)]
pub struct DeviceCore {
    boot_id: u32,
    board: Board,
    machine: Machine,
    /// The request that came during a hold.
    waiting: Option<(u32, Request)>,
}

impl DeviceCore {
    /// A device that was just switched on: dark, not homed, waiting for a hello. `boot_id` differs from start to start.
    pub fn new(capabilities: Capabilities, boot_id: u32) -> Self {
        let slots = usize::from(capabilities.layer_slots);
        let machine = match &capabilities.machine {
            MachineCapabilities::Vat(vat) => Machine::Vat(Box::new(Vat::new(vat.clone(), slots))),
            MachineCapabilities::Powder(powder) => Machine::Powder(Box::new(Powder::new(powder.clone(), slots))),
        };
        Self { boot_id, board: Board::new(capabilities), machine, waiting: None }
    }

    /// The same device, which draws what its laser melts. Without this, a powder machine gives no pictures; a vat always does.
    #[must_use]
    pub fn drawing(mut self, settings: MeltSettings) -> Self {
        if let Machine::Powder(powder) = &mut self.machine {
            powder.draw(settings);
        }
        self
    }

    /// The same device, which tells its owner each vector that its laser was on, in their order. Only a powder machine has vectors.
    #[must_use]
    pub fn telling_vectors(mut self) -> Self {
        if let Machine::Powder(powder) = &mut self.machine {
            powder.tell_vectors();
        }
        self
    }

    /// The capabilities that the device reports.
    pub fn capabilities(&self) -> &Capabilities {
        &self.board.capabilities
    }

    /// Counts.
    pub fn statistics(&self) -> Statistics {
        self.board.statistics
    }

    /// The next action for the owner.
    pub fn action(&mut self) -> Option<CoreAction> {
        self.board.actions.pop_front()
    }

    /// When [`advance`](Self::advance) must be called next.
    pub fn next_timeout_us(&self) -> Option<u64> {
        let act_us = match &self.machine {
            Machine::Vat(vat) => vat.next_timeout_us(),
            Machine::Powder(powder) => powder.next_timeout_us(),
        };
        let timers = [act_us, self.board.plate.next_timeout_us(), self.board.fault_ends_us];
        timers.into_iter().flatten().min()
    }

    /// Ends what is due by `now_us`. Every other call with a time does this first.
    pub fn advance(&mut self, now_us: u64) {
        let board = &mut self.board;
        match &mut self.machine {
            Machine::Vat(vat) => vat.advance(board, now_us),
            Machine::Powder(powder) => powder.advance(board, now_us),
        }
        board.advance_plate(now_us);
        board.now_us = board.now_us.max(now_us);
        if board.fault_ends_us.is_some_and(|ends_us| ends_us <= now_us) {
            board.report_fault(None);
        }
    }

    /// The exposure under way, and its longest time, milliseconds.
    pub fn exposure(&self) -> Option<(ExposureId, u32)> {
        match &self.machine {
            Machine::Vat(vat) => vat.exposure(),
            Machine::Powder(powder) => powder.exposure(),
        }
    }

    /// Where the plate is in truth, micrometres, as in the state. Unlike [`state`](Self::state), it tells the position of a plate that
    /// is not homed, too. `now_us` is a time of the device's clock, not before that of the last call.
    pub fn plate_um(&self, now_us: u64) -> i32 {
        self.board.plate.true_position_um(now_us)
    }

    /// Where the motion under way ends, micrometres, and whether it is a homing; `None` while the plate rests.
    pub fn plate_target(&self) -> Option<(i32, bool)> {
        self.board.plate.target()
    }

    /// Somebody moves the plate by hand to a position, micrometres. The device has an encoder and knows the new position if it was
    /// homed. A motion under way holds the plate: then this does nothing and returns `false`.
    pub fn push_plate(&mut self, to_um: i32, now_us: u64) -> bool {
        self.advance(now_us);
        let is_pushed = self.board.plate.push(to_um);
        if let Machine::Powder(powder) = &mut self.machine
            && is_pushed
        {
            powder.plate_pushed();
        }
        is_pushed
    }

    /// The state, as sent in the welcome and in reply to [`Request::State`].
    pub fn state(&self) -> DeviceState {
        let board = &self.board;
        let exposing = self.exposure().map(|(id, _)| id);
        let (slots, light_on, powder) = match &self.machine {
            Machine::Vat(vat) => (vat.slot_ids(), exposing.is_some(), None),
            Machine::Powder(powder) => (powder.slot_ids(), powder.light_on(), Some(powder.state())),
        };
        let vats = match &self.machine {
            Machine::Vat(vat) => vat.vats_state(),
            Machine::Powder(_) => None,
        };
        DeviceState {
            boot_id: self.boot_id,
            last_exposed: board.last_exposed,
            exposing,
            cut_short: board.cut_short,
            light_on,
            position_um: board.plate.position_um(board.now_us),
            moving: board.plate.is_moving(),
            slots,
            fault: board.fault.clone(),
            powder,
            vats,
        }
    }

    /// A host begins a session. A running act goes on, but its reply is not sent; a laser stops at the end of its vector. An abort or a
    /// hold is cleared.
    pub fn hello(&mut self, now_us: u64) -> DeviceState {
        self.advance(now_us);
        self.end_session("hello");
        self.board.readiness = Readiness::Ready;
        self.board.record(ActRecord { event: "hello", ..ActRecord::default() });
        self.state()
    }

    /// The host was silent for too long. A running act ends by the device's clock, and a laser stops at the end of its vector; nothing
    /// begins until a hello.
    pub fn host_silent(&mut self, now_us: u64) {
        self.advance(now_us);
        self.end_session("host_silent");
        self.board.readiness = Readiness::WaitsForHello;
        self.board.statistics.silences += 1;
        self.board.record(ActRecord { event: "host_silent", ..ActRecord::default() });
    }

    /// The device restarts. Only its non-volatile memory survives.
    pub fn reset(&mut self, boot_id: u32, now_us: u64) {
        self.advance(now_us);
        self.forget_requests();
        self.board.record(ActRecord { event: "reset", ..ActRecord::default() });
        self.cut("reset");
        self.board.plate.lose_moving_position();
        self.board.stop_motion();
        match &mut self.machine {
            Machine::Vat(vat) => vat.restart(),
            Machine::Powder(powder) => powder.restart(),
        }
        self.boot_id = boot_id;
        (self.board.readiness, self.board.fault, self.board.fault_ends_us) = (Readiness::WaitsForHello, None, None);
        self.board.statistics.resets += 1;
    }

    /// A fault begins or ends (`None`).
    pub fn set_fault(&mut self, fault: Option<Fault>, now_us: u64) {
        self.advance(now_us);
        if fault.is_some() {
            self.cut("fault");
            self.board.stop_motion();
        }
        self.board.report_fault(fault);
        self.report_room();
    }

    /// Carries out an urgent order at once. Returns whether the light is on afterwards.
    pub fn urgent(&mut self, urgent: Urgent, now_us: u64) -> bool {
        self.advance(now_us);
        let name = match urgent {
            Urgent::Abort => "abort",
            Urgent::LightOff => "light_off",
            Urgent::Hold => "hold",
            Urgent::Release => "release",
        };
        self.board.record(ActRecord { event: "urgent", reason: Some(name.into()), ..ActRecord::default() });
        match urgent {
            Urgent::Abort => self.abort(),
            Urgent::LightOff => self.cut_light("light_off"),
            Urgent::Hold if self.board.readiness == Readiness::Ready => self.board.readiness = Readiness::Held,
            Urgent::Release if self.board.readiness == Readiness::Held => {
                self.board.readiness = Readiness::Ready;
                if let Some((number, request)) = self.waiting.take() {
                    self.request(number, request);
                }
            }
            Urgent::Hold | Urgent::Release => {}
        }
        self.report_room();
        self.state().light_on
    }

    fn abort(&mut self) {
        self.cut("abort");
        self.board.stop_motion();
        self.board.readiness = Readiness::WaitsForHello;
        match &mut self.machine {
            Machine::Vat(vat) => vat.drop_layers(&mut self.board),
            Machine::Powder(powder) => powder.drop_layers(&mut self.board),
        }
        if let Some((number, _)) = self.waiting.take() {
            self.board.reply(Some(number), Reply::Refused(Refusal::NotReady));
        }
    }

    /// The light goes off, and everything else that the machine does stops, except for the plate.
    fn cut(&mut self, reason: &'static str) {
        self.cut_light(reason);
        match &mut self.machine {
            Machine::Vat(vat) => vat.stop_change(&mut self.board),
            Machine::Powder(powder) => powder.stop_recoater(&mut self.board),
        }
    }

    fn cut_light(&mut self, reason: &'static str) {
        match &mut self.machine {
            Machine::Vat(vat) => vat.cut(&mut self.board, reason),
            Machine::Powder(powder) => powder.cut(&mut self.board, reason),
        }
    }

    /// Handles a message that the session delivers.
    pub fn handle(&mut self, message: HostMessage, now_us: u64) {
        self.advance(now_us);
        match message {
            HostMessage::Request { number, request } => self.request(number, request),
            HostMessage::LayerData(bytes) => match &mut self.machine {
                Machine::Vat(vat) => vat.layer_data(&mut self.board, &bytes),
                Machine::Powder(powder) => powder.layer_data(&mut self.board, &bytes),
            },
        }
        self.report_room();
    }

    fn report_room(&mut self) {
        if let Machine::Powder(powder) = &mut self.machine {
            powder.report_room(&mut self.board);
        }
    }

    fn request(&mut self, number: u32, request: Request) {
        let (result, (what, id)) = match request {
            Request::State => {
                let state = self.state();
                self.board.reply(Some(number), Reply::State(state));
                return;
            }
            Request::LayerBegin { slot, id, encoding, encoded_bytes, decoded_crc32 } => {
                let begin = LayerBegin { slot, id, encoding, encoded_bytes, decoded_crc32 };
                let result = match &mut self.machine {
                    Machine::Vat(vat) => vat.layer_begin(&mut self.board, number, begin),
                    Machine::Powder(powder) => powder.layer_begin(&mut self.board, number, begin),
                };
                (result, ("layer_begin", Some(id)))
            }
            Request::Vat(act) => (self.begin_act(number, request), vat::named(act)),
            Request::Powder(act) => (self.begin_act(number, request), powder::named(act)),
        };
        if let Err(refusal) = result {
            self.board.refused(number, id, what, refusal);
        }
    }

    /// Begins an act, or lets it wait during a hold.
    fn begin_act(&mut self, number: u32, request: Request) -> Result<(), Refusal> {
        match (&self.machine, request) {
            (Machine::Vat(_), Request::Vat(_)) | (Machine::Powder(_), Request::Powder(_)) => {}
            _ => return Err(Refusal::Unknown),
        }
        self.board.check_ready()?;
        if self.board.readiness == Readiness::Held {
            if self.waiting.is_some() {
                return Err(Refusal::Busy);
            }
            self.waiting = Some((number, request));
            return Ok(());
        }
        // Light while the plate moves would smear the layer.
        if self.is_acting() {
            return Err(Refusal::Busy);
        }
        match (&mut self.machine, request) {
            (Machine::Vat(vat), Request::Vat(request)) => vat.begin_act(&mut self.board, number, request),
            (Machine::Powder(powder), Request::Powder(request)) => powder.begin_act(&mut self.board, number, request),
            _ => Err(Refusal::Unknown),
        }
    }

    fn is_acting(&self) -> bool {
        let machine_acts = match &self.machine {
            Machine::Vat(vat) => vat.is_acting(),
            Machine::Powder(powder) => powder.is_acting(),
        };
        machine_acts || self.board.plate.is_moving()
    }

    /// The session is over, and what was not sent is void. A layer that is not complete is dropped.
    fn end_session(&mut self, reason: &'static str) {
        self.board.actions.retain(|action| !matches!(action, CoreAction::Send(_)));
        self.forget_requests();
        match &mut self.machine {
            Machine::Vat(vat) => vat.end_session(),
            Machine::Powder(powder) => powder.end_session(&mut self.board, reason),
        }
    }

    /// No request of the session is answered any more.
    fn forget_requests(&mut self) {
        self.waiting = None;
        self.board.plate.forget_request();
        match &mut self.machine {
            Machine::Vat(vat) => vat.forget_request(),
            Machine::Powder(powder) => powder.forget_request(),
        }
    }
}
