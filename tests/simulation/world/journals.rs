//! What the journals say, compared with what really happened. They are read from outside, whenever a daemon starts.

use std::collections::BTreeSet;
use std::rc::Rc;
use std::time::Duration;

use layerd::job::{Entry, History, JobDirectory, JobState, JournalError, Record, read_journal};
use layerd::system::{Disk, How, System, install};

use super::World;
use crate::disk::Mount;
use crate::machine::Character;
use crate::operators::{number, part_of};
use crate::parts::spool;
use crate::truth::Printed;

/// A journal, or why it cannot be read.
type Read = Result<(Vec<Entry>, History), JournalError>;

impl World {
    /// Calls `act` with the disk as an observer sees it.
    pub(super) fn outside<R>(&self, act: impl FnOnce(&Mount) -> R) -> R {
        let mount = self.disk.inspect();
        let _installed = install(Rc::new(Outside(mount.clone())));
        act(&mount)
    }

    /// The journals of all jobs of the spool, by number.
    fn journals(&self) -> Vec<(u32, Read)> {
        self.outside(|mount| {
            let jobs = mount.list(&spool().join("jobs")).unwrap_or_default();
            let ids = jobs.iter().filter_map(|path| path.file_name()?.to_str()?.parse::<u32>().ok());
            ids.map(|id| (id, read_journal(&JobDirectory::of(&spool(), id).journal()))).collect()
        })
    }

    /// Learns of jobs that are new in the spool.
    pub(super) fn learn_jobs(&mut self) {
        for (id, read) in self.journals() {
            if let Ok((_, history)) = read {
                self.learn_job(id, &history);
            }
        }
    }

    fn learn_job(&mut self, id: u32, history: &History) {
        if self.truth.knows(history.key) {
            return;
        }
        // A job that repeats one whose journal cannot be read has no name.
        if let Some(part) = part_of(&history.name).or_else(|| self.part_in_spool(id)) {
            let new = Printed { job: id, part, ..Printed::default() };
            self.truth.printed.entry(history.key).or_insert(new);
        }
    }

    /// Which part lies in the spool for a job.
    fn part_in_spool(&self, id: u32) -> Option<usize> {
        self.outside(|mount| {
            let file = mount.open(&JobDirectory::of(&spool(), id).part(), How::Read).ok()?;
            self.plan.kind.parts().iter().position(|part| {
                let mut found = vec![0; part.file.len() + 1];
                file.read_at(&mut found, 0).is_ok_and(|count| found[..count] == part.file)
            })
        })
    }

    /// What the journals say after a start: each can be read, and says of every layer what is true.
    pub(super) fn check_journals(&mut self) {
        for (id, read) in self.journals() {
            let (entries, history) = match read {
                Ok(read) => read,
                Err(error) => {
                    self.check("journal reads", false, || format!("job {id}: {error}"));
                    continue;
                }
            };
            self.check("journal reads", true, String::new);
            if self.trace.is_some() {
                let records: Vec<_> = entries.iter().map(|entry| format!("{:?}", entry.record)).collect();
                self.note(|| format!("journal of job {id}: {}", records.join(", ")));
            }
            self.learn_job(id, &history);
            let Some(printed) = self.truth.printed.get(&history.key).cloned() else { continue };
            if self.plan.character != Character::Honest {
                continue;
            }
            let confirmed = entries.iter().filter_map(|entry| match entry.record {
                Record::Confirmed { exposure: layer } => Some(layer),
                _ => None,
            });
            let untrue = confirmed.clone().find(|layer| !printed.whole.contains_key(layer));
            self.check("journal true", untrue.is_none(), || {
                format!("job {id}: the journal says that layer {untrue:?} was exposed, and it was not")
            });
            let commanded = |layer: &u32| {
                entries
                    .iter()
                    .any(|entry| matches!(entry.record, Record::Commanded { exposure: it, .. } if it == *layer))
            };
            let unsaid = printed.lit.iter().find(|layer| !commanded(layer));
            self.check("journal true", unsaid.is_none(), || {
                format!("job {id}: layer {unsaid:?} was exposed, and the journal does not know of it")
            });
            let denied = printed.whole.keys().find(|layer| {
                **layer >= history.next_exposure
                    && history.unconfirmed.is_none_or(|unconfirmed| unconfirmed.exposure != **layer)
                    && !(history.in_doubt.is_some() && history.next_exposure == **layer)
                    && !printed.repeats.contains_key(layer)
            });
            self.check("journal true", denied.is_none(), || {
                format!("job {id}: layer {denied:?} was exposed, and the journal says that it was not")
            });
            self.check_partly_marked(id, &printed, &entries, &history);
            if history.state == JobState::Completed {
                let missing = printed.missing(self.plan.kind.parts());
                self.check("none left out", missing.is_none(), || {
                    format!("job {id}: completed by its journal without layer {missing:?}")
                });
            }
        }
    }

    /// What the journal says of layers that are marked in part.
    fn check_partly_marked(&mut self, id: u32, printed: &Printed, entries: &[Entry], history: &History) {
        if self.stations.len() > 1 {
            return;
        }
        let marked = |layer: u32| printed.marks.get(&layer).map_or(0, |marks| marks.next);
        let untrue = entries.iter().find_map(|entry| match entry.record {
            Record::PartlyMarked { exposure: layer, next_vector } if next_vector > marked(layer) => {
                Some((layer, next_vector))
            }
            _ => None,
        });
        self.check("journal true", untrue.is_none(), || {
            format!("job {id}: the journal has a layer marked up to a vector, {untrue:?}, and it is not")
        });
        let (layer, is_open) = (history.next_exposure, history.unconfirmed.is_some() || history.in_doubt.is_some());
        let holds = is_open || marked(layer) <= history.next_vector;
        self.check("journal true", holds, || {
            let (told, next) = (history.next_vector, marked(layer));
            format!("job {id}: layer {layer} is marked up to vector {next}, and the journal says up to {told}")
        });
    }

    /// What the daemon promised before it was started again.
    pub(super) fn check_promises(&mut self) {
        let Some(host) = &self.host else { return };
        let snapshot = host.handle.snapshot().clone();
        let known: BTreeSet<u32> = snapshot.jobs.iter().map(number).collect();
        let is_going = |id: &u32| self.promises.going.get(id).is_some_and(|count| *count > 0);
        let lost = self.promises.accepted.difference(&known).find(|id| !is_going(id)).copied();
        self.check("orders carried out", lost.is_none(), || format!("job {lost:?} was accepted and is gone"));
        let unanswered = std::mem::take(&mut self.promises.unanswered);
        let new: Vec<_> = known.difference(&self.promises.accepted).copied().collect();
        self.check("orders carried out", new.len() <= unanswered, || {
            format!("jobs {new:?} are there, and nobody was told that they were accepted")
        });
        self.promises.accepted.extend(new);
        let back = self.promises.removed.intersection(&known).next().copied();
        self.check("orders carried out", back.is_none(), || format!("job {back:?} was removed and is back"));
    }

    /// The part of a job of the present spool.
    pub(super) fn printed(&self, job: u32) -> Option<&Printed> {
        // Numbers begin anew in a new spool: the latest job of that number.
        let key = self.key_of(job)?;
        self.truth.printed.get(&key)
    }

    pub(super) fn key_of(&self, job: u32) -> Option<u64> {
        let mut of_number = self.truth.printed.iter().filter(|(_, printed)| printed.job == job);
        match (of_number.next(), of_number.next()) {
            (Some((key, _)), None) => Some(*key),
            (None, _) => None,
            _ => self.outside(|_| {
                read_journal(&JobDirectory::of(&spool(), job).journal()).ok().map(|(_, history)| history.key)
            }),
        }
    }
}

/// The system of an observer: faults of the disk do not affect it.
struct Outside(Mount);

impl System for Outside {
    fn unix_ms(&self) -> u64 {
        0
    }

    fn random_bits(&self) -> u64 {
        0
    }

    fn disk(&self) -> &dyn Disk {
        &self.0
    }

    fn spawn_blocking(&self, work: Box<dyn FnOnce() + Send>) {
        work();
    }

    fn rest(&self, _time: Duration) {}
}
