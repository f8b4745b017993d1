//! The life of a job: its states, its journal, and the engine that decides what happens next.
//!
//! [`Engine`] does no I/O and reads no clock: the daemon carries out its [`Action`]s and passes it [`Event`]s. What the machine
//! does between two layers is decided in `cycle/`, by kind of machine.
//!
//! ```
//! # use std::path::Path;
//! # use layerd::config::{Machine, Recipe};
//! use layerd::job::{Action, Engine, Event, JobPlan, Limits, Process, Record, StartPoint};
//! use layerd::device::Passes;
//! use layerd::link::message::DeviceState;
//!
//! # let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
//! # let machine = Machine::load(&root.join("machines/lcd-4k-35um.toml"))?;
//! # let recipe = Recipe::load(&root.join("recipes/fine.toml"))?;
//! let process = Process::new(&machine, &recipe).expect("a vat");
//! let plan = JobPlan { key: 7, passes: Passes::single(100), time_scale: machine.time_scale(), process };
//! let mut engine = Engine::new(plan, StartPoint::default());
//! engine.handle(Event::Ready, 0);
//! let state = DeviceState { boot_id: 1, slots: vec![None, None], ..DeviceState::default() };
//! let limits = Limits { max_position_um: 200_000, max_exposure_ms: 120_000 };
//! engine.handle(Event::Connected { state, limits }, 1000);
//! assert_eq!(engine.next_action(), Some(Action::Journal(Record::Started { exposure: 0 })));
//! assert_eq!(engine.next_action(), None, "nothing moves before the record is on disk");
//! engine.handle(Event::Journalled, 6000);
//! assert!(matches!(engine.next_action(), Some(Action::Act { .. })));
//! # Ok::<(), layerd::config::ConfigError>(())
//! ```

mod cycle;
mod engine;
mod event;
mod fate;
mod history;
mod journal;
mod plan;
mod record;
mod spool;
mod state;

pub use cycle::{LEFTOVER_MS, Limits, PowderPlan, VatPlan};
pub use engine::{ACT_MARGIN_US, Engine};
pub use event::{Action, Command, Event, Progress};
pub use fate::{Fate, fate};
pub use history::{Contradiction, History, ResumeChoice, ResumeError, StartPoint};
pub use journal::{Entries, Entry, Journal, JournalError, read_journal};
pub use plan::{JobPlan, Process};
pub use record::{EndOrder, Record, Trace, Unconfirmed};
pub use spool::{
    Forgotten, JobDirectory, MAX_FORGOTTEN, MAX_PARTS, MAX_RECORDS, NewJob, PlateAfter, Spool, SpoolError,
};
pub use state::JobState;
