//! Devices that shine too long, lie about light and plate, do not answer or answer nonsense: the light is put off at once, the
//! plate comes clear of the resin, nothing is exposed twice, and every wait ends. And a host that stood still for a while.

mod abort;
mod answers;
mod dose;
mod light;
mod peer;
mod plate;
mod standstill;
#[path = "../support/mod.rs"]
mod support;

use layerd::link::message::{Reply, Request, VatRequest};
use serde_json::Value;

use peer::{Controls, LAYER_UM, LIFT_UM, Moment, Script, Stray};

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
