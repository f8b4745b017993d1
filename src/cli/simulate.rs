//! `layerctl simulate`: a simulated device on a pseudo-terminal. The tests print on it.

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};

use crate::config::{DlpMachine, Machine, SlmMachine};
use crate::device::sim::{FAULT_HELP, FaultSpec, MeltSettings, SimulateOptions, Statistics, run as simulate};
use crate::link::FlowControl;
use crate::link::message::{Capabilities, Encoding, MachineCapabilities, PowderCapabilities, VatCapabilities, Vats};
use crate::signals::Signals;
use crate::text::{count_text, size_text};

/// Simulate a printer on a pseudo-terminal, until Ctrl-C, SIGTERM, SIGQUIT or SIGHUP.
///
/// It speaks the protocol of a real machine, times and refuses exposures like one, and writes pictures of what it exposed or melted.
#[derive(Debug, Args)]
#[command(after_help = after_help())]
pub struct SimulateArgs {
    /// Kind of machine.
    #[arg(value_enum)]
    device: Kind,
    /// Symlink to make for the host's end of the pseudo-terminal. It is removed at the end. Only one simulated device may use it.
    #[arg(long, value_name = "PATH")]
    link: PathBuf,
    /// Directory for `acts.jsonl` and a PNG of each exposed or melted layer.
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
    /// How many times faster than real time the device's clock runs, 0.001 to 100000: exposures, the scanner, moves, `t_ms` in the log.
    /// For any value but 1, set `time_scale` in the daemon's machine file to the same.
    #[arg(long, value_name = "X", default_value_t = 1.0, value_parser = time_scale)]
    time_scale: f64,
    /// Machine, a name or a path. It sets pixels and travel of a resin printer (without it 960 × 540 pixels of 40 µm, 60 mm travel);
    /// field, grid, beam, power, layer heights and travel of a laser machine (without it those of `sim-slm`).
    #[arg(long, value_name = "NAME|PATH")]
    machine: Option<String>,
    /// Receive window it declares, 1024 to 1048576 bytes.
    #[arg(long, value_name = "BYTES", default_value_t = 4096, value_parser = clap::value_parser!(u32).range(1024..=1 << 20))]
    window: u32,
    /// Longest exposure it allows, 1 to 14400000 ms. Of a laser machine, the longest time of marking in one act. Without it 120000 for a
    /// resin printer, and 3600000 for a laser machine.
    #[arg(long, value_name = "MS", value_parser = clap::value_parser!(u32).range(1..=14_400_000))]
    max_exposure_ms: Option<u32>,
    /// Size of the buffer for the data of all layers, 1024 to 16777216 bytes; without it 65536. Only `slm` has one.
    #[arg(long, value_name = "BYTES", value_parser = clap::value_parser!(u32).range(1024..=1 << 24))]
    buffer: Option<u32>,
    /// Number of vats, 1 to 8, each with a material of its own; without it 1. Only `dlp` has vats. Putting another one in place takes 2 s of the device's
    /// clock, besides washing and draining.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=8))]
    vats: Option<u8>,
}

/// Time to put another vat in place, milliseconds.
const CHANGE_MS: u32 = 2000;

/// Size of a laser machine's buffer, bytes: smaller than many layers, so that they stream.
const BUFFER_BYTES: u32 = 1 << 16;

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Kind {
    /// Resin printer with a projector.
    Dlp,
    /// Laser machine with a bed of powder.
    Slm,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Dlp => "dlp",
            Self::Slm => "slm",
        }
    }

    fn simulates(self) -> &'static str {
        match self {
            Self::Dlp => "a resin printer",
            Self::Slm => "a laser machine",
        }
    }
}

fn time_scale(text: &str) -> Result<f64, String> {
    let scale = text.parse().ok().filter(|scale| (0.001..=100_000.0).contains(scale));
    scale.ok_or_else(|| "write a number from 0.001 to 100000".into())
}

/// What the user must know of laser machines, for help.
const LASER_HELP: &str = "\
Laser machines:
A laser machine keeps the data of all layers in one buffer. A layer that is larger than the buffer streams through it while the laser
marks. If its data is late, the laser waits between two vectors and is off, and `starved_ms` in the log says for how long. In
`acts.jsonl`, `marked` gives the number of a layer's vectors and how long the laser was on. If marking ends early, `laser_off` has a
`reason`, and `next_vector` is the first vector that was not marked whole. In the PNG of a layer, a pixel of the machine's grid is white
if its centre was under the beam.";

/// Examples for help.
const EXAMPLES: &str = "\
Examples:
  layerctl simulate dlp --machine sim-dlp --link /tmp/layerd-sim-dlp -o exposed
  layerctl simulate slm --machine sim-slm --link /tmp/layerd-sim-slm -o melted
  layerctl simulate dlp --link /tmp/printer -o exposed --baud 3000000 \\
    --fault drop=0.01 --fault corrupt=0.01 --fault duplicate=0.01 --fault disconnect=3 --seed 7 --time-scale 20
  layerctl simulate slm --link /tmp/laser -o melted --buffer 4096 --fault oxygen=1 --fault reset=2";

fn after_help() -> String {
    format!("{LASER_HELP}\n\nFaults:\n{FAULT_HELP}\n\n{EXAMPLES}")
}

/// Runs the device until SIGINT, SIGTERM, SIGQUIT or SIGHUP.
///
/// # Errors
/// A machine file that cannot be used or is of another kind, options of another kind of machine, or a `PATH` or `DIR` that cannot be
/// written.
pub fn run(args: SimulateArgs) -> anyhow::Result<()> {
    let (kind, options) = (args.device, options(args)?);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("cannot start")?;
    let statistics = runtime.block_on(async {
        let mut signals = Signals::take_over().context("cannot wait for signals")?;
        let stop = async {
            signals.end().await;
        };
        let link = options.link.clone();
        let ready = || say(&format!("simulated {} ready at {}", kind.name(), link.display()));
        anyhow::Ok(simulate(options, ready, stop).await?)
    })?;
    say(&summary(kind, &statistics));
    Ok(())
}

/// What is to be simulated.
fn options(args: SimulateArgs) -> anyhow::Result<SimulateOptions> {
    let kind = args.device;
    let named = args.machine.as_deref().or(match kind {
        Kind::Dlp => None,
        Kind::Slm => Some("sim-slm"),
    });
    let machine = named.map(super::find_machine).transpose()?.map(|(machine, _)| machine);
    let flow_control = machine.as_ref().map(|machine| machine.link().flow_control);
    let (capabilities, melt) = match (kind, &machine) {
        (Kind::Dlp, _) if args.buffer.is_some() => {
            bail!("`--buffer` is for laser machines, and `simulate dlp` simulates a resin printer: leave it out")
        }
        (Kind::Dlp, _) if args.faults.iter().any(|fault| matches!(fault, FaultSpec::Interlock(..))) => bail!(
            "the faults `oxygen`, `door` and `power` are for laser machines, and `simulate dlp` simulates a resin printer: leave them out"
        ),
        (Kind::Slm, _) if args.vats.is_some() => {
            bail!("`--vats` is for resin printers, and `simulate slm` simulates a laser machine: leave it out")
        }
        (Kind::Dlp, None) => (vat(&args, None), None),
        (Kind::Dlp, Some(Machine::Dlp(machine))) => (vat(&args, Some(machine)), None),
        (Kind::Slm, Some(Machine::Slm(machine))) => {
            let melt = MeltSettings { raster: machine.raster(), beam_um: machine.beam_diameter_um };
            (powder(&args, machine), Some(melt))
        }
        (_, machine) => {
            let (found, found_kind) = match machine {
                Some(machine) => (machine.name(), machine.kind().to_string()),
                None => ("", String::new()),
            };
            bail!(
                "machine `{found}` is of kind `{found_kind}`, and `simulate {0}` simulates {1}: name a machine of kind `{0}`",
                kind.name(),
                kind.simulates()
            )
        }
    };
    Ok(SimulateOptions {
        capabilities,
        melt,
        escaped: flow_control == Some(FlowControl::XonXoff),
        link: args.link,
        directory: args.output,
        baud: args.baud,
        faults: args.faults,
        seed: args.seed,
        time_scale: args.time_scale,
    })
}

/// Writes one line to stdout. Errors are ignored: the simulated print goes on when nobody reads it.
fn say(line: &str) {
    let mut stdout = std::io::stdout().lock();
    let _ = writeln!(stdout, "{line}").and_then(|()| stdout.flush());
}

fn vat(args: &SimulateArgs, machine: Option<&DlpMachine>) -> Capabilities {
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
        max_exposure_ms: args.max_exposure_ms.unwrap_or(120_000),
        machine: MachineCapabilities::Vat(VatCapabilities {
            width_px: size_px[0],
            height_px: size_px[1],
            pixel_nm: pixel_um.map(|um| (um * 1000.0).round() as u32),
            max_position_um: travel_um as i32,
            vats: match args.vats.unwrap_or(1) {
                1 => Vats::ONE,
                count => Vats { count, change_ms: CHANGE_MS },
            },
        }),
    }
}

fn powder(args: &SimulateArgs, machine: &SlmMachine) -> Capabilities {
    Capabilities {
        name: "simulated slm".into(),
        layer_slots: 2,
        window_bytes: args.window,
        largest_frame_bytes: 1024,
        encodings: vec![Encoding::Vectors, Encoding::VectorsCoded],
        max_exposure_ms: args.max_exposure_ms.unwrap_or(3_600_000),
        machine: MachineCapabilities::Powder(PowderCapabilities {
            field_um: machine.field_um.map(|um| um.round() as u32),
            max_power_mw: (machine.max_power_w * 1000.0).round() as u32,
            layer_height_um: machine.layer_height_range_um.map(|um| um.round() as u32),
            max_position_um: machine.build_height_um.round() as i32,
            buffer_bytes: args.buffer.unwrap_or(BUFFER_BYTES),
        }),
    }
}

fn summary(kind: Kind, statistics: &Statistics) -> String {
    let Statistics { exposed, cut_short, uploads, layer_bytes, refused, moves, silences, resets, .. } = statistics;
    let done = match kind {
        Kind::Dlp => format!("exposed {}", count_text(*exposed, "layer")),
        Kind::Slm => {
            let Statistics { vectors, recoats, starved_ms, .. } = statistics;
            let (layers, vectors) = (count_text(*exposed, "layer"), count_text(*vectors, "vector"));
            format!("marked {layers} ({vectors}, waited {starved_ms} ms for data), {}", count_text(*recoats, "recoat"))
        }
    };
    format!(
        "{done}, cut short {cut_short}; received {} ({}); {}; {} refused; {} of the host; {}",
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
        let made = vat(&args, None);
        let vat = VatCapabilities {
            width_px: 960,
            height_px: 540,
            pixel_nm: [40_000; 2],
            max_position_um: 60_000,
            vats: Vats::ONE,
        };
        assert_eq!(made.machine, MachineCapabilities::Vat(vat));
        assert_eq!((made.window_bytes, made.layer_slots), (4096, 2));
        let message = parse("simulate dlp --link p --fault fire=1").expect_err("no such fault");
        assert!(message.contains("fire=1") && message.contains("disconnect=N"), "{message}");
        assert!(parse("simulate dlp --link p --time-scale 0").is_err());
        assert!(parse("simulate dlp").expect_err("no link").contains("--link"));
    }

    #[test]
    fn a_laser_machine_has_the_limits_of_its_file_and_a_buffer() {
        let made = options(parse("simulate slm --link p --machine config/machines/sim-slm.toml").expect("correct"));
        let made = made.expect("a laser machine");
        let powder = PowderCapabilities {
            field_um: [120_000; 2],
            max_power_mw: 200_000,
            layer_height_um: [20, 100],
            max_position_um: 100_000,
            buffer_bytes: 65_536,
        };
        assert_eq!(made.capabilities.machine, MachineCapabilities::Powder(powder.clone()));
        assert_eq!(made.capabilities.encodings, [Encoding::Vectors, Encoding::VectorsCoded]);
        let melt = made.melt.expect("a beam");
        assert_eq!((melt.beam_um, melt.raster.width_px, melt.raster.pixel_um), (60.0, 4000, [30.0; 2]));
        let small = options(parse("simulate slm --link p --buffer 2048").expect("correct")).expect("as sim-slm");
        assert_eq!(
            small.capabilities.machine,
            MachineCapabilities::Powder(PowderCapabilities { buffer_bytes: 2048, ..powder })
        );
        assert!(parse("simulate slm --link p --buffer 100").expect_err("too small").contains("1024"));
    }

    #[test]
    fn a_machine_or_an_option_of_another_kind_is_refused() {
        for (line, words) in [
            (
                "simulate dlp --link p --machine sim-slm",
                "is of kind `slm`, and `simulate dlp` simulates a resin printer",
            ),
            (
                "simulate slm --link p --machine sim-dlp",
                "is of kind `dlp`, and `simulate slm` simulates a laser machine",
            ),
            ("simulate dlp --link p --buffer 4096", "`--buffer` is for laser machines"),
            ("simulate slm --link p --vats 2", "`--vats` is for resin printers"),
            ("simulate dlp --link p --fault door=1", "`door` and `power` are for laser machines"),
        ] {
            let refused = run(parse(line).expect("correct")).expect_err("another kind").to_string();
            assert!(refused.contains(words), "{refused}");
        }
        assert!(!std::path::Path::new("p").exists());
    }
}
