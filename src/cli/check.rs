//! `layerctl check`: whether a print would run well. Size and memory come from header and index alone, at once. Times, and whether
//! the bottom holds to the plate, come from layers computed here, which takes some seconds. For a laser all layers are computed, because
//! the memory of a layer is known only then; if that takes too long, evenly spaced ones. So are layers of solids, for walls that are too thin.
//! `tests/check/` compares it with the daemon.

mod inspected;
mod rehearsal;
mod samples;

use std::path::{Path, PathBuf};

use anyhow::{anyhow, bail};
use serde::Serialize;

use super::progress::duration_text;
use crate::buildfile::Header;
use crate::config::{MIN_BUDGET_BYTES, Machine, Recipe, byte_size};
use crate::device::encoding;
use crate::job::Process;
use crate::pipeline::{PartError, Placed, Resolution, default_threads};
use crate::slice::{Footing, SlicePlan};
use crate::stream::MemoryBudget;
use crate::text::{count_text, size_text};
use inspected::{Inspected, inspect};
use rehearsal::{Rehearsal, rehearse, roomy};
use samples::{Sample, late_layers, late_text, mean, measure, most};

/// Check before a print whether a part fits the machine, the memory and the line, and holds to the plate.
#[derive(Debug, clap::Args)]
#[command(after_help = super::with_names("\
Examples:
  layerctl check lattice.layerd --machine lcd-4k-35um --recipe fine
  layerctl check lattice.layerd -m my-machine.toml --budget 96MiB --json | jq .fits

It names walls of solids that are thinner than a pixel along rows or columns: surely those below 7/8 of a pixel that are at least 8 pixels \
long and 2 high. It does not see needles, nor floors thinner than a layer. It looks at all layers, or at as many as it can in 10 s, evenly spaced; a \
wall that is in none of these is not named. Struts are judged by their radii."))]
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
    /// For a laser: compute all layers if that takes about so many minutes at most, else only some, evenly spaced
    #[arg(long, value_name = "N", default_value = "10", value_parser = parse_minutes)]
    pub minutes: f64,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

fn parse_minutes(text: &str) -> Result<f64, String> {
    let minutes = text.parse::<f64>().ok().filter(|minutes| minutes.is_finite() && *minutes > 0.0);
    minutes.ok_or_else(|| format!("`{text}` is no number of minutes above 0"))
}

/// Most ranges of layers that a message names.
const MAX_TOLD: usize = 6;

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
    peak_active: u64,
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
    #[serde(flatten)]
    inspected: Option<Inspected>,
    /// Of layers of scan vectors.
    #[serde(flatten)]
    rehearsal: Option<Rehearsal>,
}

/// Runs the command.
///
/// # Errors
/// The print does not fit, or cannot be judged.
pub fn run(args: CheckArgs) -> anyhow::Result<()> {
    let CheckArgs { file: path, machine, recipe, budget, minutes, json } = args;
    let pair = super::find_pair(&machine, &recipe)?;
    let mut told = Ok(());
    let findings = judge(&path, &pair, budget, minutes, &mut |size| {
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
    minutes: f64,
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
        peak_active: placed.peak_active(),
        threads: memory.threads,
        memory_needed_bytes: need_bytes,
        memory_max_bytes: (need_bytes <= budget).then(|| memory.max_bytes(budget)),
        memory_budget_bytes: budget,
        device_ms_normal_layer: process.layer_ms(plan.layer_count, None),
        print_time_s: matches!(process, Process::Vat(_)).then(|| (process.layers_ms(0..plan.layer_count) / 1e3) as u64),
    };
    let header = placed.header().clone();
    let warnings = warnings(&header, &plan, recipe);
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
        Err(error @ PartError::Materials(_)) => {
            return Ok(Findings { fits: false, problems: vec![error.to_string()], size: Some(size), times: None });
        }
        Err(error) => return Err(error.into()),
    };
    let (encoding, sample_budget) = match recipe {
        Recipe::Dlp(_) => (encoding::best(plan.depth), MemoryBudget::new(budget)),
        Recipe::Slm(_) => (encoding::BEST_VECTORS, roomy(budget)),
    };
    let samples = measure(&part, &header, encoding, &sample_budget, &process, f64::from(machine.link().baud))?;
    let rehearsal = match recipe {
        Recipe::Dlp(_) => None,
        Recipe::Slm(_) => {
            let rest_ms = process.layers_ms(0..plan.layer_count);
            let step = rehearsal::step(plan.layer_count, mean(&samples, |sample| sample.compute_ms), minutes);
            Some(rehearse(&part, &memory, budget, encoding, rest_ms, step)?)
        }
    };
    let inspected = inspect(&part, &header, &plan, budget)?;
    let late_layers = late_layers(&samples, plan.layer_count);
    let footing = part.footing(recipe, budget)?;
    let dark = if let Footing::Dark { layers } = footing { layers } else { 0 };
    let late = (!late_layers.is_empty()).then(|| late_text(&late_layers));
    let loose = footing.problem(plan.layer_count);
    let unfit = rehearsal.as_ref().and_then(|rehearsal| rehearsal.problem(budget));
    let fits = loose.is_none() && unfit.is_none();
    let unmarked = rehearsal.as_ref().and_then(Rehearsal::warning);
    let gap = rehearsal.as_ref().and_then(|rehearsal| rehearsal.gap(plan.layer_count, minutes));
    let problems = unfit.into_iter().chain(loose).chain(gap).chain(unmarked).chain(late);
    let problems = problems.chain(warnings).chain(inspected.warnings()).collect();
    let times = Times { rehearsal, inspected: Some(inspected), ..times(&samples, dark, late_layers) };
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
        inspected: None,
        rehearsal: None,
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

fn size_lines(size: &Size) -> String {
    let device = match size.print_time_s {
        Some(_) => format!("device          {:.1} ms a normal layer", size.device_ms_normal_layer),
        None => format!("device          {:.1} ms a layer, and its marking", size.device_ms_normal_layer),
    };
    let layers = format!("layers          {}", size.layer_count);
    let struts = format!("active          {} struts or triangles at most in one layer", size.peak_active);
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
