//! Draws the screen of `layerctl watch`. On a small screen the light is the last thing to be left out.
//! The unit tests below draw it in several sizes.

use std::time::{Duration, SystemTime};

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::Line;
use ratatui::widgets::{Gauge, Paragraph, Wrap};
use tokio::time::Instant;

use super::view::View;
use crate::api::{DeviceView, JobView};
use crate::cli::progress::{duration_text, layers_text, without_eta};
use crate::cli::{status, with_socket};
use crate::text::{count_text, mm_text, plain};

/// Fits 40 columns.
const KEYS: &str = "p pause r resume s stop a abort q leave";
/// A note takes at most this fraction of the rows (1/n), unless it says what to do by hand.
const NOTE_SHARE: u16 = 2;
/// A warning takes at most this fraction of the rows (1/n): its end only says what to do about the daemon.
const WARNING_SHARE: u16 = 3;

/// Draws the view at the time `now`. Rows are assigned in this order: light, question or keys, what to do by hand, warning, progress
/// bar, any other note, everything else with the jobs first.
pub(super) fn draw(frame: &mut Frame<'_>, view: &View, now: Instant) {
    let age = view.age(now);
    let width = frame.area().width;
    let (prompt, colour) = match &view.question {
        Some(question) => (question.text(), Color::Red),
        None => (KEYS.into(), Color::Reset),
    };
    let prompt = Paragraph::new(shown(&prompt)).style(Style::new().fg(colour)).wrap(Wrap { trim: false });
    let warning = age.map(|age| warning(view, age)).or_else(|| trouble(&view.reading.device)).unwrap_or_default();
    let warning = Paragraph::new(shown(&warning)).style(Style::new().fg(Color::Red)).wrap(Wrap { trim: false });
    let note = Paragraph::new(shown(view.young_note(now))).wrap(Wrap { trim: false });

    let mut left = frame.area().height;
    let mut take = |wanted: usize| {
        let rows = u16::try_from(wanted).unwrap_or(u16::MAX).min(left);
        left -= rows;
        rows
    };
    let light_rows = take(1);
    let prompt_rows = take(prompt.line_count(width));
    let wanted_note_rows = rows_of(&note, width);
    let by_hand_rows = if view.is_by_hand() { take(wanted_note_rows) } else { 0 };
    let max_warning_rows = usize::from(frame.area().height.div_ceil(WARNING_SHARE));
    let warning_rows = take(rows_of(&warning, width).min(max_warning_rows));
    let bar_rows = take(1);
    let max_note_rows = usize::from(frame.area().height.div_ceil(NOTE_SHARE));
    let note_rows = by_hand_rows + if view.is_by_hand() { 0 } else { take(wanted_note_rows.min(max_note_rows)) };
    let rest_rows = take(usize::MAX);
    let [light_area, warning_area, bar_area, rest_area, note_area, prompt_area] = Layout::vertical(
        [light_rows, warning_rows, bar_rows, rest_rows, note_rows, prompt_rows].map(Constraint::Length),
    )
    .areas(frame.area());

    frame.render_widget(light(&view.reading.device, age), light_area);
    frame.render_widget(warning, warning_area);
    let mut status = view.reading.status.clone();
    let link = status.link.state;
    if let Some(job) = &mut status.active {
        // Without a present reading the remaining time is unknown.
        job.eta_s = job.eta_s.filter(|_| age.is_none());
        without_eta(job, link);
    }
    // The elapsed time is known up to the time of the reading.
    let read_at = SystemTime::now().checked_sub(age.unwrap_or_default()).unwrap_or(SystemTime::UNIX_EPOCH);
    frame.render_widget(bar(status.active.as_ref(), age, width), bar_area);
    let rest = shown(
        &[status::work(&status, read_at), status::machine(&status), status::figures(&status)].concat().join("\n"),
    );
    draw_rest(frame, &rest, dimmed(Style::new(), age), rest_area);
    frame.render_widget(note, note_area);
    frame.render_widget(prompt, prompt_area);
}

/// Draws the text, and in the last row how much of it finds no room. A single row goes to the text.
fn draw_rest(frame: &mut Frame<'_>, text: &str, style: Style, area: Rect) {
    let text = Paragraph::new(text).style(style).wrap(Wrap { trim: false });
    let hidden_rows = (text.line_count(area.width) + 1).saturating_sub(usize::from(area.height));
    if area.height < 2 || hidden_rows < 2 {
        return frame.render_widget(text, area);
    }
    let [text_area, more_area] = Layout::vertical([Constraint::Fill(1), Constraint::Length(1)]).areas(area);
    frame.render_widget(text, text_area);
    let more = format!("… {}: enlarge the window", count_text(hidden_rows as u64, "more row"));
    frame.render_widget(Line::styled(more, style), more_area);
}

/// The text as it is safe to show in a terminal.
fn shown(text: &str) -> String {
    plain(&with_socket(text))
}

fn rows_of(text: &Paragraph<'_>, width: u16) -> usize {
    if text.line_width() == 0 { 0 } else { text.line_count(width) }
}

/// Grey if the reading is not of the present.
fn dimmed(style: Style, age: Option<Duration>) -> Style {
    if age.is_some() { Style::new().fg(Color::DarkGray) } else { style }
}

/// Line with light and plate, short enough for 40 columns.
fn light(device: &DeviceView, age: Option<Duration>) -> Line<'static> {
    let Some(state) = &device.state else { return Line::raw("light unknown: no device has answered yet") };
    let is_present = age.is_none() && device.connected;
    let plate = state.position_um.map_or_else(|| "not homed".into(), mm_text);
    let moving = if state.moving { ", moving" } else { "" };
    if is_present {
        let (light, style) = if state.light_on {
            ("LIGHT ON", Style::new().fg(Color::Yellow).add_modifier(Modifier::BOLD))
        } else {
            ("light off", Style::new())
        };
        return Line::styled(format!("{light}   plate {plate}{moving}"), style);
    }
    let light = if state.light_on { "ON" } else { "off" };
    let text = match age {
        Some(age) => format!("light? ({light} {} ago) plate {plate}", coarse(age)),
        None => format!("light? (was {light}) plate was {plate}"),
    };
    Line::styled(text, Style::new().fg(Color::DarkGray))
}

/// A duration in its largest unit: `14 s`, `14 min`, `14 h`.
fn coarse(age: Duration) -> String {
    match age.as_secs() {
        s @ 0..60 => format!("{s} s"),
        s @ 60..3600 => format!("{} min", s / 60),
        s => format!("{} h", s / 3600),
    }
}

fn warning(view: &View, age: Duration) -> String {
    let why = view.silence.as_deref().unwrap_or("the daemon does not answer");
    format!("NOT LIVE: what is shown is {} old; {why}", duration_text(age.as_secs()))
}

/// What is wrong with the device; light that does not go off comes before a fault.
fn trouble(device: &DeviceView) -> Option<String> {
    if device.stays_lit.is_some() {
        return device.stays_lit.clone();
    }
    let fault = device.state.as_ref()?.fault.as_ref()?;
    Some(format!("FAULT: {fault}"))
}

fn bar(job: Option<&JobView>, age: Option<Duration>, width: u16) -> Gauge<'_> {
    let (label, done, total) = match job {
        Some(job) => {
            let eta = job.eta_s.map_or_else(String::new, |eta| format!(", {} to go", duration_text(eta)));
            let long = format!("{}{eta}", layers_text(job));
            let fits = long.chars().count() <= usize::from(width);
            let label = if fits { long } else { format!("{}/{} layers{eta}", job.layers_done, job.layers_total) };
            (label, job.layers_done, job.layers_total)
        }
        None => ("no job".into(), 0, 0),
    };
    let share = if total == 0 { 0.0 } else { (f64::from(done) / f64::from(total)).min(1.0) };
    Gauge::default().gauge_style(dimmed(Style::new().fg(Color::Cyan), age)).ratio(share).label(label)
}

#[cfg(test)]
mod tests {
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use ratatui::buffer::Buffer;

    use super::super::view::Question;
    use super::super::view::tests::view;
    use super::*;
    use crate::api::LinkState;
    use crate::cli::patience::BY_HAND;

    fn screen(view: &View, width: u16, height: u16, now: Instant) -> (String, Buffer) {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, view, now)).unwrap();
        (terminal.backend().to_string(), terminal.backend().buffer().clone())
    }

    /// Words may be on two rows.
    fn assert_shown(shown: &str, words: &[&str]) {
        let rows: Vec<&str> = shown.lines().map(|row| row.trim_matches('"').trim()).collect();
        let text = rows.join(" ");
        for words in words {
            assert!(text.contains(words), "`{words}` is not in:\n{shown}");
        }
    }

    #[test]
    fn the_screen_shows_the_print() {
        let mut view = view();
        view.note = "a note".into();
        let shown = screen(&view, 90, 24, view.reading.at).0;
        let words = [
            "LIGHT ON   plate 1.250 mm",
            "7 part.layerd: printing",
            "3 of 12 layers done (25 %), 1 min 35 s to go",
            "1 min 35 s to go, until about 20",
            "2 layers, 40 ms",
            "a note",
            "a abort",
        ];
        assert_shown(&shown, &words);
        view.reading.status.active = None;
        assert_shown(&screen(&view, 90, 24, view.reading.at).0, &["no job"]);
    }

    #[test]
    fn a_light_that_does_not_go_off_is_shown_before_a_fault() {
        let mut view = view();
        let warning = crate::device::STAYS_LIT;
        view.reading.device.stays_lit = Some(warning.into());
        view.reading.device.state.as_mut().unwrap().fault = Some("door open".into());
        assert_shown(&screen(&view, 60, 12, view.reading.at).0, &["LIGHT ON", warning]);
        view.reading.device.stays_lit = None;
        assert_shown(&screen(&view, 60, 12, view.reading.at).0, &["FAULT: door open"]);
    }

    #[test]
    fn the_light_is_the_last_to_go_and_a_question_the_last_but_one() {
        let mut view = view();
        for (height, words) in [
            (1, &["LIGHT ON"][..]),
            (2, &["LIGHT ON", KEYS]),
            (5, &["LIGHT ON", KEYS, "3/12 layers, 1 min 35 s to go", "7 part.layerd: printing"]),
            (12, &["LIGHT ON", KEYS, "3 of 12 layers done", "part.layerd: printing"]),
        ] {
            assert_shown(&screen(&view, 40, height, view.reading.at).0, words);
        }
        for (question, words) in [
            (
                Question::Abort { id: "7".into(), name: "part.layerd".into() },
                ["Abort job 7 now?", "any other key does not (part.layerd)"],
            ),
            (Question::Stop { id: "7".into() }, ["End job 7", "any other key does not"]),
            (
                Question::PlateEmpty { id: "8".into(), name: "next.layerd".into() },
                ["is the plate empty", "begins job 8; any other key does not"],
            ),
        ] {
            view.question = Some(question);
            let shown = screen(&view, 40, 5, view.reading.at).0;
            assert_shown(&shown, &["LIGHT ON"]);
            assert_shown(&shown, &words);
        }
    }

    #[test]
    fn a_small_screen_says_that_there_is_more() {
        let view = view();
        let small = screen(&view, 40, 12, view.reading.at).0;
        assert_shown(&small, &["LIGHT ON", "7 part.layerd: printing", "more rows: enlarge the window"]);
        assert!(!small.contains("traffic"), "{small}");
        let large = screen(&view, 90, 30, view.reading.at).0;
        assert_shown(&large, &["traffic", "the line was busy 99.0 %"]);
        assert!(!large.contains("enlarge"), "{large}");
    }

    #[test]
    fn without_the_daemon_nothing_looks_live() {
        let mut view = view();
        view.silence = Some(format!("no layerd answers at /run/x: {}", "do what helps ".repeat(10)));
        let later = view.reading.at + Duration::from_secs(14);
        for (width, height) in [(80, 24), (40, 12), (40, 5)] {
            let (shown, buffer) = screen(&view, width, height, later);
            assert_shown(&shown, &["light? (ON 14 s ago)", "NOT LIVE", "14 s old", "3 of 12 layers done"]);
            assert!(!shown.contains("LIGHT ON") && !shown.contains("to go"), "{shown}");
            for cell in &buffer.content {
                assert!(![Color::Cyan, Color::Yellow].contains(&cell.fg), "{cell:?} looks live in:\n{shown}");
            }
        }
        // Nor does the time that a print has taken go on: 86 s and not 100.
        let now_ms = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_millis() as u64;
        view.reading.status.active.as_mut().unwrap().started_ms = Some(now_ms - 100_000);
        assert_shown(&screen(&view, 80, 24, later).0, &["(25 %), begun 1 min 2"]);
        // A device that does not answer is no more alive than a daemon.
        let mut view = self::view();
        view.reading.device.connected = false;
        assert_shown(&screen(&view, 80, 24, view.reading.at).0, &["light? (was ON)"]);
    }

    #[test]
    fn without_a_device_nothing_counts_down() {
        let mut view = view();
        view.reading.status.link.state = LinkState::Lost;
        view.reading.device.connected = false;
        for (width, height) in [(80, 24), (40, 12)] {
            let shown = screen(&view, width, height, view.reading.at).0;
            assert!(!shown.contains("to go"), "{shown}");
            assert_shown(&shown, &["light? (was ON) plate was 1.250 mm", "3 of 12 layers done (25 %)"]);
        }
    }

    #[test]
    fn what_to_do_by_hand_is_shown_whole_on_a_small_screen() {
        let mut view = view();
        view.silence = Some("no layerd answers: start it (systemctl start layerd)".into());
        let later = view.reading.at + Duration::from_secs(14);
        for note in [
            format!("{BY_HAND}: no layerd answers, so the order was not given"),
            format!(
                "{BY_HAND}: the device does not answer now. It will abort job 7 (part.layerd) as soon as it answers"
            ),
        ] {
            view.note = note.clone();
            view.noted_at = later;
            for (width, height) in [(80, 24), (40, 12), (40, 8)] {
                assert_shown(&screen(&view, width, height, later).0, &["light? (ON 14 s ago)", &note]);
            }
        }
    }
}
