//! `layerctl check`: whether a print would run well. Size and memory come from header and index alone, at once. Times, and whether
//! the bottom holds to the plate, come from layers computed here, which takes some seconds. For a laser all layers are computed, because
//! the memory of a layer is known only then. That takes minutes, a small share of the print.
//! `tests/check/` compares it with the daemon.

mod rehearsal;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{anyhow, bail};
use serde::Serialize;

use super::progress::duration_text;
use crate::buildfile::Header;
use crate::config::{MIN_BUDGET_BYTES, Machine, Recipe, byte_size};
use crate::device::encoding::{self, Choice};
use crate::job::Process;
use crate::pipeline::{Part, PartError, Placed, Resolution, default_threads};
use crate::slice::{Footing, SlicePlan};
use crate::stream::MemoryBudget;
use crate::text::{count_text, size_text};
use rehearsal::{Rehearsal, rehearse, roomy};

/// Check before a print whether a part fits the machine, the memory and the line, and holds to the plate.
#[derive(Debug, clap::Args)]
#[command(after_help = super::with_names("\
Examples:
  layerctl check lattice.layerd --machine lcd-4k-35um --recipe fine
  layerctl check lattice.layerd -m my-machine.toml --budget 96MiB --json | jq .fits"))]
pub struct CheckArgs {
    /// Build file (.layerd)
    pub file: PathBuf,
    /// Machine: a name, or the path of a TOML file
    #[arg(long, short, value_name = "NAME|PATH")]
    pub machine: String,
    /// Recipe: a name, or the path of a TOML file
    #[arg(long, short, value_name = "NAME|PATH", default_value = "default")]
    pub recipe: String,
    /// Memory the daemon may use: its `memory_budget`
    #[arg(long, value_name = "SIZE", default_value = "64MiB", value_parser = byte_size::parse)]
    pub budget: u64,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// Number of sample layers, spread over the height.
const MAX_SAMPLES: u32 = 12;

/// Step between samples, coprime to [`MAX_SAMPLES`]: even the first few samples are spread over the height.
const SAMPLE_STEP: u32 = 5;

/// No sample is begun after this time: each begins a sweep, which reads a million struts of a hundred million.
const MAX_SAMPLING_TIME: Duration = Duration::from_secs(2);

/// Most ranges of layers that a message names.
const MAX_TOLD: usize = 6;

/// Bits on the line for each byte: 8N1.
const LINE_BITS: f64 = 10.0;

/// What `check` found; `--json` prints it.
#[derive(Debug, Serialize)]
struct Findings {
    fits: bool,
    problems: Vec<String>,
    /// `None` if the part does not fit the build volume.
    #[serde(flatten)]
    size: Option<Size>,
    /// `None` if the part does not fit the build volume or the memory.
    #[serde(flatten)]
    times: Option<Times>,
}

/// Figures from header and index.
#[derive(Debug, Serialize)]
struct Size {
    layer_count: u32,
    peak_active_struts: u64,
    /// Threads that the cores and the memory budget allow.
    threads: usize,
    memory_needed_bytes: u64,
    /// The most that a print takes of the budget, to compute layers ahead; `None` if the budget is not enough.
    memory_max_bytes: Option<u64>,
    memory_budget_bytes: u64,
    device_ms_normal_layer: f64,
    /// If the device never waits; `None` if it depends on the layers.
    print_time_s: Option<u64>,
}

/// Figures from layers computed here.
#[derive(Debug, Serialize)]
struct Times {
    /// Layers the times were measured on.
    sampled_layers: usize,
    encoded_bytes_mean: u64,
    encoded_bytes_max: u64,
    compute_ms_mean: f64,
    compute_ms_max: f64,
    line_ms_mean: f64,
    line_ms_max: f64,
    /// Layers at the bottom in which nothing is lit; such a part is not printed.
    dark_bottom_layers: u32,
    /// Ranges of layers, first to last, around samples where computing or the line takes longer than the device.
    late_layers: Vec<[u32; 2]>,
    /// Of layers of scan vectors.
    #[serde(flatten)]
    rehearsal: Option<Rehearsal>,
}

/// One layer computed and encoded.
struct Sample {
    layer: u32,
    compute_ms: f64,
    line_ms: f64,
    device_ms: f64,
    bytes: usize,
}

/// Runs the command.
///
/// # Errors
/// The print does not fit, or cannot be judged.
pub fn run(args: CheckArgs) -> anyhow::Result<()> {
    let CheckArgs { file: path, machine, recipe, budget, json } = args;
    let pair = super::find_pair(&machine, &recipe)?;
    let mut told = Ok(());
    let findings = judge(&path, &pair, budget, &mut |size| {
        if !json {
            // Printed before the sampling, which takes seconds.
            told = super::print(&size_lines(size));
        }
    })?;
    told?;
    if json {
        super::print_json(&findings)?;
    } else {
        super::print(&verdict_text(&findings))?;
    }
    match findings.problems.first() {
        Some(problem) if !findings.fits && findings.times.is_some() => bail!("{problem}"),
        Some(problem) if !findings.fits => bail!("the print does not fit: {problem}"),
        _ => Ok(()),
    }
}

/// Judges the print; calls `tell_size` as soon as the size is known.
fn judge(
    path: &Path,
    (machine, recipe): &(Machine, Recipe),
    budget: u64,
    tell_size: &mut dyn FnMut(&Size),
) -> anyhow::Result<Findings> {
    let placed = match Placed::open(path, &Resolution::of(machine, recipe)) {
        Ok(placed) => placed,
        Err(PartError::Plan(error)) => {
            return Ok(Findings { fits: false, problems: vec![error.to_string()], size: None, times: None });
        }
        Err(error) => return Err(error.into()),
    };
    let process = Process::new(machine, recipe).ok_or_else(|| {
        anyhow!("recipe `{}` is for another kind of machine than `{}`", recipe.name(), machine.name())
    })?;
    let plan = placed.plan().clone();
    let threads = default_threads();
    let memory = placed.memory(threads, budget);
    let need_bytes = memory.need_bytes();
    let size = Size {
        layer_count: plan.layer_count,
        peak_active_struts: placed.peak_active(),
        threads: memory.threads,
        memory_needed_bytes: need_bytes,
        memory_max_bytes: (need_bytes <= budget).then(|| memory.max_bytes(budget)),
        memory_budget_bytes: budget,
        device_ms_normal_layer: process.layer_ms(plan.layer_count, None),
        print_time_s: matches!(process, Process::Vat(_)).then(|| (process.layers_ms(0..plan.layer_count) / 1e3) as u64),
    };
    let warnings = warnings(placed.header(), &plan, recipe);
    tell_size(&size);
    let part = match placed.fit(threads, budget) {
        Ok(part) => part,
        Err(PartError::Memory { need_bytes, .. }) => {
            let problem = format!(
                "it needs more memory than the budget of {}: set memory_budget = \"{}MiB\" in the daemon's configuration",
                size_text(budget),
                need_bytes.max(MIN_BUDGET_BYTES).div_ceil(1 << 20)
            );
            return Ok(Findings { fits: false, problems: vec![problem], size: Some(size), times: None });
        }
        Err(error) => return Err(error.into()),
    };
    let (encoding, rehearsal, sample_budget) = match recipe {
        Recipe::Dlp(_) => (encoding::best(plan.depth), None, MemoryBudget::new(budget)),
        Recipe::Slm(_) => {
            let rest_ms = process.layers_ms(0..plan.layer_count);
            let encoding = encoding::BEST_VECTORS;
            (encoding, Some(rehearse(&part, &memory, budget, encoding, rest_ms)?), roomy(budget))
        }
    };
    let samples = measure(&part, encoding, &sample_budget, &process, f64::from(machine.link().baud))?;
    let late_layers = late_layers(&samples, plan.layer_count);
    let footing = part.footing(recipe, budget)?;
    let dark = if let Footing::Dark { layers } = footing { layers } else { 0 };
    let late = (!late_layers.is_empty()).then(|| late_text(&late_layers));
    let loose = footing.problem(plan.layer_count);
    let unfit = rehearsal.as_ref().and_then(|rehearsal| rehearsal.problem(budget));
    let fits = loose.is_none() && unfit.is_none();
    let unmarked = rehearsal.as_ref().and_then(Rehearsal::warning);
    let problems = unfit.into_iter().chain(loose).chain(unmarked).chain(late).chain(warnings).collect();
    let times = Times { rehearsal, ..times(&samples, dark, late_layers) };
    Ok(Findings { fits, problems, size: Some(size), times: Some(times) })
}

/// What may spoil a print that fits: struts that the raster or the layers are too coarse for, and layers that are not peeled off.
fn warnings(header: &Header, plan: &SlicePlan, recipe: &Recipe) -> Vec<String> {
    let radii = header.lattices().map(|lattice| f64::from(lattice.radius_range[0]));
    let thinnest_um = 2.0 * header.quantum_um * radii.fold(f64::INFINITY, f64::min);
    let [x_um, y_um] = plan.raster.pixel_um;
    let pixel_um = x_um.max(y_um);
    let mut warnings = Vec::new();
    if thinnest_um < pixel_um {
        warnings.push(format!(
            "the thinnest strut is {thinnest_um:.1} µm thick, {:.2} pixels: struts thinner than 1 pixel ({pixel_um} µm) may print \
             broken",
            thinnest_um / pixel_um
        ));
    }
    if thinnest_um < plan.layer_height_um {
        warnings.push(format!(
            "the thinnest strut is {thinnest_um:.1} µm thick, and a layer {} µm: flat struts thinner than a layer may be missing",
            plan.layer_height_um
        ));
    }
    if matches!(recipe, Recipe::Dlp(recipe) if recipe.lift_height_um == 0) {
        warnings.push(
            "the recipe's lift_height_um = 0 does not peel a layer off the bottom of the vat: the plate stays where it is".into(),
        );
    }
    warnings
}

fn times(samples: &[Sample], dark_bottom_layers: u32, late_layers: Vec<[u32; 2]>) -> Times {
    Times {
        sampled_layers: samples.len(),
        encoded_bytes_mean: mean(samples, |sample| sample.bytes as f64) as u64,
        encoded_bytes_max: samples.iter().map(|sample| sample.bytes as u64).max().unwrap_or(0),
        compute_ms_mean: mean(samples, |sample| sample.compute_ms),
        compute_ms_max: most(samples, |sample| sample.compute_ms),
        line_ms_mean: mean(samples, |sample| sample.line_ms),
        line_ms_max: most(samples, |sample| sample.line_ms),
        dark_bottom_layers,
        late_layers,
        rehearsal: None,
    }
}

/// Computes and encodes layers spread evenly over the part, each in a sweep of its own, as a print would send them to a device that
/// reads every encoding. The time of the sweep's second layer counts: the first one includes reading the chunks, which a print
/// does once.
fn measure(
    part: &Part,
    encoding: Choice,
    budget: &MemoryBudget,
    process: &Process,
    baud: f64,
) -> anyhow::Result<Vec<Sample>> {
    let mut samples = Vec::new();
    let count = MAX_SAMPLES.min(part.layer_count());
    let began = Instant::now();
    for step in 0..MAX_SAMPLES {
        let index = step * SAMPLE_STEP % MAX_SAMPLES;
        if index >= count {
            continue;
        }
        if !samples.is_empty() && began.elapsed() > MAX_SAMPLING_TIME {
            break;
        }
        let layer = (u64::from(part.layer_count()) * u64::from(2 * index + 1) / u64::from(2 * count)) as u32;
        let mut layers = part.encoded_layers(layer.saturating_sub(1), encoding, budget)?;
        if layer > 0 {
            layers.next().transpose()?;
        }
        let start = Instant::now();
        let Some(encoded) = layers.next().transpose()? else { bail!("the layers ended too early") };
        let compute_ms = start.elapsed().as_secs_f64() * 1e3;
        let bytes = encoded.bytes.len();
        let line_ms = bytes as f64 * LINE_BITS / baud * 1e3;
        let device_ms = process.layer_ms(layer, encoded.scan.map(|scan| scan.times));
        samples.push(Sample { layer, compute_ms, line_ms, device_ms, bytes });
    }
    samples.sort_by_key(|sample| sample.layer);
    Ok(samples)
}

/// Each sample stands for the layers nearer to it than to another.
fn late_layers(samples: &[Sample], layer_count: u32) -> Vec<[u32; 2]> {
    let mut ranges: Vec<[u32; 2]> = Vec::new();
    let mut first = 0;
    for (index, sample) in samples.iter().enumerate() {
        let next = samples.get(index + 1).map_or(layer_count, |next| (sample.layer + next.layer).div_ceil(2));
        let last = next.max(first + 1) - 1;
        if sample.compute_ms.max(sample.line_ms) > sample.device_ms {
            add_layers(&mut ranges, [first, last]);
        }
        first = last + 1;
    }
    ranges
}

fn late_text(ranges: &[[u32; 2]]) -> String {
    format!(
        "the device would wait, dark, for layers {} (estimate): a faster line, a longer exposure or lift, or a coarser raster \
         would help",
        layers_text(ranges)
    )
}

/// Adds layers, first to last, behind or next to the last range.
fn add_layers(ranges: &mut Vec<[u32; 2]>, [first, last]: [u32; 2]) {
    match ranges.last_mut() {
        Some(range) if range[1] + 1 >= first => range[1] = last,
        _ => ranges.push([first, last]),
    }
}

/// Ranges of layers in words, at most [`MAX_TOLD`] of them.
fn layers_text(ranges: &[[u32; 2]]) -> String {
    let told = ranges.iter().take(MAX_TOLD).map(|[first, last]| match first == last {
        true => first.to_string(),
        false => format!("{first} to {last}"),
    });
    let more = if ranges.len() > MAX_TOLD { " and more" } else { "" };
    told.collect::<Vec<_>>().join(", ") + more
}

fn mean(samples: &[Sample], value: impl Fn(&Sample) -> f64) -> f64 {
    samples.iter().map(value).sum::<f64>() / samples.len().max(1) as f64
}

fn most(samples: &[Sample], value: impl Fn(&Sample) -> f64) -> f64 {
    samples.iter().map(value).fold(0.0, f64::max)
}

fn size_lines(size: &Size) -> String {
    let device = match size.print_time_s {
        Some(_) => format!("device          {:.1} ms a normal layer", size.device_ms_normal_layer),
        None => format!("device          {:.1} ms a layer, and its marking", size.device_ms_normal_layer),
    };
    let layers = format!("layers          {}", size.layer_count);
    let struts = format!("active struts   {} at most in one layer", size.peak_active_struts);
    let time = size.print_time_s.map(time_line);
    [layers, struts, memory_line(size), device].into_iter().chain(time).collect::<Vec<_>>().join("\n")
}

fn time_line(print_time_s: u64) -> String {
    format!("print time      {}, where the device never waits", duration_text(print_time_s))
}

fn memory_line(size: &Size) -> String {
    let ahead = size
        .memory_max_bytes
        .map_or_else(String::new, |max_bytes| format!(", and takes up to {} to compute ahead", size_text(max_bytes)));
    format!(
        "memory          needs at least {} of the budget of {}{ahead}; computes on {}",
        size_text(size.memory_needed_bytes),
        size_text(size.memory_budget_bytes),
        count_text(size.threads as u64, "thread")
    )
}

fn verdict_text(findings: &Findings) -> String {
    let mut lines = Vec::new();
    if let Some(times) = &findings.times {
        lines.push(format!(
            "encoded layer   {}, at most {} ({} sampled)",
            size_text(times.encoded_bytes_mean),
            size_text(times.encoded_bytes_max),
            count_text(times.sampled_layers as u64, "layer")
        ));
        lines.push(format!(
            "computing       {:.1} ms a layer, at most {:.1}",
            times.compute_ms_mean, times.compute_ms_max
        ));
        lines.push(format!("line            {:.1} ms a layer, at most {:.1}", times.line_ms_mean, times.line_ms_max));
        if let Some(rehearsal) = &times.rehearsal {
            lines.extend(rehearsal.lines());
            lines.push(time_line(rehearsal.print_time_s));
        }
    }
    // The first problem of a print that does not fit is reported as the command's error.
    let notes = findings.problems.iter().skip(usize::from(!findings.fits));
    lines.extend(notes.map(|problem| format!("note            {problem}")));
    let but = if findings.problems.is_empty() { "" } else { ", but read the notes" };
    lines.push(match (findings.fits, findings.times.as_ref()) {
        (true, Some(times)) if !times.late_layers.is_empty() => {
            format!("verdict         fits{but}; the device will wait for some layers")
        }
        (true, _) => format!("verdict         fits{but}; the device never waits"),
        (false, Some(Times { rehearsal: Some(rehearsal), .. })) if !rehearsal.unfit_layers.is_empty() => {
            "verdict         does not fit the memory budget".into()
        }
        (false, Some(_)) => "verdict         would not hold to the plate".into(),
        (false, None) => "verdict         does not fit".into(),
    });
    lines.join("\n")
}
