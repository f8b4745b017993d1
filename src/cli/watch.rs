//! `layerctl watch`: the print in a terminal. `view` is what it shows, `screen` draws it, `order` gives orders.
//! The unit tests in `view` show screens.

mod order;
mod screen;
mod view;

use std::io::IsTerminal;
use std::time::Duration;

use anyhow::bail;
use clap::Args;
use ratatui::crossterm::event::{self, Event as Input, KeyCode, KeyEventKind, KeyModifiers};
use tokio::sync::mpsc;
use tokio::time::{Instant, timeout};

use self::view::{News, Reading, View};
use super::client::Client;
use super::client_error::{ClientError, start_text};
use super::{block_on, print_json};

/// A reading that takes longer is given up and asked for again.
const MAX_ANSWER_TIME: Duration = Duration::from_secs(1);
/// How often the daemon is asked; people read no faster.
const ASK_INTERVAL: Duration = Duration::from_millis(500);
/// How often keys are read.
const KEY_INTERVAL: Duration = Duration::from_millis(50);
/// Readings and answers that may wait for the screen, which takes them 20 times a second.
const MAX_WAITING_NEWS: usize = 16;

/// Follow the print in the terminal; keys pause, resume, stop and abort it.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  layerctl watch
  layerctl watch --json        every event as a line of JSON, for programs

Keys: p pause, r resume, s stop after this layer, a abort, q leave; the print goes on without you. The keys s and a ask first, and so \
does r when a job waits for you to confirm that the plate is empty.

The first line shows light and plate, even where there is little room. While the daemon does not answer, everything is grey, and the \
first line says how old it is.")]
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
    block_on(async {
        // The first reading comes before the screen is taken over, so that an error stays readable.
        let view = View::new(read(&client).await?);
        let mut terminal = ratatui::try_init()?;
        let ended = follow(&client, &mut terminal, view).await;
        ratatui::restore();
        ended
    })
}

async fn print_events(client: Client) -> anyhow::Result<()> {
    let mut events = client.events().await?;
    while let Some(event) = events.next().await? {
        print_json(&event)?;
    }
    Ok(())
}

async fn read(client: &Client) -> Result<Reading, ClientError> {
    let (status, device) = (client.status().await?, client.get("/v1/device").await?);
    Ok(Reading { status, device, at: Instant::now() })
}

/// Reads the daemon's state in a loop, until the screen ends.
async fn ask(client: Client, news: mpsc::Sender<News>) {
    loop {
        let heard = match timeout(MAX_ANSWER_TIME, read(&client)).await {
            Ok(Ok(reading)) => News::Reading(Box::new(reading)),
            // Without the socket's path: there may be no room for it.
            Ok(Err(ClientError::NoDaemon { socket, .. })) => {
                News::Silence(format!("no layerd answers: {}", start_text(&socket)))
            }
            Ok(Err(error)) => News::Silence(error.to_string()),
            Err(_) => News::Silence("the daemon does not answer".into()),
        };
        if news.send(heard).await.is_err() {
            return;
        }
        tokio::time::sleep(ASK_INTERVAL).await;
    }
}

async fn follow(client: &Client, terminal: &mut ratatui::DefaultTerminal, mut view: View) -> anyhow::Result<()> {
    let (sender, mut news) = mpsc::channel(MAX_WAITING_NEWS);
    let notes = sender.clone();
    // Texts go to the screen as notes, never to stderr. If the queue is full, a newer text is on its way.
    let client = client.clone().telling(move |text| drop(notes.try_send(News::Note(text.into(), None))));
    // Readings and orders are tasks of their own, so that the keys work even if the daemon does not answer.
    tokio::spawn(ask(client.clone().telling(|_| {}), sender.clone()));
    loop {
        while let Ok(heard) = news.try_recv() {
            view.hear(heard);
        }
        terminal.draw(|frame| screen::draw(frame, &view, Instant::now()))?;
        tokio::time::sleep(KEY_INTERVAL).await;
        while event::poll(Duration::ZERO)? {
            let Input::Key(key) = event::read()? else { continue };
            if key.kind != KeyEventKind::Press {
                continue;
            }
            let interrupt = key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL);
            if interrupt || (key.code == KeyCode::Char('q') && view.question.is_none()) {
                return Ok(());
            }
            if let Some(order) = view.press(key.code) {
                view.note(format!("{} ordered", order.order));
                let (client, sender) = (client.clone(), sender.clone());
                tokio::spawn(async move {
                    // Sending fails only when the screen has ended.
                    let (text, job) = order.give(&client).await;
                    let _ = sender.send(News::Note(text, job)).await;
                });
            }
        }
    }
}
