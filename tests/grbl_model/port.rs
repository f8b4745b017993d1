//! The machine on a pseudo-terminal, in a thread, on the real clock.

use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use layerd::device::sim::Pty;

use super::facts::Facts;
use super::machine::Machine;
use super::options::{Fault, Options};

/// Bytes on the line behind those that arrived: what a serial port's own buffers hold.
const LINE_BYTES: usize = 64;
/// Answers that nobody reads. Beyond, they are lost.
const MAX_UNREAD_BYTES: usize = 64 * 1024;
/// How often the line is looked at.
const LOOK: Duration = Duration::from_micros(400);

/// A machine with a grbl controller at a serial port. It ends when it is dropped.
pub struct GrblModel {
    port: PathBuf,
    shared: Arc<Mutex<Shared>>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    machine: Machine,
    ends: bool,
    /// The port is to vanish, and to come back after so many ms, if ever.
    unplugs: Option<Option<u64>>,
}

impl GrblModel {
    /// Starts a machine whose port is the symlink `port`. It is there when this returns.
    pub fn start(port: &Path, options: Options) -> Self {
        let speed_up = options.speed_up;
        let byte_us = 10.0 * 1e6 / f64::from(options.baud);
        let pty = Pty::open(port).expect("a pseudo-terminal");
        let shared = Arc::new(Mutex::new(Shared { machine: Machine::new(options), ends: false, unplugs: None }));
        let line = Line {
            path: port.to_owned(),
            pty: Some(pty),
            comes_back: None,
            arriving: Vec::new(),
            unread: Vec::new(),
            began: Instant::now(),
            speed_up,
            byte_us,
            next_us: 0.0,
        };
        let for_thread = Arc::clone(&shared);
        let thread = std::thread::spawn(move || line.run(&for_thread));
        Self { port: port.to_owned(), shared, thread: Some(thread) }
    }

    /// The port, as a path to open.
    pub fn port(&self) -> &Path {
        &self.port
    }

    fn shared(&self) -> std::sync::MutexGuard<'_, Shared> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What happened so far.
    pub fn facts(&self) -> Facts {
        self.shared().machine.facts()
    }

    /// Lets something go wrong. It counts from now.
    pub fn inject(&self, fault: Fault) {
        self.shared().machine.trouble.arm(fault);
    }

    /// Takes all faults away. A port that vanished stays away.
    pub fn heal(&self) {
        self.shared().machine.trouble.clear();
    }

    /// Pulls the plug of the port now. Power stays on. After `back_after_ms` of real time the port is there again, if ever.
    pub fn unplug(&self, back_after_ms: Option<u64>) {
        self.shared().unplugs = Some(back_after_ms);
    }

    /// Power goes and comes back now.
    pub fn power_cycle(&self) {
        self.shared().machine.lose_power();
    }

    /// Waits until `is_so` of the facts, at most so long. The facts then, whatever they are.
    pub fn wait(&self, longest: Duration, is_so: impl Fn(&Facts) -> bool) -> Facts {
        let until = Instant::now() + longest;
        loop {
            let facts = self.facts();
            if is_so(&facts) || Instant::now() > until {
                return facts;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

impl Drop for GrblModel {
    fn drop(&mut self) {
        self.shared().ends = true;
        if let Some(thread) = self.thread.take() {
            let ended = thread.join();
            assert!(ended.is_ok() || std::thread::panicking(), "the model panicked");
        }
    }
}

/// The port's side of the thread.
struct Line {
    path: PathBuf,
    pty: Option<Pty>,
    comes_back: Option<Instant>,
    /// Bytes on their way to the machine.
    arriving: Vec<u8>,
    /// Bytes that the host did not take yet.
    unread: Vec<u8>,
    began: Instant,
    speed_up: f64,
    /// A byte takes so long on the line, on the machine's clock.
    byte_us: f64,
    /// When the line is free for the next byte.
    next_us: f64,
}

impl Line {
    fn run(mut self, shared: &Mutex<Shared>) {
        loop {
            {
                let mut shared = shared.lock().unwrap_or_else(PoisonError::into_inner);
                if shared.ends {
                    return;
                }
                let unplugs = shared.unplugs.take().or_else(|| shared.machine.trouble.disconnects());
                if let Some(back_after_ms) = unplugs {
                    self.unplug(back_after_ms);
                }
                self.turn(&mut shared.machine);
            }
            std::thread::sleep(LOOK);
        }
    }

    fn unplug(&mut self, back_after_ms: Option<u64>) {
        self.pty = None;
        self.arriving.clear();
        self.unread.clear();
        self.comes_back = back_after_ms.map(|ms| Instant::now() + Duration::from_millis(ms));
    }

    fn turn(&mut self, machine: &mut Machine) {
        if self.comes_back.is_some_and(|at| Instant::now() >= at) {
            self.comes_back = None;
            self.pty = Some(Pty::open(&self.path).expect("a pseudo-terminal"));
        }
        let now_us = self.began.elapsed().as_secs_f64() * 1e6 * self.speed_up;
        if self.arriving.is_empty() {
            // Bytes that are there now may have come at any time since the last look, which can be long ago on a busy host. They count
            // from now on, so that nothing is done before it was asked for.
            self.next_us = self.next_us.max(now_us);
        }
        loop {
            self.read();
            if self.arriving.is_empty() {
                break;
            }
            let mut done = 0;
            while done < self.arriving.len() && self.next_us + self.byte_us <= now_us {
                self.next_us += self.byte_us;
                machine.receive(self.next_us as u64, self.arriving[done]);
                done += 1;
            }
            self.arriving.drain(..done);
            if done == 0 {
                break;
            }
        }
        machine.advance(now_us as u64);
        self.unread.extend(machine.take_output());
        self.write();
    }

    /// Takes bytes of the host, no more than a line holds: the rest waits with the host.
    fn read(&mut self) {
        let Some(pty) = &self.pty else { return };
        let mut bytes = [0; LINE_BYTES];
        let room = LINE_BYTES - self.arriving.len().min(LINE_BYTES);
        if let Ok(read) = rustix::io::read(pty.as_fd(), &mut bytes[..room]) {
            self.arriving.extend_from_slice(&bytes[..read]);
        }
    }

    fn write(&mut self) {
        let Some(pty) = &self.pty else { return self.unread.clear() };
        while !self.unread.is_empty() {
            match rustix::io::write(pty.as_fd(), &self.unread) {
                Ok(written) if written > 0 => drop(self.unread.drain(..written)),
                _ => break,
            }
        }
        self.unread.truncate(MAX_UNREAD_BYTES);
    }
}
