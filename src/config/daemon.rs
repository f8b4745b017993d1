//! The daemon's own settings, `config/layerd.toml`. `tests/shipped_config.rs` loads it.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::{ConfigError, OutOfRange, parse, read_text, within};
use crate::text::size_text;

/// Settings of `layerd`. Relative paths are relative to the directory of the file.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DaemonConfig {
    /// Control socket; default `/run/layerd/control.sock`.
    #[serde(default = "default_socket")]
    pub socket: PathBuf,
    /// Directory of jobs and journals; default `/var/lib/layerd`.
    #[serde(default = "default_spool")]
    pub spool: PathBuf,
    /// Ceiling of the print path's memory, e.g. `"96MiB"`; default 64 MiB.
    #[serde(with = "byte_size", default = "default_memory_budget")]
    pub memory_budget: u64,
    /// Most threads that compute layers; default one per core. A job takes fewer if the budget is short.
    #[serde(default)]
    pub threads: Option<usize>,
    /// Machine file.
    pub machine: PathBuf,
    /// Recipe file for jobs that name none.
    pub recipe: PathBuf,
}

/// Default path of the control socket.
pub const DEFAULT_SOCKET: &str = "/run/layerd/control.sock";
/// Default directory of jobs and journals.
pub const DEFAULT_SPOOL: &str = "/var/lib/layerd";

fn default_socket() -> PathBuf {
    DEFAULT_SOCKET.into()
}

fn default_spool() -> PathBuf {
    DEFAULT_SPOOL.into()
}

/// Smallest memory budget. Below it not even a small picture and the line's buffers fit.
pub const MIN_BUDGET_BYTES: u64 = 8 << 20;

/// Most threads: more than the cores of any host that drives a printer.
pub const MAX_THREADS: usize = 256;

fn default_memory_budget() -> u64 {
    64 << 20
}

impl DaemonConfig {
    /// Reads and checks the daemon's file.
    ///
    /// # Errors
    /// [`ConfigError`] names file, key, value and the allowed range.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let mut config = parse(path, &read_text(path)?, Self::check)?;
        let directory = path.parent().unwrap_or(Path::new("."));
        for file in [&mut config.socket, &mut config.spool, &mut config.machine, &mut config.recipe] {
            *file = directory.join(&*file);
        }
        Ok(config)
    }

    fn check(&self) -> Vec<OutOfRange> {
        let is_in_range = (MIN_BUDGET_BYTES..=1 << 40).contains(&self.memory_budget);
        let budget = (!is_in_range).then(|| OutOfRange {
            key: "memory_budget".into(),
            value: size_text(self.memory_budget),
            allowed: format!("{}MiB to 1024GiB", MIN_BUDGET_BYTES >> 20),
        });
        let threads = within("threads", self.threads.unwrap_or(1), 1, MAX_THREADS);
        budget.into_iter().chain(threads).collect()
    }
}

/// Sizes such as `64MiB`.
pub mod byte_size {
    use serde::{Deserialize, Deserializer, de::Error};

    /// Parses `"4096"`, `"64KiB"`, `"64MiB"`, `"2GiB"`.
    ///
    /// # Errors
    /// A text that says what was found and what is expected.
    pub fn parse(text: &str) -> Result<u64, String> {
        let trimmed = text.trim();
        let digits = trimmed.trim_end_matches(|c: char| !c.is_ascii_digit());
        let unit = match trimmed[digits.len()..].trim() {
            "" | "B" => 0,
            "KiB" | "K" => 10,
            "MiB" | "M" => 20,
            "GiB" | "G" => 30,
            _ => {
                return Err(format!(
                    "`{text}` is not a size; write bytes or a number with KiB, MiB or GiB, such as 64MiB"
                ));
            }
        };
        let count: u64 = digits.parse().map_err(|_| format!("`{text}` is not a size; write for example 64MiB"))?;
        count.checked_mul(1 << unit).ok_or_else(|| format!("`{text}` is too large"))
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
        parse(&String::deserialize(deserializer)?).map_err(D::Error::custom)
    }
}
