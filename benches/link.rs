//! The link's speed: the frame codec, and how busy a 3 Mbaud line with a window of 4 KiB is kept.
//!
//! `busy_line` moves 300,000 payload bytes to a device that reads at the pace of the line, on a pseudo-terminal. The line
//! carries 300 kB/s; frames take 3 % of it, so 291 kB/s of payload are a line that is busy all the time.

use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use divan::Bencher;
use divan::counter::BytesCount;
use layerd::link::driver::{LinkEvent, LinkHandle, link};
use layerd::link::message::{
    Capabilities, DeviceMessage, DeviceState, HostMessage, MachineCapabilities, Reply, Request, VatCapabilities, Vats,
};
use layerd::link::session::HostEvent;
use layerd::link::{FlowControl, LinkSettings, Protocol, SystemPorts};
use layerd_wire::session::{DeviceEvent, DeviceSession, DeviceSettings};
use layerd_wire::{FrameDecoder, FrameKind, encode_frame};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use tokio::sync::mpsc::Receiver;

const BAUD: u32 = 3_000_000;
const BYTES: usize = 300_000;
/// The longest that fits the device's frames of 601 bytes.
const PIECE_BYTES: usize = 583;

fn main() {
    divan::main();
}

#[divan::bench]
fn encode(bencher: Bencher<'_, '_>) {
    let payload = vec![0x5A_u8; 1000];
    bencher.counter(BytesCount::new(payload.len())).bench(|| encode_frame(FrameKind::Data, 1, 2, &payload));
}

#[divan::bench]
fn decode(bencher: Bencher<'_, '_>) {
    let frame = encode_frame(FrameKind::Data, 1, 2, &vec![0x5A_u8; 1000]);
    let mut decoder = FrameDecoder::new(1024);
    bencher.counter(BytesCount::new(1000_usize)).bench_local(|| decoder.next_frame(&mut &frame[..]));
}

#[divan::bench(sample_count = 5, sample_size = 1)]
fn busy_line(bencher: Bencher<'_, '_>) {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).expect("a pseudo-terminal");
    grantpt(&master).expect("granted");
    unlockpt(&master).expect("unlocked");
    let name = ptsname(&master, Vec::new()).expect("a name");
    let path = PathBuf::from(name.to_str().expect("ASCII"));
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().expect("runtime");
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| device(&master, &stop));
        let settings = LinkSettings { path, baud: BAUD, flow_control: FlowControl::None, protocol: Protocol::Layerd };
        let (handle, mut events, driver) = link(settings, None, Arc::new(SystemPorts));
        runtime.spawn(driver.run());
        let session_id = runtime.block_on(connected(&mut events));
        let mut number = 0;
        bencher.counter(BytesCount::new(BYTES)).bench_local(|| {
            number += 1;
            runtime.block_on(transfer(&handle, &mut events, session_id, number));
        });
        let statistics = handle.statistics();
        eprintln!("retransmitted {} of {} frames", statistics.retransmitted_frames, statistics.frames_sent);
        stop.store(true, Ordering::Relaxed);
    });
}

async fn connected(events: &mut Receiver<LinkEvent>) -> u32 {
    loop {
        if let LinkEvent::Session(HostEvent::Connected { session_id, .. }) = events.recv().await.expect("runs") {
            return session_id;
        }
    }
}

/// Sends the bytes and a request behind them; done when that is answered.
async fn transfer(handle: &LinkHandle, events: &mut Receiver<LinkEvent>, session_id: u32, number: u32) {
    for _ in 0..BYTES.div_ceil(PIECE_BYTES) {
        handle.room().await;
        handle.try_send(session_id, HostMessage::LayerData(vec![0xA5; PIECE_BYTES])).expect("runs");
    }
    handle.room().await;
    handle.try_send(session_id, HostMessage::Request { number, request: Request::State }).expect("runs");
    loop {
        match events.recv().await.expect("runs") {
            LinkEvent::Session(HostEvent::Message(DeviceMessage::Reply { number: answered, .. }))
                if answered == number =>
            {
                return;
            }
            LinkEvent::Session(_) => {}
            other => panic!("unexpected {other:?}"),
        }
    }
}

/// Reads what the line would have carried since the last look. Finding less than that means that the line ran dry: the rest
/// of the time is lost.
fn device(master: &OwnedFd, stop: &AtomicBool) {
    let capabilities = Capabilities {
        name: "bench".into(),
        layer_slots: 2,
        window_bytes: 4096,
        largest_frame_bytes: 601,
        encodings: Vec::new(),
        max_exposure_ms: 1,
        machine: MachineCapabilities::Vat(VatCapabilities {
            width_px: 16,
            height_px: 16,
            pixel_nm: [50_000; 2],
            max_position_um: 1,
            vats: Vats::ONE,
        }),
    };
    rustix::io::ioctl_fionbio(master, true).expect("non-blocking");
    let start = Instant::now();
    let now_us = || u64::try_from(start.elapsed().as_micros()).expect("short");
    let mut session = DeviceSession::new(capabilities, DeviceSettings { baud: BAUD, escaped: false }, 0);
    let (mut buffer, mut budget, mut last_us) = ([0_u8; 4096], 0_usize, 0);
    while !stop.load(Ordering::Relaxed) {
        let elapsed_us = now_us() - last_us;
        let carried = usize::try_from(elapsed_us).expect("short") * 3 / 10;
        last_us += (carried * 10 / 3) as u64;
        budget = (budget + carried).min(buffer.len());
        if budget > 0 {
            let count = rustix::io::read(master, &mut buffer[..budget]).unwrap_or(0);
            budget = 0;
            session.receive(&buffer[..count], now_us());
        }
        session.handle_timeout(now_us());
        while let Some(event) = session.event() {
            match event {
                DeviceEvent::Hello { .. } => session.welcome(&DeviceState::default(), now_us()),
                DeviceEvent::Message(HostMessage::Request { number, .. }) => {
                    session.send(&DeviceMessage::Reply { number, reply: Reply::Done }).expect("room");
                }
                _ => {}
            }
        }
        while let Some(frame) = session.transmit(now_us()) {
            rustix::io::write(master, &frame).expect("the terminal takes a frame");
        }
        std::thread::sleep(Duration::from_micros(200));
    }
}
