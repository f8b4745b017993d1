//! A daemon but for its sockets, signals and systemd: its configuration, its jobs, and the printer's loop with its line.
//! `run` serves one; `tests/simulation/` runs one in virtual time.

use std::path::Path;
use std::sync::Arc;

use tokio::sync::watch;

use crate::api::{BudgetView, DeviceView, LineView, LinkState, LinkView};
use crate::daemon::handle::{self, Desk, Handle, Snapshot};
use crate::daemon::jobs::Jobs;
use crate::daemon::machine::line::LineHandle;
use crate::daemon::machine::raised::RaisedNote;
use crate::daemon::printer::Printer;
use crate::daemon::setting::Setting;
use crate::job::Spool;
use crate::link::Ports;
use crate::stream::MemoryBudget;

/// A daemon that holds its spool, and does not run yet.
#[derive(Debug)]
pub struct Daemon {
    setting: Setting,
    spool: Spool,
    raised: RaisedNote,
    jobs: Jobs,
    handle: Handle,
    desk: Desk,
}

impl Daemon {
    /// Reads the configuration file `place` and the files that it names, and opens the spool. It does not make the checks of a start.
    ///
    /// # Errors
    /// What is wrong with these files, or with the spool.
    pub fn open(place: &Path) -> anyhow::Result<Self> {
        let setting = Setting::load(place, Setting::config(place)?);
        Self::new(setting.map_err(|errors| anyhow::anyhow!(together(&errors)))?)
    }

    /// Opens the spool.
    ///
    /// # Errors
    /// [`SpoolError`](crate::job::SpoolError).
    pub(super) fn new(setting: Setting) -> anyhow::Result<Self> {
        let spool = Spool::open(&setting.config.spool)?;
        let jobs = Jobs::load(spool.jobs()?, spool.forgotten()?, setting.machine.confirm_plate());
        let (handle, desk) = handle::channel(first_snapshot(&setting, &jobs));
        let raised = RaisedNote::load(&spool);
        Ok(Self { setting, spool, raised, jobs, handle, desk })
    }

    /// Gives orders to it, and tells its state.
    pub fn handle(&self) -> Handle {
        self.handle.clone()
    }

    /// Runs until `ending` becomes true and the machine is safe. The line is opened with `ports`.
    ///
    /// # Errors
    /// The machine could not be made safe, or the line's task ended with a panic.
    pub async fn run(self, ports: Arc<dyn Ports>, ending: watch::Receiver<bool>) -> anyhow::Result<()> {
        let Self { setting, spool, raised, jobs, handle, desk } = self;
        // The printer sees when nobody can give orders any more.
        drop(handle);
        let budget = MemoryBudget::new(setting.config.memory_budget);
        let line = LineHandle::start(&setting.machine, ports);
        Printer::new(Arc::new(setting), spool, raised, jobs, budget, desk, line).run(ending).await
    }
}

/// Several errors as one text.
pub(super) fn together(errors: &[anyhow::Error]) -> String {
    let errors: Vec<_> = errors.iter().map(|error| format!("{error:#}")).collect();
    errors.join("\nerror: ")
}

fn first_snapshot(setting: &Setting, jobs: &Jobs) -> Snapshot {
    let path = setting.machine.link().path.display().to_string();
    Snapshot {
        machine: setting.machine.name().into(),
        link: LinkView { state: LinkState::Connecting, path, device: None, reason: None },
        device: DeviceView::default(),
        budget: BudgetView::default(),
        line: LineView::default(),
        jobs_ended: 0,
        fit: None,
        jobs: jobs.views(),
    }
}
