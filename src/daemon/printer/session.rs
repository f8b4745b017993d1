//! What the printer does with events of the line: sessions begin and end, the device sends messages.
//! `tests/hostile` tests it with devices that lie.

use super::Printer;
use crate::api::{Event as News, LinkState, LinkView};
use crate::daemon::machine::view;
use crate::device::{DriverEvent, FramedDriver, check_fit};
use crate::job::Event;
use crate::link::driver::LinkEvent;
use crate::link::message::{Capabilities, DeviceMessage, Urgent};
use crate::link::session::HostEvent;

impl Printer {
    /// Handles an event of the line.
    pub(crate) fn link_event(&mut self, event: LinkEvent) {
        let now_us = self.clock.now_us();
        match event {
            LinkEvent::Session(HostEvent::Connected { capabilities, state, .. }) => {
                self.message = None;
                view::device_connected(&mut self.device, &capabilities, &state, &self.jobs);
                self.compare(&capabilities);
                self.faults.connected();
                self.capabilities = Some(capabilities.clone());
                self.device_state = Some(state.clone());
                let may_begin = !self.abort_goes_first() && self.plate_allows(&state, now_us);
                match &mut self.running {
                    Some(running) if may_begin => running.connected(&capabilities, &state, now_us),
                    Some(_) => {}
                    None => {
                        self.idle.driver = Some(FramedDriver::new(0, &capabilities.machine));
                        self.idle_state(&state, now_us);
                    }
                }
                self.link_changed(LinkState::Connected, None);
            }
            LinkEvent::Session(HostEvent::Message(message)) => self.message(message, now_us),
            LinkEvent::Session(HostEvent::UrgentDone { number, light_on }) => {
                self.urgent_done(number, light_on, now_us);
            }
            LinkEvent::Session(HostEvent::Lost(reason)) => self.lost(self.link.lost_text(reason), now_us),
            LinkEvent::Session(HostEvent::Refused(refusal)) => self.lost(refusal.to_string(), now_us),
            LinkEvent::NotOpen(error) => self.lost(error.to_string(), now_us),
            LinkEvent::NotSent(error) => {
                // Device and driver no longer agree on what was requested.
                self.lost(format!("a message could not be sent: {error}"), now_us);
                self.link.give_up();
            }
            LinkEvent::PortFailed(error) => self.lost(format!("the port failed: {error}"), now_us),
        }
    }

    /// Whether the abort of an earlier job is not answered yet. The device obeys it in this session and then needs a new one, so the
    /// running job waits for that.
    fn abort_goes_first(&self) -> bool {
        let own = self.running.as_ref().and_then(|running| running.urgent).map(|(number, _)| number);
        self.last_abort.is_some() && self.last_abort != own
    }

    /// Checks whether a device that connected can print here, and tells the operator once if not.
    fn compare(&mut self, capabilities: &Capabilities) {
        let misfit = check_fit(&self.setting.machine, &self.setting.recipe, capabilities).err();
        let misfit = misfit.map(|misfit| misfit.to_string());
        if let Some(text) = misfit.as_ref().filter(|_| misfit != self.device.misfit) {
            self.notice(format!("the device does not fit: {text}"));
        }
        self.device.misfit = misfit;
    }

    /// Handles a message of the device.
    fn message(&mut self, message: DeviceMessage, now_us: u64) {
        match self.driver().and_then(|driver| driver.handle(message)) {
            Some(DriverEvent::Fault(fault)) => {
                if let Some(fault) = self.faults.reported(fault, now_us) {
                    self.driver_event(DriverEvent::Fault(fault), now_us);
                }
            }
            Some(event) => self.driver_event(event, now_us),
            None => {}
        }
    }

    pub(crate) fn driver_event(&mut self, event: DriverEvent, now_us: u64) {
        let event = self.with_cause(event);
        let holder = self.holder();
        view::device_told(&mut self.device, &event, &self.jobs, holder);
        let is_state = matches!(event, DriverEvent::StateKnown { .. });
        if let DriverEvent::StateKnown { state, .. } = &event {
            self.device_state = Some(state.clone());
        }
        match &mut self.running {
            Some(running) => running.driver_event(event, now_us),
            None => self.idle_event(event, now_us),
        }
        if is_state {
            self.publish();
        }
    }

    /// Passes on fault reports that were held back because they came too fast.
    pub(crate) fn late_faults(&mut self) {
        let now_us = self.clock.now_us();
        if let Some(fault) = self.faults.due(now_us) {
            self.driver_event(DriverEvent::Fault(fault), now_us);
        }
        if let Some(count) = self.faults.too_many(now_us) {
            self.notice(format!("the device repeated its fault reports: {count} were dropped; check its firmware"));
        }
    }

    /// Adds to a report of misbehaviour what keeps data from getting through: the device may not have been reached.
    fn with_cause(&self, event: DriverEvent) -> DriverEvent {
        match (event, self.link.hindrance()) {
            (DriverEvent::Misbehaved(text), Some(hindrance)) => DriverEvent::Misbehaved(format!("{text}; {hindrance}")),
            (event, _) => event,
        }
    }

    /// Ends a session with a device that does not follow the protocol, and begins a new one. If a job runs, its engine has
    /// already told the operator.
    pub(crate) fn end_session(&mut self, why: String, now_us: u64) {
        if self.running.is_none() {
            self.notice(format!("the session with the device is ended and a new one begins: {why}"));
        }
        self.lost(why, now_us);
        self.link.give_up();
    }

    fn urgent_done(&mut self, number: u32, light_on: bool, now_us: u64) {
        let awaited = self.running.as_mut().and_then(|running| {
            let (_, urgent) = running.urgent.take_if(|(awaited, _)| *awaited == number)?;
            Some((running, urgent))
        });
        let Some((running, urgent)) = awaited else {
            if self.last_abort.take_if(|abort| *abort == number).is_some() {
                // The abort of a job that does not run: it ended before the device came back, or is interrupted. The device
                // does nothing more until a new hello.
                let text = if light_on {
                    "the device answered an abort, but says that its light is still on; a new session begins"
                } else {
                    "the device has obeyed an abort; a new session begins"
                };
                if light_on {
                    self.notice(text.into());
                }
                self.renew_session(text.into(), now_us);
            }
            self.idle.light.put_off_answered();
            return;
        };
        running.engine.handle(if light_on { Event::UrgentFailed(urgent) } else { Event::UrgentDone(urgent) }, now_us);
        if urgent == Urgent::Abort {
            self.last_abort = None;
            if !light_on {
                // An aborted device does nothing more until a new hello. If it is lit, the engine gives it time to go dark.
                self.link.reconnect();
            }
        }
    }

    /// Begins a new session after an abort. It is no reconnect: nothing is wrong with the line.
    pub(crate) fn renew_session(&mut self, why: String, now_us: u64) {
        self.session_over(&why, now_us);
        self.device.connected = false;
        self.link_changed(LinkState::Connecting, Some(why));
        self.link.reconnect();
    }

    /// What was under way in the session is void.
    fn session_over(&mut self, reason: &str, now_us: u64) {
        self.message = None;
        self.idle.driver = None;
        self.device_state = None;
        self.raise_lost(reason);
        self.with_engine(|running| running.line_lost(reason.to_owned(), now_us));
    }

    fn lost(&mut self, reason: String, now_us: u64) {
        self.session_over(&reason, now_us);
        self.reconnects += u64::from(std::mem::take(&mut self.device.connected));
        let state = if self.capabilities.is_some() { LinkState::Lost } else { LinkState::Connecting };
        self.link_changed(state, Some(reason));
    }

    fn link_changed(&mut self, state: LinkState, reason: Option<String>) {
        let path = self.setting.machine.link().path.display().to_string();
        let device = self.capabilities.as_ref().map(|capabilities| capabilities.name.clone());
        let link = LinkView { state, path, device, reason };
        let changed = self.desk.snapshot.borrow().link != link;
        if changed {
            tracing::info!(state = %link.state, reason = link.reason.as_deref().unwrap_or(""), "line");
            self.desk.snapshot.send_modify(|snapshot| snapshot.link = link.clone());
            let _ = self.desk.events.send(News::Link(link));
        }
        self.publish();
    }
}
