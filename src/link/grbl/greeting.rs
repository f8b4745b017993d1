//! How a session begins: waits until the controller is at rest, resets it, and asks what it is and where its axes are. Part of
//! [`GrblSession`].

use super::answer::{Answer, State, Status};
use super::sender::{Kind, PRESS_AGAIN_US};
use super::settings::{GrblMisfit, MAX_LINE_BYTES, Told};
use super::{GrblSession, PIECE_BYTES, Phase, is_dark};
use crate::link::session::{HelloRefusal, HostEvent, LostReason};

/// A controller that was reset when its port was opened takes up to two seconds until it answers.
const LISTEN_US: u64 = 4_000_000;
/// How long a controller may go on with what it was sent before, microseconds; after that it is reset in its motion.
const SETTLE_US: u64 = 10_000_000;
/// A controller that says for so long that it is at rest has read all that it was sent, microseconds. It says so too in the moment
/// between reading a line and moving.
const REST_US: u64 = 100_000;
/// Longest time until the banner, and until each answer to a question about itself, microseconds.
const ANSWER_US: u64 = 3_000_000;
/// The status is asked for this often, microseconds.
const ASK_US: u64 = 200_000;
/// Most banners. A controller that starts more often has a fault.
const MAX_BANNERS: u32 = 5;
/// The questions about the controller: what it is, its settings, and the offsets of its coordinate systems.
const QUESTIONS: [&str; 3] = ["$I", "$$", "$#"];

impl GrblSession {
    /// The next session begins. What the controller was sent before, it may still do.
    pub fn begin(&mut self, session_id: u32, now_us: u64) {
        self.firmware.end_session();
        self.session_id = session_id;
        self.events.clear();
        self.lines.clear();
        self.garbage_before = self.statistics.malformed_frames;
        (self.heard_us, self.now_us) = (now_us, now_us);
        self.enter(Phase::Listening, LISTEN_US);
        (self.banners, self.rests_since_us) = (0, None);
        // An abort does not wait for the controller to finish, nor does a reset that was not answered.
        if self.firmware.is_resetting() || self.urgents.iter().any(|(_, urgent)| is_dark(*urgent)) {
            self.press_reset();
        }
    }

    fn enter(&mut self, phase: Phase, most_us: u64) {
        (self.phase, self.give_up_us, self.ask_us) = (phase, self.now_us + most_us, self.now_us);
    }

    pub(super) fn press_reset(&mut self) {
        self.firmware.sender.reset();
        self.enter(Phase::Resetting, ANSWER_US);
        self.ask_us = self.now_us + PRESS_AGAIN_US;
    }

    /// An answer while the session begins.
    pub(super) fn greet(&mut self, answer: Answer) {
        match (self.phase, answer) {
            // Nothing counts before the banner.
            (_, Answer::Banner(_)) if self.banners >= MAX_BANNERS => {
                self.lose(LostReason::NoAnswer { garbage_frames: 0 });
            }
            (_, Answer::Banner(name)) => {
                self.banners += 1;
                self.firmware.started(self.now_us);
                self.told = Told::of(name);
                self.firmware.sender.set_room(MAX_LINE_BYTES);
                self.ask_about(0);
            }
            (Phase::Listening | Phase::Settling, Answer::Status(status)) => self.settle(&status),
            (Phase::Asking(_), Answer::Options(blocks, bytes)) => self.told.options = Some((blocks, bytes)),
            (Phase::Asking(_), Answer::Setting(setting, value)) => self.told.note(setting, value),
            (Phase::Asking(_), Answer::Offset(offset_um)) => self.told.offset_um = Some(offset_um),
            (Phase::Asking(answered), Answer::Ok) => self.ask_about(answered + 1),
            // What it does not tell is missing when its settings are checked.
            (Phase::Asking(answered), Answer::Error(_)) => self.ask_about(answered + 1),
            (Phase::Locating, Answer::Status(status)) => self.open(&status),
            _ => {}
        }
    }

    /// The controller is there. What it still does, it may end: its laser goes off at the end of a vector then.
    fn settle(&mut self, status: &Status) {
        self.firmware.sender.heard_status();
        match status.state {
            State::Moving => self.rests_since_us = None,
            State::Idle => {
                let since_us = *self.rests_since_us.get_or_insert(self.now_us);
                if self.now_us >= since_us + REST_US {
                    self.firmware.ran_dry();
                    return self.press_reset();
                }
            }
            State::Alarm | State::Held | State::Off => return self.press_reset(),
        }
        if self.phase == Phase::Listening {
            self.enter(Phase::Settling, SETTLE_US);
            self.ask_us = self.now_us + ASK_US;
        }
    }

    fn ask_about(&mut self, answered: usize) {
        self.firmware.sender.answered();
        let Some(question) = QUESTIONS.get(answered) else { return self.enter(Phase::Locating, ANSWER_US) };
        self.firmware.sender.push(*question, Kind::Other);
        self.enter(Phase::Asking(answered), ANSWER_US);
    }

    /// All is known of the controller.
    fn open(&mut self, status: &Status) {
        self.firmware.sender.heard_status();
        let controller = self.told.check(self.firmware.machine());
        let greeted = controller.and_then(|controller| self.firmware.greet(controller, status, self.now_us));
        self.lacks_position = greeted == Err(GrblMisfit::NoPosition);
        if self.lacks_position {
            // A controller tells its offsets only now and then.
            return;
        }
        if let Err(misfit) = greeted {
            return self.refuse(misfit);
        }
        self.enter(Phase::Open, 0);
        self.events.push_back(HostEvent::Connected {
            session_id: self.session_id,
            capabilities: self.firmware.capabilities().clone(),
            state: self.firmware.state(),
            largest_layer_data_bytes: PIECE_BYTES,
        });
        for (number, urgent) in self.urgents.clone() {
            self.firmware.urgent(number, urgent, self.now_us);
        }
    }

    fn refuse(&mut self, misfit: GrblMisfit) {
        self.phase = Phase::Ended;
        self.events.push_back(HostEvent::Refused(HelloRefusal::Grbl(misfit)));
    }

    /// Handles the timers of a session that begins.
    pub(super) fn greeting_due(&mut self) {
        match self.phase {
            // It does not come to rest.
            Phase::Settling if self.now_us >= self.give_up_us => self.press_reset(),
            Phase::Locating if self.now_us >= self.give_up_us && self.lacks_position => {
                self.refuse(GrblMisfit::NoPosition);
            }
            _ if self.now_us >= self.give_up_us => {
                let garbage_frames = self.statistics.malformed_frames - self.garbage_before;
                self.lose(LostReason::NoAnswer { garbage_frames });
            }
            Phase::Listening | Phase::Settling | Phase::Locating => self.ask_status(ASK_US),
            // The reset may have been lost.
            Phase::Resetting if self.now_us >= self.ask_us => {
                self.firmware.sender.reset();
                self.ask_us = self.now_us + PRESS_AGAIN_US;
            }
            Phase::Asking(_) => self.ask_us = u64::MAX,
            Phase::Resetting | Phase::Open | Phase::Ended => {}
        }
    }
}
