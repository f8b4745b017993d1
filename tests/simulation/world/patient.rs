//! The operator who, once nothing goes wrong any more, sees to it that every job ends.

use std::collections::BTreeMap;

use layerd::daemon::handle::Snapshot;
use layerd::job::JobState;
use layerd::system::Disk;

use super::{SECOND_US, World};
use crate::machine::{Incident, Interlock};
use crate::operators::{Ask, asks_for_empty_plate, is_unread, number};
use crate::parts::{LAYER_UM, spool};

/// Once nothing goes wrong any more, all jobs have ended after this time: some prints, and the long waits of a protocol that was
/// broken in many ways before.
const MAX_CALM_US: u64 = 1_200 * SECOND_US;
/// How often the patient operator looks.
const LOOK_US: u64 = 1_500_000;
/// So often in a row it may see a job whose journal could not be read: the daemon tries that again every 10 s.
const MAX_UNREAD_LOOKS: u32 = 8;
/// An accepted order to pause, stop or abort is carried out within this time once nothing goes wrong any more.
const MAX_OBEYED_US: u64 = 120 * SECOND_US;

/// The operator who sees to it that every job ends.
#[derive(Debug, Default)]
pub(super) struct Patient {
    /// Since when nothing goes wrong any more.
    pub(super) since_us: Option<u64>,
    pub(super) look_us: u64,
    /// How often each job refused to go on.
    pub(super) refusals: BTreeMap<u32, u32>,
    /// How often in a row it saw a job whose journal could not be read.
    unread_looks: u32,
    /// The last job, which must complete.
    pub(super) last: Option<u32>,
    /// How often it looked whether all is given back.
    looks: u32,
    /// When everything was over.
    pub(super) over_us: Option<u64>,
}

impl World {
    /// From when on nothing goes wrong any more, the patient operator sees to it that every job ends.
    pub(super) fn be_patient(&mut self) {
        let now_us = self.now_us;
        let Some(since_us) = self.patient.since_us else {
            // A machine without power is a fault that lasts.
            let is_powered = self.stations.iter().all(|station| station.machine.is_on());
            if self.next_event == self.plan.events.len() && self.ends.is_empty() && is_powered {
                self.patient.since_us = Some(now_us);
                self.patient.refusals.clear();
                self.patient.look_us = now_us + LOOK_US;
                self.disk.kill_after(u32::MAX);
                for station in &mut self.stations {
                    for interlock in Interlock::ALL {
                        station.machine.strike(Incident::InterlockCloses(interlock), now_us);
                    }
                    station.machine.repair(now_us);
                }
                self.note(|| "** nothing goes wrong any more".into());
            }
            return;
        };
        if now_us < self.patient.look_us || self.frozen_until_us.is_some() {
            return;
        }
        self.patient.look_us = now_us + LOOK_US;
        let Some(host) = &self.host else { return };
        let snapshot = host.handle.snapshot().clone();
        let states: Vec<_> = snapshot.jobs.iter().map(|job| format!("{} {}", job.id, job.state)).collect();
        self.check("jobs end", now_us - since_us < MAX_CALM_US, || {
            format!("{} s after the last fault: {}", (now_us - since_us) / SECOND_US, states.join(", "))
        });
        if self.patient.over_us.is_some() {
            return;
        }
        if now_us - since_us > MAX_OBEYED_US {
            self.check_obeyed(&snapshot);
        }
        let open: Vec<_> = snapshot.jobs.iter().filter(|job| !job.state.is_final()).collect();
        if open.is_empty() {
            return self.all_ended(&snapshot);
        }
        // A journal that was moved away with its spool is not there to be read: the job is resumed, and told to end.
        let is_unread = !self.spool_is_new && open.iter().any(|job| is_unread(job));
        self.patient.unread_looks = if is_unread { self.patient.unread_looks + 1 } else { 0 };
        let unread_looks = self.patient.unread_looks;
        self.check("jobs end", unread_looks <= MAX_UNREAD_LOOKS, || {
            format!("the disk works again, and no journal was read again: {}", states.join(", "))
        });
        if is_unread {
            return;
        }
        for job in &open {
            // A stop may leave a job interrupted, if its plate could not be lifted.
            let id = number(job);
            let waits = job.state == JobState::Interrupted && self.promises.ended.get(&id) == Some(&"abort");
            self.check("orders carried out", !waits, || {
                format!("job {id}: an abort was accepted, and it is interrupted")
            });
        }
        if let Some(ask) = open.into_iter().find_map(|job| self.next_ask(number(job), &snapshot)) {
            self.give(&ask);
        }
    }

    /// What the patient operator asks for a job that has not ended.
    pub(super) fn next_ask(&mut self, id: u32, snapshot: &Snapshot) -> Option<Ask> {
        let job = snapshot.job(&id.to_string())?;
        let refusals = self.patient.refusals.get(&id).copied().unwrap_or(0);
        let says = |text: &str| job.reason.as_ref().is_some_and(|reason| reason.contains(text));
        match job.state {
            JobState::Paused | JobState::Interrupted | JobState::Queued if refusals > 3 => {
                self.patient.refusals.insert(id, 0);
                Some(Ask::Abort(Some(id)))
            }
            // The daemon says that this job cannot go on, or the machine no longer knows where the part is.
            JobState::Interrupted if says("Abort it") || says("ake the part out and") => Some(Ask::Abort(Some(id))),
            // Somebody moved the plate, and brings it back.
            JobState::Interrupted if says("bring it back") => {
                let to_um = (job.layers_done as i32 + 1) * LAYER_UM;
                let now_us = self.now_us;
                let ask = Ask::Resume(id, self.judge(job));
                self.stations[self.connected].machine.strike(Incident::PlateMovedByHand { to_um }, now_us);
                Some(ask)
            }
            JobState::Interrupted => Some(Ask::Resume(id, self.judge(job))),
            JobState::Paused => Some(Ask::Resume(id, None)),
            JobState::Queued if asks_for_empty_plate(job) || job.reason.is_some() && snapshot.active().is_none() => {
                let station = &self.stations[self.connected];
                // Out of a bed of powder a part is taken where it is.
                let is_low = !station.is_laser() && !station.is_clear() && station.part_um.is_some();
                Some(if is_low && refusals < 2 {
                    *self.patient.refusals.entry(id).or_default() += 1;
                    Ask::Raise
                } else {
                    Ask::Resume(id, None)
                })
            }
            _ => None,
        }
    }

    /// Accepted orders were carried out by now.
    fn check_obeyed(&mut self, snapshot: &Snapshot) {
        for (id, order) in self.promises.ended.clone() {
            let state = snapshot.job(&id.to_string()).map(|job| job.state);
            let holds = state.is_none_or(JobState::is_final);
            self.check("orders carried out", holds, || format!("job {id}: {order} was accepted, but it is {state:?}"));
        }
        let pause = self.promises.pauses.first_key_value().map(|(id, pause)| (*id, pause.at_us));
        self.check("orders carried out", pause.is_none(), || {
            format!("a pause of job {pause:?} (and its time, µs) was accepted, and the job has not rested since")
        });
    }

    /// Every print survives what happens to the host and the line, unless somebody told it to end.
    fn check_survived(&mut self, snapshot: &Snapshot) {
        if !self.gentle {
            return;
        }
        for job in
            snapshot.jobs.iter().filter(|job| !self.promises.told_to_end.contains(&number(job))).collect::<Vec<_>>()
        {
            self.check("prints survive", job.state == JobState::Completed, || {
                format!("job {} is {}: {:?}", job.id, job.state, job.reason)
            });
        }
    }

    /// Every job has ended: one more must complete, and all that was taken is given back.
    pub(super) fn all_ended(&mut self, snapshot: &Snapshot) {
        self.check_obeyed(snapshot);
        self.check_survived(snapshot);
        let Some(last) = self.patient.last else {
            let jobs: Vec<u32> = snapshot.jobs.iter().map(number).collect();
            self.patient.last = Some(jobs.last().copied().unwrap_or(0) + 1);
            return self.give(&Ask::Submit { part: 2 });
        };
        match snapshot.job(&last.to_string()).map(|job| (job.state, job.reason.clone())) {
            // Not there yet, or refused: it is tried again.
            None => self.patient.last = None,
            Some((JobState::Completed, _)) => {
                if snapshot.budget.used_bytes == 0 {
                    self.given_back(snapshot);
                }
            }
            Some((state, reason)) => {
                self.check("jobs end", false, || format!("the last job, {last}, is {state}: {reason:?}"));
            }
        }
    }

    pub(super) fn given_back(&mut self, snapshot: &Snapshot) {
        let open_files = self.disk.open_files();
        // The lock of the spool. A journal may just be being closed.
        self.patient.looks += 1;
        if open_files != 1 && self.patient.looks < 5 {
            return;
        }
        self.check("all given back", open_files == 1, || format!("{open_files} files are open in the end"));
        let incoming = self.outside(|mount| mount.list(&spool().join("incoming")).map(|left| left.len()));
        self.check("all given back", self.undeleted || incoming.as_ref().is_ok_and(|left| *left == 0), || {
            format!("in the end there are files in `incoming`: {incoming:?}")
        });
        self.check("all given back", snapshot.device.connected, || "in the end no device is connected".into());
        let lit = self.stations[self.connected].machine.is_lit();
        self.check("all given back", !lit, || "in the end the light is on".into());
        self.patient.over_us = Some(self.now_us + 1);
    }
}
