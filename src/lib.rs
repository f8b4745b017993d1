//! layerd prints implicit geometry: it computes each layer just ahead of the printer, inside a fixed memory budget.
//!
//! ```text
//! part.3mf ──pack──▶ part.layerd ──sweep──▶ layer ──encode──▶ frames ──serial──▶ device
//!                    (sorted by z)   (bitmap)      (credit, CRC, seq)     (DLP | simulated)
//!                           ▲                                  │
//!                           └───────── job engine, journal ◀───┘ acknowledged, exposed
//! ```
//!
//! Data flows one way, each step has one owner, and every queue between two steps has a limit:
//!
//! | module        | owns                                                              |
//! |---------------|-------------------------------------------------------------------|
//! | [`buildfile`] | the build file: import, external sort, write, stream, seek        |
//! | [`solid`]     | which points are solid: convolution struts, exact union           |
//! | [`layer`]     | one layer as pixels or scan vectors, its grid, files for export   |
//! | [`mod@slice`] | a part as a stream of layers: pixels, or regions and their filling |
//! | [`stream`]    | computing ahead: task, memory budget, queue of finished layers    |
//! | [`link`]      | the serial line: the host's session, the port; bytes: [`layerd_wire`] |
//! | [`device`]    | drivers, layer encodings and the simulated devices                |
//! | [`pipeline`]  | a part on a machine with a recipe: encoded layers, ahead          |
//! | [`job`]       | the life of a job: states, journal, resume                        |
//! | [`config`]    | machines, recipes and the daemon's own settings                   |
//! | [`api`]       | the control API's types, for daemon and clients                   |
//! | [`daemon`]    | control API, systemd, wiring the above together                   |
//! | [`cli`]       | `layerctl`                                                        |
//! | [`system`]    | files, wall clock, entropy, threads: what a simulation replaces   |
//!
//! `ARCHITECTURE.md` states the invariants and where to start reading.

pub mod api;
pub mod buildfile;
pub mod cli;
mod codec;
pub mod config;
pub mod daemon;
mod deadline;
pub mod device;
pub mod disk;
pub mod job;
pub mod layer;
pub mod link;
mod output;
pub mod pipeline;
mod random;
mod signals;
pub mod slice;
pub mod solid;
pub mod stream;
pub mod system;
mod text;
