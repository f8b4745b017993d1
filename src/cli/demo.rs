//! `layerctl demo`: makes a part and prints it on a simulated device. Daemon and device are processes of their own.
//! `.ci/run` runs it.

mod compare;
mod processes;
mod rough;

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};

use self::processes::{Children, run_self, spawn_self};
use super::block_on;
use super::client::{Client, NewJob};
use super::progress::duration_text;
use super::start::wait;
use crate::api::{JobView, LinkState, Status};
use crate::job::JobState;
use crate::text::{count_text, size_text};

/// How long a process may take to start: a second on a slow machine, more on a busy one.
const MAX_START_TIME: Duration = Duration::from_secs(30);
/// First line of the configuration. It marks the directory of an earlier demo; others must not be touched.
const MARK: &str = "# written by `layerctl demo`; the next demo replaces this directory's contents\n";
/// What a demo leaves in its directory and the next one removes.
const CONTENTS: [&str; 10] = [
    "layerd.toml",
    "machine.toml",
    "recipe.toml",
    "demo.obj",
    "demo.png",
    "demo.layerd",
    "layerd.log",
    "device.log",
    "exposed",
    "sliced",
];

/// Print a part on a simulated printer, and compare the result.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  layerctl demo                  about half a minute; pictures in demo-out/exposed
  layerctl demo --displaced      a ring of 480 triangles, made rough by a height map
  layerctl demo slm              a laser machine, simulated twenty times faster than real
  layerctl demo dlp -o /tmp/d    somewhere else

It makes a part, a lattice unless --displaced is given, starts a simulated printer on a virtual serial port and the daemon, and prints \
the part. Then it slices the part, and compares each layer with what the printer made of it: the pictures that a DLP printer exposed, pixel by pixel; the \
area that an SLM machine melted, which may differ at the border.")]
pub(super) struct DemoArgs {
    /// Kind of machine.
    #[arg(value_enum, default_value_t = Kind::Dlp)]
    kind: Kind,
    /// Print a solid whose surface a height map displaces, instead of a lattice.
    #[arg(long)]
    displaced: bool,
    /// Directory for everything the demo writes.
    #[arg(short, long, value_name = "DIR", default_value = "demo-out")]
    output: PathBuf,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// Resin and a projector.
    Dlp,
    /// Metal powder and a laser.
    Slm,
}

/// What a kind of machine needs for its demo.
struct Stage {
    /// As the user names the kind.
    name: &'static str,
    /// The shipped machine, and the path of its line.
    machine: &'static str,
    line: &'static str,
    recipe: &'static str,
    time_scale: u32,
    /// Arguments of `generate`.
    part: &'static [&'static str],
    /// Radii of the displaced ring and of its tube, and the height of its map, millimetres.
    ring_mm: [f64; 2],
    height_mm: &'static str,
}

impl Kind {
    fn stage(self) -> Stage {
        match self {
            Self::Dlp => Stage {
                name: "dlp",
                machine: include_str!("../../config/machines/sim-dlp.toml"),
                line: "/tmp/layerd-sim-dlp",
                recipe: include_str!("../../config/recipes/demo.toml"),
                time_scale: 1,
                part: &["--struts", "3600", "--box", "24,16,5", "--radius", "0.2"],
                ring_mm: [7.5, 2.0],
                height_mm: "0.5",
            },
            Self::Slm => Stage {
                name: "slm",
                machine: include_str!("../../config/machines/sim-slm.toml"),
                line: "/tmp/layerd-sim-slm",
                recipe: include_str!("../../config/recipes/slm-demo.toml"),
                time_scale: 20,
                part: &["--struts", "500", "--box", "12,12,1", "--radius", "0.15"],
                ring_mm: [4.0, 0.4],
                height_mm: "0.15",
            },
        }
    }
}

pub(super) fn run(args: &DemoArgs) -> anyhow::Result<()> {
    let stage = args.kind.stage();
    let directory = prepare(&args.output)?;
    // Socket and port get short paths, as DIR may be long and a socket's path may have only 107 bytes.
    let short =
        tempfile::Builder::new().prefix("layerd-demo-").tempdir().context("cannot make a directory for sockets")?;
    write_config(&stage, &directory, short.path())?;
    let part = directory.join("demo.layerd");
    make_part(&stage, args.displaced, &directory, &part)?;

    let began = Instant::now();
    let mut children = Children::default();
    let print = block_on(async {
        tokio::select! {
            printed = print(&stage, &directory, short.path(), &part, &mut children) => printed,
            () = interrupted() => bail!("interrupted; daemon and device are being ended"),
        }
    });
    drop(children);
    let (job, status) = print.with_context(|| format!("logs are in {}", directory.display()))?;
    if job.state != JobState::Completed {
        bail!("the job is {} instead of completed; logs are in {}", job.state, directory.display());
    }
    summarise(&directory, &job, &status, began.elapsed())?;
    match args.kind {
        Kind::Dlp => compare::pictures(&directory, &part, job.layers_total),
        Kind::Slm => compare::melted(&directory, &part, job.layers_total),
    }
}

/// Generates a lattice, or packs a displaced ring.
fn make_part(stage: &Stage, is_displaced: bool, directory: &Path, part: &Path) -> anyhow::Result<()> {
    if !is_displaced {
        super::eprint("generating a lattice");
        let generate = [&["generate", "bcc"], stage.part, &["-o"]].concat();
        return run_self(
            &[&generate.into_iter().map(OsStr::new).collect::<Vec<_>>(), &[part.as_os_str()][..]].concat(),
        );
    }
    super::eprint("packing a ring of few triangles and a height map");
    let (ring, map) = (directory.join("demo.obj"), directory.join("demo.png"));
    rough::write_ring(&ring, stage.ring_mm)?;
    rough::write_weave(&map)?;
    let words = ["--displacement", "--height", stage.height_mm, "--curved", "-o"].map(OsStr::new);
    let [displacement, height, height_mm, curved, output] = words;
    run_self(&[
        "pack".as_ref(),
        ring.as_os_str(),
        displacement,
        map.as_os_str(),
        height,
        height_mm,
        curved,
        output,
        part.as_os_str(),
    ])
}

/// Makes the directory, or empties it of an earlier demo; returns its absolute path.
fn prepare(output: &Path) -> anyhow::Result<PathBuf> {
    std::fs::create_dir_all(output).with_context(|| format!("cannot make {}", output.display()))?;
    let directory = output.canonicalize().with_context(|| format!("cannot find {}", output.display()))?;
    let ours = std::fs::read_to_string(directory.join("layerd.toml")).is_ok_and(|text| text.starts_with(MARK));
    let empty = std::fs::read_dir(&directory).context("cannot list the demo's directory")?.next().is_none();
    if !ours && !empty {
        bail!("{} holds something else than a demo: name a new or empty directory with -o", directory.display());
    }
    for name in CONTENTS.iter().chain(&["spool"]) {
        let path = directory.join(name);
        let removed = if path.is_dir() { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
        match removed {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(error).with_context(|| format!("cannot remove {}", path.display()));
            }
            _ => {}
        }
    }
    Ok(directory)
}

/// Writes the configuration. Machine and recipe are those of `config/`.
fn write_config(stage: &Stage, directory: &Path, short: &Path) -> anyhow::Result<()> {
    let port = toml_text(&short.join("port"));
    let time_scale = format!("time_scale = {}.0", stage.time_scale);
    let machine = stage.machine.replace(&format!("\"{}\"", stage.line), &port);
    let machine = machine.replace("# time_scale = 1.0", &time_scale);
    let socket = toml_text(&short.join("control.sock"));
    let daemon = format!(
        "{MARK}socket = {socket}\nspool = \"spool\"\nmemory_budget = \"64MiB\"\nmachine = \"machine.toml\"\nrecipe = \"recipe.toml\"\n"
    );
    let write = |name: &str, text: &str| {
        let path = directory.join(name);
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    write("layerd.toml", &daemon)?;
    write("machine.toml", &machine)?;
    write("recipe.toml", stage.recipe)?;
    std::fs::create_dir_all(directory.join("spool")).context("cannot make the demo's spool")
}

/// A path as a TOML string. JSON's escapes are valid in TOML.
fn toml_text(path: &Path) -> String {
    serde_json::Value::from(path.to_string_lossy()).to_string()
}

/// Starts device and daemon and prints; leaves them running in `children`.
async fn print(
    stage: &Stage,
    directory: &Path,
    short: &Path,
    part: &Path,
    children: &mut Children,
) -> anyhow::Result<(JobView, Status)> {
    let port = short.join("port");
    super::eprint(&format!("starting a simulated {} machine and the daemon", stage.name.to_uppercase()));
    let exposed = directory.join("exposed");
    let machine = directory.join("machine.toml");
    let time_scale = stage.time_scale.to_string();
    let device: [&OsStr; 12] = [
        "simulate".as_ref(),
        stage.name.as_ref(),
        "--machine".as_ref(),
        machine.as_ref(),
        "--baud".as_ref(),
        "3000000".as_ref(),
        "--time-scale".as_ref(),
        time_scale.as_ref(),
        "--link".as_ref(),
        port.as_ref(),
        "-o".as_ref(),
        exposed.as_ref(),
    ];
    children.add("the simulated device", spawn_self(&device, &directory.join("device.log"))?);
    wait_until("the simulated device's port", children, async || std::fs::symlink_metadata(&port).is_ok()).await?;
    let config = directory.join("layerd.toml");
    let daemon: [&OsStr; 3] = ["daemon".as_ref(), "--config".as_ref(), config.as_ref()];
    children.add("the daemon", spawn_self(&daemon, &directory.join("layerd.log"))?);
    let client = Client::new(short.join("control.sock"));
    wait_until("the line between daemon and device", children, async || {
        client.status().await.is_ok_and(|status| status.link.state == LinkState::Connected)
    })
    .await?;
    let events = client.events().await?;
    let new = NewJob { part: part.into(), name: "demo.layerd".into(), recipe: None };
    let job = client.submit(&new, |_, _| {}).await?;
    let (job, _) = wait(&client, job, events, &super::progress_bar(super::start::BAR)).await?;
    Ok((job, client.status().await?))
}

async fn wait_until(what: &str, children: &mut Children, met: impl AsyncFn() -> bool) -> anyhow::Result<()> {
    let began = Instant::now();
    while !met().await {
        children.check()?;
        if began.elapsed() > MAX_START_TIME {
            bail!("{what} did not come up within {} s", MAX_START_TIME.as_secs());
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    Ok(())
}

/// Waits for SIGINT, SIGTERM or SIGHUP.
async fn interrupted() {
    use tokio::signal::unix::{SignalKind, signal};
    let streams = [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()].map(signal);
    let [Ok(mut interrupt), Ok(mut terminate), Ok(mut hangup)] = streams else {
        // Without handlers the signals end this process as they always do.
        return std::future::pending().await;
    };
    tokio::select! {
        _ = interrupt.recv() => {}
        _ = terminate.recv() => {}
        _ = hangup.recv() => {}
    }
}

fn summarise(directory: &Path, job: &JobView, status: &Status, took: Duration) -> anyhow::Result<()> {
    let line = &status.line;
    super::print(&format!("layers   {} done in {}", job.layers_done, duration_text(took.as_secs())))?;
    let late = count_text(job.late_layers.into(), "layer");
    super::print(&format!("late     {late}, {} ms in all", job.late_ms_total))?;
    let (sent, frames) = (size_text(line.sent_bytes), count_text(line.sent_frames, "frame"));
    super::print(&format!("line     {sent} sent in {frames}, {} of them again", line.retransmitted_frames))?;
    let budget = status.budget;
    let (peak, limit) = (size_text(budget.peak_bytes), size_text(budget.limit_bytes));
    super::print(&format!("memory   {peak} of the budget of {limit} at most"))?;
    super::print(&format!("pictures {}", directory.join("exposed").display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{DaemonConfig, Machine, Recipe};

    #[test]
    fn the_demo_writes_configuration_the_daemon_takes() {
        let directory = tempfile::tempdir().unwrap();
        let short = directory.path().join("a \"quoted\" place");
        write_config(&Kind::Dlp.stage(), directory.path(), &short).unwrap();
        let config = DaemonConfig::load(&directory.path().join("layerd.toml")).unwrap();
        assert_eq!(config.socket, short.join("control.sock"));
        let machine = Machine::load(&config.machine).unwrap();
        assert_eq!(machine.link().path, short.join("port"), "the shipped path was replaced");
        Recipe::load(&config.recipe).unwrap();
        write_config(&Kind::Slm.stage(), directory.path(), &short).unwrap();
        let machine = Machine::load(&config.machine).unwrap();
        assert_eq!((machine.link().path.clone(), machine.time_scale()), (short.join("port"), 20.0));
        prepare(directory.path()).unwrap();
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0, "a demo cleans up after the one before");
    }

    #[test]
    fn a_directory_with_other_things_is_left_alone() {
        let directory = tempfile::tempdir().unwrap();
        std::fs::write(directory.path().join("layerd.toml"), "my own settings").unwrap();
        assert!(prepare(directory.path()).unwrap_err().to_string().contains("-o"));
        assert!(directory.path().join("layerd.toml").exists());
    }
}
