//! The model of a grbl controller behaves as the real firmwares do: one script for the model and, if there is one, a real controller. And
//! what the model does beyond: facts and faults.
//!
//! `LAYERD_GRBL11_PORT` and `LAYERD_GRBLHAL_PORT` name ports of controllers whose axes may move 12 mm each way. Their settings are changed.

mod facts;
#[path = "../grbl_model/mod.rs"]
mod grbl_model;
mod script;
#[path = "../skip/mod.rs"]
mod skip;

use std::path::Path;
use std::time::Duration;

use grbl_model::host::Host;
use grbl_model::{Firmware, GrblModel, Options};
use script::script;

const BOTH: [Firmware; 2] = [Firmware::Grbl11, Firmware::GrblHal];

/// Long enough for every answer that comes at once.
const SOON: Duration = Duration::from_millis(400);

/// A model and a host at its port.
fn bench(options: Options) -> (tempfile::TempDir, GrblModel, Host) {
    let directory = tempfile::tempdir().expect("a directory");
    let model = GrblModel::start(&directory.path().join("grbl"), options);
    let host = Host::open(model.port());
    (directory, model, host)
}

/// As `bench`, after the banner.
fn ready(options: Options) -> (tempfile::TempDir, GrblModel, Host) {
    let (directory, model, mut host) = bench(options);
    host.until("Grbl");
    (directory, model, host)
}

/// Resets, and unlocks if that is needed.
fn fresh(host: &mut Host) {
    host.send([0x18]);
    host.until("Grbl");
    assert_eq!(host.answer("$X"), "ok");
}

fn x_mm(report: &str) -> f64 {
    let place = Host::field(report, "MPos").unwrap_or_else(|| panic!("no MPos in {report}"));
    place.split(',').next().and_then(|x| x.parse().ok()).expect("a number")
}

#[test]
fn models_do_as_real_controllers_do() {
    std::thread::scope(|scope| {
        for firmware in BOTH {
            scope.spawn(move || {
                let (_directory, model, host) = bench(Options::new(firmware));
                drop(host);
                script(model.port(), firmware);
            });
        }
    });
}

#[test]
fn real_controllers_do_so_too() {
    for (variable, firmware) in [("LAYERD_GRBL11_PORT", Firmware::Grbl11), ("LAYERD_GRBLHAL_PORT", Firmware::GrblHal)] {
        match std::env::var_os(variable) {
            Some(port) => script(Path::new(&port), firmware),
            None => skip::skipped(&format!("no {variable} names a real controller")),
        }
    }
}
