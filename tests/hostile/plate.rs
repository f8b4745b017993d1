//! Plates that go elsewhere or nowhere: they come clear of the resin, and nothing is exposed on the way.

use layerd::link::message::{Request, VatRequest};

use crate::peer::{
    CLEAR_UM, Entry, LAYER_UM, LIFT_UM, Moment, PATIENCE, Peer, Script, Seen, Stage, side_by_side, soon,
};
use crate::support::{Bench, Setup};
use crate::{AT_LAYER_UM, LIFTED_UM, reason};

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

/// Its plate is low, by its own word, and it says at once that it is clear of the resin.
#[test]
fn a_plate_that_is_raised_too_soon_by_the_hosts_clock_is_not_believed() {
    const SPEED_UM_S: u32 = 5_000;
    let mut bench = Bench::prepare(Setup { plate_speed_um_s: SPEED_UM_S, time_scale: 1, ..Setup::default() });
    bench.start_daemon();
    let mut is_low = true;
    // The firmware's plate is clear: it answers at once.
    let script: Script = Box::new(move |_, moment| match moment {
        Moment::Answers(Request::Vat(VatRequest::Move { .. }), _) => is_low = false,
        Moment::Tells(state) if is_low => state.position_um = Some(LIFT_UM),
        _ => {}
    });
    let _peer = Peer::start(&bench.path("device"), script);
    assert!(soon(PATIENCE, || bench.layerctl(&["raise"]).status.success()), "it moves");
    let log = || std::fs::read_to_string(bench.path("daemon.log")).expect("the log");
    assert!(soon(PATIENCE, || log().contains("after the order, which is too soon")), "{}", log());
    assert!(!log().contains("the plate is raised: it is at"), "{}", log());
}
