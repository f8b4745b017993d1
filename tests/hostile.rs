//! Devices that shine too long, lie about light and plate, do not answer or answer nonsense: the light is put off at once, the
//! plate comes clear of the resin, nothing is exposed twice, and every wait ends. And a host that stood still for a while.

mod hostile_peer;
mod support;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use hostile_peer::{
    CLEAR_UM, Controls, EXPOSURE_MS, Entry, LAYER_UM, LIFT_UM, Moment, PATIENCE, Script, Seen, Stage, Stray, honest,
    side_by_side, soon,
};
use layerd::link::message::{ExposureId, Reply, Request, Urgent, VatReply, VatRequest};
use serde_json::Value;
use support::signal;

/// The layer at which most devices begin to lie: one before it was printed well, and one comes after it.
const LAYER: u32 = 2;
/// Where the plate is while that layer is exposed.
const AT_LAYER_UM: i32 = (LAYER as i32 + 1) * LAYER_UM;
/// Where the lift before it ends.
const LIFTED_UM: i32 = AT_LAYER_UM - LAYER_UM + LIFT_UM;
/// Light may last its time, a round trip and half a second more; a busy machine and a line that comes back take the rest.
const LONGEST_LIGHT_MS: u64 = 6_000;

/// Makes a device.
type Make = fn() -> Script;
/// A device and its name.
type Case<T> = (&'static str, T);

fn reason(job: &Value) -> &str {
    job["reason"].as_str().unwrap_or_default()
}

fn exposes(request: &Request, layer: u32) -> bool {
    matches!(request, Request::Vat(VatRequest::Expose { id, .. }) if id.layer == layer)
}

fn sends(request: &Request, layer: u32) -> bool {
    matches!(request, Request::LayerBegin { id, .. } if id.layer == layer)
}

fn moves_to(request: &Request, to_um: i32) -> bool {
    matches!(request, Request::Vat(VatRequest::Move { position_um, .. }) if *position_um == to_um)
}

/// A light source that does not go off by itself: it takes `LAYER` for a layer of a minute.
fn shines_on(moment: &mut Moment<'_>) -> bool {
    match moment {
        Moment::Asked(Some(Request::Vat(VatRequest::Expose { id, duration_ms, .. }))) if id.layer == LAYER => {
            *duration_ms = 60_000;
            true
        }
        _ => false,
    }
}

/// Light beside every exposure, from the way down to the layer after `LAYER` on.
fn stray(outlasts: u32) -> Script {
    Box::new(move |controls, moment| begin_stray(outlasts, controls, &moment))
}

fn begin_stray(outlasts: u32, controls: &mut Controls, moment: &Moment<'_>) {
    if let Moment::Asked(Some(request)) = moment
        && moves_to(request, AT_LAYER_UM + LAYER_UM)
        && controls.once()
    {
        controls.stray = Some(Stray { outlasts });
    }
}

/// Changes the first answer to such a request.
fn answers(is: impl Fn(&Request) -> bool + Send + 'static, lie: fn(&mut Vec<(u32, Reply)>)) -> Script {
    Box::new(move |controls, moment| {
        if let Moment::Answers(request, answers) = moment
            && is(request)
            && controls.once()
        {
            lie(answers);
        }
    })
}

/// Carries out the first such request in another way, or not at all.
fn does(is: impl Fn(&Request) -> bool + Send + 'static, lie: fn(&mut Option<Request>)) -> Script {
    Box::new(move |controls, moment| {
        if let Moment::Asked(request) = moment
            && request.as_ref().is_some_and(&is)
            && controls.once()
        {
            lie(request);
        }
    })
}

#[test]
fn an_honest_device_is_never_told_to_be_dark() {
    let stage = Stage::with(honest());
    let job = stage.ended(stage.print());
    assert_eq!(job["state"], "completed", "{job}");
    stage.assert_each_layer_lit_once(&job);
    assert!(!stage.log().iter().any(|entry| matches!(entry.seen, Seen::Urgent(..))), "{}", stage.story());
    let told: Vec<_> = stage.layers().iter().map(|layer| layer.exposure_ms).collect();
    assert_eq!(told, vec![Some(EXPOSURE_MS); stage.lit_layers().len()]);
    assert_eq!(stage.plate_um(), Some(CLEAR_UM));
}

#[test]
fn light_that_nobody_commanded_is_put_off_and_the_job_interrupted() {
    let cases: [Case<Make>; 9] = [
        ("the light does not go off", || {
            Box::new(|_, mut moment| {
                shines_on(&mut moment);
            })
        }),
        ("the light goes on after its exposure has ended", || {
            Box::new(|controls, moment| {
                if let Moment::Answers(request, _) = moment
                    && exposes(request, LAYER)
                    && controls.once()
                {
                    controls.stray = Some(Stray::default());
                }
            })
        }),
        ("the line dies, and the exposure does not end", || {
            Box::new(|controls, mut moment| {
                if shines_on(&mut moment) {
                    controls.cut_line = Some((100, 400));
                }
            })
        }),
        ("the device restarts and comes back with light", || {
            Box::new(|controls, moment| {
                if let Moment::Answers(request, _) = moment
                    && exposes(request, LAYER)
                    && controls.once()
                {
                    (controls.restart, controls.stray) = (Some(2), Some(Stray::default()));
                }
            })
        }),
        ("the device says that it exposes another layer", || {
            Box::new(|_, moment| {
                if let Moment::Tells(state) = moment
                    && let Some(id) = state.exposing.as_mut().filter(|id| id.layer == LAYER)
                {
                    id.layer += 1;
                }
            })
        }),
        ("there is light while the plate moves", || stray(0)),
        ("the light outlasts three orders, and the device says so", || stray(3)),
        ("the device never answers an order", || {
            Box::new(|_, mut moment| {
                shines_on(&mut moment);
                if let Moment::Obeys(_, answer) = moment {
                    *answer = None;
                }
            })
        }),
        ("the device says that it is dark, and shines", || {
            Box::new(|controls, moment| {
                begin_stray(2, controls, &moment);
                if let Moment::Obeys(_, answer) = moment {
                    *answer = Some(false);
                }
            })
        }),
    ];
    side_by_side(&cases, |script| {
        let stage = Stage::with(script());
        let id = stage.print();
        stage.dark_order_ms(0);
        let job = stage.ended(id);
        assert_eq!(job["state"], "interrupted", "{job}");
        stage.assert_noticed(&["ordered to switch", "off"]);
        assert!(stage.longest_light_ms() < LONGEST_LIGHT_MS, "{}", stage.story());
        stage.assert_nothing_commanded_before_dark();
        assert_eq!(stage.plate_um(), Some(CLEAR_UM), "{}", stage.story());
        stage.complete(&job, "exposed");
    });
}

#[test]
fn light_in_a_device_without_a_job_is_put_off() {
    let cases: [(&str, u32); 2] = [("it goes off", 0), ("it outlasts three orders", 3)];
    side_by_side(&cases, |outlasts| {
        let outlasts = *outlasts;
        let mut stage = Stage::without_device();
        // First in the welcome.
        stage.connect(Box::new(move |controls, moment| {
            if let Moment::Tells(state) = moment
                && controls.once()
            {
                controls.stray = Some(Stray { outlasts });
                (state.light_on, state.exposing) = (true, Some(ExposureId::first_pass(77, 5)));
            }
        }));
        let dark = |stage: &Stage, times: usize| {
            let ends = || stage.lights_ms().iter().filter(|(_, until)| until.is_some()).count() == times;
            assert!(soon(PATIENCE, ends), "{}", stage.story());
        };
        dark(&stage, 1);
        stage.assert_noticed(&["ordered to switch", "off"]);
        // Then without any occasion, once the device has been asked after the first time.
        stage.wait_until_said_dark();
        let notices = stage.notices().len();
        stage.control(|controls| controls.stray = Some(Stray { outlasts }));
        dark(&stage, 2);
        assert!(soon(Duration::from_secs(5), || stage.notices().len() > notices), "{:?}", stage.notices());
        assert!(stage.longest_light_ms() < LONGEST_LIGHT_MS, "{}", stage.story());
    });
}

#[test]
fn no_job_begins_in_light_that_nothing_puts_off() {
    let stage = Stage::with(honest());
    stage.control(|controls| controls.stray = Some(Stray { outlasts: u32::MAX }));
    stage.dark_order_ms(0);
    let id = stage.print();
    stage.wait_until_seen("an order to be dark, time and again", 4, |seen| {
        matches!(seen, Seen::Urgent(_, Urgent::LightOff))
    });
    std::thread::sleep(Duration::from_millis(1500));
    let acts = |seen: &Seen| matches!(seen, Seen::Asked(Request::Vat(_)));
    assert!(!stage.log().iter().any(|entry| acts(&entry.seen)), "{}", stage.story());
    let job = stage.bench.job(id);
    assert!(job["state"] == "queued" && reason(&job).contains("waits for a dark device"), "{job}");
    stage.bench.ok(&["abort", &id.to_string()]);
    let job = stage.wait_for(id, &["aborted"]);
    assert!(!stage.log().iter().any(|entry| acts(&entry.seen)), "{job}\n{}", stage.story());
}

#[test]
fn light_that_stays_on_without_a_job_is_shown_as_long_as_it_lasts() {
    const WARNING: &str =
        "WARNING: the device does not switch its light off: switch the machine off at its mains and look";
    let stage = Stage::with(honest());
    stage.control(|controls| controls.stray = Some(Stray { outlasts: u32::MAX }));
    let order_ms = stage.dark_order_ms(0);
    assert!(stage.bench.json(&["status"])["stays_lit"].is_null(), "told at once");
    let id = stage.print();
    let warned = || stage.bench.json(&["status"])["stays_lit"] == WARNING;
    assert!(soon(PATIENCE, warned), "no warning\n{}", stage.story());
    let told_ms = stage.log().last().expect("a log").at_ms;
    assert!(told_ms >= order_ms + 4_900, "told {told_ms} ms, ordered {order_ms} ms");
    assert_eq!(stage.bench.json(&["device"])["stays_lit"], WARNING);
    for command in ["status", "device"] {
        let shown = stage.bench.ok(&[command]);
        assert!(shown.contains(WARNING), "{command}: {shown}");
    }
    let job = stage.bench.job(id);
    assert!(job["state"] == "queued" && reason(&job).contains(WARNING), "{job}");
    assert_eq!(stage.notices().iter().filter(|text| *text == WARNING).count(), 1, "{:?}", stage.notices());
    let log = std::fs::read_to_string(stage.bench.path("daemon.log")).expect("a log");
    assert_eq!(log.lines().filter(|line| line.contains("WARN") && line.contains(WARNING)).count(), 1, "{log}");
    // The device goes dark by itself: the warning goes, and the job begins.
    stage.control(|controls| controls.stray = Some(Stray::default()));
    assert!(soon(PATIENCE, || stage.bench.json(&["status"])["stays_lit"].is_null()), "{}", stage.story());
    stage.assert_noticed(&["reports that its light is off"]);
    assert!(!stage.bench.ok(&["device"]).contains("WARNING"));
    let job = stage.ended(id);
    assert_eq!(job["state"], "completed", "{job}\n{}", stage.story());
    stage.assert_each_layer_lit_once(&job);
}

#[test]
fn light_in_a_pause_is_put_off_and_the_job_can_go_on() {
    let stage = Stage::with(honest());
    let id = stage.print();
    stage.wait_until_seen("light", 1, |seen| matches!(seen, Seen::Lit(_)));
    stage.bench.ok(&["pause"]);
    stage.wait_for(id, &["paused"]);
    stage.control(|controls| controls.stray = Some(Stray { outlasts: 1 }));
    stage.dark_order_ms(0);
    stage.assert_goes_dark();
    stage.assert_noticed(&["ordered to switch", "off"]);
    assert!(stage.longest_light_ms() < LONGEST_LIGHT_MS, "{}", stage.story());
    stage.assert_nothing_commanded_before_dark();
    let job = stage.wait_for(id, &["paused", "interrupted"]);
    stage.complete(&job, "exposed");
}

#[test]
fn light_that_a_killed_daemon_left_behind_is_put_off() {
    let mut stage = Stage::with(Box::new(|_, mut moment| {
        shines_on(&mut moment);
    }));
    let id = stage.print();
    stage.wait_until_seen("light", 1, |seen| *seen == Seen::Lit(LAYER));
    stage.restart_daemon();
    stage.assert_goes_dark();
    stage.assert_noticed(&["ordered to switch", "off"]);
    // The time without a daemon is nobody's fault.
    assert!(stage.longest_light_ms() < 2 * LONGEST_LIGHT_MS, "{}", stage.story());
    let job = stage.wait_for(id, &["interrupted"]);
    let resumed = stage.bench.layerctl(&["resume", &id.to_string()]);
    let job = if resumed.status.success() { stage.ended(id) } else { job };
    assert_eq!((&job["state"], &job["in_doubt"]), (&"interrupted".into(), &LAYER.into()), "{job}");
    stage.complete(&stage.bench.job(id), "exposed");
}

#[test]
fn a_daemon_that_ends_leaves_no_light_behind() {
    let mut stage = Stage::with(Box::new(|_, mut moment| {
        shines_on(&mut moment);
    }));
    stage.print();
    stage.wait_until_seen("light", 1, |seen| *seen == Seen::Lit(LAYER));
    assert_eq!(stage.bench.terminate_daemon(), Some(0), "{}", stage.story());
    assert!(stage.longest_light_ms() < LONGEST_LIGHT_MS, "{}", stage.story());
    assert_eq!(stage.plate_um(), Some(CLEAR_UM), "{}", stage.story());
}

#[test]
fn an_abort_is_repeated_until_it_is_dark() {
    let cases: [Case<(Make, &[&str])>; 2] = [
        ("the light outlasts two orders", (|| stray(2), &["aborted"])),
        ("the device never answers an order", {
            let make: Make = || {
                Box::new(|controls, moment| {
                    begin_stray(0, controls, &moment);
                    if let Moment::Obeys(_, answer) = moment {
                        *answer = None;
                    }
                })
            };
            // Its end comes later; what matters, the light, goes off now.
            (make, &["aborting", "aborted"])
        }),
    ];
    side_by_side(&cases, |(script, states)| {
        let stage = Stage::with(script());
        let id = stage.print();
        stage.wait_until_seen("light beside an exposure", 1, |seen| *seen == Seen::Lied);
        // The daemon may be faster and end the job by itself; then it is aborted afterwards.
        stage.bench.ok(&["abort", &id.to_string()]);
        let ordered = Instant::now();
        let job = stage.wait_for(id, states);
        assert!(ordered.elapsed() < Duration::from_secs(8), "watchers are told at once");
        stage.assert_goes_dark();
        let lit = stage.after_lie(|seen| matches!(seen, Seen::Lit(_)));
        assert_eq!(lit, None, "{job}\n{}", stage.story());
    });
}

/// It goes dark only with its third session, and answers no abort in any.
#[test]
fn an_abort_that_is_neither_obeyed_nor_answered_goes_again_in_the_next_session() {
    let mut aborts = 0;
    let stage = Stage::with(Box::new(move |controls, moment| match moment {
        // A light-off does nothing.
        Moment::Obeys(urgent, answer) if controls.lied => {
            if urgent == Urgent::Abort {
                aborts += 1;
                *answer = None;
            }
            controls.stray = (aborts < 3).then_some(Stray { outlasts: 2 });
        }
        moment => begin_stray(2, controls, &moment),
    }));
    let id = stage.print();
    stage.wait_until_seen("light beside an exposure", 1, |seen| *seen == Seen::Lied);
    stage.bench.ok(&["abort", &id.to_string()]);
    stage.assert_goes_dark();
    assert!(stage.longest_light_ms() < LONGEST_LIGHT_MS, "{}", stage.story());
    let aborts = stage.log().iter().filter(|entry| matches!(entry.seen, Seen::Urgent(_, Urgent::Abort))).count();
    assert!(aborts >= 3, "{aborts} aborts\n{}", stage.story());
    let job = stage.wait_for(id, &["aborted"]);
    assert!(reason(&job).contains("switch the machine off at its mains"), "{job}");
    assert_eq!(stage.after_lie(|seen| matches!(seen, Seen::Lit(_))), None, "{job}\n{}", stage.story());
}

/// A device that lights `LAYER` well and says another time.
fn says_it_shone(told_ms: u32) -> Script {
    Box::new(move |controls, moment| {
        if let Moment::Answers(_, answers) = moment
            && let [(_, Reply::Vat(VatReply::Exposed { id, duration_ms }))] = &mut answers[..]
            && id.layer == LAYER
            && controls.once()
        {
            *duration_ms = told_ms;
        }
    })
}

/// Judges how a job ended whose device reported that many milliseconds.
type Judge = fn(&Stage, &Value, u32);

#[test]
fn the_time_with_light_is_compared_with_the_commanded_one() {
    let cases: [Case<(u32, Judge)>; 7] = [
        ("none", (0, is_in_doubt)),
        ("a tenth", (EXPOSURE_MS / 10, is_in_doubt)),
        ("not quite enough", (EXPOSURE_MS - 25, is_in_doubt)),
        ("within the tolerance, less", (EXPOSURE_MS - 15, is_right)),
        ("within the tolerance, more", (EXPOSURE_MS + 15, is_right)),
        ("a little too much", (EXPOSURE_MS + 25, is_too_much)),
        ("ten times", (EXPOSURE_MS * 10, is_too_much)),
    ];
    side_by_side(&cases, |(told_ms, judge)| {
        let stage = Stage::with(says_it_shone(*told_ms));
        let job = stage.ended(stage.print());
        judge(&stage, &job, *told_ms);
        assert_eq!(stage.plate_um(), Some(CLEAR_UM), "{}", stage.story());
    });
}

/// It gives a layer a third of its light and reports the whole.
#[test]
fn a_layer_that_ends_too_soon_by_the_hosts_clock_is_in_doubt() {
    let stage = Stage::with(Box::new(|controls, moment| match moment {
        Moment::Asked(Some(Request::Vat(VatRequest::Expose { id, duration_ms, .. })))
            if id.layer == LAYER && controls.once() =>
        {
            *duration_ms /= 3;
        }
        Moment::Answers(_, answers) => {
            if let [(_, Reply::Vat(VatReply::Exposed { duration_ms, .. }))] = &mut answers[..] {
                *duration_ms = EXPOSURE_MS;
            }
        }
        _ => {}
    }));
    let job = stage.ended(stage.print());
    assert_eq!((&job["state"], &job["in_doubt"]), (&"interrupted".into(), &LAYER.into()), "{job}");
    assert!(reason(&job).contains("have passed since the order"), "{job}");
    assert_eq!(stage.plate_um(), Some(CLEAR_UM), "{}", stage.story());
    stage.complete(&job, "exposed");
}

fn is_in_doubt(stage: &Stage, job: &Value, told_ms: u32) {
    assert_eq!((&job["state"], &job["in_doubt"]), (&"interrupted".into(), &LAYER.into()), "{job}");
    assert!(reason(job).contains(&format!("{told_ms} ms")) && reason(job).contains("300 ms"), "{job}");
    assert_eq!(job["layers_done"], LAYER, "{job}");
    assert!(stage.layers().iter().all(|told| told.layer < LAYER), "{:?}", stage.layers());
    let refused = stage.bench.layerctl(&["resume"]);
    assert!(!refused.status.success(), "a layer in doubt takes a word");
    assert_eq!(stage.plate_um(), Some(CLEAR_UM), "{}", stage.story());
    stage.complete(job, "exposed");
}

fn is_right(stage: &Stage, job: &Value, told_ms: u32) {
    assert_eq!(job["state"], "completed", "{job}");
    let told: Vec<_> = stage.layers().iter().map(|told| told.exposure_ms).collect();
    assert_eq!(told[LAYER as usize..][..2], [Some(told_ms), Some(EXPOSURE_MS)], "{told:?}");
}

fn is_too_much(stage: &Stage, job: &Value, told_ms: u32) {
    assert_eq!((&job["state"], &job["in_doubt"]), (&"interrupted".into(), &Value::Null), "{job}");
    assert!(reason(job).contains(&format!("{told_ms} ms")) && reason(job).contains("300 ms"), "{job}");
    assert_eq!(job["layers_done"], LAYER + 1, "{job}");
    let told: Vec<_> = stage.layers().iter().map(|told| (told.layer, told.exposure_ms)).collect();
    assert_eq!(told.last(), Some(&(LAYER, Some(told_ms))), "{told:?}");
    assert_eq!(stage.plate_um(), Some(CLEAR_UM), "{}", stage.story());
    stage.complete(job, "no doubt");
}

/// A device that is asked for the plate at `wanted_um` and takes it to `found_um` once.
fn goes_astray(wanted_um: i32, found_um: i32) -> Script {
    Box::new(move |controls, moment| {
        if let Moment::Asked(Some(Request::Vat(VatRequest::Move { position_um, .. }))) = moment
            && *position_um == wanted_um
            && controls.once()
        {
            *position_um = found_um;
        }
    })
}

#[test]
fn a_plate_that_went_elsewhere_is_lifted_and_the_job_can_go_on() {
    let cases = [
        ("an approach too high", (AT_LAYER_UM, AT_LAYER_UM + LAYER_UM * 3 / 4)),
        ("an approach too low", (AT_LAYER_UM, AT_LAYER_UM - LAYER_UM * 3 / 4)),
        ("a lift", (LIFTED_UM, LIFTED_UM - LIFT_UM / 2)),
    ];
    side_by_side(&cases, |(wanted_um, found_um)| {
        let stage = Stage::with(goes_astray(*wanted_um, *found_um));
        let job = stage.ended(stage.print());
        assert_eq!(job["state"], "interrupted", "{job}\n{}", stage.story());
        for height_um in [wanted_um, found_um] {
            assert!(reason(&job).contains(&format!("{:.3} mm", f64::from(*height_um) / 1000.0)), "{job}");
        }
        assert_eq!(stage.plate_um(), Some(CLEAR_UM), "{}", stage.story());
        stage.complete(&job, "no doubt");
    });
}

#[test]
fn a_plate_that_did_not_come_clear_is_told_and_the_job_can_go_on() {
    side_by_side(&[("at the end", false), ("in a pause", true)], |pauses| {
        let found_um = CLEAR_UM - 5_000;
        let stage = Stage::with(goes_astray(CLEAR_UM, found_um));
        let id = stage.print();
        if *pauses {
            stage.wait_until_seen("light", 1, |seen| matches!(seen, Seen::Lit(_)));
            stage.bench.ok(&["pause"]);
        }
        let job = stage.ended(id);
        assert_eq!(job["state"], "interrupted", "{job}");
        // Perhaps it was tried once more; if not, the operator must know.
        let is_clear = stage.plate_um() == Some(CLEAR_UM);
        assert!(is_clear || reason(&job).contains("not lifted"), "{job}");
        assert!(reason(&job).contains(&format!("{:.3} mm", f64::from(found_um) / 1000.0)), "{job}");
        stage.complete(&job, "no doubt");
        assert_eq!(stage.plate_um(), Some(CLEAR_UM), "{}", stage.story());
    });
}

#[test]
fn a_plate_that_never_moves_again_ends_the_job() {
    let stage = Stage::with(Box::new(|controls, moment| {
        if let Moment::Asked(Some(Request::Vat(VatRequest::Move { position_um, .. }))) = moment {
            if *position_um == LIFTED_UM {
                controls.once();
            }
            if controls.lied {
                *position_um = AT_LAYER_UM - LAYER_UM;
            }
        }
    }));
    let job = stage.ended(stage.print());
    assert_eq!(job["state"], "interrupted", "{job}\n{}", stage.story());
    assert!(reason(&job).contains("not lifted"), "{job}");
    let moves = |entry: &&Entry| matches!(entry.seen, Seen::Asked(Request::Vat(VatRequest::Move { .. })));
    let in_vain = stage.log().iter().skip_while(|entry| entry.seen != Seen::Lied).filter(moves).count();
    assert!(in_vain <= 5, "{in_vain} moves in vain\n{}", stage.story());
    assert_eq!(stage.after_lie(|seen| matches!(seen, Seen::Lit(_))), None, "{}", stage.story());
}

/// What becomes of a print.
enum End {
    /// It goes on in a new session.
    Completed,
    /// The operator decides on `LAYER`, which had its light.
    InDoubt,
    /// The device has failed to answer once too often.
    GivenUp,
}

#[test]
fn every_wait_for_an_answer_ends() {
    let cases: [Case<(Make, End, &str)>; 8] = [
        ("a move's", {
            (|| answers(|request| moves_to(request, AT_LAYER_UM), Vec::clear), End::Completed, "arrived at 0.600 mm")
        }),
        ("a layer's", {
            (|| answers(|request| sends(request, LAYER + 1), Vec::clear), End::Completed, "whether it holds layer 3")
        }),
        ("a layer that goes nowhere", {
            let make: Make = || does(|request| sends(request, LAYER), |taken| *taken = None);
            (make, End::Completed, "whether it holds layer 2")
        }),
        ("a state's", (creeps_and_is_silent, End::Completed, "did not answer")),
        ("an exposure that never begins", {
            let make: Make = || does(|request| exposes(request, LAYER), |taken| *taken = None);
            (make, End::Completed, "the end of layer 2's exposure")
        }),
        ("an exposure's", {
            let make: Make = || answers(|request| exposes(request, LAYER), Vec::clear);
            (make, End::Completed, "the end of layer 2's exposure")
        }),
        ("an exposure that is never spoken of", (forgets_its_light, End::InDoubt, "the end of layer 2's exposure")),
        ("everything but moves and light", (answers_little, End::GivenUp, "did not answer")),
    ];
    side_by_side(&cases, |(script, end, words)| {
        let stage = Stage::with(script());
        let job = stage.ended(stage.print());
        stage.assert_noticed(&["the device", words]);
        let told = stage.notices().join("\n");
        assert!(!told.contains("still has light") && !told.contains("plate did not arrive"), "not what it is: {told}");
        match end {
            End::Completed => {
                assert_eq!(job["state"], "completed", "{job}");
                stage.assert_each_layer_lit_once(&job);
            }
            End::InDoubt => {
                assert_eq!((&job["state"], &job["in_doubt"]), (&"interrupted".into(), &LAYER.into()), "{job}");
                stage.dark_order_ms(0);
                assert_eq!(stage.plate_um(), Some(CLEAR_UM), "{}", stage.story());
                stage.complete(&job, "exposed");
            }
            End::GivenUp => {
                assert_eq!(job["state"], "interrupted", "{job}");
                assert!(reason(&job).contains(words), "{job}");
                assert_eq!(stage.plate_um(), Some(CLEAR_UM), "{}", stage.story());
            }
        }
    });
}

/// Exposes `LAYER`, and neither answers nor names it as exposed.
fn forgets_its_light() -> Script {
    Box::new(|controls, moment| match moment {
        Moment::Answers(request, answers) if exposes(request, LAYER) && controls.once() => answers.clear(),
        Moment::Tells(state) => {
            if let Some(id) = state.last_exposed.as_mut().filter(|id| id.layer == LAYER) {
                id.layer -= 1;
            }
        }
        _ => {}
    })
}

/// Takes long to go down to `LAYER`, and does not answer the first question on the way.
fn creeps_and_is_silent() -> Script {
    let mut silent = false;
    Box::new(move |controls, moment| match moment {
        Moment::Asked(Some(Request::Vat(VatRequest::Move { position_um: AT_LAYER_UM, speed_um_s })))
            if controls.once() =>
        {
            *speed_um_s = 400;
            silent = true;
        }
        Moment::Answers(Request::State, answers) if std::mem::take(&mut silent) => answers.clear(),
        _ => {}
    })
}

/// Once a layer has had light, neither says its state nor whether it has another layer.
fn answers_little() -> Script {
    Box::new(|controls, moment| match moment {
        Moment::Answers(request, _) if exposes(request, LAYER) => controls.lied = true,
        Moment::Answers(Request::State | Request::LayerBegin { .. }, answers) if controls.lied => answers.clear(),
        Moment::Tells(state) if controls.lied => state.slots.fill(None),
        _ => {}
    })
}

#[test]
fn an_answer_that_makes_no_sense_ends_the_session_and_the_print_goes_on() {
    fn exposes_it(request: &Request) -> bool {
        exposes(request, LAYER)
    }
    let cases: [Case<Make>; 9] = [
        ("a wrong number", || answers(exposes_it, |answers| answers[0].0 += 1000)),
        ("another kind", || {
            answers(exposes_it, |answers| answers[0].1 = Reply::Vat(VatReply::Moved { position_um: AT_LAYER_UM }))
        }),
        ("another layer", || {
            answers(exposes_it, |answers| {
                if let Reply::Vat(VatReply::Exposed { id, .. }) = &mut answers[0].1 {
                    id.layer += 1;
                }
            })
        }),
        ("twice", || answers(exposes_it, |answers| answers.push(answers[0].clone()))),
        ("no request", || answers(exposes_it, |answers| answers.push((4711, Reply::Done)))),
        ("no request, before the answer", || answers(exposes_it, |answers| answers.insert(0, (4711, Reply::Done)))),
        ("a state that is none", || {
            let mut armed = false;
            Box::new(move |controls, moment| match moment {
                Moment::Asked(Some(request)) => armed |= exposes_it(request),
                Moment::Answers(Request::State, answers) if armed && controls.once() => answers[0].1 = Reply::Done,
                _ => {}
            })
        }),
        ("a move that was a layer", || {
            answers(|request| moves_to(request, AT_LAYER_UM), |answers| answers[0].1 = Reply::Done)
        }),
        ("a layer that was a move", || {
            answers(
                |request| sends(request, LAYER),
                |answers| answers[0].1 = Reply::Vat(VatReply::Moved { position_um: 0 }),
            )
        }),
    ];
    side_by_side(&cases, |script| {
        let stage = Stage::with(script());
        let job = stage.ended(stage.print());
        assert_eq!((&job["state"], &job["in_doubt"]), (&"completed".into(), &Value::Null), "{job}");
        stage.assert_each_layer_lit_once(&job);
        let lied_ms = stage.after_lie(|seen| *seen == Seen::Lied).expect("itself").at_ms;
        let greeted_ms = stage.after_lie(|seen| *seen == Seen::Hello).expect("the job's end begins a session").at_ms;
        // At once: a request without answer would have taken longer.
        assert!(greeted_ms - lied_ms < 4_000, "{}", stage.story());
        let lit_ms = stage.after_lie(|seen| matches!(seen, Seen::Lit(_))).expect("it goes on").at_ms;
        assert!(greeted_ms <= lit_ms, "nothing is exposed in a session of nonsense\n{}", stage.story());
        stage.assert_noticed(&["repl"]);
    });
}

#[test]
fn a_device_without_a_job_is_held_to_its_answers_too() {
    let cases: [Case<Make>; 3] = [
        ("another kind", || answers(|request| *request == Request::State, |answers| answers[0].1 = Reply::Done)),
        ("twice", || answers(|request| *request == Request::State, |answers| answers.push(answers[0].clone()))),
        ("none", || answers(|request| *request == Request::State, Vec::clear)),
    ];
    side_by_side(&cases, |script| {
        let stage = Stage::with(script());
        let begins_anew = || stage.after_lie(|seen| *seen == Seen::Hello).is_some();
        stage.wait_until_seen("a question", 1, |seen| *seen == Seen::Lied);
        assert!(soon(PATIENCE, begins_anew), "{}", stage.story());
        stage.assert_noticed(&["device"]);
        let job = stage.ended(stage.print());
        assert_eq!(job["state"], "completed", "{job}");
    });
}

#[test]
fn a_device_that_answers_nothing_but_nonsense_ends_the_job() {
    let cases: [Case<Make>; 2] = [
        ("layers", || {
            Box::new(|controls, moment| match moment {
                Moment::Answers(request @ Request::LayerBegin { .. }, answers)
                    if controls.lied || sends(request, LAYER) =>
                {
                    controls.lied = true;
                    answers[0].1 = Reply::Vat(VatReply::Moved { position_um: 0 });
                }
                Moment::Tells(state) if controls.lied => state.slots.fill(None),
                _ => {}
            })
        }),
        ("states", || {
            Box::new(|controls, moment| match moment {
                Moment::Asked(Some(request)) if exposes(request, LAYER) => controls.lied = true,
                Moment::Answers(Request::State, answers) if controls.lied => answers[0].1 = Reply::Done,
                _ => {}
            })
        }),
    ];
    side_by_side(&cases, |script| {
        let stage = Stage::with(script());
        let job = stage.ended(stage.print());
        assert_eq!(job["state"], "interrupted", "{job}");
        assert!(reason(&job).contains("repl"), "{job}");
        let hellos = stage.log().iter().filter(|entry| entry.seen == Seen::Hello).count();
        assert!(hellos < 20, "{hellos} sessions\n{}", stage.story());
        assert_eq!(stage.longest_light_ms().min(LONGEST_LIGHT_MS), stage.longest_light_ms(), "{}", stage.story());
    });
}

#[test]
fn a_daemon_that_stood_still_blames_nobody() {
    type Is = fn(&Request) -> bool;
    let cases: [Case<(Is, u64)>; 7] = [
        ("on the way down", (|request| moves_to(request, AT_LAYER_UM), 1_500)),
        ("on the way down, for long", (|request| moves_to(request, AT_LAYER_UM), 4_000)),
        ("on the way up, for long", (|request| moves_to(request, LIFTED_UM), 4_000)),
        ("under light", (|request| exposes(request, LAYER), 1_500)),
        ("under light, for long", (|request| exposes(request, LAYER), 4_000)),
        ("with a layer on its way, for long", (|request| sends(request, LAYER), 4_000)),
        ("longer than any move", (|request| moves_to(request, AT_LAYER_UM), 17_000)),
    ];
    side_by_side(&cases, |(is, for_ms)| {
        let mut stage = Stage::without_device();
        let (pid, stopped) = (stage.bench.daemon_pid(), Arc::new(AtomicBool::new(false)));
        let (flag, is) = (Arc::clone(&stopped), *is);
        stage.connect(Box::new(move |controls, moment| {
            if let Moment::Asked(Some(request)) = moment
                && is(request)
                && controls.once()
            {
                signal(pid, "STOP");
                flag.store(true, Ordering::Relaxed);
            }
        }));
        let id = stage.print();
        assert!(soon(PATIENCE, || stopped.load(Ordering::Relaxed)), "{}", stage.story());
        std::thread::sleep(Duration::from_millis(*for_ms));
        signal(pid, "CONT");
        let job = stage.ended(id);
        assert_eq!(job["state"], "completed", "{job}\n{}", stage.story());
        stage.assert_each_layer_lit_once(&job);
        let told = stage.notices().join("\n");
        assert!(!told.contains("did not") && !told.contains("does not"), "{told}");
        assert!(!stage.log().iter().any(|entry| matches!(entry.seen, Seen::Urgent(..))), "{}", stage.story());
    });
}
