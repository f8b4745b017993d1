//! What goes wrong, and what ends by itself; the daemon's starts and deaths.

use std::sync::PoisonError;

use layerd::job::JobState;

use crate::disk::Unreadable;
use crate::host::{Host, config_path};
use crate::line::LineFault;
use crate::machine::{Character, Lie};
use crate::parts::spool;
use crate::plan::What;

use super::{End, Promises, SECOND_US, Station, World};

impl World {
    pub(super) fn strike(&mut self, what: &What) {
        self.happen(what.name());
        self.note(|| format!("** {what:?}"));
        if what.disturbs_light() {
            self.disturbed_us = self.now_us;
        }
        self.gentle &= what.is_gentle();
        self.reserve_holds &= what.spares_records();
        let now_us = self.now_us;
        match *what {
            What::Order(wish) => self.wish(wish),
            What::Machine(incident) => self.stations[self.connected].machine.strike(incident, now_us),
            What::OtherMachine { for_us } => {
                if self.stations.len() == 1 {
                    let seed = self.plan.seed ^ now_us;
                    self.stations.push(Station::new(self.plan.kind, Character::Honest, seed));
                }
                self.connect(1);
                self.end_at(now_us + for_us, End::OtherMachine);
            }
            What::Line(fault) => self.line_fault(fault),
            What::DiskFull { free_bytes, for_us } => {
                self.disk.leave_free(Some(free_bytes));
                self.end_at(now_us + for_us, End::DiskFull);
            }
            What::DiskBroken { per_million, for_us } => {
                self.disk.set_broken(per_million);
                self.undeleted = true;
                self.end_at(now_us + for_us, End::DiskBroken);
            }
            What::DiskUnreadable { name, per_million, for_us } => {
                self.disk.set_unreadable(Some(Unreadable { below: spool(), name, per_million }));
                self.undeleted = true;
                self.end_at(now_us + for_us, End::DiskUnreadable);
            }
            What::DiskSlow { slow_us, for_us } => {
                self.shared.set_slow(slow_us);
                self.end_at(now_us + for_us, End::DiskSlow);
            }
            What::DiskHangs { for_us } => self.shared.hang_until(now_us + for_us),
            What::Kill { after_calls: None, down_us } => {
                self.down_us = Some(down_us);
                self.die("killed");
            }
            What::Kill { after_calls: Some(calls), down_us } => {
                self.down_us = Some(down_us);
                self.power_fails = false;
                self.disk.kill_after(calls);
            }
            What::PowerCut { after_calls: None, down_us } => {
                self.down_us = Some(down_us);
                self.disk.power_cut();
                self.die("power lost");
            }
            What::PowerCut { after_calls: Some(calls), down_us } => {
                self.down_us = Some(down_us);
                self.power_fails = true;
                self.disk.kill_after(calls);
            }
            What::End { down_us } => {
                self.down_us = Some(down_us);
                if let Some(host) = &self.host {
                    host.end();
                }
            }
            What::StandStill { for_us } => {
                if self.host.is_some() {
                    self.frozen_until_us = Some(now_us + for_us);
                }
            }
            What::WallClock { by_ms } => self.shared.set_wall_clock(by_ms),
            What::SpoolReplaced { while_down } => {
                if while_down {
                    self.down_us = Some(SECOND_US);
                    self.die("killed");
                }
                self.disk.replace_directory(&spool());
                self.spool_is_new = true;
                self.forget_spool();
                if self.plan.character.lie() == Some(Lie::LosesMemory) {
                    // Whoever replaces the spool of a machine that forgets clears its plate: nothing else tells of the part.
                    self.stations[0].part_um = None;
                }
            }
        }
    }

    /// What was promised of the jobs of a spool that is gone is void.
    pub(super) fn forget_spool(&mut self) {
        self.promises = Promises::default();
        self.patient.refusals.clear();
        self.patient.last = None;
        self.patient.over_us = None;
    }

    /// Called once for each event of the plan.
    pub(super) fn end_at(&mut self, at_us: u64, end: End) {
        self.ends.insert((at_us, self.next_event), end);
    }

    pub(super) fn end(&mut self, end: End) {
        self.note(|| format!("** over: {end:?}"));
        if matches!(end, End::OtherMachine) {
            self.disturbed_us = self.now_us;
        }
        match end {
            End::OtherMachine => self.connect(0),
            End::DiskFull => self.disk.leave_free(None),
            End::DiskBroken => self.disk.set_broken(0),
            End::DiskUnreadable => self.disk.set_unreadable(None),
            End::DiskSlow => self.shared.set_slow(0),
        }
    }

    pub(super) fn line_fault(&mut self, fault: LineFault) {
        let now_us = self.now_us;
        // A line that stands still twice does so for the sum of both times.
        let from_us = self.line_faulty_until_us.max(now_us);
        self.line_faulty_until_us = match fault {
            LineFault::Stall { for_us } => from_us + for_us,
            fault => from_us.max(now_us + fault.felt_us()),
        };
        self.shared.line().fault(fault, now_us);
    }

    pub(super) fn connect(&mut self, index: usize) {
        if self.connected != index {
            self.line_fault(LineFault::Unplugged { for_us: 300_000 });
            self.connected = index;
            // A person who connects a machine clears its plate, unless a job is to go on.
            let goes_on = self.host.as_ref().is_none_or(|host| {
                host.handle.snapshot().jobs.iter().any(|job| !job.state.is_final() && job.layers_done > 0)
            });
            if !goes_on {
                self.stations[index].part_um = None;
            }
        }
    }

    /// A machine that changes plates by itself does so when its plate is clear and no job has to go on with what is on it.
    pub(super) fn change_plate(&mut self) {
        let (false, Some(host)) = (self.plan.confirms_plate, &self.host) else { return };
        let is_needed = host
            .handle
            .snapshot()
            .jobs
            .iter()
            .any(|job| !job.state.is_final() && (job.started_ms.is_some() || job.state != JobState::Queued));
        let station = &mut self.stations[self.connected];
        // A laser machine takes the whole bed out.
        let is_reachable = station.is_clear() || station.is_laser();
        if !is_needed && is_reachable && station.part_um.take().is_some() {
            self.note(|| "machine: changes its plate".into());
        }
    }

    pub(super) fn die(&mut self, how: &str) {
        self.disk.kill();
        self.frozen_until_us = None;
        self.promises.pauses.clear();
        // What was accepted with a warning may be lost.
        for printed in self.truth.printed.values_mut().filter(|printed| !printed.is_aborted) {
            printed.abort_given_us = None;
        }
        self.start_us = self.start_us.or(Some(self.now_us + self.down_us.take().unwrap_or(300_000)));
        self.answers.lock().unwrap_or_else(PoisonError::into_inner).clear();
        if let Some(host) = self.host.take() {
            self.note(|| format!("host: {how}"));
            host.drop_dead();
        }
    }

    pub(super) fn start(&mut self) {
        self.start_us = None;
        match Host::start(&self.shared, &self.disk, &config_path(), self.now_us) {
            Ok(host) => {
                self.note(|| "host: the daemon runs".into());
                self.host = Some(host);
                self.patient.refusals.clear();
                // A disk that still fails keeps files from being deleted from now on, too.
                self.undeleted = self.ends.values().any(|end| matches!(end, End::DiskBroken | End::DiskUnreadable));
                if std::mem::take(&mut self.spool_is_new) {
                    self.forget_spool();
                }
                self.check_journals();
                self.check_promises();
            }
            Err(text) => {
                self.note(|| format!("host: the daemon does not start: {text}"));
                self.check("jobs end", self.patient.since_us.is_none(), || {
                    format!("the daemon does not start: {text}")
                });
                self.disk.kill();
                // As systemd does.
                self.start_us = Some(self.now_us + SECOND_US);
            }
        }
    }
}
