//! How large a part is before it is scaled: the factor that makes it as large as wanted. The sources are read for it, before `pack` reads them;
//! `tests/pack_size.rs` tests it.

use std::path::{Path, PathBuf};

use super::error::PackError;
use super::import::{self, Collector, Rules, Source};
use super::model::Bounds;
use super::options::{JointChoice, PackOptions, ReliefOptions};
use super::progress::PackProgress;

/// A source that has to be scaled by more than this is measured again once it is scaled: at first, it was rounded to few quanta.
const ROUGH_FACTOR: f64 = 2.0;

/// Reads sources of `total` bytes, and returns the factor with which the longest edge of the box around them has `size_mm`.
///
/// # Errors
/// [`PackError`], if a source cannot be read, or the factor is out of range.
pub(super) fn factor(
    inputs: &[PathBuf],
    sources: &[Source],
    (options, joint, size_mm): (&PackOptions, JointChoice, f64),
    directory: &Path,
    progress: &mut dyn FnMut(PackProgress),
    total: u64,
) -> Result<f64, PackError> {
    // Maps are left out. What is open stays a shell.
    let relief = ReliefOptions { height_mm: Some(0.0), shell_mm: options.relief.shell_mm, ..ReliefOptions::default() };
    let mut options = PackOptions { scale: [1.0; 3], relief, ..options.clone() };
    loop {
        let mut reading = |step| {
            if let PackProgress::Reading { done, total } = step {
                progress(PackProgress::Measuring { done, total });
            }
        };
        let rules = Rules::new(&options, joint)?;
        let mut collector = Collector::new(&rules, &options, import::kinds(sources, &options), directory);
        import::import_all(inputs, sources, &options, &mut collector, total, &mut reading).map_err(unscaled)?;
        // Packing says that there is nothing.
        let Some(longest_mm) = collector.bounds().map(|bounds| longest_mm(bounds, options.quantum_um)) else {
            return Ok(1.0);
        };
        let [scale, ..] = options.scale;
        let factor = scale * size_mm / longest_mm;
        if !(1e-6..=1e6).contains(&factor) {
            let text = format!(
                "--size {size_mm}: the part is {} mm long; it may be scaled by 0.000001 to 1000000",
                longest_mm / scale
            );
            return Err(PackError::Option(text));
        }
        if factor <= scale * ROUGH_FACTOR {
            return Ok(factor);
        }
        options.scale = [factor; 3];
    }
}

/// The longest edge of a box in quanta, millimetres.
fn longest_mm(Bounds { min, max }: Bounds, quantum_um: f64) -> f64 {
    let edges = (0..3).map(|axis| i64::from(max[axis]) - i64::from(min[axis]));
    edges.max().unwrap_or(0) as f64 * quantum_um / 1000.0
}

/// The error of a source that is read as it is.
fn unscaled(error: PackError) -> PackError {
    match error {
        PackError::Input { place, problem } => PackError::input(
            place,
            format!(
                "{problem}. --size first reads the source at another scale; if the source is right, give --scale instead"
            ),
        ),
        error => error,
    }
}
