//! The next exposure, and what is known of it. Its doubts are tested by `tests/job_engine/doubt.rs`.

use super::super::{ResumeChoice, StartPoint, Unconfirmed};
use crate::link::message::Refusal;

/// The exposure that is next, or under way.
#[derive(Debug)]
pub(super) struct NextExposure {
    pub(super) number: u32,
    pub(super) known: Known,
    /// The operator's decision, if it is in doubt. Taken when the device first comes to rest: it is for the layer as it is then.
    pub(super) choice: ResumeChoice,
    /// How often it was commanded in this run.
    pub(super) commands: u32,
}

/// What is known of the light of a layer.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Known {
    /// It was not commanded, or the device says that it had no light.
    Dark,
    /// It was commanded, and neither confirmed nor denied.
    Commanded {
        /// Boot id of the device that it was commanded to.
        boot_id: u32,
        sign: Sign,
    },
    /// It was commanded, and it is unknown how much light it had. Says what is known.
    InDoubt(String),
}

/// What the device said of a commanded layer that its state must prove, or that cannot be true.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) enum Sign {
    /// Nothing.
    #[default]
    None,
    /// It refused the layer. Its state must tell whether there was light nevertheless.
    Refused(Refusal),
    /// A state named the layer as exposed sooner than it can be; describes it.
    EndedEarly(String),
}

impl NextExposure {
    pub(super) fn new(start: StartPoint) -> Self {
        let known = match start.unconfirmed {
            _ if start.in_doubt => Known::InDoubt("it was not settled before".into()),
            Some(Unconfirmed { boot_id, .. }) => Known::Commanded { boot_id, sign: Sign::None },
            None => Known::Dark,
        };
        Self { number: start.next_exposure, known, choice: start.choice, commands: 0 }
    }

    /// The command, if it is neither confirmed nor denied.
    pub(super) fn unconfirmed(&self) -> Option<Unconfirmed> {
        match self.known {
            Known::Commanded { boot_id, .. } => Some(Unconfirmed { exposure: self.number, boot_id }),
            Known::Dark | Known::InDoubt(_) => None,
        }
    }

    /// Why it is in doubt, if it is.
    pub(super) fn doubt(&self) -> Option<&str> {
        match &self.known {
            Known::InDoubt(why) => Some(why),
            Known::Dark | Known::Commanded { .. } => None,
        }
    }

    /// Notes that it had no light, or that its command never left the host. Returns whether it was commanded.
    pub(super) fn deny(&mut self) -> bool {
        let was_commanded = self.unconfirmed().is_some();
        if was_commanded {
            self.known = Known::Dark;
        }
        was_commanded
    }

    /// Goes on to the layer after it.
    pub(super) fn advance(&mut self) {
        self.number += 1;
        (self.known, self.commands) = (Known::Dark, 0);
    }

    /// Notes what the device said of the command. Does nothing if the layer is not commanded.
    pub(super) fn note(&mut self, new: Sign) {
        if let Known::Commanded { sign, .. } = &mut self.known {
            *sign = new;
        }
    }

    /// Takes what the device said of the command.
    pub(super) fn take_sign(&mut self) -> Sign {
        match &mut self.known {
            Known::Commanded { sign, .. } => std::mem::take(sign),
            Known::Dark | Known::InDoubt(_) => Sign::None,
        }
    }

    /// Takes the description of an end that came too early, if there was one.
    pub(super) fn take_early_end(&mut self) -> Option<String> {
        match &mut self.known {
            Known::Commanded { sign: sign @ Sign::EndedEarly(_), .. } => match std::mem::take(sign) {
                Sign::EndedEarly(text) => Some(text),
                Sign::None | Sign::Refused(_) => None,
            },
            _ => None,
        }
    }
}
