//! Aborts that the device does not obey: they are repeated until it is dark.

use std::time::{Duration, Instant};

use layerd::link::message::Urgent;

use crate::peer::{Moment, Seen, Stage, Stray, side_by_side};
use crate::{Case, LONGEST_LIGHT_MS, Make, begin_stray, reason, stray};

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
