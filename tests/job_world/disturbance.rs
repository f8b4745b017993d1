//! What happens to the world in the middle of a print.

use layerd::job::{Action, Command, EndOrder, Engine, Event, History, ResumeChoice};
use layerd::link::message::Urgent;

use super::{Lies, World, plan};

/// What happens to the world at a given step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Disturbance {
    /// The line is down for this long.
    LineLost {
        for_us: u64,
    },
    /// The host dies; the daemon starts again and resumes.
    Crash,
    Order(Command),
    Shutdown,
    /// The device does its next act, or the one under way, and says nothing of it.
    Mute,
    /// The host stands still for this long; its timers are the first to run after that.
    Standstill {
        for_us: u64,
    },
}

impl World {
    pub(crate) fn disturbance(&mut self) -> Option<Disturbance> {
        let place = self.disturb_at.iter().position(|(step, _)| *step <= self.steps)?;
        Some(self.disturb_at.remove(place).1)
    }

    pub(crate) fn disturb(&mut self, disturbance: Disturbance) {
        match disturbance {
            Disturbance::LineLost { for_us } => {
                self.drop_line(for_us);
                self.engine.handle(Event::LineLost("cable".into()), self.now_us);
            }
            Disturbance::Crash => self.crash(),
            Disturbance::Order(command) => {
                self.engine.handle(Event::Command(command), self.now_us);
                if command == Command::Abort {
                    self.aborted = true;
                    let action = self.engine.next_action();
                    assert_eq!(action, Some(Action::Urgent(Urgent::Abort)), "light off before anything else");
                    self.perform(Action::Urgent(Urgent::Abort));
                }
            }
            Disturbance::Shutdown => self.engine.handle(Event::Shutdown, self.now_us),
            Disturbance::Mute => self.mute_once = true,
            Disturbance::Standstill { for_us } => {
                self.now_us += for_us;
                let is_over = self.device_act.is_some_and(|(at_us, _)| at_us <= self.now_us);
                let unread = if is_over { self.end_device_act() } else { None };
                self.engine.handle(Event::Timeout, self.now_us);
                if let Some(event) = unread {
                    self.engine.handle(event, self.now_us);
                }
            }
        }
    }

    pub(crate) fn drop_line(&mut self, for_us: u64) {
        self.line_up = false;
        self.held = None;
        self.awaited = None;
        self.upload = None;
        self.reconnect_at_us = Some(self.now_us + for_us);
    }

    /// A new engine from what the journal says.
    pub(crate) fn crash(&mut self) {
        let history = History::replay(&self.journal).expect("the journal is true at every moment");
        // As the daemon does: what was ordered to end is taken up for that alone.
        let (start, end) = match history.ordered {
            Some(EndOrder::Stop) => (history.start_to_end().ok(), Some(Command::Stop)),
            Some(EndOrder::Abort) => (history.start_to_end().ok(), Some(Command::Abort)),
            None => (history.start(ResumeChoice::None).ok(), None),
        };
        let Some(start) = start else {
            self.finished = Some((history.state, history.reason));
            return;
        };
        self.drop_line(2_000_000);
        self.flushing = None;
        self.engine = Engine::new(plan(), start);
        self.finished = None;
        self.tell(Event::Ready);
        if let Some(command) = end {
            self.tell(Event::Command(command));
        }
    }

    /// Goes on after an end that can be resumed, with a device that is honest again.
    pub(crate) fn resume(&mut self, choice: ResumeChoice) {
        self.lies = Lies::default();
        let history = History::replay(&self.journal).expect("the journal is true");
        self.engine = Engine::new(plan(), history.start(choice).expect("resumable"));
        self.finished = None;
        self.drop_line(100_000);
        self.tell(Event::Ready);
    }
}
