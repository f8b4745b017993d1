//! Times, durations and the progress of a job as every command words them.
//!
//! Times are local to the reader, as `TZ` and `/etc/localtime` say, with their offset from UTC, in every locale.
//! The unit tests below show the words.

use std::sync::OnceLock;
use std::time::SystemTime;

use time::{OffsetDateTime, UtcOffset};

use crate::api::{JobView, LinkState};
use crate::text::count_text;

const UNKNOWN_TIME: &str = "at an unknown time";
const MONTHS: [&str; 12] = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];
/// A day and month without a year mean the last ones before now; older times are shown with their year.
const MAX_YEARLESS_MS: u64 = 300 * 86_400_000;

/// `812 of 3000 layers done (27 %)`. The percentage is rounded down.
pub(super) fn layers_text(job: &JobView) -> String {
    let JobView { layers_done, layers_total, .. } = job;
    let percent = (u64::from(*layers_done) * 100).checked_div(u64::from(*layers_total));
    let share = percent.map_or_else(String::new, |percent| format!(" ({percent} %)"));
    format!("{layers_done} of {} done{share}", count_text(u64::from(*layers_total), "layer"))
}

/// Progress of a job, the same for every command: its layers, and how long ago it began or how long it took, pauses included; and if
/// known, the remaining time and the time of the end, as `1 min 35 s to go, until about 2026-01-31 08:05 UTC`.
pub(super) fn progress_lines(job: &JobView, now: SystemTime) -> Vec<String> {
    let now_ms = unix_ms(now);
    let took = took_s(job, now_ms).map_or_else(String::new, |took_s| {
        let took = duration_text(took_s);
        if job.state.is_final() { format!(" in {took}") } else { format!(", begun {took} ago") }
    });
    let mut lines = vec![format!("{}{took}", layers_text(job))];
    lines.extend(job.eta_s.map(|eta_s| {
        let end = time_text(now_ms.saturating_add(eta_s.saturating_mul(1000)));
        format!("{} to go, until about {end}", duration_text(eta_s))
    }));
    lines
}

/// How long ago a job began, or how long it took, pauses included, seconds; `None` if it has not begun.
pub(super) fn took_s(job: &JobView, now_ms: u64) -> Option<u64> {
    job.duration_s.or_else(|| job.started_ms.map(|started_ms| now_ms.saturating_sub(started_ms) / 1000))
}

/// `about 12 ml of resin`, or `about 3.1 of 12 ml of resin` if the job has exposed a part of its layers; `None` if that is not known.
pub(super) fn resin_text(job: &JobView) -> Option<String> {
    about_ml_text(job).map(|ml| format!("{ml} of resin"))
}

/// The same where a label says already that it is resin: `about 12 ml`.
pub(super) fn about_ml_text(job: &JobView) -> Option<String> {
    let all = ml_text(job.resin_ml?);
    let done_ml = job.resin_done_ml.filter(|_| job.layers_done > 0 && job.layers_done < job.layers_total);
    Some(match done_ml {
        Some(done_ml) => format!("about {} of {all} ml", ml_text(done_ml)),
        None => format!("about {all} ml"),
    })
}

/// Two digits at least, and no fraction from 10 on: an estimate is no better.
fn ml_text(ml: f64) -> String {
    match ml {
        10.0.. => format!("{ml:.0}"),
        1.0.. => format!("{ml:.1}"),
        0.1.. => format!("{ml:.2}"),
        _ => format!("{ml:.3}"),
    }
}

/// Removes the remaining time if no device is connected: the print does not go on.
pub(super) fn without_eta(job: &mut JobView, link: LinkState) {
    job.eta_s = job.eta_s.filter(|_| link == LinkState::Connected);
}

/// A time in Unix milliseconds; 0 before 1970.
pub(super) fn unix_ms(time: SystemTime) -> u64 {
    time.duration_since(SystemTime::UNIX_EPOCH).map_or(0, |since| u64::try_from(since.as_millis()).unwrap_or(u64::MAX))
}

/// The time since `since_ms`, Unix milliseconds.
pub(super) fn age_text(since_ms: u64) -> String {
    duration_text(unix_ms(SystemTime::now()).saturating_sub(since_ms) / 1000)
}

/// A time in Unix milliseconds as `2026-01-31 08:05 UTC` or `2026-01-31 09:05 +01:00`.
pub(super) fn time_text(unix_ms: u64) -> String {
    local(unix_ms).map_or_else(
        || UNKNOWN_TIME.into(),
        |at| format!("{} {:02}:{:02} {}", date_text(at), at.hour(), at.minute(), offset_text(at.offset())),
    )
}

/// The same with seconds.
pub(super) fn second_text(unix_ms: u64) -> String {
    local(unix_ms).map_or_else(
        || UNKNOWN_TIME.into(),
        |at| {
            let (hour, minute, second) = at.to_hms();
            format!("{} {hour:02}:{minute:02}:{second:02} {}", date_text(at), offset_text(at.offset()))
        },
    )
}

/// A time in Unix milliseconds as `08:05:12` if it is on the same day as the one before it, else as [`second_text`].
pub(super) fn later_text(unix_ms: u64, before_ms: u64) -> String {
    match (local(before_ms), local(unix_ms)) {
        (Some(before), Some(at)) if before.date() == at.date() && before.offset() == at.offset() => {
            let (hour, minute, second) = at.to_hms();
            format!("{hour:02}:{minute:02}:{second:02}")
        }
        _ => second_text(unix_ms),
    }
}

/// A time in Unix milliseconds for a narrow column: `31 Jan 08:05`, or `31 Jan 2025` if it is long ago.
pub(super) fn short_time_text(unix_ms: u64, now_ms: u64) -> String {
    local(unix_ms).map_or_else(
        || "unknown".into(),
        |at| {
            let (day, month) = (at.day(), MONTHS[usize::from(u8::from(at.month())) - 1]);
            if now_ms.abs_diff(unix_ms) > MAX_YEARLESS_MS {
                format!("{day:2} {month} {}", at.year())
            } else {
                format!("{day:2} {month} {:02}:{:02}", at.hour(), at.minute())
            }
        },
    )
}

/// The offset of local times from UTC at the time `unix_ms`, as a heading names it.
pub(super) fn zone_text(unix_ms: u64) -> String {
    local(unix_ms).map_or_else(|| "UTC".into(), |at| offset_text(at.offset()))
}

fn date_text(at: OffsetDateTime) -> String {
    format!("{}-{:02}-{:02}", at.year(), u8::from(at.month()), at.day())
}

fn offset_text(offset: UtcOffset) -> String {
    let (hours, minutes, _) = offset.as_hms();
    if offset.is_utc() {
        return "UTC".into();
    }
    let sign = if offset.is_negative() { '-' } else { '+' };
    format!("{sign}{:02}:{:02}", hours.unsigned_abs(), minutes.unsigned_abs())
}

fn local(unix_ms: u64) -> Option<OffsetDateTime> {
    let utc = OffsetDateTime::from_unix_timestamp(i64::try_from(unix_ms / 1000).ok()?).ok()?;
    utc.checked_to_offset(UtcOffset::local_offset_at(utc).unwrap_or_else(|_| offset_at_start()))
}

/// The local offset when this was called first. While there are several threads, `time` tells no other: one of them could change
/// `TZ` meanwhile.
pub(super) fn offset_at_start() -> UtcOffset {
    static OFFSET: OnceLock<UtcOffset> = OnceLock::new();
    *OFFSET.get_or_init(|| UtcOffset::current_local_offset().unwrap_or(UtcOffset::UTC))
}

/// `1 h 05 min`, `4 min 10 s`, `12 s`.
pub(super) fn duration_text(seconds: u64) -> String {
    match (seconds / 3600, seconds / 60 % 60, seconds % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, m, s) => format!("{m} min {s:02} s"),
        (h, m, _) => format!("{h} h {m:02} min"),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn durations_read_well() {
        assert_eq!(duration_text(12), "12 s");
        assert_eq!(duration_text(250), "4 min 10 s");
        assert_eq!(duration_text(3900), "1 h 05 min");
    }

    #[test]
    fn times_that_are_none_are_told_as_that() {
        assert_eq!(time_text(u64::MAX), "at an unknown time");
        assert_eq!(second_text(u64::MAX), "at an unknown time");
        assert_eq!(short_time_text(u64::MAX, 0), "unknown");
        assert_eq!(later_text(u64::MAX, 0), "at an unknown time");
    }

    #[test]
    fn a_time_of_the_same_day_needs_no_date() {
        let evening_ms = 1_767_225_600_000 - 1000;
        assert_eq!(later_text(evening_ms, evening_ms - 3_600_000), "23:59:59");
        assert_eq!(later_text(evening_ms + 2000, evening_ms), "2026-01-01 00:00:01 UTC");
    }

    #[test]
    fn offsets_read_well() {
        let told = [(0, 0), (1, 0), (5, 30), (-3, -30), (0, -15)]
            .map(|(hours, minutes)| offset_text(UtcOffset::from_hms(hours, minutes, 0).expect("an offset")));
        assert_eq!(told, ["UTC", "+01:00", "+05:30", "-03:30", "-00:15"]);
    }

    #[test]
    fn progress_is_told_in_layers_share_and_time() {
        let text = r#"{"id": "8", "name": "a", "state": "printing", "recipe": "r", "layers_done": 812, "layers_total": 3000,
            "layer": 812, "eta_s": 95, "late_layers": 0, "late_ms_total": 0, "submitted_ms": 1,
            "started_ms": 1767225600000, "ended_ms": null, "reason": null, "in_doubt": null}"#;
        let mut job: JobView = serde_json::from_str(text).unwrap();
        let now = SystemTime::UNIX_EPOCH + Duration::from_secs(1_767_225_600 + 3900);
        let end = format!("1 min 35 s to go, until about {}", time_text(1_767_225_600_000 + 3_995_000));
        assert_eq!(progress_lines(&job, now), ["812 of 3000 layers done (27 %), begun 1 h 05 min ago", &end]);
        without_eta(&mut job, LinkState::Connected);
        assert_eq!(job.eta_s, Some(95));
        without_eta(&mut job, LinkState::Lost);
        assert_eq!(progress_lines(&job, now).len(), 1);
        // Interrupted or not, the time is counted in one way.
        (job.state, job.ended_ms) = (crate::job::JobState::Interrupted, Some(1_767_225_612_000));
        assert_eq!(progress_lines(&job, now), ["812 of 3000 layers done (27 %), begun 1 h 05 min ago"]);
        (job.state, job.duration_s) = (crate::job::JobState::Stopped, Some(12));
        assert_eq!(progress_lines(&job, now), ["812 of 3000 layers done (27 %) in 12 s"]);
        assert_eq!(resin_text(&job), None);
        (job.resin_ml, job.resin_done_ml) = (Some(12.44), Some(3.116));
        assert_eq!(resin_text(&job).as_deref(), Some("about 3.1 of 12 ml of resin"));
        (job.layers_done, job.layers_total, job.started_ms, job.duration_s) = (0, 1, None, None);
        assert_eq!(progress_lines(&job, now), ["0 of 1 layer done (0 %)"]);
        assert_eq!(resin_text(&job).as_deref(), Some("about 12 ml of resin"));
        assert_eq!([123.4, 0.4567, 0.0123].map(ml_text), ["123", "0.46", "0.012"]);
    }
}
