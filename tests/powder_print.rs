//! Whole prints on a laser machine through the real processes: simulated device, daemon, command.

mod meshes;
mod support;

use std::time::Duration;

use layerd::config::{Machine, Recipe};
use layerd::device::encoding::BEST_VECTORS;
use layerd::layer::Bitmap;
use layerd::pipeline::{Placed, Resolution};
use layerd::stream::MemoryBudget;
use serde_json::Value;
use support::{Bench, Laser, Setup, wait_until};

/// A small lattice of some dozen layers.
const SMALL: [&str; 10] = ["generate", "bcc", "--struts", "100", "--box", "5,5,2", "--seed", "1", "-o", "part.layerd"];

fn setup(laser: Laser) -> Setup {
    Setup { time_scale: 20, laser: Some(laser), ..Setup::default() }
}

/// Marks a layer in some 100 ms of the host's clock.
const QUICK: Laser = Laser { mark_speed_mm_s: 200, buffer_bytes: 65_536 };
/// Marks a layer in about a second of the host's clock.
const SLOW: Laser = Laser { mark_speed_mm_s: 4, buffer_bytes: 65_536 };

/// Checks in the device's own log that each layer was marked from its first vector to its last, each vector once, in the order of the
/// layers, with powder spread and the plate at its depth. Returns how often a layer went on after it was cut short.
fn assert_marked_once(bench: &Bench, layers: u64) -> u64 {
    let (mut layer, mut next_vector, mut lit, mut went_on) = (0, 0, false, 0);
    let number = |act: &Value, key: &str| act[key].as_u64().unwrap_or_else(|| panic!("no {key} in {act}"));
    let (mut recoated, mut position_um) = (false, 0);
    for act in bench.acts() {
        match act["event"].as_str().expect("event") {
            "moved" => (recoated, position_um) = (false, number(&act, "position_um")),
            "recoated" => recoated = true,
            "laser_on" => {
                assert!(!lit && recoated, "{act}");
                assert_eq!((number(&act, "layer"), number(&act, "from_vector")), (layer, next_vector), "{act}");
                assert_eq!(position_um, (layer + 1) * 100, "{act}");
                went_on += u64::from(next_vector > 0);
                lit = true;
            }
            "laser_off" => {
                lit = false;
                if let Some(vector) = act["next_vector"].as_u64() {
                    next_vector = vector;
                }
            }
            "marked" => {
                assert!(next_vector <= number(&act, "vectors"), "{act}");
                (layer, next_vector) = (layer + 1, 0);
            }
            _ => {}
        }
    }
    assert_eq!((layer, lit), (layers, false));
    went_on
}

/// Compares what was melted of each layer with the bitmap of the layer. Returns the shares that were covered, and melted beside it.
fn coverage(bench: &Bench, layers: u64) -> (f64, f64) {
    let machine = Machine::load(&bench.path("machine.toml")).expect("a machine");
    let recipe = Recipe::load(&bench.path("recipe.toml")).expect("a recipe");
    let resolution = Resolution::of(&machine, &recipe);
    let placed = Placed::open(&bench.path("part.layerd"), &resolution).expect("fits");
    let mut slicer = placed.slicer(1, 0).expect("slices");
    let raster = &resolution.raster;
    let mut bitmap = Bitmap::new(raster.width_px, raster.height_px, resolution.depth);
    let (mut inside, mut covered, mut beside) = (0_u64, 0_u64, 0_u64);
    for layer in 0..layers {
        slicer.next_layer(&mut bitmap).expect("computed");
        let path = bench.path("device-out").join(format!("layer_{layer:06}.png"));
        let melted = image::open(path).expect("a picture").into_luma8();
        for y in 0..raster.height_px {
            for x in 0..raster.width_px {
                let byte = bitmap.data()[y as usize * bitmap.stride_bytes() + x as usize / 8];
                let (wanted, melted) = (byte >> (7 - x % 8) & 1 > 0, melted.get_pixel(x, y).0[0] > 0);
                inside += u64::from(wanted);
                covered += u64::from(wanted && melted);
                beside += u64::from(!wanted && melted);
            }
        }
    }
    (covered as f64 / inside as f64, beside as f64 / inside as f64)
}

#[test]
fn a_print_marks_every_layer_once_and_melts_what_was_sliced() {
    let bench = Bench::start(setup(QUICK));
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    let layers = bench.printed(id);
    assert!(layers >= 20, "{layers}");
    assert_eq!(assert_marked_once(&bench, layers), 0);
    for words in [bench.ok(&["status"]), bench.ok(&["jobs"]), bench.ok(&["log", &id.to_string()])] {
        assert!(!words.contains("resin") && !words.contains("vat"), "a laser machine has no resin: {words}");
    }
    let (covered, beside) = coverage(&bench, layers);
    assert!(covered > 0.97 && beside < 0.03, "covered {covered}, beside {beside}");
    let (computed, measured) = marking_ms(&bench);
    assert!(computed.abs_diff(measured) * 20 <= measured, "{computed} ms computed, {measured} ms measured");
}

#[test]
fn a_hollow_solid_is_melted_as_sliced() {
    let bench = Bench::start(setup(QUICK));
    std::fs::write(bench.path("ball.stl"), meshes::hollow_ball([4.0, 4.0, 1.5], 1.5, 0.8)).expect("can be written");
    bench.ok(&["pack", "ball.stl", "-o", "part.layerd"]);
    let id = bench.start_job("part.layerd");
    let layers = bench.printed(id);
    assert!(layers >= 29, "{layers}");
    assert_eq!(assert_marked_once(&bench, layers), 0);
    let (covered, beside) = coverage(&bench, layers);
    assert!(covered > 0.97 && beside < 0.03, "covered {covered}, beside {beside}");
}

/// How long the layers take to mark: as computed, and by the device's clock, milliseconds.
fn marking_ms(bench: &Bench) -> (u64, u64) {
    let machine = Machine::load(&bench.path("machine.toml")).expect("a machine");
    let recipe = Recipe::load(&bench.path("recipe.toml")).expect("a recipe");
    let placed = Placed::open(&bench.path("part.layerd"), &Resolution::of(&machine, &recipe)).expect("fits");
    let part = placed.fit(1, 64 << 20).expect("fits the memory");
    let layers = part.encoded_layers(0, BEST_VECTORS, &MemoryBudget::new(64 << 20)).expect("begins");
    let computed = layers.map(|layer| u64::from(layer.expect("a layer").scan.expect("vectors").times.mark_ms)).sum();
    let (mut measured, mut began_ms) = (0, 0);
    for act in bench.acts() {
        let at_ms = act["t_ms"].as_u64().expect("t_ms");
        match act["event"].as_str().expect("event") {
            "laser_on" => began_ms = at_ms,
            "marked" => measured += at_ms - began_ms,
            _ => {}
        }
    }
    (computed, measured)
}

#[test]
fn a_layer_larger_than_the_buffer_streams_while_it_is_marked() {
    let bench = Bench::start(setup(Laser { buffer_bytes: 1024, ..QUICK }));
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    let layers = bench.printed(id);
    assert_marked_once(&bench, layers);
}

#[test]
fn lost_lines_and_bad_frames_leave_no_vector_out_and_mark_none_twice() {
    let faults = ["--fault", "drop=0.01", "--fault", "corrupt=0.01", "--fault", "disconnect=6", "--seed", "3"];
    let simulate = faults.map(String::from).to_vec();
    let bench = Bench::start(Setup { simulate, ..setup(SLOW) });
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    let layers = bench.printed(id);
    let went_on = assert_marked_once(&bench, layers);
    assert!(went_on > 0, "no layer was cut short: the test shows nothing");
}

#[test]
fn kill_at_any_moment_then_resume_marks_each_vector_exactly_once() {
    let mut bench = Bench::start(setup(SLOW));
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    // Moments spread over the phases of a layer by a multiplicative sequence.
    bench.kill_and_resume(id, |kill| Duration::from_millis(150 + kill * 7919 % 900));
    let layers = bench.printed(id);
    let went_on = assert_marked_once(&bench, layers);
    assert!(went_on > 0, "no layer was cut short: the test shows nothing");
}

/// No layer is known to fit before it is computed. A print of days must not be lost to one that does not.
#[test]
fn a_layer_that_does_not_fit_the_memory_interrupts_a_print_that_goes_on_with_a_larger_budget() {
    let mut bench = Bench::prepare(setup(Laser { mark_speed_mm_s: 2000, ..QUICK }));
    // A larger field, for a part whose layers take more than the least of any print.
    let path = bench.path("machine.toml");
    let machine = std::fs::read_to_string(&path).expect("machine.toml");
    std::fs::write(&path, machine.replace("12000.0, 12000.0", "24000.0, 24000.0")).expect("machine.toml");
    bench.start_device();
    bench.start_daemon();
    let lattice = "generate bcc --struts 6000 --box 22,22,0.8 --radius 0.1 --seed 1 -o part.layerd";
    bench.ok(&lattice.split(' ').collect::<Vec<_>>());
    let pair = ["--machine", "machine.toml", "--recipe", "recipe.toml", "--json", "--budget"];
    let check = |bench: &Bench, budget: u64| -> Value {
        let checked = bench.layerctl(&[&["check", "part.layerd"], &pair[..], &[&budget.to_string()]].concat());
        serde_json::from_slice(&checked.stdout).expect("findings")
    };
    let enough_bytes = check(&bench, 1 << 30)["largest_layer_budget_bytes"].as_u64().expect("a number");
    let few_bytes = enough_bytes - (2 << 20);
    let unfit = &check(&bench, few_bytes)["unfit_layers"];
    assert!(unfit[0][0].as_u64().is_some_and(|first| first > 0), "the first layer fits: {unfit}");

    restart_with(&mut bench, few_bytes);
    let id = bench.start_job("part.layerd");
    let job = bench.wait_for(id, &["interrupted", "completed", "failed"]);
    assert_eq!(job["state"], "interrupted", "{job}");
    let reason = job["reason"].as_str().unwrap_or_default();
    assert!(reason.contains("are free") && reason.contains("memory_budget") && reason.contains("resume"), "{reason}");
    assert!(job["layers_done"].as_u64() > Some(0), "{job}");

    restart_with(&mut bench, enough_bytes);
    bench.ok(&["resume", &id.to_string()]);
    let layers = bench.printed(id);
    assert_marked_once(&bench, layers);
}

/// Starts the daemon again with this budget.
fn restart_with(bench: &mut Bench, budget_bytes: u64) {
    bench.kill_daemon();
    let path = bench.path("layerd.toml");
    let text = std::fs::read_to_string(&path).expect("layerd.toml");
    let is_budget = |line: &&str| line.starts_with("memory_budget");
    let others: Vec<&str> = text.lines().filter(|line| !is_budget(line)).collect();
    // Keys of the file come before its first table.
    std::fs::write(&path, format!("memory_budget = \"{budget_bytes}\"\n{}\n", others.join("\n"))).expect("layerd.toml");
    bench.start_daemon();
}

#[test]
fn abort_is_dark_at_once_and_a_new_job_waits_for_an_empty_bed() {
    let bench = Bench::start(setup(SLOW));
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    wait_until("a layer", || bench.job(id)["layers_done"].as_u64() >= Some(1));
    bench.ok(&["abort"]);
    bench.wait_for(id, &["aborted"]);
    let acts = bench.acts();
    let last = acts.iter().rev().find(|act| act["event"].as_str().is_some_and(|event| event.starts_with("laser")));
    assert_eq!(last.expect("there was light")["event"], "laser_off");
    // The part is still in the powder.
    let next = bench.start_job("part.layerd");
    let job = bench.job(next);
    assert_eq!(job["state"], "queued", "{job}");
    assert!(job["reason"].as_str().is_some_and(|reason| reason.contains("below the working plane")), "{job}");
    bench.ok(&["resume", &next.to_string()]);
    wait_until("a layer of the next job", || bench.job(next)["layers_done"].as_u64() >= Some(1));
}
