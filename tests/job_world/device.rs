//! What the scripted device does with the engine's acts and orders.

use layerd::device::{Act, Outcome, VatAct, VatOutcome};
use layerd::job::{Event, Record};
use layerd::link::message::{ExposureId, Refusal, Urgent};

use super::{KEY, MAX_POSITION_UM, World};

/// What the device does otherwise than it was told.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Lies {
    /// Exposures are reported with this time, milliseconds.
    pub(crate) light_ms: Option<u32>,
    /// Where a move to this height ends, micrometres.
    pub(crate) misplaced: Option<(i32, i32)>,
    /// Its light goes on only by itself, and off by nobody's order.
    pub(crate) stays_lit: bool,
    /// It tells of no act that it is done.
    pub(crate) mute: bool,
    /// It takes no act at all.
    pub(crate) deaf: bool,
    /// It says that it is done after a tenth of the time.
    pub(crate) hasty: bool,
    /// So many aborts, one a session, it neither obeys nor answers.
    pub(crate) unheard_aborts: u32,
    /// It answers aborts with its light on, and does nothing else; a light-off it obeys.
    pub(crate) deaf_to_aborts: bool,
    /// It obeys an abort, answers with its light on, and is dark after this time.
    pub(crate) dark_after_us: Option<u64>,
    /// It exposes this layer and then says that it refused it, for this reason; with `true` its state names the layer as cut short,
    /// and never as being exposed.
    pub(crate) refuses_lit: Option<(u32, Refusal, bool)>,
}

impl World {
    pub(crate) fn begin_act(&mut self, number: u64, act: Act) {
        self.acts.push(act);
        if !self.line_up {
            return;
        }
        if self.line_holds_us == 0 {
            return self.receive_act(number, act);
        }
        self.held = Some((self.now_us + self.line_holds_us, number, act));
    }

    /// The act leaves the host, and reaches the device at once.
    pub(crate) fn receive_act(&mut self, number: u64, act: Act) {
        self.engine.handle(Event::ActSent { number }, self.now_us);
        if self.lies.deaf {
            return;
        }
        assert!(self.awaited.is_none() && self.device_act.is_none(), "two acts at once: {act:?}");
        let position_um = self.device.position_um.unwrap_or(0);
        let duration_us = match act {
            Act::Powder(_) | Act::Vat(VatAct::Change { .. }) => panic!("an act of another kind of machine: {act:?}"),
            Act::Vat(VatAct::Home) => {
                assert!(self.exposed.is_empty(), "homing with a part on the plate");
                3_000_000
            }
            Act::Vat(VatAct::Move { position_um: to_um, speed_um_s }) => {
                assert!((0..=MAX_POSITION_UM).contains(&to_um));
                u64::from(to_um.abs_diff(position_um)) * 1_000_000 / u64::from(speed_um_s)
            }
            Act::Vat(VatAct::Expose { layer, duration_ms, .. }) => {
                assert!(!self.aborted, "light after an abort");
                let commanded = self
                    .journal
                    .iter()
                    .rev()
                    .find(|r| !matches!(r, Record::Paused | Record::Resumed | Record::Ordered(_)));
                assert!(
                    matches!(commanded, Some(Record::Commanded { exposure, .. }) if *exposure == layer),
                    "{commanded:?}"
                );
                let (at_um, target_um) = (self.device.position_um, 50 * (layer as i32 + 1));
                assert!(at_um.is_some_and(|at_um| at_um.abs_diff(target_um) <= 25), "layer {layer} at {at_um:?} µm");
                assert_eq!(duration_ms, [20_000, 11_000, 2000, 2000, 2000][layer as usize]);
                self.awaited = Some(number);
                let id = ExposureId::first_pass(KEY, layer);
                if self.device.last_exposed.is_some_and(|last| last.job == KEY && last.layer >= layer) {
                    return self.answer(number, Outcome::Refused(Refusal::AlreadyExposed));
                }
                assert!(self.device.slots.contains(&Some(id)), "layer {layer} is not on the device");
                let hidden = self.lies.refuses_lit.is_some_and(|(lied, _, hidden)| hidden && lied == layer);
                self.device.exposing = Some(id).filter(|_| !hidden);
                self.device.light_on = !hidden;
                u64::from(duration_ms) * 1000
            }
        };
        self.device.moving = !matches!(act, Act::Vat(VatAct::Expose { .. }));
        assert!(!self.device.moving || !self.device.light_on, "a move under light: {act:?}");
        self.awaited = Some(number);
        let duration_us = if self.lies.hasty { duration_us / 10 } else { duration_us };
        self.device_act = Some((self.now_us + duration_us, act));
        self.engine.handle(Event::ActTaken { number }, self.now_us);
    }

    pub(crate) fn answer(&mut self, number: u64, outcome: Outcome) {
        self.awaited = None;
        self.engine.handle(Event::ActDone { number, outcome }, self.now_us);
    }

    pub(crate) fn urgent(&mut self, urgent: Urgent) {
        if !self.line_up {
            self.urgent_waits = Some(urgent);
            return;
        }
        self.urgents.push((self.now_us, urgent));
        if urgent == Urgent::Abort && self.lies.unheard_aborts > 0 {
            self.lies.unheard_aborts -= 1;
            // The host repeats it, and the device knows its number until the next session.
            self.urgent_waits = Some(urgent);
            return;
        }
        if self.urgent_waits == Some(Urgent::Abort) && urgent == Urgent::LightOff {
            return;
        }
        if urgent == Urgent::Abort
            && self.device.light_on
            && let Some(after_us) = self.lies.dark_after_us
        {
            (self.dark_at_us, self.device_act) = (Some(self.now_us + after_us), None);
            return self.engine.handle(Event::UrgentFailed(urgent), self.now_us);
        }
        if urgent == Urgent::Abort && self.lies.deaf_to_aborts && self.device.light_on {
            return self.engine.handle(Event::UrgentFailed(urgent), self.now_us);
        }
        if self.lies.stays_lit {
            return self.engine.handle(Event::UrgentFailed(urgent), self.now_us);
        }
        self.device.light_on = false;
        if let Some(id) = self.device.exposing.take() {
            self.device.cut_short = Some((id, 1));
            let cut = self.device_act.take_if(|(_, act)| matches!(act, Act::Vat(VatAct::Expose { .. })));
            if let (Some(_), Urgent::LightOff, Some(number)) = (cut, urgent, self.awaited) {
                self.answer(number, Outcome::Refused(Refusal::CutShort));
            }
        }
        self.engine.handle(Event::UrgentDone(urgent), self.now_us);
        if urgent == Urgent::Abort {
            self.device.moving = false;
            self.device_act = None;
            self.device.slots = vec![None, None];
            self.drop_line(500_000);
            self.engine.handle(Event::LineLost("aborted".into()), self.now_us);
        }
    }

    pub(crate) fn end_act(&mut self) {
        if let Some(event) = self.end_device_act() {
            self.tell(event);
        }
    }

    /// The device's act ends; what it says of that, if the host is to hear of it.
    pub(super) fn end_device_act(&mut self) -> Option<Event> {
        let (_, act) = self.device_act.take()?;
        self.device.moving = false;
        let outcome = match act {
            Act::Powder(_) | Act::Vat(VatAct::Change { .. }) => panic!("an act of another kind of machine: {act:?}"),
            Act::Vat(VatAct::Home) => {
                self.device.position_um = Some(0);
                Outcome::Vat(VatOutcome::Arrived { position_um: 0 })
            }
            Act::Vat(VatAct::Move { position_um, .. }) => {
                let ends_at = self.lies.misplaced.filter(|(to_um, _)| *to_um == position_um);
                let position_um = ends_at.map_or(position_um, |(_, ends_at_um)| ends_at_um);
                self.device.position_um = Some(position_um);
                Outcome::Vat(VatOutcome::Arrived { position_um })
            }
            Act::Vat(VatAct::Expose { layer, .. }) if self.lies.refuses_lit.is_some_and(|(lied, ..)| lied == layer) => {
                let (_, refusal, hidden) = self.lies.refuses_lit?;
                self.exposed.push(layer);
                self.device.light_on = false;
                self.device.exposing = None;
                self.device.cut_short = hidden.then_some((ExposureId::first_pass(KEY, layer), 400));
                Outcome::Refused(refusal)
            }
            Act::Vat(VatAct::Expose { layer, pass, duration_ms, .. }) => {
                self.exposed.push(layer);
                self.device.light_on = false;
                self.device.last_exposed = self.device.exposing.take();
                for slot in &mut self.device.slots {
                    *slot = slot.filter(|id| id.layer != layer);
                }
                Outcome::Vat(VatOutcome::Exposed {
                    layer,
                    pass,
                    duration_ms: self.lies.light_ms.unwrap_or(duration_ms),
                })
            }
        };
        let is_told = !self.lies.mute && !std::mem::take(&mut self.mute_once);
        let number = self.awaited.take().filter(|_| is_told)?;
        Some(Event::ActDone { number, outcome })
    }
}
