//! `layerctl watch`: the print in a terminal.

use std::io::IsTerminal;
use std::time::Duration;

use anyhow::bail;
use clap::Args;
use ratatui::Frame;
use ratatui::crossterm::event::{self, Event as Input, KeyCode, KeyEventKind, KeyModifiers};
use ratatui::layout::{Constraint, Layout};
use ratatui::style::{Color, Style};
use ratatui::widgets::{Block, Gauge, Paragraph, Wrap};
use tokio::time::timeout;

use super::client::Client;
use super::{block_on, duration_text, print_json, status};
use crate::daemon::api::{DeviceView, JobView, ResumeBody, Status};
use crate::text::{plain, short_name};

/// A daemon that does not answer must not keep the keys from working.
const ANSWER_LIMIT: Duration = Duration::from_secs(1);
/// How often the daemon is asked; people read no faster.
const ASK_INTERVAL: Duration = Duration::from_millis(500);
/// How often keys are looked for.
const KEY_INTERVAL: Duration = Duration::from_millis(50);

/// Follow the print in the terminal.
#[derive(Debug, Args)]
#[command(after_help = "\
Keys: p pause, r resume, s stop after this layer, a abort (asks first), q leave; the print goes on without you.

Examples:
  layerctl watch
  layerctl watch --json        every event as a line of JSON, for programs")]
pub(super) struct WatchArgs {
    /// Print every event of the daemon as one JSON object a line, until it ends.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &WatchArgs) -> anyhow::Result<()> {
    let client = Client::from_environment();
    if args.json {
        return block_on(print_events(client));
    }
    if !std::io::stdout().is_terminal() || !std::io::stdin().is_terminal() {
        bail!("watch needs a terminal; without one use `layerctl status` or `layerctl watch --json`");
    }
    // Asked once before the screen is taken: an error stays readable.
    let view = block_on(View::read(&client, String::new()))?;
    let mut terminal = ratatui::try_init()?;
    let ended = block_on(follow(&client, &mut terminal, view));
    ratatui::restore();
    ended
}

async fn print_events(client: Client) -> anyhow::Result<()> {
    let mut events = client.events().await?;
    while let Some(event) = events.next().await? {
        print_json(&event)?;
    }
    Ok(())
}

/// What is on the screen.
struct View {
    status: Status,
    device: DeviceView,
    note: String,
    asks_abort: bool,
}

impl View {
    async fn read(client: &Client, note: String) -> anyhow::Result<Self> {
        let (status, device) = (client.status().await?, client.get("/v1/device").await?);
        Ok(Self { status, device, note, asks_abort: false })
    }
}

async fn follow(client: &Client, terminal: &mut ratatui::DefaultTerminal, mut view: View) -> anyhow::Result<()> {
    let mut asked = tokio::time::Instant::now();
    loop {
        terminal.draw(|frame| draw(frame, &view))?;
        tokio::time::sleep(KEY_INTERVAL).await;
        while event::poll(Duration::ZERO)? {
            if let Input::Key(key) = event::read()?
                && key.kind == KeyEventKind::Press
            {
                let interrupt = key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL);
                if interrupt || (key.code == KeyCode::Char('q') && !view.asks_abort) {
                    return Ok(());
                }
                press(client, &mut view, key.code).await;
            }
        }
        if asked.elapsed() >= ASK_INTERVAL {
            asked = tokio::time::Instant::now();
            match timeout(ANSWER_LIMIT, View::read(client, view.note.clone())).await {
                Ok(Ok(read)) => view = View { asks_abort: view.asks_abort, ..read },
                Ok(Err(error)) => view.note = format!("{error:#}"),
                Err(_) => view.note = "the daemon does not answer; what is shown is old".into(),
            }
        }
    }
}

/// One key: orders go to the job that holds the machine.
async fn press(client: &Client, view: &mut View, key: KeyCode) {
    let active = view.status.active.as_ref().map(|job| job.id.clone());
    if std::mem::take(&mut view.asks_abort) {
        view.note = match key {
            KeyCode::Char('y') => told(client.abort_active().await),
            _ => "not aborted".into(),
        };
        return;
    }
    let Some(id) = active else {
        view.note = "no job holds the machine".into();
        return;
    };
    view.note = match key {
        KeyCode::Char('p') => told(client.order(&id, "pause").await),
        KeyCode::Char('s') => told(client.order(&id, "stop").await),
        KeyCode::Char('r') => told(client.resume(&id, ResumeBody::default()).await),
        KeyCode::Char('a') => {
            view.asks_abort = true;
            String::new()
        }
        _ => return,
    };
}

fn told(answer: Result<JobView, super::client::ClientError>) -> String {
    match answer {
        Ok(job) => format!("job {} is {}", job.id, job.state),
        Err(error) => error.to_string(),
    }
}

fn draw(frame: &mut Frame<'_>, view: &View) {
    let rows = [Constraint::Length(3), Constraint::Min(6), Constraint::Length(4), Constraint::Length(2)];
    let [progress, status, device, keys] = Layout::vertical(rows).areas(frame.area());
    frame.render_widget(gauge(view.status.active.as_ref()), progress);
    let text = plain(&status::lines(&view.status).join("\n"));
    frame.render_widget(
        Paragraph::new(text).wrap(Wrap { trim: false }).block(Block::bordered().title("layerd")),
        status,
    );
    frame.render_widget(
        Paragraph::new(plain(&device_text(&view.device))).block(Block::bordered().title("device")),
        device,
    );
    let (text, colour) = if view.asks_abort {
        ("abort this print now? y aborts, any other key does not".into(), Color::Red)
    } else {
        (format!("p pause  r resume  s stop  a abort  q leave\n{}", plain(&view.note)), Color::Reset)
    };
    frame.render_widget(Paragraph::new(text).style(Style::new().fg(colour)), keys);
}

fn gauge(job: Option<&JobView>) -> Gauge<'_> {
    let (title, done, total, eta) = match job {
        Some(job) => (format!("{} {}", short_name(&job.name), job.state), job.layers_done, job.layers_total, job.eta_s),
        None => ("no job".into(), 0, 0, None),
    };
    let share = if total == 0 { 0.0 } else { (f64::from(done) / f64::from(total)).min(1.0) };
    let eta = eta.map_or_else(String::new, |eta| format!(", {} to go", duration_text(eta)));
    Gauge::default()
        .block(Block::bordered().title(title))
        .gauge_style(Style::new().fg(Color::Cyan))
        .ratio(share)
        .label(format!("{done} of {total} layers{eta}"))
}

fn device_text(device: &DeviceView) -> String {
    let Some(state) = &device.state else { return "not connected yet".into() };
    let light = if state.light_on { "LIGHT ON" } else { "light off" };
    let plate = state.position_um.map_or_else(|| "not homed".into(), |um| format!("{:.3} mm", f64::from(um) / 1000.0));
    let moving = if state.moving { ", moving" } else { "" };
    let fault = state.fault.as_ref().map_or_else(String::new, |fault| format!("FAULT: {fault}"));
    format!("{light}   plate {plate}{moving}\n{fault}")
}

#[cfg(test)]
mod tests {
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    use super::*;

    const STATUS: &str = r#"{"version": "0.1.0", "machine": "bench", "queue": [],
        "link": {"state": "connected", "path": "/dev/layerd", "device": "sim", "reason": null},
        "active": {"id": "7", "name": "part.layerd", "state": "printing", "recipe": "fine", "layers_done": 3,
            "layers_total": 12, "layer": 3, "eta_s": 95, "late_layers": 2, "late_ms_total": 40, "submitted_ms": 1,
            "started_ms": 2, "ended_ms": null, "reason": null, "in_doubt": null},
        "budget": {"limit_bytes": 67108864, "used_bytes": 1048576, "peak_bytes": 2097152},
        "line": {"sent_bytes": 10, "received_bytes": 1, "sent_frames": 4, "retransmitted_frames": 1, "bad_frames": 0,
            "reconnects": 0, "round_trip_ms": null, "busy_share": 0.99}}"#;

    fn screen(view: &View) -> String {
        let mut terminal = Terminal::new(TestBackend::new(90, 24)).unwrap();
        terminal.draw(|frame| draw(frame, view)).unwrap();
        terminal.backend().to_string()
    }

    #[test]
    fn the_screen_shows_the_print_and_asks_before_an_abort() {
        let status = serde_json::from_str(STATUS).unwrap();
        let mut view = View { status, device: DeviceView::default(), note: "a note".into(), asks_abort: false };
        let shown = screen(&view);
        for words in
            ["part.layerd printing", "3 of 12 layers, 1 min 35 s to go", "2 layers, 40 ms", "a note", "a abort"]
        {
            assert!(shown.contains(words), "`{words}` is not in:\n{shown}");
        }
        view.asks_abort = true;
        assert!(screen(&view).contains("abort this print now?"));
        view.status.active = None;
        assert!(screen(&view).contains("no job"));
    }

    #[tokio::test]
    async fn any_other_key_than_y_does_not_abort() {
        let status = serde_json::from_str(STATUS).unwrap();
        let mut view = View { status, device: DeviceView::default(), note: String::new(), asks_abort: false };
        let client = Client::new("/nonexistent/control.sock");
        press(&client, &mut view, KeyCode::Char('a')).await;
        assert!(view.asks_abort, "nothing was sent yet: the client has no daemon to refuse it");
        press(&client, &mut view, KeyCode::Char('n')).await;
        assert_eq!((view.asks_abort, view.note.as_str()), (false, "not aborted"));
        press(&client, &mut view, KeyCode::Char('a')).await;
        press(&client, &mut view, KeyCode::Char('y')).await;
        assert!(view.note.contains("/nonexistent/control.sock"), "the order was sent: {}", view.note);
    }
}
