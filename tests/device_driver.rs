//! The DLP driver: pairs replies by number, sends a layer while another shines, tells what the device refused.

mod device_common;

use std::path::Path;

use device_common::{Bench, capabilities, id, picture};
use layerd::config::{Machine, Recipe};
use layerd::device::encoding::{encode, picture_crc32};
use layerd::device::{
    Act, DriverBusy, DriverEvent, FramedDriver, Misfit, Outcome, Passes, VatAct, VatOutcome, check_capabilities,
    check_fit,
};
use layerd::job::{Action, Engine, Event, JobPlan, Limits, Process, StartPoint, VatPlan};
use layerd::link::message::{
    Capabilities, DeviceMessage, DeviceState, Encoding, ExposureId, Fault, HostMessage, MachineCapabilities, Refusal,
    Reply, Report, Request, VatCapabilities, VatReply, VatRequest,
};

fn driver() -> FramedDriver {
    FramedDriver::new(id(0).job, &capabilities().machine)
}

/// What the driver makes of a message that its owner must know of.
fn told(driver: &mut FramedDriver, message: DeviceMessage) -> DriverEvent {
    driver.handle(message).expect("an event")
}

fn encoded(layer: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode(&picture(layer), Encoding::Group4, &mut bytes).expect("bits");
    bytes
}

fn upload(driver: &mut FramedDriver, layer: u32, slot: u8) {
    let crc32 = picture_crc32(&picture(layer));
    driver.upload(layer, 0, slot, Encoding::Group4, encoded(layer), crc32).expect("no upload under way");
}

/// Sends all the driver has to the device and returns what came back.
fn exchange(driver: &mut FramedDriver, bench: &mut Bench) -> Vec<DriverEvent> {
    while let Some(message) = driver.next_message(13, 0) {
        bench.message(message);
    }
    answers(driver, bench)
}

fn answers(driver: &mut FramedDriver, bench: &mut Bench) -> Vec<DriverEvent> {
    let replies = std::mem::take(&mut bench.replies);
    replies.into_iter().map(|(number, reply)| told(driver, DeviceMessage::Reply { number, reply })).collect()
}

#[test]
fn the_next_layer_travels_while_one_shines() {
    let (mut driver, mut bench) = (driver(), Bench::new());
    upload(&mut driver, 0, 1);
    assert_eq!(exchange(&mut driver, &mut bench), [DriverEvent::Uploaded { layer: 0 }]);
    assert_eq!(bench.core.state().slots, [None, Some(id(0))], "in the slot that was named");
    upload(&mut driver, 1, 0);
    driver.act(Act::Vat(VatAct::Expose { layer: 0, pass: 0, duration_ms: 1000, light_pwm: 255 }), 0).expect("idle");
    assert_eq!(driver.upload(2, 0, 1, Encoding::Group4, vec![1], 0), Err(DriverBusy::UploadUnderWay));
    assert_eq!(driver.act(Act::Vat(VatAct::Home), 0), Err(DriverBusy::ActUnderWay));
    // The requests go before the data, although room is scarce.
    let requests: Vec<_> = std::iter::from_fn(|| driver.next_message(0, 0)).collect();
    assert!(
        matches!(
            requests.as_slice(),
            [
                HostMessage::Request { request: Request::Vat(VatRequest::Expose { .. }), .. },
                HostMessage::Request { request: Request::State, .. },
                HostMessage::Request { request: Request::LayerBegin { .. }, .. },
            ]
        ),
        "{requests:?}"
    );
    requests.into_iter().for_each(|request| bench.message(request));
    let events = exchange(&mut driver, &mut bench);
    assert!(
        matches!(
            events.as_slice(),
            [DriverEvent::StateKnown { act_taken: true, .. }, DriverEvent::Uploaded { layer: 1 }]
        ),
        "{events:?}"
    );
    bench.advance(1_000_000);
    let done = answers(&mut driver, &mut bench);
    assert_eq!(
        done,
        [DriverEvent::ActDone(Outcome::Vat(VatOutcome::Exposed { layer: 0, pass: 0, duration_ms: 1000 }))]
    );
    driver.act(Act::Vat(VatAct::Home), 0).expect("idle");
    exchange(&mut driver, &mut bench);
    bench.advance(60_000_000);
    assert_eq!(
        answers(&mut driver, &mut bench),
        [DriverEvent::ActDone(Outcome::Vat(VatOutcome::Arrived { position_um: 0 }))]
    );
}

#[test]
fn a_refused_layer_is_told_and_the_next_one_travels() {
    let (mut driver, mut bench) = (driver(), Bench::new());
    // A checksum that does not fit.
    driver.upload(0, 0, 0, Encoding::Group4, encoded(0), 1).expect("no upload under way");
    let refused = DriverEvent::UploadRefused { layer: 0, refusal: Refusal::BadLayer };
    assert_eq!(exchange(&mut driver, &mut bench), [refused]);
    // Refused at its beginning: none of its data follows.
    driver.upload(0, 0, 9, Encoding::Group4, encoded(0), 1).expect("the last one ended");
    bench.message(driver.next_message(0, 0).expect("its beginning"));
    assert!(matches!(answers(&mut driver, &mut bench).as_slice(), [DriverEvent::UploadRefused { layer: 0, .. }]));
    assert_eq!(driver.next_message(1000, 0), None);
    upload(&mut driver, 0, 0);
    assert_eq!(exchange(&mut driver, &mut bench), [DriverEvent::Uploaded { layer: 0 }]);
}

#[test]
fn a_layer_is_not_taken_for_uploaded_before_it_was_sent() {
    let mut driver = driver();
    upload(&mut driver, 0, 0);
    let Some(HostMessage::Request { number, .. }) = driver.next_message(0, 0) else { panic!("no request") };
    let early = told(&mut driver, DeviceMessage::Reply { number, reply: Reply::Done });
    assert!(
        matches!(&early, DriverEvent::Misbehaved(text) if text.contains("asked to take layer 0, pass 0")),
        "{early:?}"
    );
    // The session ends with that; the next one's driver begins anew.
    let mut driver = self::driver();
    upload(&mut driver, 0, 0);
    while driver.next_message(7, 0).is_some() {}
    let done = told(&mut driver, DeviceMessage::Reply { number, reply: Reply::Done });
    assert_eq!(done, DriverEvent::Uploaded { layer: 0 });
}

#[test]
fn news_and_strange_numbers_are_not_taken_for_answers() {
    let mut driver = driver();
    driver.act(Act::Vat(VatAct::Home), 0).expect("idle");
    let Some(HostMessage::Request { number, .. }) = driver.next_message(0, 0) else { panic!("no request") };
    let reply = |number, reply| DeviceMessage::Reply { number, reply };
    let fault = Some(Fault { code: 3, text: "door open".into() });
    let event = told(&mut driver, DeviceMessage::Report(Report::Fault(fault.clone())));
    assert_eq!(event, DriverEvent::Fault(fault));
    let strange = told(&mut driver, reply(number + 7, Reply::Vat(VatReply::Moved { position_um: 0 })));
    assert!(misbehaved(&strange, "request 8, which awaits no reply"), "{strange:?}");
    let other = told(&mut driver, reply(number, Reply::Done));
    assert!(misbehaved(&other, "asked to home (request 1) and replied with \"done\""), "{other:?}");
    assert!(driver.is_acting());
    let done = told(&mut driver, reply(number, Reply::Vat(VatReply::Moved { position_um: 0 })));
    assert_eq!(done, DriverEvent::ActDone(Outcome::Vat(VatOutcome::Arrived { position_um: 0 })));
    let again = told(&mut driver, reply(number, Reply::Vat(VatReply::Moved { position_um: 0 })));
    assert!(misbehaved(&again, "awaits no reply"), "a repeated reply answers nothing: {again:?}");
    driver.act(Act::Vat(VatAct::Expose { layer: 3, pass: 0, duration_ms: 10, light_pwm: 255 }), 0).expect("idle");
    let number = number + 2;
    let wrong = told(&mut driver, reply(number, Reply::Vat(VatReply::Exposed { id: id(4), duration_ms: 10 })));
    let job = format!("{:016x}", id(3).job);
    for words in [
        format!("asked to expose layer 3, pass 0, of job {job} for 10 ms (request 3)"),
        format!("replied with an exposure of 10 ms of layer 4, pass 0, of job {job}"),
    ] {
        assert!(misbehaved(&wrong, &words), "`{words}` is not in {wrong:?}");
    }
    let refused = told(&mut driver, reply(number + 1, Reply::Refused(Refusal::Busy)));
    assert!(
        misbehaved(&refused, "asked for its state (request 4) and replied with a refusal (reason 10)"),
        "{refused:?}"
    );
    let other_pass = ExposureId { pass: 1, ..id(3) };
    let wrong = told(&mut driver, reply(number, Reply::Vat(VatReply::Exposed { id: other_pass, duration_ms: 10 })));
    assert!(misbehaved(&wrong, "layer 3, pass 1"), "ids are compared whole: {wrong:?}");
}

fn misbehaved(event: &DriverEvent, words: &str) -> bool {
    matches!(event, DriverEvent::Misbehaved(text) if text.contains(words))
}

#[test]
fn a_question_without_an_answer_times_out() {
    let mut driver = driver();
    assert_eq!(driver.next_timeout_us(), None);
    driver.query_state(1_000_000);
    driver.query_state(2_000_000);
    assert_eq!(driver.next_timeout_us(), Some(6_000_000));
    assert_eq!(driver.handle_timeout(5_999_999), None);
    let late = driver.handle_timeout(6_000_000).expect("overdue");
    assert!(misbehaved(&late, "did not answer a question for its state within 5 s"), "{late:?}");
}

/// A host that stood still hears first what was said meanwhile.
#[test]
fn a_question_is_not_judged_by_a_host_that_stood_still() {
    let mut driver = driver();
    driver.query_state(0);
    assert_eq!(driver.handle_timeout(30_000_000), None);
    assert_eq!(driver.next_timeout_us(), Some(31_000_000));
    assert!(driver.handle_timeout(31_000_000).is_some(), "but once only");
}

#[test]
fn a_layer_that_is_never_confirmed_times_out() {
    let mut driver = driver();
    upload(&mut driver, 0, 0);
    while driver.next_message(7, 2_000_000).is_some() {}
    assert_eq!(driver.next_timeout_us(), Some(12_000_000));
    let late = driver.handle_timeout(12_000_000).expect("overdue");
    assert!(misbehaved(&late, "did not say within 10 s whether it holds layer 0"), "{late:?}");
}

#[test]
fn an_exposure_that_has_not_left_can_be_taken_back() {
    let expose = Act::Vat(VatAct::Expose { layer: 0, pass: 0, duration_ms: 10, light_pwm: 255 });
    let mut driver = driver();
    driver.act(expose, 0).expect("idle");
    assert!(driver.take_back_exposure(false), "it waits in the driver");
    assert!(!driver.is_acting());
    let next = driver.next_message(0, 0);
    assert!(matches!(next, Some(HostMessage::Request { request: Request::State, .. })), "{next:?}");
    driver.act(expose, 0).expect("idle");
    driver.next_message(0, 0).expect("the exposure leaves the driver");
    assert!(!driver.take_back_exposure(false) && driver.is_acting());
    assert!(driver.take_back_exposure(true), "its owner still holds it");
    driver.act(Act::Vat(VatAct::Home), 0).expect("idle");
    assert!(!driver.take_back_exposure(true), "no exposure");
}

#[test]
fn acts_and_their_requests_agree_on_what_is_an_exposure() {
    let acts = [
        (VatAct::Home, false),
        (VatAct::Move { position_um: 500, speed_um_s: 100 }, false),
        (VatAct::Expose { layer: 0, pass: 0, duration_ms: 10, light_pwm: 255 }, true),
    ];
    for (act, expected) in acts.map(|(act, expected)| (Act::Vat(act), expected)) {
        let mut driver = driver();
        driver.act(act, 0).expect("idle");
        let Some(HostMessage::Request { request, .. }) = driver.next_message(0, 0) else { panic!("no request") };
        assert_eq!((act.is_exposure(), request.is_exposure()), (expected, expected), "{act:?}");
        assert_eq!(driver.take_back_exposure(true), expected, "{act:?}");
    }
    let layer =
        Request::LayerBegin { slot: 0, id: id(0), encoding: Encoding::RawBit, encoded_bytes: 1, decoded_crc32: 0 };
    assert!(!layer.is_exposure() && !Request::State.is_exposure());
}

#[test]
fn a_new_sessions_driver_learns_of_an_exposure_that_goes_on() {
    let mut bench = Bench::new();
    bench.upload(0, id(4));
    bench.upload(1, id(5));
    bench.request(Request::Vat(VatRequest::Expose { id: id(4), duration_ms: 1000, light_pwm: 255 }));
    // What was said in the old session reaches nobody.
    bench.replies.clear();
    bench.hello();
    let mut driver = driver();
    let ask = |driver: &mut FramedDriver, bench: &mut Bench| {
        driver.query_state(0);
        match exchange(driver, bench).as_slice() {
            [DriverEvent::StateKnown { state, .. }] => (state.exposing, state.last_exposed),
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(ask(&mut driver, &mut bench), (Some(id(4)), None));
    bench.advance(1_000_000);
    assert_eq!(ask(&mut driver, &mut bench), (None, Some(id(4))));
}

fn machine() -> Machine {
    let text = "name = \"bench\"\nkind = \"dlp\"\nwidth_px = 70\nheight_px = 20\npixel_um = [40.0, 40.0]\n\
                build_height_um = 40000.0\nclear_height_um = 50000.0\n[link]\npath = \"x\"\nbaud = 115200\n";
    Machine::parse(Path::new("bench.toml"), text).expect("a machine")
}

fn recipe(exposure_ms: u32, antialias: bool) -> Recipe {
    let text = format!(
        "name = \"bench\"\nlayer_height_um = 100.0\nexposure_ms = 400\nbottom_exposure_ms = {exposure_ms}\nbottom_layers = 1\n\
         lift_height_um = 3000\nlift_speed_um_s = 20000\nretract_speed_um_s = 20000\nantialias = {antialias}\n"
    );
    Recipe::parse(Path::new("bench.toml"), &text).expect("a recipe")
}

#[test]
fn a_device_that_is_not_the_configured_machine_is_named() {
    let machine = machine();
    assert_eq!(check_capabilities(&machine, &capabilities()), Ok(()));
    let MachineCapabilities::Vat(vat) = capabilities().machine else { panic!("a vat") };
    let machine_of = |vat| Capabilities { machine: MachineCapabilities::Vat(vat), ..capabilities() };
    let wide = machine_of(VatCapabilities { width_px: 1920, ..vat.clone() });
    let message = check_capabilities(&machine, &wide).expect_err("too wide").to_string();
    assert!(message.contains("70 × 20 pixels") && message.contains("1920 × 20 pixels"), "{message}");
    let fine = machine_of(VatCapabilities { pixel_nm: [40_000, 35_000], ..vat });
    let message = check_capabilities(&machine, &fine).expect_err("too fine").to_string();
    assert!(message.contains("40 × 40 µm") && message.contains("40 × 35 µm"), "{message}");
}

#[test]
fn a_recipe_that_the_device_cannot_print_is_named_with_its_limit() {
    let (machine, mut device) = (machine(), capabilities());
    let choice = check_fit(&machine, &recipe(60_000, false), &device).expect("fits");
    assert_eq!((choice.encoding, choice.raw), (Encoding::Group4, Some(Encoding::RawBit)));
    let long = check_fit(&machine, &recipe(60_001, false), &device).expect_err("too long");
    assert!(matches!(long, Misfit::Exposure { longest_ms: 60_001, allowed_ms: 60_000, .. }), "{long}");
    assert!(long.to_string().contains("at most 60000 ms: shorten"), "{long}");
    let grey = check_fit(&machine, &recipe(400, true), &device).expect_err("no grey").to_string();
    assert!(grey.contains("grey layers") && grey.contains("antialias = false"), "{grey}");
    device.encodings = vec![Encoding::RawGrey];
    let bits = check_fit(&machine, &recipe(400, false), &device).expect_err("no bits").to_string();
    assert!(bits.contains("black and white layers") && bits.contains("antialias = true"), "{bits}");
    // Neither value of the setting helps.
    device.encodings.clear();
    for antialias in [false, true] {
        let none = check_fit(&machine, &recipe(400, antialias), &device).expect_err("reads nothing").to_string();
        assert!(none.contains("Update the device's firmware") && !none.contains("set `antialias"), "{none}");
    }
    device.encodings = vec![Encoding::RawGrey];
    device.layer_slots = 1;
    assert!(
        matches!(check_fit(&machine, &recipe(400, true), &device), Err(Misfit::Machine(_))),
        "the machine comes first"
    );
}

#[test]
fn each_refusal_of_a_layer_has_a_remedy_of_its_own() {
    let Recipe::Dlp(recipe) = recipe(400, false) else { panic!("a recipe for a vat machine") };
    let process = Process::Vat(VatPlan { recipe, clear_height_um: 20_000.0 });
    let plan = JobPlan { key: 7, passes: Passes::single(3), time_scale: 1.0, process };
    let state = DeviceState { slots: vec![None; 2], position_um: Some(30_000), ..DeviceState::default() };
    let cases = [
        (Refusal::BadLayer, "width_px"),
        (Refusal::BadEncoding, "encoding"),
        (Refusal::NotReady, "not ready"),
        (Refusal::NoSuchLayer, "slots"),
        (Refusal::Unknown, "protocol version"),
        (Refusal::NotHomed, "firmware"),
    ];
    for (refusal, words) in cases {
        let mut engine = Engine::new(plan.clone(), StartPoint::default());
        engine.handle(Event::Ready, 0);
        engine.handle(
            Event::Connected {
                state: state.clone(),
                limits: Limits { max_position_um: 100_000, max_exposure_ms: 120_000 },
            },
            0,
        );
        let mut refused = 0;
        while refused < 3 {
            match engine.next_action().expect("the layer is asked for again") {
                Action::Upload { exposure, .. } => {
                    engine.handle(Event::UploadRefused { exposure, refusal }, 0);
                    refused += 1;
                }
                Action::Journal(_) => engine.handle(Event::Journalled, 0),
                _ => {}
            }
        }
        let reason = engine.progress().reason;
        assert!(reason.contains("refused layer 0 3 times") && reason.contains(words), "{refusal:?}: {reason}");
        assert_eq!(reason.contains("width_px"), refusal == Refusal::BadLayer, "{refusal:?}: {reason}");
    }
}
