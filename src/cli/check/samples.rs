//! Some layers, spread over the part: how long computing, the line and the device take for them. `tests/check/` compares what `check` says
//! of them.

use std::time::{Duration, Instant};

use anyhow::bail;

use super::layers_text;
use crate::buildfile::{BodyHeader, Header};
use crate::device::encoding::Choice;
use crate::job::Process;
use crate::pipeline::Part;
use crate::slice::add_layers;
use crate::stream::MemoryBudget;

/// Number of sample layers, spread over the height.
const MAX_SAMPLES: u32 = 12;

/// Step between samples, coprime to [`MAX_SAMPLES`]: even the first few samples are spread over the height.
const SAMPLE_STEP: u32 = 5;

/// No sample is begun after this time: each begins a sweep, which reads a million struts of a hundred million.
const MAX_SAMPLING_TIME: Duration = Duration::from_secs(2);

/// Layers that are timed one after the other where a sweep keeps what it has divided for the next layers: one of them may take little.
const TIMED_LAYERS: u32 = 8;

/// Bits on the line for each byte: 8N1.
const LINE_BITS: f64 = 10.0;

/// One layer computed and encoded.
pub(super) struct Sample {
    layer: u32,
    pub(super) compute_ms: f64,
    pub(super) line_ms: f64,
    device_ms: f64,
    pub(super) bytes: usize,
}

/// Computes and encodes layers spread evenly over the part, each in a sweep of its own, as a print would send them to a device that
/// reads every encoding. The time of the sweep's second layer counts, or the mean of those that follow: the first one includes reading the
/// chunks, which a print does once.
pub(super) fn measure(
    part: &Part,
    header: &Header,
    encoding: Choice,
    budget: &MemoryBudget,
    process: &Process,
    baud: f64,
) -> anyhow::Result<Vec<Sample>> {
    let mut samples = Vec::new();
    let count = MAX_SAMPLES.min(part.layer_count());
    let is_kept = |body: &BodyHeader| matches!(body, BodyHeader::Relief(_));
    let timed = if header.bodies.iter().any(is_kept) { TIMED_LAYERS } else { 1 };
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
        let mut computed = 1;
        while computed < timed && layers.next().transpose()?.is_some() {
            computed += 1;
        }
        let compute_ms = start.elapsed().as_secs_f64() * 1e3 / f64::from(computed);
        let bytes = encoded.bytes.len();
        let line_ms = bytes as f64 * LINE_BITS / baud * 1e3;
        let device_ms = process.layer_ms(layer, encoded.scan.map(|scan| scan.times));
        samples.push(Sample { layer, compute_ms, line_ms, device_ms, bytes });
    }
    samples.sort_by_key(|sample| sample.layer);
    Ok(samples)
}

/// Each sample stands for the layers nearer to it than to another.
pub(super) fn late_layers(samples: &[Sample], layer_count: u32) -> Vec<[u32; 2]> {
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

pub(super) fn late_text(ranges: &[[u32; 2]]) -> String {
    format!(
        "the device would wait, dark, for layers {} (estimate): a faster line, a longer exposure or lift, or a coarser raster \
         would help",
        layers_text(ranges)
    )
}

pub(super) fn mean(samples: &[Sample], value: impl Fn(&Sample) -> f64) -> f64 {
    samples.iter().map(value).sum::<f64>() / samples.len().max(1) as f64
}

pub(super) fn most(samples: &[Sample], value: impl Fn(&Sample) -> f64) -> f64 {
    samples.iter().map(value).fold(0.0, f64::max)
}
