//! A host for tests of controllers, model or real: it writes bytes and waits for lines.

use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::{Duration, Instant};

use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

/// Longest wait for one answer. A real controller may need 0.5 s after an alarm.
const PATIENCE: Duration = Duration::from_secs(10);

/// An open port.
pub struct Host {
    file: File,
    text: Vec<u8>,
}

impl Host {
    /// Opens a port in raw mode.
    pub fn open(port: &Path) -> Self {
        let flags = libc::O_NONBLOCK | libc::O_NOCTTY;
        let file = File::options().read(true).write(true).custom_flags(flags).open(port).expect("the port opens");
        let mut modes = tcgetattr(&file).expect("a terminal");
        modes.make_raw();
        tcsetattr(&file, OptionalActions::Now, &modes).expect("raw mode");
        Self { file, text: Vec::new() }
    }

    /// Writes bytes.
    pub fn send(&mut self, bytes: impl AsRef<[u8]>) {
        let mut rest = bytes.as_ref();
        let until = Instant::now() + PATIENCE;
        while !rest.is_empty() {
            match self.file.write(rest) {
                Ok(written) => rest = &rest[written..],
                Err(error) if error.kind() == ErrorKind::WouldBlock => std::thread::sleep(Duration::from_millis(1)),
                Err(error) => panic!("the port: {error}"),
            }
            assert!(Instant::now() < until, "the port takes no bytes");
        }
    }

    /// The next line without its end, if one comes in time. Empty lines are left out.
    pub fn line(&mut self, longest: Duration) -> Option<String> {
        let until = Instant::now() + longest;
        loop {
            if let Some(end) = self.text.iter().position(|byte| *byte == b'\n') {
                let line: Vec<u8> = self.text.drain(..=end).collect();
                let line = String::from_utf8_lossy(&line).trim_end().to_owned();
                if line.is_empty() {
                    continue;
                }
                return Some(line);
            }
            let mut bytes = [0; 512];
            match self.file.read(&mut bytes) {
                Ok(read) if read > 0 => {
                    self.text.extend_from_slice(&bytes[..read]);
                    continue;
                }
                Err(error) if error.kind() != ErrorKind::WouldBlock => return None,
                _ => {}
            }
            if Instant::now() > until {
                return None;
            }
            std::thread::sleep(Duration::from_micros(500));
        }
    }

    /// All lines up to the first that starts like this, with it.
    pub fn until(&mut self, start: &str) -> Vec<String> {
        let mut lines = Vec::new();
        loop {
            let Some(line) = self.line(PATIENCE) else { panic!("no `{start}` after {lines:?}") };
            let is_last = line.starts_with(start);
            lines.push(line);
            if is_last {
                return lines;
            }
        }
    }

    /// Sends a line. What comes up to its `ok` or error, with it.
    pub fn ask(&mut self, line: &str) -> Vec<String> {
        self.send(format!("{line}\n"));
        let mut lines = Vec::new();
        loop {
            let Some(answer) = self.line(PATIENCE) else { panic!("`{line}` got only {lines:?}") };
            let is_last = answer == "ok" || answer.starts_with("error:");
            lines.push(answer);
            if is_last {
                return lines;
            }
        }
    }

    /// How a line is answered at last: `ok` or an error.
    pub fn answer(&mut self, line: &str) -> String {
        self.ask(line).pop().unwrap_or_default()
    }

    /// A status report.
    pub fn status(&mut self) -> String {
        self.send("?");
        self.until("<").pop().unwrap_or_default()
    }

    /// A field of a status report, as `MPos`; the state is the field ``.
    pub fn field(report: &str, name: &str) -> Option<String> {
        let inside = report.strip_prefix('<')?.strip_suffix('>')?;
        if name.is_empty() {
            return inside.split('|').next().map(str::to_owned);
        }
        let value = inside.split('|').find_map(|field| field.strip_prefix(name)?.strip_prefix(':'));
        value.map(str::to_owned)
    }

    /// Waits until a status report has this state.
    pub fn wait_for_state(&mut self, state: &str) -> String {
        let until = Instant::now() + PATIENCE;
        loop {
            let report = self.status();
            if Self::field(&report, "").is_some_and(|found| found == state) {
                return report;
            }
            assert!(Instant::now() < until, "no `{state}`: {report}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// Nothing comes for a while.
    pub fn is_quiet(&mut self, longest: Duration) -> bool {
        self.line(longest).is_none()
    }
}
