//! A whole print on a model of a grbl controller: its machine and recipe, the daemon, and what must be marked.

use std::time::Duration;

use layerd::config::{Machine, Recipe};
use layerd::device::encoding::BEST_VECTORS;
use layerd::layer::MarkClass;
use layerd::pipeline::{Placed, Resolution};
use layerd::stream::MemoryBudget;
use layerd_wire::encoding::{VectorDecoder, VectorEncoding};

use crate::grbl_model::{Facts, GrblModel, Mark, Options};
use crate::support::{Bench, Setup};

/// How much faster than real the machine's clock runs.
const SPEED_UP: f64 = 6.0;
/// Size of the field, micrometres.
const FIELD_UM: [u32; 2] = [40_000, 40_000];
/// Greatest power, milliwatts.
const MAX_POWER_MW: f64 = 5_000.0;
/// Layer height, millimetres.
pub(crate) const LAYER_MM: f64 = 0.1;
/// How far a mark may end from where it should, millimetres: a step has 4 µm, and a vector that was cut off so near its begin begins
/// anew.
const TOLERANCE_MM: f64 = 0.014;

const MACHINE: &str = "name = \"bench\"\nkind = \"slm\"\nfield_um = [40000.0, 40000.0]\ngrid_um = 50.0\nbuild_height_um = 50000.0\n\
    beam_diameter_um = 120.0\nmax_power_w = 5.0\nlayer_height_range_um = [50.0, 200.0]\nrecoat_ms = 500\nconfirm_plate = false\n\
    time_scale = 6.0\n[axes]\nmax_speed_mm_s = 100.0\nacceleration_mm_s2 = 500.0\n[link]\npath = \"device\"\nbaud = 115200\n\
    protocol = \"grbl\"\n";
const RECIPE: &str = "name = \"bench\"\nkind = \"slm\"\nlayer_height_um = 100.0\nlaser_power_w = 3.0\nmark_speed_mm_s = 60.0\n\
    jump_speed_mm_s = 100.0\npoint_time_us = 2000\nhatch_strategy = \"zigzag\"\nhatch_spacing_um = 120.0\nplate_speed_um_s = 5000\n\
    [contour]\nlaser_power_w = 2.0\nmark_speed_mm_s = 40.0\n";

/// A mark that is due: its ends in millimetres, `S`, and feed.
#[derive(Clone, Debug)]
struct Due {
    from_mm: [f64; 3],
    to_mm: [f64; 3],
    s: f64,
    feed_mm_per_min: f64,
}

/// Daemon and machine.
pub(crate) struct GrblBench {
    pub(crate) bench: Bench,
    pub(crate) model: GrblModel,
    due: Vec<Due>,
}

impl GrblBench {
    /// Starts a machine like this and the daemon. The part has a dozen layers.
    pub(crate) fn start(mut options: Options) -> Self {
        let mut bench = Bench::prepare(Setup::default());
        std::fs::write(bench.path("machine.toml"), MACHINE).expect("machine.toml");
        std::fs::write(bench.path("recipe.toml"), RECIPE).expect("recipe.toml");
        let generate = ["generate", "bcc", "--struts", "20", "--box", "4,4,1", "--seed", "1", "-o", "part.layerd"];
        bench.ok(&generate);
        let due = due(&bench);
        options.speed_up = SPEED_UP;
        let model = GrblModel::start(&bench.path("device"), options);
        bench.start_daemon();
        Self { bench, model, due }
    }

    /// Starts the print; its number.
    pub(crate) fn print(&self) -> u64 {
        self.bench.start_job("part.layerd")
    }

    /// Waits until so many marks are made.
    pub(crate) fn wait_marks(&self, count: usize) -> Facts {
        let facts = self.model.wait(Duration::from_secs(60), |facts| facts.marks.len() >= count);
        assert!(facts.marks.len() >= count, "only {} marks: {}", facts.marks.len(), self.daemon_log());
        facts
    }

    /// Waits until the print is completed.
    pub(crate) fn completed(&self, id: u64) {
        let job = self.bench.wait_for(id, &["completed", "failed", "interrupted", "aborted"]);
        assert_eq!(job["state"], "completed", "{job}\n{}", self.daemon_log());
    }

    /// Waits until the print is interrupted; the reason.
    pub(crate) fn interrupted(&self, id: u64) -> String {
        let job = self.bench.wait_for(id, &["completed", "failed", "interrupted", "aborted"]);
        assert_eq!(job["state"], "interrupted", "{job}\n{}", self.daemon_log());
        job["reason"].as_str().unwrap_or_default().to_owned()
    }

    fn daemon_log(&self) -> String {
        std::fs::read_to_string(self.bench.path("daemon.log")).unwrap_or_default()
    }

    /// Checks that every vector of every layer was marked exactly once, in its order, at the right depth, with its power and speed; and
    /// that the laser was never on at rest. A vector that was broken off must have gone on where it ended.
    pub(crate) fn assert_marked_once(&self) {
        assert_eq!(self.count_repeats(), 0);
    }

    /// The same where the operator had vectors repeated.
    pub(crate) fn assert_marked_at_least_once(&self) {
        self.count_repeats();
    }

    /// Checks all that, and counts how often marking went back to a vector of the same layer that was marked before.
    fn count_repeats(&self) -> usize {
        let facts = self.model.facts();
        assert_eq!(facts.overflowed_bytes, 0);
        assert!(facts.at_rest_lit_ms() < 1.0, "{} ms", facts.at_rest_lit_ms());
        assert!(facts.lines.iter().all(|line| line.text.len() < 80));
        let (mut next, mut at_mm, mut repeats) = (0, None, 0);
        for mark in &facts.marks {
            let is_due = |number: usize, from_mm: Option<[f64; 3]>| {
                self.due.get(number).is_some_and(|due| is_mark_of(mark, due, from_mm.unwrap_or(due.from_mm)))
            };
            if !is_due(next, at_mm) {
                let back = (0..=next.min(self.due.len() - 1)).rev().find(|number| is_due(*number, None));
                let before = back.unwrap_or_else(|| {
                    let due = &self.due[next.saturating_sub(1)..(next + 2).min(self.due.len())];
                    panic!(
                        "after vector {next}, {mark:?} was marked; around it are due {due:#?}\n{}",
                        self.daemon_log()
                    )
                });
                (next, repeats) = (before, repeats + 1);
            }
            let is_whole = is_near(mark.to_mm, self.due[next].to_mm);
            at_mm = (!is_whole).then_some([mark.to_mm[0], mark.to_mm[1], mark.to_mm[2]]);
            next += usize::from(is_whole);
        }
        assert_eq!((next, at_mm), (self.due.len(), None), "not everything was marked\n{}", self.daemon_log());
        repeats
    }
}

/// Whether a mark is a vector from here on, or a part of it that was cut off.
fn is_mark_of(mark: &Mark, due: &Due, from_mm: [f64; 3]) -> bool {
    is_near(mark.from_mm, from_mm)
        && mark.s == due.s
        && mark.feed_mm_per_min == due.feed_mm_per_min
        && (is_near(mark.to_mm, due.to_mm) || !mark.whole && lies_between(mark, due))
}

fn is_near(found_mm: [f64; 4], due_mm: [f64; 3]) -> bool {
    (0..3).all(|axis| (found_mm[axis] - due_mm[axis]).abs() <= TOLERANCE_MM)
}

/// Whether a mark that was cut off ended on the way of the vector.
fn lies_between(mark: &Mark, due: &Due) -> bool {
    let length = |from: [f64; 3], to: [f64; 3]| (0..3).map(|axis| (to[axis] - from[axis]).powi(2)).sum::<f64>().sqrt();
    let end = [mark.to_mm[0], mark.to_mm[1], mark.to_mm[2]];
    length(due.from_mm, end) + length(end, due.to_mm) - length(due.from_mm, due.to_mm) < TOLERANCE_MM
}

/// What must be marked, in order, computed as the daemon does.
fn due(bench: &Bench) -> Vec<Due> {
    let machine = Machine::load(&bench.path("machine.toml")).expect("a machine");
    let recipe = Recipe::load(&bench.path("recipe.toml")).expect("a recipe");
    let placed = Placed::open(&bench.path("part.layerd"), &Resolution::of(&machine, &recipe)).expect("fits");
    let part = placed.fit(1, 64 << 20).expect("fits the memory");
    let Recipe::Slm(recipe) = recipe else { panic!("a recipe for a laser") };
    let mut due = Vec::new();
    for layer in part.encoded_layers(0, BEST_VECTORS, &MemoryBudget::new(64 << 20)).expect("begins") {
        let layer = layer.expect("a layer");
        let encoding = layer.encoding.vectors().unwrap_or(VectorEncoding::Plain);
        let mut decoder = VectorDecoder::new(encoding, FIELD_UM, layer.bytes.len() as u32);
        let mut bytes = &layer.bytes[..];
        let z_mm = -(f64::from(layer.exposure) + 1.0) * LAYER_MM;
        while let Some(vector) = decoder.next(&mut bytes).expect("vectors") {
            let laser = recipe.laser(vector.class);
            let [mut from_mm, mut to_mm] = [vector.from_um, vector.to_um]
                .map(|point| [f64::from(point[0]) / 1e3, f64::from(point[1]) / 1e3, z_mm]);
            let mut feed_mm_per_min = laser.mark_speed_mm_s * 60.0;
            if vector.class == MarkClass::Point {
                // 40 µm in the time of the point.
                (from_mm[0], to_mm[0]) = (from_mm[0] - 0.02, to_mm[0] + 0.02);
                feed_mm_per_min = 0.04 / (f64::from(laser.point_time_us) * 1e-6) * 60.0;
            }
            let s = (laser.power_w * 1000.0 / MAX_POWER_MW * 1000.0).floor();
            due.push(Due { from_mm, to_mm, s, feed_mm_per_min: feed_mm_per_min.round() });
        }
    }
    due
}
