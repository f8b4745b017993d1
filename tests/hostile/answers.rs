//! Devices that do not answer, or answer nonsense: every wait ends, and no session lasts on it.

use layerd::link::message::{Reply, Request, VatReply, VatRequest};
use serde_json::Value;

use crate::peer::{CLEAR_UM, Moment, PATIENCE, Script, Seen, Stage, side_by_side, soon};
use crate::{AT_LAYER_UM, Case, LAYER, LONGEST_LIGHT_MS, Make, answers, does, exposes, moves_to, reason, sends};

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
