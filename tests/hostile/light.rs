//! Light that nobody commanded: it is put off at once, with or without a job.

use std::time::Duration;

use layerd::link::message::{ExposureId, Request, Urgent};

use crate::peer::{CLEAR_UM, EXPOSURE_MS, Moment, PATIENCE, Seen, Stage, Stray, honest, side_by_side, soon};
use crate::{Case, LAYER, LONGEST_LIGHT_MS, Make, begin_stray, exposes, reason, shines_on, stray};

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
        stage.assert_noticed(&["told to switch", "off"]);
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
        stage.assert_noticed(&["told to switch", "off"]);
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
    stage.assert_noticed(&["told to switch", "off"]);
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
    stage.assert_noticed(&["told to switch", "off"]);
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
