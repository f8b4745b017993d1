//! Requests and urgent orders of the host, checked in the order of `docs/protocol.md`. Part of [`Firmware`](super::Firmware).

use layerd_wire::powder::{AnnouncedLayer, Arrival};

use super::acts::Running;
use super::{Firmware, Readiness};
use crate::link::message::{HostMessage, Refusal, Reply, Request, Urgent};

/// Most requests for the state that wait for the controller's status. A driver has four open.
const MAX_QUESTIONS: usize = 16;

impl Firmware {
    /// Handles a message of the host.
    pub(in crate::link::grbl) fn handle(&mut self, message: &HostMessage, now_us: u64) {
        self.now_us = now_us;
        match message {
            HostMessage::Request { number, request } => self.request(*number, *request),
            HostMessage::LayerData(bytes) => self.layer_data(bytes),
        }
        self.go_on();
    }

    fn request(&mut self, number: u32, request: Request) {
        let result = match request {
            Request::State => return self.question(number),
            Request::LayerBegin { slot, id, encoding, encoded_bytes, decoded_crc32: crc32 } => {
                self.refuse_unfinished();
                self.check_layer(slot, encoded_bytes).and_then(|()| {
                    let encoding = encoding.vectors().filter(|_| self.capabilities.encodings.contains(&encoding));
                    let encoding = encoding.ok_or(Refusal::BadEncoding)?;
                    self.buffer.begin(slot, AnnouncedLayer { number, id, encoding, encoded_bytes, crc32 });
                    Ok(())
                })
            }
            Request::Vat(_) => Err(Refusal::Unknown),
            Request::Powder(act) => match self.check_act() {
                Ok(()) if self.readiness == Readiness::Held => {
                    self.waiting = Some((number, request));
                    Ok(())
                }
                Ok(()) => self.begin_act(number, act),
                Err(refusal) => Err(refusal),
            },
        };
        if let Err(refusal) = result {
            self.reply(number, Reply::Refused(refusal));
        }
    }

    /// The state is answered when the controller has told its position, unless it cannot tell that now.
    fn question(&mut self, number: u32) {
        if self.is_deaf() || self.reset.is_some() || self.questions.len() >= MAX_QUESTIONS {
            let state = self.state();
            return self.reply(number, Reply::State(state));
        }
        self.questions.push(number);
        self.sender.ask(self.now_us);
    }

    fn is_ready(&self) -> bool {
        self.readiness != Readiness::Aborted && self.fault.is_none() && self.reset.is_none()
    }

    fn check_layer(&self, slot: u8, encoded_bytes: u32) -> Result<(), Refusal> {
        match self.is_ready() {
            false => Err(Refusal::NotReady),
            true if slot >= self.capabilities.layer_slots => Err(Refusal::NoSuchLayer),
            true if self.marking().is_some_and(|marking| marking.slot == usize::from(slot)) => Err(Refusal::SlotBusy),
            true if encoded_bytes == 0 => Err(Refusal::BadLayer),
            true => Ok(()),
        }
    }

    fn check_act(&self) -> Result<(), Refusal> {
        match self.is_ready() {
            false => Err(Refusal::NotReady),
            true if self.running.is_some() || self.waiting.is_some() => Err(Refusal::Busy),
            true => Ok(()),
        }
    }

    fn layer_data(&mut self, bytes: &[u8]) {
        match self.buffer.push(bytes) {
            Some((_, Arrival::Ready(number))) => self.reply(number, Reply::Done),
            Some((slot, Arrival::Bad(why))) => self.refuse_layer(slot, &why),
            Some((_, Arrival::More)) | None => {}
        }
    }

    /// A new layer begins before the one on its way is complete.
    fn refuse_unfinished(&mut self) {
        if let Some(slot) = self.buffer.receiving() {
            self.refuse_layer(slot, "not finished");
        }
    }

    fn refuse_layer(&mut self, slot: usize, why: &str) {
        tracing::debug!(slot, why, "layer refused");
        if let Some(number) = self.buffer.layer(slot).filter(|layer| !layer.is_ready).map(|layer| layer.number) {
            self.reply(number, Reply::Refused(Refusal::BadLayer));
        }
        self.buffer.drop_layer(slot);
        if let Some(marking) =
            self.running.as_mut().and_then(Running::marking_mut).filter(|marking| marking.slot == slot)
        {
            marking.stopping = marking.stopping.or(Some("its layer was dropped"));
        }
    }

    /// An urgent order. Its number comes back from [`Self::urgent_done`] when it is carried out.
    pub(in crate::link::grbl) fn urgent(&mut self, number: u32, urgent: Urgent, now_us: u64) {
        self.now_us = now_us;
        match urgent {
            Urgent::Abort => {
                self.readiness = Readiness::Aborted;
                self.buffer.drop_layers();
                if let Some((waiting, _)) = self.waiting.take() {
                    self.reply(waiting, Reply::Refused(Refusal::NotReady));
                }
                if self.running.is_some() || self.reset.is_some() {
                    return self.reset("abort", None, Some(number));
                }
            }
            Urgent::LightOff => {
                if self.marking().is_some() || self.reset.is_some() {
                    return self.reset("light off", None, Some(number));
                }
            }
            Urgent::Hold if self.readiness == Readiness::Ready => self.readiness = Readiness::Held,
            Urgent::Release if self.readiness == Readiness::Held => {
                self.readiness = Readiness::Ready;
                if let Some((number, request)) = self.waiting.take() {
                    self.request(number, request);
                }
            }
            Urgent::Hold | Urgent::Release => {}
        }
        self.done.push_back(number);
        self.go_on();
    }
}
