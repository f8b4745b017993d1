//! The records of a journal in plain words. Layers exposed one after another share a line.
//! The unit tests below show whole logs, `tests/operator/records.rs` that of a print.

use crate::api::{LogEntry, LogRecord};
use crate::cli::progress::{later_text, second_text};
use crate::job::{EndOrder, JobState};
use crate::text::{count_text, layer_text, plain_line};

/// Turns the entries of a log into lines.
pub(super) struct Story {
    /// Whether each layer has lines of its own.
    all: bool,
    /// Layers exposed one after another that are not told yet.
    exposed: Option<Exposed>,
    /// A layer that was commanded and is not told yet.
    commanded: Option<Commanded>,
    /// Whether an engine had taken the job over, and no end is recorded since.
    runs: bool,
    /// The last order to end. It is recorded again when the job takes the machine for it.
    ordered: Option<EndOrder>,
}

/// A layer whose exposure was commanded.
struct Commanded {
    layer: u32,
    material: Option<String>,
    /// When, Unix milliseconds.
    at_ms: u64,
}

/// Layers exposed one after another.
struct Exposed {
    first: u32,
    last: u32,
    last_material: Option<String>,
    /// When the first was commanded, Unix milliseconds.
    from_ms: u64,
    /// When the last was confirmed, Unix milliseconds.
    until_ms: u64,
}

impl Exposed {
    /// Whether this exposure can be the next.
    fn is_before(&self, layer: u32, material: Option<&str>) -> bool {
        self.last.checked_add(1) == Some(layer) || (self.last == layer && self.last_material.as_deref() != material)
    }
}

impl Story {
    /// The beginning; with `all`, each layer gets lines of its own.
    pub(super) fn new(all: bool) -> Self {
        Self { all, exposed: None, commanded: None, runs: false, ordered: None }
    }

    /// The lines that the next entry completes.
    pub(super) fn continued(&mut self, entry: &LogEntry) -> Vec<String> {
        let LogEntry { at_ms, material, record } = entry;
        let material = material.as_deref();
        match record {
            LogRecord::Commanded { layer } if !self.all => {
                let mut lines = Vec::new();
                // Commanded a second time: the first time it was not exposed.
                if self.exposed.as_ref().is_some_and(|exposed| !exposed.is_before(*layer, material)) {
                    lines = self.ended();
                }
                self.commanded =
                    Some(Commanded { layer: *layer, material: material.map(str::to_owned), at_ms: *at_ms });
                lines
            }
            LogRecord::Confirmed { layer } if !self.all && self.is_commanded(*layer, material) => {
                let from_ms = self.commanded.take().map_or(*at_ms, |commanded| commanded.at_ms);
                let (last, until_ms, last_material) = (*layer, *at_ms, material.map(str::to_owned));
                let (first, from_ms) =
                    self.exposed.take().map_or((last, from_ms), |before| (before.first, before.from_ms));
                self.exposed = Some(Exposed { first, last, last_material, from_ms, until_ms });
                Vec::new()
            }
            LogRecord::LastExposed { .. } if !self.all => Vec::new(),
            LogRecord::Ordered { order } if !self.all && self.ordered == Some(*order) => Vec::new(),
            record => {
                let mut lines = self.ended();
                lines.push(line(*at_ms, &self.words(record, material)));
                lines
            }
        }
    }

    /// The lines that are left when the log ends.
    pub(super) fn ended(&mut self) -> Vec<String> {
        let exposed = self.exposed.take().map(|exposed| {
            let Exposed { first, last, from_ms, until_ms, .. } = exposed;
            let until = later_text(until_ms, from_ms);
            let text = match first == last {
                true => format!("layer {first}: exposed, confirmed at {until}"),
                false => format!("layers {first} to {last}: exposed, the last at {until}"),
            };
            line(from_ms, &text)
        });
        let commanded = self
            .commanded
            .take()
            .map(|Commanded { layer, material, at_ms }| line(at_ms, &commanded_text(layer, material.as_deref())));
        exposed.into_iter().chain(commanded).collect()
    }

    fn is_commanded(&self, layer: u32, material: Option<&str>) -> bool {
        self.commanded.as_ref().is_some_and(|known| known.layer == layer && known.material.as_deref() == material)
    }

    fn words(&mut self, record: &LogRecord, material: Option<&str>) -> String {
        let name = |layer: &u32| layer_text(*layer, material);
        match record {
            LogRecord::Accepted { name, layers_total } => {
                format!("accepted: {}, {}", plain_line(name), count_text(u64::from(*layers_total), "layer"))
            }
            LogRecord::Materials { names, exposures_total, changes_total } => {
                let names: Vec<_> = names.iter().map(|name| plain_line(name)).collect();
                let (exposures, changes) = (u64::from(*exposures_total), u64::from(*changes_total));
                format!(
                    "of {}: {}, {} of the vat",
                    names.join(", "),
                    count_text(exposures, "exposure"),
                    count_text(changes, "change")
                )
            }
            LogRecord::Started { layer } => {
                let layer = name(layer);
                let crashed = std::mem::replace(&mut self.runs, true);
                let after = if crashed {
                    "; before that the daemon ended without recording why (crash or power cut)"
                } else {
                    ""
                };
                format!("took the machine, {layer} is next{after}")
            }
            LogRecord::PlateClear { confirmed_exposures: 0 } => "the plate is taken to be empty".into(),
            LogRecord::PlateClear { confirmed_exposures } => format!(
                "the operator confirmed that the plate is empty, although the device shows {} of jobs unknown here",
                count_text(u64::from(*confirmed_exposures), "exposure")
            ),
            LogRecord::LastExposed { layer } => format!("before, the device exposed layer {layer} of another job last"),
            LogRecord::Commanded { layer } => commanded_text(*layer, material),
            LogRecord::Confirmed { layer } => format!("{}: exposed, the device confirms", name(layer)),
            LogRecord::NotExposed { layer } => {
                format!("{}: not exposed, says the device; it is commanded again", name(layer))
            }
            LogRecord::PartlyMarked { layer, next_vector } => {
                format!("{}: marked up to vector {next_vector}, where it goes on", name(layer))
            }
            LogRecord::Withdrawn { layer } => {
                format!("{}: not exposed, its command never left the host; it is commanded again", name(layer))
            }
            LogRecord::InDoubt { layer, why } => format!("{}: in doubt, {}", name(layer), plain_line(why)),
            LogRecord::Decided { layer, exposed: true } => {
                format!("{}: the operator decided that it was exposed", name(layer))
            }
            LogRecord::Decided { layer, exposed: false } => {
                format!("{}: the operator decided to expose it again", name(layer))
            }
            LogRecord::Paused => "paused".into(),
            LogRecord::Resumed => "resumed".into(),
            LogRecord::LightOff => "light off, the device confirms".into(),
            LogRecord::Ordered { order } => {
                self.ordered = Some(*order);
                format!("ordered to {}", order.verb())
            }
            LogRecord::Dropped { what } => plain_line(what),
            LogRecord::Parked => "parked: the machine rests, and the part is where it is safe".into(),
            LogRecord::Ended { state, reason } => {
                self.runs = false;
                let word = if *state == JobState::Interrupted { "interrupted" } else { "ended" };
                let how = if *state == JobState::Interrupted { String::new() } else { format!(": {state}") };
                let why = if reason.is_empty() { String::new() } else { format!(": {}", plain_line(reason)) };
                format!("{word}{how}{why}")
            }
        }
    }
}

fn commanded_text(layer: u32, material: Option<&str>) -> String {
    format!("{}: exposure commanded", layer_text(layer, material))
}

fn line(at_ms: u64, text: &str) -> String {
    format!("{}  {text}", second_text(at_ms))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(all: bool, records: &[LogRecord]) -> Vec<String> {
        let mut story = Story::new(all);
        let mut lines = Vec::new();
        for (record, at_ms) in records.iter().zip(1_767_225_600_000_u64..) {
            lines.extend(story.continued(&LogEntry { at_ms, material: None, record: record.clone() }));
        }
        lines.extend(story.ended());
        lines.iter().map(|line| line.strip_prefix("2026-01-01 00:00:00 UTC  ").expect("a time").to_owned()).collect()
    }

    #[test]
    fn layers_that_follow_each_other_share_a_line_until_something_else_happens() {
        use LogRecord::{Commanded, Confirmed, Decided, InDoubt, Started, Withdrawn};
        let layer = |layer| [Commanded { layer }, Confirmed { layer }];
        let doubt = InDoubt { layer: 3, why: "its light was cut short\nafter 40 ms".into() };
        let decided = Decided { layer: 3, exposed: false };
        let records: Vec<_> = [
            [layer(0), layer(1), layer(2)].as_flattened(),
            &[Commanded { layer: 3 }, doubt, Started { layer: 3 }, decided],
            &layer(3),
            &[Commanded { layer: 4 }, Withdrawn { layer: 4 }, Commanded { layer: 4 }],
        ]
        .concat();

        assert_eq!(
            told(false, &records),
            [
                "layers 0 to 2: exposed, the last at 00:00:00",
                "layer 3: exposure commanded",
                "layer 3: in doubt, its light was cut short\\nafter 40 ms",
                "took the machine, layer 3 is next",
                "layer 3: the operator decided to expose it again",
                "layer 3: exposed, confirmed at 00:00:00",
                "layer 4: exposure commanded",
                "layer 4: not exposed, its command never left the host; it is commanded again",
                "layer 4: exposure commanded",
            ]
        );
        assert_eq!(told(true, &records).len(), records.len(), "a line for each");
    }

    #[test]
    fn a_crash_is_told_where_the_job_is_taken_up_again() {
        let end = LogRecord::Ended { state: JobState::Interrupted, reason: "the line was lost".into() };
        let begins = LogRecord::Started { layer: 0 };
        let lines = told(false, &[begins.clone(), end, begins.clone(), begins]);
        assert_eq!(lines[..2], ["took the machine, layer 0 is next", "interrupted: the line was lost"]);
        assert_eq!(lines[2], lines[0], "its end is recorded");
        assert!(lines[3].ends_with("the daemon ended without recording why (crash or power cut)"), "{lines:?}");
    }
}
