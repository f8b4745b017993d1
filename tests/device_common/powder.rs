//! A laser machine on the bench, and layers for it. The host here keeps the buffer's credit, as a real one does.

use std::ops::{Deref, DerefMut};

use layerd::device::encoding::encode_vectors;
use layerd::device::sim::{DeviceCore, MeltSettings};
use layerd::layer::{LaserParameters, Mark, MarkClass, Mirror, Raster, Vectors};
use layerd::link::message::{
    Capabilities, Encoding, ExposureId, Fault, HostMessage, MachineCapabilities, PowderCapabilities, PowderReply,
    PowderRequest, Refusal, Reply, Request,
};

pub use super::id;

use super::Bench;

pub const FIELD_UM: [u32; 2] = [20_000, 10_000];
pub const BUFFER_BYTES: u32 = 2048;
pub const MAX_MS: u32 = 60_000;
pub const MAX_POWER_MW: u32 = 200_000;

/// 1 m/s, jumps of 5 m/s: a micrometre takes a microsecond, and a jump a fifth of that.
pub const LASER: LaserParameters = LaserParameters {
    power_mw: 100_000,
    mark_speed_um_s: 1_000_000,
    jump_speed_um_s: 5_000_000,
    focus_um: 0,
    jump_delay_us: 100,
    mark_delay_us: 50,
    polygon_delay_us: 20,
    point_time_us: 400,
};

pub fn capabilities() -> Capabilities {
    Capabilities {
        name: "bench slm".into(),
        layer_slots: 2,
        window_bytes: 4096,
        largest_frame_bytes: 1024,
        encodings: vec![Encoding::Vectors, Encoding::VectorsCoded],
        max_exposure_ms: MAX_MS,
        machine: MachineCapabilities::Powder(PowderCapabilities {
            field_um: FIELD_UM,
            max_power_mw: MAX_POWER_MW,
            layer_height_um: [20, 100],
            max_position_um: 50_000,
            buffer_bytes: BUFFER_BYTES,
        }),
    }
}

pub fn melt_settings() -> MeltSettings {
    let raster = Raster {
        width_px: 667,
        height_px: 334,
        pixel_um: [30.0; 2],
        build_height_um: 50_000.0,
        mirror: Mirror::default(),
    };
    MeltSettings { raster, beam_um: 60.0 }
}

/// A layer as it is sent.
#[derive(Clone)]
pub struct Sent {
    pub encoding: Encoding,
    pub bytes: Vec<u8>,
    pub crc32: u32,
    pub vectors: u32,
    pub marks: Vec<Mark>,
}

pub fn sent_with(vectors: &Vectors, encoding: Encoding, laser: LaserParameters) -> Sent {
    let mut bytes = Vec::new();
    let of_vectors = encoding.vectors().expect("of vectors");
    let sum = encode_vectors(vectors, of_vectors, FIELD_UM, &[laser; 6], &mut bytes).expect("fits the field");
    Sent { encoding, bytes, crc32: sum.crc32, vectors: sum.vectors, marks: vectors.marks().collect() }
}

pub fn sent(vectors: &Vectors) -> Sent {
    sent_with(vectors, Encoding::Vectors, LASER)
}

/// Rings beside each other: each of four vectors of 200 µm.
pub fn rings(count: i32) -> Vectors {
    let mut vectors = Vectors::default();
    for ring in 0..count {
        let (x, y) = (100 + ring % 40 * 450, 100 + ring / 40 * 450);
        let points = [[x, y], [x + 200, y], [x + 200, y + 200], [x, y + 200], [x, y]];
        vectors.push_path(MarkClass::Contour, &points);
    }
    vectors
}

pub fn mark(id: ExposureId, from_vector: u32, most_ms: u32) -> Request {
    Request::Powder(PowderRequest::Mark { id, from_vector, most_ms })
}

pub fn door() -> Option<Fault> {
    Some(Fault { code: 12, text: "the door is open".into() })
}

/// A laser machine with a host that keeps the credit.
pub struct Powder {
    bench: Bench,
    /// Bytes of layer data that the host sent in this session.
    pub sent_bytes: u32,
}

impl Deref for Powder {
    type Target = Bench;

    fn deref(&self) -> &Bench {
        &self.bench
    }
}

impl DerefMut for Powder {
    fn deref_mut(&mut self) -> &mut Bench {
        &mut self.bench
    }
}

impl Powder {
    /// A machine that was greeted.
    pub fn new() -> Self {
        Self::greeted(melt_settings())
    }

    fn greeted(settings: MeltSettings) -> Self {
        Self { bench: Bench::of(DeviceCore::new(capabilities(), 5).drawing(settings).telling_vectors()), sent_bytes: 0 }
    }

    /// A machine that is homed, with powder on its plate.
    pub fn ready() -> Self {
        Self::drawing(melt_settings())
    }

    /// The same, with another picture of what is melted.
    pub fn drawing(settings: MeltSettings) -> Self {
        let mut powder = Self::greeted(settings);
        powder.make_ready();
        powder
    }

    pub fn make_ready(&mut self) {
        let home = self.request(Request::Powder(PowderRequest::Home));
        self.advance(5_000_000);
        assert_eq!(self.reply(home), Some(Reply::Powder(PowderReply::Moved { position_um: 0 })));
        self.recoat();
    }

    pub fn recoat(&mut self) {
        let number = self.request(Request::Powder(PowderRequest::Recoat));
        self.advance(4_000_000);
        assert_eq!(self.reply(number), Some(Reply::Powder(PowderReply::Recoated)));
    }

    /// A new session: the counts of the buffer begin at 0.
    pub fn greet(&mut self) {
        self.hello();
        self.sent_bytes = 0;
        self.rooms.clear();
    }

    pub fn announce(&mut self, slot: u8, id: ExposureId, layer: &Sent) -> u32 {
        self.request(Request::LayerBegin {
            slot,
            id,
            encoding: layer.encoding,
            encoded_bytes: layer.bytes.len() as u32,
            decoded_crc32: layer.crc32,
        })
    }

    /// Bytes that the host may send now.
    pub fn credit_bytes(&self) -> u32 {
        let taken = self.rooms.last().copied().unwrap_or(0);
        BUFFER_BYTES - self.sent_bytes.wrapping_sub(taken)
    }

    /// Sends as much of `bytes` as there is credit for, at most so much in a message, and returns the rest.
    pub fn feed<'a>(&mut self, bytes: &'a [u8], piece_bytes: usize) -> &'a [u8] {
        let mut rest = bytes;
        loop {
            let count = rest.len().min(self.credit_bytes() as usize).min(piece_bytes);
            if count == 0 {
                return rest;
            }
            let (piece, after) = rest.split_at(count);
            self.sent_bytes += count as u32;
            self.message(HostMessage::LayerData(piece.to_vec()));
            rest = after;
        }
    }

    /// Sends a layer that fits the buffer.
    pub fn load(&mut self, slot: u8, id: ExposureId, layer: &Sent) {
        let number = self.announce(slot, id, layer);
        assert!(self.feed(&layer.bytes, 100).is_empty(), "it fits");
        assert_eq!(self.reply(number), Some(Reply::Done));
    }

    /// Marks a layer of any size, as layer 0.
    pub fn mark_whole(&mut self, layer: &Sent) {
        self.announce(0, id(0), layer);
        let rest = self.feed(&layer.bytes, 1000);
        self.request(mark(id(0), 0, MAX_MS));
        self.stream(rest);
    }

    /// Advances in small steps until the laser has nothing to do.
    pub fn mark_to_its_end(&mut self) {
        self.stream(&[]);
    }

    /// The same, and after each step `bytes` are sent as there is credit. Returns those that were not sent.
    pub fn stream<'a>(&mut self, bytes: &'a [u8]) -> &'a [u8] {
        let mut rest = bytes;
        for _ in 0..200_000 {
            if self.core.exposure().is_none() {
                return rest;
            }
            self.advance(500);
            rest = self.feed(rest, 64);
        }
        panic!("marking does not end");
    }

    pub fn refused_with(&mut self, request: Request, refusal: Refusal, when: &str) {
        let number = self.request(request);
        assert_eq!(self.reply(number), Some(Reply::Refused(refusal)), "{when}: {request:?}");
    }

    /// The first vector not marked, of the layer that was cut short last.
    pub fn next_vector(&self) -> u32 {
        self.core.state().powder.expect("a powder machine").next_vector
    }
}
