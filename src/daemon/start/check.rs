//! `layerd --check`: checks what a start needs, changes nothing, and reports everything it finds. A start makes the same checks
//! first, with the same texts. `tests/check_start.rs` shows every text.

use std::io::{ErrorKind, Write};
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

use rustix::fs::{Access, access};

use super::descriptors;
use crate::config::{DEFAULT_SOCKET, DEFAULT_SPOOL, Machine};
use crate::daemon::http::socket::{self, BindError};
use crate::daemon::setting::Setting;
use crate::disk::{self, File, How};
use crate::link::transport::{OpenError, denied};
use crate::pipeline::PrintMemory;
use crate::text::{shell_word, size_text};

/// Memory of the program besides its memory budget; `ARCHITECTURE.md` lists what it is for.
const BESIDE_BUDGET_BYTES: u64 = 24 << 20;

/// What a check found.
#[derive(Debug, Default)]
pub struct Findings {
    /// What keeps the daemon from starting. Each names the fault, its place, and what to do.
    pub errors: Vec<String>,
    /// What lets it start but keeps it from printing now.
    pub warnings: Vec<String>,
    /// Names of machine and recipe, if both could be read.
    pub summary: Option<String>,
}

/// Checks what a start with the configuration file `place` needs.
pub fn check(place: &Path) -> Findings {
    let mut findings = Findings::default();
    let config = match Setting::config(place) {
        Ok(config) => config,
        Err(error) => {
            findings.errors.push(format!("{error:#}"));
            return findings;
        }
    };
    findings.socket(&config.socket, place);
    findings.spool(&config.spool, place);
    findings.errors.extend(descriptors::check().err());
    match Setting::load(place, config) {
        Ok(setting) => {
            findings.machine(&setting);
            findings.summary =
                Some(format!("machine `{}`, recipe `{}`", setting.machine.name(), setting.recipe.name()));
        }
        Err(errors) => findings.errors.extend(errors.iter().map(|error| format!("{error:#}"))),
    }
    findings
}

/// The checks of a start, once the configuration is read.
pub(crate) fn before_start(setting: &Setting, place: &Path) -> Findings {
    let mut findings = Findings::default();
    // Unlike in `check`, systemd has made its directories by now.
    findings.errors.extend(socket::check(&setting.config.socket).err().map(|error| named("socket", place, &error)));
    match spool(&setting.config.spool) {
        Ok(()) => findings.room(&setting.config.spool, place),
        Err(error) => findings.errors.push(named("spool", place, &error.text())),
    }
    findings.errors.extend(descriptors::reserve().err());
    findings.machine(setting);
    findings
}

fn named(key: &str, place: &Path, what: &dyn std::fmt::Display) -> String {
    format!("`{key}` in {}: {what}", place.display())
}

impl Findings {
    fn socket(&mut self, path: &Path, place: &Path) {
        match socket::check(path) {
            Ok(()) => {}
            // Only a warning: before the service's first start this directory does not exist yet.
            Err(error @ BindError::NoDirectory(_)) if path == Path::new(DEFAULT_SOCKET) => {
                self.warnings.push(format!("{} (the service makes it when it starts)", named("socket", place, &error)));
            }
            Err(error) => self.errors.push(named("socket", place, &error)),
        }
    }

    fn spool(&mut self, path: &Path, place: &Path) {
        match spool(path) {
            Ok(()) => {
                self.room(path, place);
                if is_held(path) {
                    let text = format!("another layerd uses {} now, and a second one does not start", path.display());
                    self.warnings.push(named("spool", place, &text));
                }
            }
            Err(error @ SpoolFault::Missing(_)) if path == Path::new(DEFAULT_SPOOL) => {
                let text = named("spool", place, &error.text());
                self.warnings.push(format!("{text} (the service makes it when it starts)"));
            }
            Err(error) => self.errors.push(named("spool", place, &error.text())),
        }
    }

    /// A full disk keeps no daemon from starting: jobs may be there whose plate must be lifted.
    fn room(&mut self, path: &Path, place: &Path) {
        if let Ok(free_bytes) = disk::free_bytes(path)
            && free_bytes < disk::RESERVE_BYTES
        {
            let text = format!(
                "only {} are free in {}, and {} are kept in reserve: no job can be taken until there is room (`layerctl remove \
                 JOB` deletes jobs that are over)",
                size_text(free_bytes),
                path.display(),
                size_text(disk::RESERVE_BYTES)
            );
            self.warnings.push(named("spool", place, &text));
        }
    }

    fn machine(&mut self, setting: &Setting) {
        let (config, machine) = (&setting.config, &setting.machine);
        let place = config.machine.display();
        if let Some(error) = port(machine) {
            let text = format!("`link.path` in {place}: {error}");
            match error {
                // Waiting does not help.
                OpenError::NotATerminal(_) => self.errors.push(text),
                _ => self.warnings.push(format!("{text}; the daemon starts and waits for it")),
            }
        }
        if machine.time_scale() != 1.0 {
            self.warnings.push(format!(
                "`time_scale` in {place} is {}: the host accepts exposures and moves that are shorter by this factor. Only a \
                 simulated device needs that; remove the line for a real one",
                machine.time_scale()
            ));
        }
        if machine.grbl().is_some() {
            self.warnings.push(format!(
                "the line to a grbl controller (`link.protocol` in {place}) has no checksum: a byte that is lost or changed on it can spoil \
                 a mark without notice. Use a short shielded cable, and flow_control = \"rts_cts\" if the controller has it"
            ));
        }
        let raster = machine.raster();
        let (width_px, height_px) = (raster.width_px, raster.height_px);
        let need_bytes = PrintMemory::min_bytes(machine);
        if need_bytes > config.memory_budget {
            self.warnings.push(format!(
                "`memory_budget` of {} is less than the {} that one layer of {width_px} x {height_px} pixels takes: every job will be refused; \
                 raise it",
                size_text(config.memory_budget),
                size_text(need_bytes),
            ));
        }
        let whole_bytes = config.memory_budget.saturating_add(BESIDE_BUDGET_BYTES);
        if let Some((limit_bytes, of)) = memory_limit().filter(|(limit_bytes, _)| *limit_bytes < whole_bytes) {
            self.warnings.push(format!(
                "`memory_budget` of {} and {} beside it are more than the {} {of}: lower the budget or raise that",
                size_text(config.memory_budget),
                size_text(BESIDE_BUDGET_BYTES),
                size_text(limit_bytes)
            ));
        }
    }
}

/// What is wrong with a spool.
enum SpoolFault {
    /// It is not there and cannot be made.
    Missing(String),
    /// It cannot be used.
    Unusable(String),
}

impl SpoolFault {
    fn text(self) -> String {
        match self {
            Self::Missing(text) | Self::Unusable(text) => text,
        }
    }
}

/// Checks that files can be made in a spool and its directories. Does not take the lock.
fn spool(root: &Path) -> Result<(), SpoolFault> {
    if !root.exists() {
        return can_be_made(root);
    }
    for directory in [root.to_path_buf(), root.join("jobs"), root.join("incoming")] {
        if !directory.exists() {
            continue;
        }
        let fault = |what: String| {
            let text = format!(
                "{what}: give it and all in it to the user layerd runs as (chown -R USER {}), or name another directory",
                shell_word(&root.to_string_lossy())
            );
            SpoolFault::Unusable(text)
        };
        if !directory.is_dir() {
            return Err(fault(format!("{} is not a directory", directory.display())));
        }
        let is_full =
            |error: &std::io::Error| matches!(error.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded);
        match tempfile::NamedTempFile::with_prefix_in(".check-", &directory)
            .and_then(|mut file| file.write_all(b"layerd"))
        {
            Ok(()) => {}
            // A spool that was used before needs no room to be opened.
            Err(error) if is_full(&error) && root.join("lock").exists() => {}
            Err(error) if is_full(&error) => {
                let text = format!("no file can be written in {} ({error}): make room", directory.display());
                return Err(SpoolFault::Unusable(text));
            }
            Err(error) => {
                let kind = error.kind();
                return Err(fault(format!("this user cannot make files in {} ({kind})", directory.display())));
            }
        }
    }
    let lock = root.join("lock");
    match access(&lock, Access::WRITE_OK) {
        Err(error) if error != rustix::io::Errno::NOENT => Err(SpoolFault::Unusable(format!(
            "this user may not write {} ({}): give it to the user layerd runs as",
            lock.display(),
            std::io::Error::from(error).kind()
        ))),
        _ => Ok(()),
    }
}

/// Whether a daemon holds the spool at this moment.
fn is_held(root: &Path) -> bool {
    let lock = File::open(&root.join("lock"), How::ReadWrite);
    lock.is_ok_and(|lock| matches!(lock.try_lock(), Err(std::fs::TryLockError::WouldBlock)))
}

fn can_be_made(root: &Path) -> Result<(), SpoolFault> {
    let Some(above) = root.ancestors().skip(1).find(|above| above.exists() || *above == Path::new("")) else {
        return Ok(());
    };
    let above = if above == Path::new("") { Path::new(".") } else { above };
    if above.is_dir() && access(above, Access::WRITE_OK | Access::EXEC_OK).is_ok() {
        return Ok(());
    }
    Err(SpoolFault::Missing(format!(
        "{} does not exist, and this user may not make it in {}: make it, and give it to the user layerd runs as",
        root.display(),
        above.display()
    )))
}

/// What would keep the port from being opened. Does not open it: that resets many boards.
fn port(machine: &Machine) -> Option<OpenError> {
    let path = &machine.link().path;
    match std::fs::metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Some(OpenError::Missing(path.clone())),
        Err(error) if error.kind() == ErrorKind::PermissionDenied => Some(denied(path)),
        Err(error) => Some(OpenError::Other { path: path.clone(), reason: error.to_string() }),
        Ok(metadata) if !metadata.file_type().is_char_device() => Some(OpenError::NotATerminal(path.clone())),
        Ok(_) if access(path, Access::READ_OK | Access::WRITE_OK).is_err() => Some(denied(path)),
        Ok(_) => None,
    }
}

/// The lowest limit on this process's memory, bytes, and what sets it, as far as that can be read.
fn memory_limit() -> Option<(u64, &'static str)> {
    let group = std::fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    let group = group.lines().find_map(|line| line.strip_prefix("0::/")).unwrap_or_default();
    let of_group = std::fs::read_to_string(Path::new("/sys/fs/cgroup").join(group).join("memory.max"));
    let of_group = of_group.ok().and_then(|text| Some((text.trim().parse().ok()?, "its MemoryMax allows")));
    // /proc/meminfo may be missing in a sandboxed service.
    let system = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let of_system = system.lines().find_map(|line| {
        let kibibytes: u64 = line.strip_prefix("MemTotal:")?.trim().strip_suffix(" kB")?.parse().ok()?;
        Some((kibibytes << 10, "this host has"))
    });
    of_group.into_iter().chain(of_system).min_by_key(|(bytes, _)| *bytes)
}
