//! A device's firmware on the bench: virtual time, and everything it says and does kept.
#![allow(dead_code, unreachable_pub, reason = "each test file uses its part")]

pub mod powder;
pub mod powder_print;
pub mod print;

use layerd::device::encoding::{encode, picture_crc32};
use layerd::device::sim::{ActRecord, CoreAction, DeviceCore, MarkedVector};
use layerd::layer::{Bitmap, Depth};
use layerd::link::message::{
    Capabilities, DeviceMessage, DeviceState, Encoding, ExposureId, Fault, HostMessage, MachineCapabilities, Reply,
    Report, Request, Urgent, VatCapabilities, VatReply, VatRequest, Vats,
};
use layerd::link::session::{HostSession, SendError};

/// A host that prints, without the line.
pub trait Host {
    fn is_done(&self) -> bool;
    /// The line was opened.
    fn opened(&mut self);
    fn connected(&mut self, state: &DeviceState);
    fn lost(&mut self);
    fn message(&mut self, message: DeviceMessage);
    /// Gives the session what it has room for.
    fn work(&mut self, session: &mut HostSession);
}

/// Gives the session messages until it has no room, or there are none. `unsent` keeps the one without room; `next` makes one with at most
/// so many bytes of layer data.
fn send_all(
    session: &mut HostSession,
    unsent: &mut Option<HostMessage>,
    mut next: impl FnMut(usize) -> Option<HostMessage>,
) {
    loop {
        let piece_bytes = session.largest_layer_data_bytes();
        let Some(message) = unsent.take().or_else(|| next(piece_bytes)) else { return };
        match session.send(&message) {
            Ok(()) => {}
            Err(SendError::Full | SendError::NotConnected) => {
                *unsent = Some(message);
                return;
            }
            Err(error) => panic!("{error}"),
        }
    }
}

pub const WIDTH_PX: u32 = 70;
pub const HEIGHT_PX: u32 = 20;

pub fn capabilities() -> Capabilities {
    Capabilities {
        name: "bench dlp".into(),
        layer_slots: 2,
        window_bytes: 4096,
        largest_frame_bytes: 1024,
        encodings: vec![Encoding::RawBit, Encoding::Group4],
        max_exposure_ms: 60_000,
        machine: MachineCapabilities::Vat(VatCapabilities {
            width_px: WIDTH_PX,
            height_px: HEIGHT_PX,
            pixel_nm: [40_000, 40_000],
            max_position_um: 60_000,
            vats: Vats::ONE,
        }),
    }
}

pub fn id(layer: u32) -> ExposureId {
    ExposureId::first_pass(0x1234_5678_9abc_def0, layer)
}

/// A picture that no other layer has.
pub fn picture(layer: u32) -> Bitmap {
    let mut bitmap = Bitmap::new(WIDTH_PX, HEIGHT_PX, Depth::Bit);
    for (index, byte) in bitmap.data_mut().iter_mut().enumerate() {
        // The ninth byte of a row holds six pixels.
        let mask = if index % 9 == 8 { 0xfc } else { 0xff };
        *byte = (index as u32).wrapping_mul(2_654_435_761).wrapping_add(layer * 40_503).to_be_bytes()[1] & mask;
    }
    bitmap
}

pub struct Bench {
    pub core: DeviceCore,
    now_us: u64,
    number: u32,
    pub replies: Vec<(u32, Reply)>,
    pub faults: Vec<Option<Fault>>,
    /// What a powder machine said of its buffer.
    pub rooms: Vec<u32>,
    pub records: Vec<ActRecord>,
    pub pictures: Vec<(u32, Bitmap)>,
    /// What the laser was on.
    pub vectors: Vec<MarkedVector>,
}

impl Bench {
    /// A device that was greeted.
    pub fn new() -> Self {
        Self::of(DeviceCore::new(capabilities(), 5))
    }

    /// A device of any kind that is greeted.
    pub fn of(core: DeviceCore) -> Self {
        let mut bench = Self {
            core,
            now_us: 0,
            number: 0,
            replies: Vec::new(),
            faults: Vec::new(),
            rooms: Vec::new(),
            records: Vec::new(),
            pictures: Vec::new(),
            vectors: Vec::new(),
        };
        bench.hello();
        bench
    }

    pub fn message(&mut self, message: HostMessage) {
        self.core.handle(message, self.now_us);
        self.collect();
    }

    pub fn request(&mut self, request: Request) -> u32 {
        self.number += 1;
        self.message(HostMessage::Request { number: self.number, request });
        self.number
    }

    pub fn data(&mut self, bytes: &[u8]) {
        for piece in bytes.chunks(11) {
            self.message(HostMessage::LayerData(piece.to_vec()));
        }
    }

    pub fn begin(&mut self, slot: u8, id: ExposureId) -> u32 {
        let mut bytes = Vec::new();
        encode(&picture(id.layer), Encoding::Group4, &mut bytes).expect("bits");
        let number = self.request(Request::LayerBegin {
            slot,
            id,
            encoding: Encoding::Group4,
            encoded_bytes: bytes.len() as u32,
            decoded_crc32: picture_crc32(&picture(id.layer)),
        });
        self.data(&bytes);
        number
    }

    pub fn upload(&mut self, slot: u8, id: ExposureId) {
        let number = self.begin(slot, id);
        assert_eq!(self.reply(number), Some(Reply::Done));
    }

    pub fn try_upload(&mut self, id: ExposureId) {
        let slot = self.core.state().slots.iter().position(Option::is_none);
        self.begin(slot.unwrap_or(0) as u8, id);
    }

    /// Exposes to the end.
    pub fn expose(&mut self, id: ExposureId, duration_ms: u32) {
        let number = self.request(Request::Vat(VatRequest::Expose { id, duration_ms, light_pwm: 255 }));
        self.advance(u64::from(duration_ms) * 1000);
        assert_eq!(self.reply(number), Some(Reply::Vat(VatReply::Exposed { id, duration_ms })));
    }

    pub fn urgent(&mut self, urgent: Urgent) -> bool {
        let light_on = self.core.urgent(urgent, self.now_us);
        self.collect();
        light_on
    }

    pub fn advance(&mut self, us: u64) {
        self.now_us += us;
        self.core.advance(self.now_us);
        self.collect();
    }

    pub fn hello(&mut self) -> DeviceState {
        let state = self.core.hello(self.now_us);
        self.collect();
        state
    }

    pub fn silence(&mut self) {
        self.core.host_silent(self.now_us);
        self.collect();
    }

    pub fn reset(&mut self, boot_id: u32) {
        self.core.reset(boot_id, self.now_us);
        self.collect();
    }

    pub fn fault(&mut self, fault: Option<Fault>) {
        self.core.set_fault(fault, self.now_us);
        self.collect();
    }

    pub fn reply(&self, number: u32) -> Option<Reply> {
        self.replies.iter().find(|(found, _)| *found == number).map(|(_, reply)| reply.clone())
    }

    /// The time of the device's clock, microseconds.
    pub fn now_us(&self) -> u64 {
        self.now_us
    }

    pub fn events(&self) -> Vec<&'static str> {
        self.records.iter().map(|record| record.event).collect()
    }

    fn collect(&mut self) {
        while let Some(action) = self.core.action() {
            match action {
                CoreAction::Send(DeviceMessage::Reply { number, reply }) => self.replies.push((number, reply)),
                CoreAction::Send(DeviceMessage::Report(Report::Fault(fault))) => self.faults.push(fault),
                CoreAction::Send(DeviceMessage::Report(Report::Room { taken_bytes })) => self.rooms.push(taken_bytes),
                CoreAction::Record(record) => self.records.push(record),
                CoreAction::Picture(id, picture) => self.pictures.push((id.layer, picture)),
                CoreAction::Vector(vector) => self.vectors.push(vector),
            }
        }
    }
}
