//! A change of the vat: the one in place goes away, what hangs on the plate is washed and drains, and another one comes. Part of [`Vat`].

use super::Vat;
use crate::device::sim::core::board::Board;
use crate::device::sim::log::ActRecord;
use crate::link::message::{Refusal, Reply, VatReply};

/// A change under way.
#[derive(Debug)]
pub(super) struct Change {
    /// Number of the request, while its session lasts.
    pub(super) number: Option<u32>,
    vat: u8,
    pub(super) ends_us: u64,
}

impl Vat {
    /// Begins a change.
    pub(super) fn change(
        &mut self,
        board: &mut Board,
        number: u32,
        vat: u8,
        [wash_ms, drain_ms]: [u32; 2],
    ) -> Result<(), Refusal> {
        let vats = self.capabilities.vats;
        if !(1..=vats.count).contains(&vat) || vats.count == 1 {
            return Err(Refusal::NoSuchVat);
        }
        if board.plate.position_um(board.now_us).is_none() {
            return Err(Refusal::NotHomed);
        }
        let took_ms = u64::from(vats.change_ms) + u64::from(wash_ms) + u64::from(drain_ms);
        self.in_place = None;
        self.change = Some(Change { number: Some(number), vat, ends_us: board.now_us + took_ms * 1000 });
        board.record(ActRecord { event: "change", vat: Some(vat), ..ActRecord::default() });
        Ok(())
    }

    /// Ends a change that is due by `now_us`, at its own time.
    pub(super) fn advance_change(&mut self, board: &mut Board, now_us: u64) {
        let Some(change) = self.change.take_if(|change| change.ends_us <= now_us) else { return };
        board.now_us = change.ends_us;
        self.in_place = Some(change.vat);
        board.statistics.changes += 1;
        board.record(ActRecord { event: "changed", vat: Some(change.vat), ..ActRecord::default() });
        board.reply(change.number, Reply::Vat(VatReply::Changed { vat: change.vat }));
    }

    /// The change under way stops where it is: no vat is in place.
    pub(in crate::device::sim::core) fn stop_change(&mut self, board: &mut Board) {
        if let Some(change) = self.change.take() {
            board.record(ActRecord { event: "change_stopped", vat: Some(change.vat), ..ActRecord::default() });
            board.reply(change.number, Reply::Refused(Refusal::CutShort));
        }
    }
}
