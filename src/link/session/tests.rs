//! Tests that need private parts: sequence numbers that wrap around.

use super::{DeviceEvent, DeviceSession, DeviceSettings, HostEvent, HostSession, HostSettings};
use crate::link::message::{Capabilities, DeviceState, HostMessage, MachineCapabilities, VatCapabilities};

#[test]
fn sequences_wrap_around() {
    let capabilities = Capabilities {
        name: "test".into(),
        layer_slots: 2,
        window_bytes: 256,
        largest_frame_bytes: 64,
        encodings: Vec::new(),
        max_exposure_ms: 1,
        machine: MachineCapabilities::Vat(VatCapabilities {
            width_px: 16,
            height_px: 16,
            pixel_nm: [50_000; 2],
            max_position_um: 1,
        }),
    };
    let first = u32::MAX - 20;
    let mut host = HostSession::new(7, HostSettings { baud: 115_200, escaped: false }, 0).starting_at(first);
    let mut device =
        DeviceSession::new(capabilities, DeviceSettings { baud: 115_200, escaped: false }, 0).starting_at(first);
    let (mut sent, mut received) = (0_u32, Vec::new());
    for now_us in (0..3_000_000).step_by(1_000) {
        while host.is_connected() && sent < 60 && host.send(&HostMessage::LayerData(sent.to_le_bytes().into())).is_ok()
        {
            sent += 1;
        }
        // Every seventh frame is lost, so that gaps and time-outs straddle the wrap-around.
        while let Some(frame) = host.transmit(now_us) {
            if host.statistics().frames_sent % 7 != 3 {
                device.receive(&frame, now_us);
            }
        }
        while let Some(event) = device.event() {
            match event {
                DeviceEvent::Hello { .. } => device.welcome(&DeviceState::default(), now_us),
                DeviceEvent::Message(HostMessage::LayerData(bytes)) => received.push(bytes),
                other => panic!("unexpected {other:?}"),
            }
        }
        while let Some(frame) = device.transmit(now_us) {
            host.receive(&frame, now_us);
        }
        while let Some(event) = host.event() {
            assert!(matches!(event, HostEvent::Connected { .. }), "unexpected {event:?}");
        }
        host.handle_timeout(now_us);
        device.handle_timeout(now_us);
    }
    let expected: Vec<Vec<u8>> = (0..60_u32).map(|index| index.to_le_bytes().into()).collect();
    assert_eq!(received, expected);
}
