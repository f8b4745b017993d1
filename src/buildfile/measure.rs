//! How large a part is before it is scaled: the factor that makes it as large as wanted. `pack` reads the sources once more for it;
//! `tests/pack_size.rs` tests it.

use std::path::{Path, PathBuf};

use super::error::PackError;
use super::import::{self, Collector, Rules, Source};
use super::options::{BlendChoice, PackOptions, ReliefOptions};
use super::progress::PackProgress;

/// Reads sources of `total_bytes`, and returns the factor with which the longest edge of the box around them has `size_mm`.
///
/// # Errors
/// [`PackError`], if a source cannot be read, or the factor is out of range.
pub(super) fn factor(
    inputs: &[PathBuf],
    sources: &[Source],
    (options, blend, size_mm): (&PackOptions, BlendChoice, f64),
    directory: &Path,
    progress: &mut dyn FnMut(PackProgress),
    total: u64,
) -> Result<f64, PackError> {
    // Maps are left out. What is open stays a shell.
    let relief = ReliefOptions { height_mm: Some(0.0), shell_mm: options.relief.shell_mm, ..ReliefOptions::default() };
    let options = PackOptions { scale: [1.0; 3], relief, ..options.clone() };
    let rules = Rules::new(&options, blend)?;
    let mut collector = Collector::new(&rules, &options, import::kinds(sources, &options), directory);
    let mut before = 0;
    for (path, source) in inputs.iter().zip(sources) {
        let mut report = |step| {
            if let PackProgress::Reading { done, .. } = step {
                progress(PackProgress::Measuring { done: before + done, total });
            }
        };
        source.import(path, &options, &mut collector, &mut report).map_err(unscaled)?;
        before += std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    }
    // Packing says that there is nothing.
    let Some(bounds) = collector.bounds() else { return Ok(1.0) };
    let longest = (0..3).map(|axis| i64::from(bounds.max[axis]) - i64::from(bounds.min[axis])).max().unwrap_or(0);
    let longest_mm = longest as f64 * options.quantum_um / 1000.0;
    let factor = size_mm / longest_mm;
    if (1e-6..=1e6).contains(&factor) {
        return Ok(factor);
    }
    let text = format!("--size {size_mm}: the part is {longest_mm} mm long; it may be scaled by 0.000001 to 1000000");
    Err(PackError::Option(text))
}

/// The error of a source that is read as it is.
fn unscaled(error: PackError) -> PackError {
    match error {
        PackError::Input { place, problem } => PackError::input(
            place,
            format!("{problem}. This is how it is before --size scales it; --scale takes other lengths, too"),
        ),
        error => error,
    }
}
