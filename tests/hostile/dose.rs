//! Devices that light a layer for another time than commanded, or say so.

use layerd::link::message::{Reply, Request, VatReply, VatRequest};
use serde_json::Value;

use crate::peer::{CLEAR_UM, EXPOSURE_MS, Moment, Script, Stage, side_by_side};
use crate::{Case, LAYER, reason};

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
