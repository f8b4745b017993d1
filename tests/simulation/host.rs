//! The host: one process of the daemon at a time, in a runtime with a paused clock, on a system of the simulation.

use std::cell::Cell;
use std::collections::BinaryHeap;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Waker;
use std::time::Duration;

use layerd::api::Event;
use layerd::daemon::Daemon;
use layerd::daemon::handle::Handle;
use layerd::system::{Disk, Installed, System, install};
use tokio::sync::{Notify, broadcast, watch};
use tokio::time::Instant;

use crate::disk::{Mount, SimDisk};
use crate::line::Line;
use crate::port::SimPorts;
use crate::rng::Rng;

/// The wall clock at the simulation's begin, milliseconds since 1970.
const WALL_MS: u64 = 1_767_225_600_000;

/// What the host's code reaches from inside: the world's clock, the line, and work that may block.
#[derive(Debug)]
pub(crate) struct Shared {
    /// Something happened that the world must look at.
    pub(crate) attention: Notify,
    pub(crate) line: Mutex<Line>,
    wall_offset_ms: AtomicI64,
    inside: Mutex<Inside>,
}

#[derive(Debug)]
struct Inside {
    reader: Option<Waker>,
    writer: Option<Waker>,
    works: BinaryHeap<Work>,
    /// How many works there were.
    count: u64,
    rng: Rng,
    /// Work takes at least so long, microseconds.
    slow_us: u64,
    /// Work that begins before this time ends only then: the disk hangs.
    hangs_until_us: u64,
    /// Whether the work under way is abandoned when it rests; `None` before that is decided.
    abandons: Option<bool>,
    /// Where the loop itself used the disk, if it did.
    loop_access: Option<String>,
}

/// Work that may block, and when it is done.
struct Work {
    due_us: u64,
    number: u64,
    work: Box<dyn FnOnce() + Send>,
}

impl std::fmt::Debug for Work {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "work {} at {}", self.number, self.due_us)
    }
}

impl Ord for Work {
    /// The earliest is the greatest, for [`BinaryHeap`].
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (other.due_us, other.number).cmp(&(self.due_us, self.number))
    }
}

impl PartialOrd for Work {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Work {
    fn eq(&self, other: &Self) -> bool {
        self.number == other.number
    }
}

impl Eq for Work {}

impl Shared {
    pub(crate) fn new(line: Line, rng: Rng) -> Arc<Self> {
        let inside = Inside {
            reader: None,
            writer: None,
            works: BinaryHeap::new(),
            count: 0,
            rng,
            slow_us: 0,
            hangs_until_us: 0,
            abandons: None,
            loop_access: None,
        };
        Arc::new(Self {
            attention: Notify::new(),
            line: Mutex::new(line),
            wall_offset_ms: AtomicI64::new(0),
            inside: Mutex::new(inside),
        })
    }

    pub(crate) fn line(&self) -> MutexGuard<'_, Line> {
        self.line.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn inside(&self) -> MutexGuard<'_, Inside> {
        self.inside.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Wakes this task when something has arrived.
    pub(crate) fn wait_to_read(&self, waker: &Waker) {
        self.inside().reader = Some(waker.clone());
    }

    /// Wakes this task when the line has room.
    pub(crate) fn wait_to_write(&self, waker: &Waker) {
        self.inside().writer = Some(waker.clone());
    }

    /// The wall clock is set, by so much.
    pub(crate) fn set_wall_clock(&self, by_ms: i64) {
        self.wall_offset_ms.fetch_add(by_ms, Ordering::Relaxed);
    }

    /// From now on every access to the disk takes at least so long.
    pub(crate) fn set_slow(&self, slow_us: u64) {
        self.inside().slow_us = slow_us;
    }

    /// The disk answers nobody before this time.
    pub(crate) fn hang_until(&self, until_us: u64) {
        let mut inside = self.inside();
        inside.hangs_until_us = until_us;
        let works = std::mem::take(&mut inside.works);
        inside.works = works.into_iter().map(|work| Work { due_us: work.due_us.max(until_us), ..work }).collect();
    }

    /// When the next work is done.
    pub(crate) fn next_work_us(&self) -> Option<u64> {
        self.inside().works.peek().map(|work| work.due_us)
    }

    /// Where the loop itself used the disk, if it did since the last call.
    pub(crate) fn take_loop_access(&self) -> Option<String> {
        self.inside().loop_access.take()
    }

    fn due_work(&self, now_us: u64) -> Option<Box<dyn FnOnce() + Send>> {
        let mut inside = self.inside();
        inside.works.peek().filter(|work| work.due_us <= now_us)?;
        inside.works.pop().map(|work| work.work)
    }
}

/// The world's clock as a process reads it: its runtime's clock, which is paused while the process does not run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HostClock {
    started: Instant,
    /// The world's clock when the runtime started.
    started_us: u64,
}

impl HostClock {
    /// Now; called in the runtime.
    pub(crate) fn now_us(self) -> u64 {
        self.started_us + self.started.elapsed().as_micros() as u64
    }

    fn at(self, time_us: u64) -> Instant {
        self.started + Duration::from_micros(time_us - self.started_us)
    }
}

/// One process of the daemon.
pub(crate) struct Host {
    runtime: tokio::runtime::Runtime,
    shared: Arc<Shared>,
    clock: HostClock,
    pub(crate) handle: Handle,
    pub(crate) events: broadcast::Receiver<Event>,
    ending: watch::Sender<bool>,
    asked_to_end: Cell<bool>,
    ended: Arc<Mutex<Option<Result<(), String>>>>,
    system: Rc<HostSystem>,
}

impl Host {
    /// Starts the daemon.
    ///
    /// # Errors
    /// Why it does not start: as an operator reads it.
    pub(crate) fn start(shared: &Arc<Shared>, disk: &SimDisk, config: &Path, now_us: u64) -> Result<Self, String> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build();
        let runtime = runtime.expect("a runtime");
        {
            let mut inside = shared.inside();
            (inside.reader, inside.writer) = (None, None);
        }
        let entered = runtime.enter();
        let clock = HostClock { started: Instant::now(), started_us: now_us };
        let system =
            Rc::new(HostSystem { shared: Arc::clone(shared), mount: disk.mount(), clock, may_block: Cell::new(true) });
        let installed = install(Rc::clone(&system) as Rc<dyn System>);
        let daemon = Daemon::open(config).map_err(|error| format!("{error:#}"))?;
        let handle = daemon.handle();
        let (events, (ending, end)) = (handle.subscribe(), watch::channel(false));
        let ended = Arc::new(Mutex::new(None));
        let (ports, told) = (SimPorts::new(shared, clock), Arc::clone(&ended));
        let wake = Arc::clone(shared);
        runtime.spawn(async move {
            let result = daemon.run(Arc::new(ports), end).await.map_err(|error| format!("{error:#}"));
            *told.lock().unwrap_or_else(PoisonError::into_inner) = Some(result);
            wake.attention.notify_one();
        });
        drop(installed);
        drop(entered);
        system.may_block.set(false);
        Ok(Self {
            asked_to_end: Cell::new(false),
            runtime,
            shared: Arc::clone(shared),
            clock,
            handle,
            events,
            ending,
            ended,
            system,
        })
    }

    /// Installs its system for this thread.
    pub(crate) fn install(&self) -> Installed {
        install(Rc::clone(&self.system) as Rc<dyn System>)
    }

    /// Lets it run until `until_us`, or until it has done something that the world must look at. Returns the time then.
    pub(crate) fn run_until(&self, until_us: u64) -> u64 {
        let _installed = self.install();
        let until = self.clock.at(until_us);
        self.runtime.block_on(async {
            tokio::select! {
                biased;
                () = self.shared.attention.notified() => {}
                () = tokio::time::sleep_until(until) => {}
            }
        });
        self.now_us()
    }

    fn now_us(&self) -> u64 {
        let _entered = self.runtime.enter();
        self.clock.now_us()
    }

    /// It stood still until `now_us`.
    pub(crate) fn stood_still(&self, now_us: u64) {
        let _installed = self.install();
        let for_us = now_us.saturating_sub(self.now_us());
        self.runtime.block_on(tokio::time::advance(Duration::from_micros(for_us)));
    }

    /// Does the next work that is due.
    pub(crate) fn work(&self, now_us: u64) {
        let Some(work) = self.shared.due_work(now_us) else { return };
        let _installed = self.install();
        let _entered = self.runtime.enter();
        self.shared.inside().abandons = None;
        self.system.may_block.set(true);
        let done = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
        self.system.may_block.set(false);
        if let Err(panic) = done
            && !panic.is::<Abandoned>()
        {
            std::panic::resume_unwind(panic);
        }
    }

    /// Wakes those who wait for the line.
    pub(crate) fn wake_line(&self) {
        let mut inside = self.shared.inside();
        let wakers = [inside.reader.take(), inside.writer.take()];
        drop(inside);
        wakers.into_iter().flatten().for_each(Waker::wake);
    }

    /// Asks it to end, as a signal does.
    pub(crate) fn end(&self) {
        self.asked_to_end.set(true);
        let _ = self.ending.send(true);
    }

    /// Whether [`Self::end`] was called.
    pub(crate) fn was_asked_to_end(&self) -> bool {
        self.asked_to_end.get()
    }

    /// How it ended, if it did.
    pub(crate) fn ended(&self) -> Option<Result<(), String>> {
        self.ended.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Runs a client of it.
    pub(crate) fn spawn(&self, client: impl Future<Output = ()> + Send + 'static) {
        self.runtime.spawn(client);
    }

    /// Ends the process at once. The disk must be told before, so that what is dropped here has no effect on it.
    pub(crate) fn drop_dead(self) {
        let _installed = install(Rc::clone(&self.system) as Rc<dyn System>);
        self.system.may_block.set(true);
        let works = std::mem::take(&mut self.shared.inside().works);
        drop(works);
        drop(self.runtime);
    }
}

/// The panic of work that is made to fail.
struct Abandoned;

/// The system under the daemon.
struct HostSystem {
    shared: Arc<Shared>,
    mount: Mount,
    clock: HostClock,
    /// Whether the code that runs now may wait for the disk.
    may_block: Cell<bool>,
}

impl System for HostSystem {
    fn unix_ms(&self) -> u64 {
        (WALL_MS + self.clock.now_us() / 1000).saturating_add_signed(self.shared.wall_offset_ms.load(Ordering::Relaxed))
    }

    fn random_bits(&self) -> u64 {
        self.shared.inside().rng.next_u64()
    }

    fn disk(&self) -> &dyn Disk {
        if !self.may_block.get() {
            let place = std::backtrace::Backtrace::force_capture().to_string();
            self.shared.inside().loop_access.get_or_insert(place);
        }
        &self.mount
    }

    fn spawn_blocking(&self, work: Box<dyn FnOnce() + Send>) {
        let now_us = self.clock.now_us();
        let mut inside = self.shared.inside();
        let takes_us = 20 + inside.rng.below(3_000) + inside.slow_us;
        let due_us = (now_us + takes_us).max(inside.hangs_until_us);
        inside.count += 1;
        let number = inside.count;
        inside.works.push(Work { due_us, number, work });
        self.shared.attention.notify_one();
    }

    /// Only the sampling of resin rests. Nothing waits for it and it takes a third of a run's time, so most of it fails at once.
    fn rest(&self, _time: Duration) {
        let mut inside = self.shared.inside();
        let is_to_fail = inside.rng.below(16) > 0;
        let fails = *inside.abandons.get_or_insert(is_to_fail);
        drop(inside);
        if fails {
            std::panic::resume_unwind(Box::new(Abandoned));
        }
    }
}

/// Where the daemon finds its configuration.
pub(crate) fn config_path() -> PathBuf {
    "/etc/layerd/layerd.toml".into()
}
