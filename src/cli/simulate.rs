//! `layerctl simulate`: a simulated device on a pseudo-terminal. The tests print on it.

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};

use crate::config::{DlpMachine, Machine};
use crate::device::sim::{FAULT_HELP, FaultSpec, SimulateOptions, Statistics, run as simulate};
use crate::link::FlowControl;
use crate::link::message::{Capabilities, Encoding, MachineCapabilities, VatCapabilities};
use crate::signals::Signals;
use crate::text::{count_text, size_text};

/// Simulate a printer on a pseudo-terminal, until Ctrl-C, SIGTERM, SIGQUIT or SIGHUP.
///
/// It speaks the protocol of a real machine, times and refuses exposures like one, and writes pictures of what it exposed.
#[derive(Debug, Args)]
#[command(after_help = after_help())]
pub struct SimulateArgs {
    /// Kind of machine.
    #[arg(value_enum)]
    device: Kind,
    /// Symlink to make for the host's end of the pseudo-terminal. It is removed at the end. Only one simulated device may use it.
    #[arg(long, value_name = "PATH")]
    link: PathBuf,
    /// Directory for `acts.jsonl` and a PNG of each exposed layer.
    #[arg(short = 'o', long = "output", value_name = "DIR")]
    output: Option<PathBuf>,
    /// Baud rate in both directions, 300 to 100000000; without it the rate is not limited.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(300..=100_000_000))]
    baud: Option<u32>,
    /// Fault to inject (see below); may be given several times.
    #[arg(long = "fault", value_name = "SPEC")]
    faults: Vec<FaultSpec>,
    /// Seed of faults and identities.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// How many times faster than real time the device's clock runs, 0.001 to 100000: exposures, moves, `t_ms` in the log. For any
    /// value but 1, set `time_scale` in the daemon's machine file to the same.
    #[arg(long, value_name = "X", default_value_t = 1.0, value_parser = time_scale)]
    time_scale: f64,
    /// Machine, a name or a path, that sets pixels and travel; without it 960 × 540 pixels of 40 µm, 60 mm travel.
    #[arg(long, value_name = "NAME|PATH")]
    machine: Option<String>,
    /// Receive window it declares, 1024 to 1048576 bytes.
    #[arg(long, value_name = "BYTES", default_value_t = 4096, value_parser = clap::value_parser!(u32).range(1024..=1 << 20))]
    window: u32,
    /// Longest exposure it allows, milliseconds.
    #[arg(long, value_name = "MS", default_value_t = 120_000, value_parser = clap::value_parser!(u32).range(1..=600_000))]
    max_exposure_ms: u32,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Kind {
    /// Resin printer with a projector.
    Dlp,
    /// Laser machine: not simulated yet.
    Slm,
}

fn time_scale(text: &str) -> Result<f64, String> {
    let scale = text.parse().ok().filter(|scale| (0.001..=100_000.0).contains(scale));
    scale.ok_or_else(|| "write a number from 0.001 to 100000".into())
}

fn after_help() -> String {
    format!(
        "Faults:\n{FAULT_HELP}\n\nExamples:\n  layerctl simulate dlp --machine sim-dlp --link /tmp/layerd-sim-dlp -o exposed\n  layerctl \
         simulate dlp --link /tmp/printer -o exposed --baud 3000000 \\\n    --fault drop=0.01 --fault corrupt=0.01 --fault duplicate=0.01 --fault disconnect=3 --seed 7 --time-scale 20"
    )
}

/// Runs the device until SIGINT, SIGTERM, SIGQUIT or SIGHUP.
///
/// # Errors
/// A machine file that cannot be used, a `PATH` or `DIR` that cannot be written, or a kind of device that is not simulated yet.
pub fn run(args: SimulateArgs) -> anyhow::Result<()> {
    if matches!(args.device, Kind::Slm) {
        bail!("there is no simulated slm yet; `layerctl simulate dlp` simulates a resin printer");
    }
    let machine = match args.machine.as_deref().map(super::find_machine).transpose()? {
        None => None,
        Some((Machine::Dlp(machine), _)) => Some(machine),
        Some((machine, _)) => bail!(
            "machine `{}` is of kind `{}`, and `simulate dlp` simulates a resin printer: name a machine of kind `dlp`",
            machine.name(),
            machine.kind()
        ),
    };
    let options = SimulateOptions {
        capabilities: capabilities(&args, machine.as_ref()),
        escaped: machine.is_some_and(|machine| machine.link.flow_control == FlowControl::XonXoff),
        link: args.link,
        directory: args.output,
        baud: args.baud,
        faults: args.faults,
        seed: args.seed,
        time_scale: args.time_scale,
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("cannot start")?;
    let statistics = runtime.block_on(async {
        let mut signals = Signals::take_over().context("cannot wait for signals")?;
        let stop = async {
            signals.end().await;
        };
        let link = options.link.clone();
        let ready = || say(&format!("simulated dlp ready at {}", link.display()));
        anyhow::Ok(simulate(options, ready, stop).await?)
    })?;
    say(&summary(&statistics));
    Ok(())
}

/// Writes one line to stdout. Errors are ignored: the simulated print goes on when nobody reads it.
fn say(line: &str) {
    let mut stdout = std::io::stdout().lock();
    let _ = writeln!(stdout, "{line}").and_then(|()| stdout.flush());
}

fn capabilities(args: &SimulateArgs, machine: Option<&DlpMachine>) -> Capabilities {
    let (size_px, pixel_um, travel_um) = machine.map_or(([960, 540], [40.0, 40.0], 60_000.0), |machine| {
        // The plate must rise high enough to lift the finished part out.
        let travel_um = machine.build_height_um.max(machine.clear_height_um) + 20_000.0;
        ([machine.width_px, machine.height_px], machine.pixel_um, travel_um)
    });
    Capabilities {
        name: "simulated dlp".into(),
        layer_slots: 2,
        window_bytes: args.window,
        largest_frame_bytes: 1024,
        encodings: vec![Encoding::RawBit, Encoding::Group4, Encoding::RawGrey, Encoding::RunGrey],
        max_exposure_ms: args.max_exposure_ms,
        machine: MachineCapabilities::Vat(VatCapabilities {
            width_px: size_px[0],
            height_px: size_px[1],
            pixel_nm: pixel_um.map(|um| (um * 1000.0).round() as u32),
            max_position_um: travel_um as i32,
        }),
    }
}

fn summary(statistics: &Statistics) -> String {
    let Statistics { exposed, cut_short, uploads, layer_bytes, refused, moves, silences, resets, .. } = statistics;
    format!(
        "exposed {}, cut short {cut_short}; received {} ({}); {}; {} refused; {} of the host; {}",
        count_text(*exposed, "layer"),
        count_text(*uploads, "layer"),
        size_text(*layer_bytes),
        count_text(*moves, "move"),
        count_text(*refused, "request"),
        count_text(*silences, "silence"),
        count_text(*resets, "reset")
    )
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        simulate: SimulateArgs,
    }

    fn parse(line: &str) -> Result<SimulateArgs, String> {
        Line::try_parse_from(line.split(' ')).map(|line| line.simulate).map_err(|error| error.to_string())
    }

    #[test]
    fn faults_and_limits_are_read_and_wrong_ones_are_named() {
        let args =
            parse("simulate dlp --link p --fault drop=0.01 --fault disconnect=3 --time-scale 20").expect("correct");
        assert_eq!(args.faults, [FaultSpec::Drop(0.01), FaultSpec::Disconnect(3)]);
        let made = capabilities(&args, None);
        let vat = VatCapabilities { width_px: 960, height_px: 540, pixel_nm: [40_000; 2], max_position_um: 60_000 };
        assert_eq!(made.machine, MachineCapabilities::Vat(vat));
        assert_eq!((made.window_bytes, made.layer_slots), (4096, 2));
        let message = parse("simulate dlp --link p --fault fire=1").expect_err("no such fault");
        assert!(message.contains("fire=1") && message.contains("disconnect=N"), "{message}");
        assert!(parse("simulate dlp --link p --time-scale 0").is_err());
        assert!(parse("simulate dlp").expect_err("no link").contains("--link"));
    }

    #[test]
    fn a_laser_machine_is_refused_for_now() {
        let args = parse("simulate slm --link p").expect("correct");
        assert!(run(args).expect_err("not yet").to_string().contains("no simulated slm yet"));
        assert!(!std::path::Path::new("p").exists());
    }
}
