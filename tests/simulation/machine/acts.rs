//! What the firmware of a [`Machine`] does with light, plate and powder becomes facts; here a machine lies about its light.

use layerd::device::sim::{ActRecord, CoreAction, MarkedVector};
use layerd::link::message::{DeviceMessage, ExposureId, Report};

use super::character::Lie;
use super::facts::FactKind;
use super::{Machine, Stray};

impl Machine {
    /// Carries out what the firmware asks for, and notes what happened.
    pub(super) fn drain(&mut self, now_us: u64) {
        while let Some(action) = self.core.action() {
            match action {
                CoreAction::Send(DeviceMessage::Reply { number, reply }) => self.answer(number, reply, now_us),
                CoreAction::Send(DeviceMessage::Report(Report::Room { taken_bytes })) => {
                    self.report_room(taken_bytes, now_us);
                }
                CoreAction::Send(message) => self.say_now(message),
                CoreAction::Picture(_, picture) => self.picture = Some(picture),
                CoreAction::Record(record) => self.note_act(&record, now_us),
                CoreAction::Vector(marked) => self.note_vector(&marked, now_us),
            }
        }
        let plate_um = self.core.plate_um(self.clock.machine_us(now_us));
        self.facts.plate_moves(plate_um, self.core.plate_target(), now_us);
        if self.core.next_timeout_us().is_none() {
            self.clock.correct(now_us);
        }
    }

    fn note_act(&mut self, record: &ActRecord, now_us: u64) {
        let id = record.job.zip(record.layer).map(|(job, layer)| ExposureId::first_pass(job, layer));
        match (record.event, id) {
            ("light_on" | "laser_on", Some(id)) => {
                let commanded_ms = self.core.exposure().map_or(0, |(_, commanded_ms)| commanded_ms);
                self.stray = None;
                self.facts.lamp_on(Some(id), commanded_ms, now_us);
            }
            ("light_off" | "laser_off", Some(id)) if record.reason.is_some() => {
                self.facts.lamp_off(now_us);
                self.facts.note(FactKind::CutShort { id, lit_ms: record.duration_ms.unwrap_or(0) }, now_us);
            }
            ("light_off" | "laser_off", Some(_)) => self.end_exposure(now_us),
            ("exposed", Some(id)) => {
                if let (Some(picture), Some(duration_ms)) = (self.picture.take(), record.duration_ms) {
                    self.facts.note(FactKind::ExposedWhole { id, duration_ms, picture }, now_us);
                }
            }
            ("marked", Some(id)) => {
                self.facts.note(FactKind::MarkedWhole { id, vectors: record.vectors.unwrap_or(0) }, now_us);
            }
            ("recoated", _) if record.reason.is_none() => self.end_recoating(now_us),
            ("moved", _) => self.facts.plate_rests(self.core.plate_um(self.clock.machine_us(now_us)), now_us),
            _ => {}
        }
    }

    fn note_vector(&mut self, marked: &MarkedVector, now_us: u64) {
        let MarkedVector { id, vector, laser, is_whole, .. } = *marked;
        let [began_us, ended_us] = [marked.began_us, marked.ended_us].map(|at_us| self.clock.true_us(at_us));
        self.facts.note(FactKind::Vector { id, vector, laser, began_us, ended_us, is_whole }, now_us);
    }

    /// The firmware has moved the recoater; whether there was powder in it is another matter.
    fn end_recoating(&mut self, now_us: u64) {
        let lie = self.liar.due(|lie| lie == Lie::NoPowder);
        self.note_lie(lie, now_us);
        if lie.is_none() {
            self.facts.note(FactKind::Recoated, now_us);
        }
    }

    /// The firmware switches the lamp off at the end of an exposure; whether it goes off is another matter.
    fn end_exposure(&mut self, now_us: u64) {
        let lie = self.liar.due(|lie| matches!(lie, Lie::DarkWhenLit { .. } | Lie::LampStays { .. }));
        self.note_lie(lie, now_us);
        match lie {
            Some(Lie::DarkWhenLit { extra_us }) => {
                self.stray = Some(Stray { until_us: now_us + extra_us, is_known: false });
            }
            Some(Lie::LampStays { extra_us }) => {
                self.stray = Some(Stray { until_us: now_us + extra_us, is_known: true });
            }
            _ => self.facts.lamp_off(now_us),
        }
    }
}
