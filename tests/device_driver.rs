//! The DLP driver: pairs replies by number, fills slots while a layer shines, sends again what the device found damaged.

mod device_common;

use device_common::{Bench, capabilities, id, picture};
use layerd::device::encoding::{encode, picture_crc32};
use layerd::device::{Act, DlpDriver, DriverBusy, DriverEvent, Outcome, check_capabilities};
use layerd::link::message::{
    DeviceKind, DeviceMessage, DeviceState, Encoding, Fault, HostMessage, Refusal, Reply, Report, Request,
};

fn driver() -> DlpDriver {
    DlpDriver::new(id(0).job, &capabilities(), &DeviceState::default())
}

fn upload(driver: &mut DlpDriver, layer: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode(&picture(layer), Encoding::Group4, &mut bytes).expect("bits");
    driver.upload(layer, Encoding::Group4, bytes.clone(), picture_crc32(&picture(layer))).expect("a free slot");
    bytes
}

/// Sends all the driver has to the device and returns what came back.
fn exchange(driver: &mut DlpDriver, bench: &mut Bench) -> Vec<DriverEvent> {
    while let Some(message) = driver.next_message(13) {
        bench.message(message);
    }
    answers(driver, bench)
}

fn answers(driver: &mut DlpDriver, bench: &mut Bench) -> Vec<DriverEvent> {
    let replies = std::mem::take(&mut bench.replies);
    replies.into_iter().filter_map(|(number, reply)| driver.handle(DeviceMessage::Reply { number, reply })).collect()
}

#[test]
fn the_next_layer_travels_while_one_shines() {
    let (mut driver, mut bench) = (driver(), Bench::new());
    let bytes = upload(&mut driver, 0);
    assert_eq!(exchange(&mut driver, &mut bench), [DriverEvent::Uploaded { layer: 0, buffer: bytes }]);
    driver.act(Act::Expose { layer: 0, duration_ms: 1000, light_pwm: 255 }).expect("idle");
    let bytes = upload(&mut driver, 1);
    assert_eq!(driver.upload(2, Encoding::Group4, vec![1], 0), Err(DriverBusy::NoFreeSlot));
    // The exposure is asked for before the data, although room is scarce.
    assert!(
        matches!(driver.next_message(0), Some(HostMessage::Request { request: Request::Expose { .. }, number }) if {
            bench.message(HostMessage::Request { number, request: Request::Expose { id: id(0), duration_ms: 1000, light_pwm: 255 } });
            true
        })
    );
    assert_eq!(exchange(&mut driver, &mut bench), [DriverEvent::Uploaded { layer: 1, buffer: bytes }]);
    assert!(driver.holds(1) && !driver.holds(0) && driver.free_slots() == 0);
    assert_eq!(driver.act(Act::Home), Err(DriverBusy::ActUnderWay));
    bench.advance(1_000_000);
    let done = answers(&mut driver, &mut bench);
    assert_eq!(done, [DriverEvent::ActDone(Outcome::Exposed { layer: 0, duration_ms: 1000 })]);
    assert_eq!(driver.free_slots(), 1);
    driver.act(Act::Home).expect("idle");
    exchange(&mut driver, &mut bench);
    bench.advance(60_000_000);
    assert_eq!(answers(&mut driver, &mut bench), [DriverEvent::ActDone(Outcome::Arrived { position_um: 0 })]);
}

#[test]
fn a_layer_the_device_finds_damaged_is_sent_again_but_not_for_ever() {
    let (mut driver, mut bench) = (driver(), Bench::new());
    let bytes = upload(&mut driver, 0);
    // The first time a byte is damaged on its way.
    while let Some(message) = driver.next_message(1000) {
        bench.message(match message {
            HostMessage::LayerData(mut data) => {
                data[0] ^= 0x40;
                HostMessage::LayerData(data)
            }
            request => request,
        });
    }
    assert_eq!(answers(&mut driver, &mut bench), []);
    assert_eq!(exchange(&mut driver, &mut bench), [DriverEvent::Uploaded { layer: 0, buffer: bytes.clone() }]);
    // A checksum that never fits.
    driver.upload(1, Encoding::Group4, bytes, 1).expect("a free slot");
    let mut events = Vec::new();
    for _ in 0..3 {
        assert_eq!(events, []);
        events = exchange(&mut driver, &mut bench);
    }
    assert_eq!(events, [DriverEvent::UploadFailed { layer: 1, refusal: Refusal::BadLayer }]);
    assert_eq!(driver.next_message(1000), None);
    assert_eq!(driver.free_slots(), 1);
}

#[test]
fn news_and_strange_numbers_are_not_taken_for_answers() {
    let mut driver = driver();
    driver.act(Act::Home).expect("idle");
    let Some(HostMessage::Request { number, .. }) = driver.next_message(0) else { panic!("no request") };
    let reply = |number, reply| DeviceMessage::Reply { number, reply };
    let fault = Some(Fault { code: 3, text: "door open".into() });
    let event = driver.handle(DeviceMessage::Report(Report::Fault(fault.clone())));
    assert_eq!(event, Some(DriverEvent::Fault(fault)));
    let strange = driver.handle(reply(number + 7, Reply::Moved { position_um: 0 }));
    assert_eq!(strange, Some(DriverEvent::Confused { number: number + 7 }));
    let other = driver.handle(reply(number, Reply::Done));
    assert_eq!(other, Some(DriverEvent::Confused { number }));
    assert!(driver.is_acting());
    let done = driver.handle(reply(number, Reply::Moved { position_um: 0 }));
    assert_eq!(done, Some(DriverEvent::ActDone(Outcome::Arrived { position_um: 0 })));
    let again = driver.handle(reply(number, Reply::Moved { position_um: 0 }));
    assert_eq!(again, Some(DriverEvent::Confused { number }), "a repeated reply answers nothing");
}

#[test]
fn after_a_reconnect_the_driver_knows_what_the_device_holds() {
    let mut bench = Bench::new();
    bench.upload(0, id(4));
    bench.upload(1, id(5));
    bench.request(Request::Expose { id: id(4), duration_ms: 1000, light_pwm: 255 });
    // What was said in the old session reaches nobody.
    bench.replies.clear();
    let mut driver = DlpDriver::new(id(0).job, &capabilities(), &bench.hello());
    assert!(!driver.holds(4) && driver.holds(5) && driver.free_slots() == 0);
    let ask = |driver: &mut DlpDriver, bench: &mut Bench| {
        driver.query_state();
        match exchange(driver, bench).as_slice() {
            [DriverEvent::StateKnown(state)] => (state.exposing, state.last_exposed),
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(ask(&mut driver, &mut bench), (Some(id(4)), None));
    bench.advance(1_000_000);
    assert_eq!(ask(&mut driver, &mut bench), (None, Some(id(4))));
    assert!(driver.holds(5) && driver.free_slots() == 1);
    driver.forget(5);
    assert_eq!(driver.free_slots(), 2);
    // Another job's layers are of no use.
    let other = DlpDriver::new(1, &capabilities(), &bench.hello());
    assert_eq!(other.free_slots(), 2);
}

#[test]
fn a_device_that_is_not_the_configured_machine_is_named() {
    let text = "name = \"bench\"\nkind = \"dlp\"\nwidth_px = 70\nheight_px = 20\npixel_um = [40.0, 40.0]\n\
                build_height_um = 40000.0\nclear_height_um = 50000.0\n[link]\npath = \"x\"\nbaud = 115200\n";
    let file = tempfile::NamedTempFile::new().expect("a file");
    std::fs::write(file.path(), text).expect("written");
    let machine = layerd::config::Machine::load(file.path()).expect("a machine");
    assert_eq!(check_capabilities(&machine, &capabilities()), Ok(()));
    let mut wide = capabilities();
    wide.width_px = 1920;
    let message = check_capabilities(&machine, &wide).expect_err("too wide").to_string();
    assert!(message.contains("70 × 20 pixels") && message.contains("1920 × 20 pixels"), "{message}");
    let mut fine = capabilities();
    fine.pixel_nm[1] = 35_000;
    let message = check_capabilities(&machine, &fine).expect_err("too fine").to_string();
    assert!(message.contains("40 × 40 µm") && message.contains("40 × 35 µm"), "{message}");
    let mut laser = capabilities();
    laser.kind = DeviceKind::Slm;
    assert!(check_capabilities(&machine, &laser).expect_err("a laser").to_string().contains("says slm"));
}
