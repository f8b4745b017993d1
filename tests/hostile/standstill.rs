//! A host that stood still for a while: its clock blames no device.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use layerd::link::message::Request;

use crate::peer::{Moment, PATIENCE, Seen, Stage, side_by_side, soon};
use crate::support::signal;
use crate::{AT_LAYER_UM, Case, LAYER, LIFTED_UM, exposes, moves_to, sends};

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
