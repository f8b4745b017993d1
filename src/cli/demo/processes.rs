//! The demo's processes: this program with other arguments. They end with the demo, however it ends. `cli/demo.rs` starts them.

use std::ffi::OsStr;
use std::fs::File;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use rustix::process::{Pid, Signal, kill_process};

/// How long a process may take to make its machine safe and end before it is killed.
const GRACE: Duration = Duration::from_secs(5);

/// Processes that are ended when this is dropped, the last one first.
#[derive(Default)]
pub(super) struct Children(Vec<(&'static str, Child)>);

impl Children {
    /// Adds a process; `name` is for messages.
    pub(super) fn add(&mut self, name: &'static str, child: Child) {
        self.0.push((name, child));
    }

    /// Fails if one has ended.
    pub(super) fn check(&mut self) -> anyhow::Result<()> {
        for (name, child) in &mut self.0 {
            if let Some(status) = child.try_wait().with_context(|| format!("cannot ask after {name}"))? {
                bail!("{name} ended early: {status}");
            }
        }
        Ok(())
    }
}

impl Drop for Children {
    fn drop(&mut self) {
        while let Some((_, mut child)) = self.0.pop() {
            end(&mut child);
        }
    }
}

/// Asks a process to end, and kills it if it does not.
fn end(child: &mut Child) {
    let began = Instant::now();
    if let Some(pid) = i32::try_from(child.id()).ok().and_then(Pid::from_raw) {
        // Not yet waited for, so the id is still the child's.
        let _ = kill_process(pid, Signal::TERM);
    }
    while began.elapsed() < GRACE {
        if !matches!(child.try_wait(), Ok(None)) {
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    let _ = child.kill();
    let _ = child.wait();
}

/// Runs this program with other arguments to its end. Its own messages say what went wrong.
pub(super) fn run_self(arguments: &[&OsStr]) -> anyhow::Result<()> {
    let mut command = this_program()?;
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::null());
    let status = command.status().context("cannot start layerctl")?;
    if !status.success() {
        bail!("this failed ({status}): {command:?}");
    }
    Ok(())
}

/// Starts this program with other arguments in the background; its output goes to `log`.
pub(super) fn spawn_self(arguments: &[&OsStr], log: &Path) -> anyhow::Result<Child> {
    let writing = || format!("cannot write {}", log.display());
    let stderr = File::create(log).with_context(writing)?;
    let stdout = stderr.try_clone().with_context(writing)?;
    let mut command = this_program()?;
    command.args(arguments).stdin(Stdio::null()).stdout(stdout).stderr(stderr);
    command.spawn().with_context(|| format!("cannot start {command:?}"))
}

fn this_program() -> anyhow::Result<Command> {
    Ok(Command::new(std::env::current_exe().context("cannot find this program's own file")?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn children_end_with_their_owner_and_a_dead_one_is_noticed() {
        let mut children = Children::default();
        let sleeper = Command::new("sleep").arg("600").spawn().unwrap();
        let pid = Pid::from_child(&sleeper);
        children.add("sleeper", sleeper);
        children.check().unwrap();
        let began = Instant::now();
        children.add("brief", Command::new("true").spawn().unwrap());
        while children.check().is_ok() {
            assert!(began.elapsed() < Duration::from_secs(10), "the end of `true` goes unnoticed");
            std::thread::sleep(Duration::from_millis(5));
        }
        assert!(children.check().unwrap_err().to_string().contains("brief"));
        drop(children);
        assert!(rustix::process::test_kill_process(pid).is_err(), "the sleeper is gone");
    }
}
