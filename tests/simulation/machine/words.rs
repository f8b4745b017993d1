//! What a machine hears and says, and where it lies. Part of [`Machine`].

use layerd::link::message::{
    DeviceMessage, DeviceState, Fault, HostMessage, MachineCapabilities, PowderReply, PowderRequest, Reply, Report,
    Request, Urgent, VatReply, VatRequest,
};
use layerd_wire::{FrameDecoder, FrameKind, Welcome, encode_frame};

use super::character::{Asked, Lie};
use super::facts::FactKind;
use super::{Flood, Machine, Stray};

/// Requests without an answer that a machine remembers. A host has a few open; a machine that never answers forgets the oldest.
const MAX_OPEN: usize = 64;
/// Largest welcome.
const WELCOME_BYTES: usize = 1024;

impl Machine {
    /// A host begins a session.
    pub(super) fn hello(&mut self, session_id: u32, now_us: u64) {
        self.facts.note(FactKind::Hello { session_id }, now_us);
        self.forget_messages();
        let lie = self.liar.due(|lie| matches!(lie, Lie::BackWithLight { .. } | Lie::OtherGeometry { .. }));
        self.is_other = matches!(lie, Some(Lie::OtherGeometry { .. }));
        if let Some(Lie::BackWithLight { for_us }) = lie
            && !self.facts.is_lit()
        {
            self.stray = Some(Stray { until_us: now_us + for_us, is_known: true });
            self.facts.lamp_on(None, 0, now_us);
        }
        self.note_lie(lie, now_us);
        let state = self.core.hello(self.clock.machine_us(now_us));
        self.drain(now_us);
        let state = self.told_state(state, now_us);
        self.session.welcome(&state, now_us);
    }

    /// A message of the host.
    pub(super) fn hear(&mut self, message: HostMessage, now_us: u64) {
        match message {
            HostMessage::Request { number, request } => self.asked(number, request, now_us),
            data @ HostMessage::LayerData(_) => self.core.handle(data, self.clock.machine_us(now_us)),
        }
        self.drain(now_us);
    }

    fn asked(&mut self, number: u32, mut request: Request, now_us: u64) {
        if request != Request::State {
            self.facts.note(FactKind::Asked(request), now_us);
        }
        if self.asked.len() >= MAX_OPEN {
            self.asked.pop_front();
        }
        self.asked.push_back((number, request));
        self.known.hear(&request);
        let (asked, is_act) = (Asked::of(&request), matches!(request, Request::Vat(_) | Request::Powder(_)));
        let is_move =
            matches!(request, Request::Vat(VatRequest::Move { .. }) | Request::Powder(PowderRequest::Move { .. }));
        let lie = self.liar.due(|lie| match lie {
            Lie::Refuses { of, .. } => of == asked,
            Lie::RepliesEarly { .. } | Lie::WrongClock { .. } | Lie::Floods { .. } => is_act,
            Lie::MovesElsewhere { .. } => is_move,
            _ => false,
        });
        match lie {
            Some(Lie::Refuses { refusal, obeys, .. }) => {
                self.note_lie(lie, now_us);
                self.close(number);
                self.say(number, Reply::Refused(refusal));
                if !obeys {
                    return;
                }
            }
            Some(Lie::WrongClock { percent }) => {
                self.note_lie(lie, now_us);
                self.clock.set_rate(percent, now_us);
            }
            Some(Lie::MovesElsewhere { offset_um }) => {
                self.note_lie(lie, now_us);
                if let Request::Vat(VatRequest::Move { position_um, .. })
                | Request::Powder(PowderRequest::Move { position_um, .. }) = &mut request
                {
                    *position_um = (*position_um + offset_um).clamp(0, self.max_position_um());
                }
            }
            Some(Lie::Floods { states, every_us }) if self.liar.told == 1 => {
                self.note_lie(lie, now_us);
                self.flood =
                    Some(Flood { next_us: now_us + every_us.max(1), left: self.liar.count(), states, every_us });
            }
            _ => {}
        }
        self.core.handle(HostMessage::Request { number, request }, self.clock.machine_us(now_us));
        if let Some(Lie::RepliesEarly { by_us }) = lie {
            self.drain(now_us);
            self.reply_early(number, request, by_us, now_us);
        }
    }

    /// Answers the act that just began before it ends.
    fn reply_early(&mut self, number: u32, request: Request, by_us: u64, now_us: u64) {
        let Some(ends_us) = self.core.next_timeout_us().map(|at_us| self.clock.true_us(at_us)) else { return };
        let reply = match request {
            Request::Vat(VatRequest::Expose { id, duration_ms, .. }) => {
                Reply::Vat(VatReply::Exposed { id, duration_ms })
            }
            Request::Vat(VatRequest::Move { position_um, .. }) => Reply::Vat(VatReply::Moved { position_um }),
            Request::Vat(VatRequest::Home) => Reply::Vat(VatReply::Moved { position_um: 0 }),
            Request::Vat(VatRequest::Change { vat, .. }) => Reply::Vat(VatReply::Changed { vat }),
            Request::Powder(request) => match self.early_reply(request) {
                Some(reply) => Reply::Powder(reply),
                None => return,
            },
            Request::State | Request::LayerBegin { .. } => return,
        };
        if self.close(number).is_none() {
            return;
        }
        self.note_lie(Some(Lie::RepliesEarly { by_us }), now_us);
        let due_us = ends_us.saturating_sub(by_us).max(now_us);
        self.say_later(due_us, DeviceMessage::Reply { number, reply });
    }

    /// The firmware answers.
    pub(super) fn answer(&mut self, number: u32, mut reply: Reply, now_us: u64) {
        let Some(request) = self.close(number) else { return };
        let asked = Asked::of(&request);
        if let Reply::State(state) = reply {
            reply = Reply::State(self.told_state(state, now_us));
        }
        let is_marked = matches!(reply, Reply::Powder(PowderReply::Marked { .. }));
        let is_exposed = is_marked || matches!(reply, Reply::Vat(VatReply::Exposed { .. }));
        let is_moved = matches!(reply, Reply::Vat(VatReply::Moved { .. }) | Reply::Powder(PowderReply::Moved { .. }));
        let lie = self.liar.due(|lie| match lie {
            Lie::RepliesLate { of, .. }
            | Lie::RepliesTwice { of }
            | Lie::RepliesNever { of }
            | Lie::WrongNumber { of, .. } => of == asked,
            Lie::WrongDose { .. } | Lie::WrongLayer { .. } => is_exposed,
            Lie::WrongPosition { .. } => is_moved,
            Lie::WrongCount { .. } | Lie::MarksTwice => is_marked,
            _ => false,
        });
        self.note_lie(lie, now_us);
        if is_moved {
            self.position_offset_um = 0;
        }
        match (lie, &mut reply) {
            (
                Some(Lie::WrongDose { percent }),
                Reply::Vat(VatReply::Exposed { duration_ms: light_ms, .. })
                | Reply::Powder(PowderReply::Marked { laser_ms: light_ms, .. }),
            ) => {
                *light_ms = (u64::from(*light_ms) * u64::from(percent) / 100).min(u64::from(u32::MAX)) as u32;
            }
            (
                Some(Lie::WrongLayer { offset }),
                Reply::Vat(VatReply::Exposed { id, .. }) | Reply::Powder(PowderReply::Marked { id, .. }),
            ) => {
                id.layer = id.layer.wrapping_add_signed(offset);
            }
            (
                Some(Lie::WrongPosition { offset_um }),
                Reply::Vat(VatReply::Moved { position_um }) | Reply::Powder(PowderReply::Moved { position_um }),
            ) => {
                self.position_offset_um = offset_um;
                *position_um += offset_um;
            }
            (Some(Lie::WrongCount { offset }), Reply::Powder(PowderReply::Marked { vectors, .. })) => {
                *vectors = vectors.wrapping_add_signed(offset);
            }
            (Some(Lie::MarksTwice), _) => return self.mark_again(number, reply, now_us),
            (Some(Lie::RepliesLate { by_us, .. }), _) => {
                return self.say_later(now_us + by_us, DeviceMessage::Reply { number, reply });
            }
            (Some(Lie::RepliesTwice { .. }), _) => self.say(number, reply.clone()),
            (Some(Lie::RepliesNever { .. }), _) => return,
            (Some(Lie::WrongNumber { offset, .. }), _) => return self.say(number.wrapping_add_signed(offset), reply),
            _ => {}
        }
        self.say(number, reply);
    }

    /// The state as it is told.
    fn told_state(&mut self, mut state: DeviceState, now_us: u64) -> DeviceState {
        state.light_on |= self.shows_stray();
        state.position_um = state.position_um.map(|position_um| position_um + self.position_offset_um);
        let names_exposed = state.last_exposed.is_some() || state.cut_short.is_some();
        let names_slot = state.slots.iter().any(Option::is_some);
        let is_dark = !state.light_on;
        let lie = self.liar.due(|lie| match lie {
            Lie::LitWhenDark => is_dark,
            Lie::ForgetsExposed => names_exposed,
            Lie::ForgetsSlots => names_slot,
            Lie::OtherBoot => true,
            _ => false,
        });
        self.note_lie(lie, now_us);
        match lie {
            Some(Lie::LitWhenDark) => state.light_on = true,
            Some(Lie::ForgetsExposed) => (state.last_exposed, state.cut_short) = (None, None),
            Some(Lie::ForgetsSlots) => state.slots.fill(None),
            Some(Lie::OtherBoot) => state.boot_id ^= 1,
            _ => {}
        }
        self.told_powder(&mut state, now_us);
        state
    }

    /// An urgent order.
    pub(super) fn urgent(&mut self, number: u32, urgent: Urgent, now_us: u64) {
        let lie = self.liar.due(|lie| matches!(lie, Lie::IgnoresUrgent { .. } | Lie::SilentUrgent));
        self.note_lie(lie, now_us);
        let obeyed = !matches!(lie, Some(Lie::IgnoresUrgent { .. }));
        if obeyed {
            self.core.urgent(urgent, self.clock.machine_us(now_us));
            self.drain(now_us);
            if matches!(urgent, Urgent::LightOff | Urgent::Abort) && self.shows_stray() {
                self.stray = None;
                self.facts.lamp_off(now_us);
            }
        }
        let is_lit = self.core.exposure().is_some() || self.shows_stray();
        let is_answered = !matches!(lie, Some(Lie::SilentUrgent | Lie::IgnoresUrgent { answers: false }));
        let light_on = is_answered.then_some(is_lit);
        self.facts.note(FactKind::Urgent { number, urgent, obeyed, light_on }, now_us);
        if let Some(light_on) = light_on {
            self.session.urgent_done(number, light_on);
        }
    }

    /// One message that nobody asked for.
    pub(super) fn flood(&mut self, states: bool) {
        let message = match states {
            true => DeviceMessage::Reply { number: u32::MAX, reply: Reply::State(self.core.state()) },
            false => DeviceMessage::Report(Report::Fault(None::<Fault>)),
        };
        self.say_now(message);
    }

    /// The frame of a welcome, from another machine.
    pub(super) fn disguise(&self, frame: Vec<u8>) -> Vec<u8> {
        let Some(Lie::OtherGeometry { wider_px, higher_um }) = self.liar.character.lie() else { return frame };
        let Some(Ok(decoded)) = FrameDecoder::new(WELCOME_BYTES).next_frame(&mut frame.as_slice()) else {
            return frame;
        };
        let welcome = Welcome::decode(&decoded.frame.payload);
        let Some(mut welcome) = welcome.ok().filter(|_| decoded.frame.kind == FrameKind::Welcome) else { return frame };
        match &mut welcome.capabilities.machine {
            MachineCapabilities::Vat(vat) => {
                vat.width_px += wider_px;
                vat.max_position_um += higher_um;
            }
            MachineCapabilities::Powder(powder) => {
                powder.field_um[0] += wider_px;
                powder.max_position_um += higher_um;
            }
        }
        encode_frame(FrameKind::Welcome, decoded.frame.session_id, decoded.frame.sequence, &welcome.encode())
    }

    /// The request of that number, if it is not answered yet; now it is.
    fn close(&mut self, number: u32) -> Option<Request> {
        let place = self.asked.iter().position(|(open, _)| *open == number)?;
        self.asked.remove(place).map(|(_, request)| request)
    }

    fn say(&mut self, number: u32, reply: Reply) {
        self.waiting.push_back(DeviceMessage::Reply { number, reply });
    }

    pub(super) fn note_lie(&mut self, lie: Option<Lie>, now_us: u64) {
        if let Some(lie) = lie {
            self.facts.note(FactKind::Lied(format!("{lie:?}")), now_us);
        }
    }

    fn shows_stray(&self) -> bool {
        self.stray.is_some_and(|stray| stray.is_known)
    }
}
