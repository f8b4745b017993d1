//! The firmware of the simulated DLP under virtual time: what it refuses, and when there is light.

#[path = "../device_common/mod.rs"]
mod device_common;
#[path = "../properties/mod.rs"]
mod properties;

mod any_host;
mod disturbances;
mod exposure;
mod layers;
mod plate;
mod refusals;
mod urgent;
mod vats;

use device_common::{Bench, id};
use layerd::link::message::{Fault, Refusal, Reply, Request, VatReply, VatRequest};

/// A device with layer 1 exposed, layer 2 in slot 0, and homed.
fn busy_bench() -> Bench {
    let mut bench = Bench::new();
    let home = bench.request(Request::Vat(VatRequest::Home));
    bench.advance(5_000_000);
    assert_eq!(bench.reply(home), Some(Reply::Vat(VatReply::Moved { position_um: 0 })));
    bench.upload(0, id(1));
    bench.expose(id(1), 100);
    bench.upload(0, id(2));
    bench
}

fn fault() -> Option<Fault> {
    Some(Fault { code: 9, text: "door open".into() })
}

fn refused_with(bench: &mut Bench, request: &Request, refusal: Refusal, when: &str) {
    let number = bench.request(*request);
    assert_eq!(bench.reply(number), Some(Reply::Refused(refusal)), "{when}: {request:?}");
}
