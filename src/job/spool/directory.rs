//! Directories of jobs: what they are called and what is in them, and what the name of a removed one still tells.
//! [`Spool`](super::Spool) makes and removes them; `tests/job_spool.rs` shows that.

use std::path::{Path, PathBuf};

pub(super) const PART: &str = "part.layerd";
pub(super) const RECIPE: &str = "recipe.toml";
pub(super) const MACHINE: &str = "machine.toml";
pub(super) const JOURNAL: &str = "journal";
const RESIN: &str = "resin";

/// One job's directory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct JobDirectory {
    /// The job's number, from 1, ascending in order of acceptance.
    pub id: u32,
    path: PathBuf,
}

/// What a job that is over tells about the plate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlateAfter {
    /// Nothing: it had no light and never moved the plate.
    Unsaid,
    /// No part of it or of an earlier job is in the vat.
    Clear,
    /// Its part may be in the vat.
    Left,
}

/// What is still known of a job that was removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Forgotten {
    /// Its number.
    pub id: u32,
    /// Identified its exposures; 0 if its journal could not be read.
    pub key: u64,
    /// What it tells about the plate.
    pub plate: PlateAfter,
}

impl JobDirectory {
    /// The directory of job `id` in the spool at `root`, whether it is there or not.
    pub fn of(root: &Path, id: u32) -> Self {
        Self { id, path: root.join("jobs").join(Self::name(id)) }
    }

    /// The directory itself.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The part; deleted some time after the job is over.
    pub fn part(&self) -> PathBuf {
        self.path.join(PART)
    }

    /// The recipe as it was when the job was accepted.
    pub fn recipe(&self) -> PathBuf {
        self.path.join(RECIPE)
    }

    /// The machine file as it was when the job was accepted.
    pub fn machine(&self) -> PathBuf {
        self.path.join(MACHINE)
    }

    /// About how much resin the part takes; missing until that is estimated.
    pub fn resin(&self) -> PathBuf {
        self.path.join(RESIN)
    }

    /// The journal.
    pub fn journal(&self) -> PathBuf {
        self.path.join(JOURNAL)
    }

    /// The job whose directory this is; `None` if the path does not name one.
    pub(super) fn from_path(path: PathBuf) -> Option<Self> {
        let name = path.file_name()?.to_str()?;
        let id = name.parse().ok().filter(|id| *id > 0)?;
        (name == Self::name(id)).then_some(Self { id, path })
    }

    /// The name of the directory of job `id`.
    pub(super) fn name(id: u32) -> String {
        format!("{id:08}")
    }
}

impl Forgotten {
    /// The name of its directory.
    pub(super) fn name(self) -> String {
        let plate = match self.plate {
            PlateAfter::Unsaid => "",
            PlateAfter::Clear => "-clear",
            PlateAfter::Left => "-left",
        };
        format!("{:08}-{:016x}{plate}", self.id, self.key)
    }

    /// Parses the name of a directory; `None` if it is not that of a removed job.
    pub(super) fn of(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?;
        let (id, rest) = name.split_once('-')?;
        let (key, plate) = match rest.split_once('-') {
            None => (rest, PlateAfter::Unsaid),
            Some((key, "clear")) => (key, PlateAfter::Clear),
            Some((key, _)) => (key, PlateAfter::Left),
        };
        let job = Self { id: id.parse().ok()?, key: u64::from_str_radix(key, 16).ok()?, plate };
        (name == job.name()).then_some(job)
    }
}
