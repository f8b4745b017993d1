//! What is printed: a small machine, quick recipes, some parts, and the pictures that the slicer makes of them.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use layerd::buildfile::{PackOptions, pack};
use layerd::config::{Machine, Recipe};
use layerd::device::encoding;
use layerd::link::message::{Capabilities, Encoding, MachineCapabilities, VatCapabilities};
use layerd::pipeline::{Placed, Resolution};
use layerd::stream::MemoryBudget;
use layerd_wire::encoding::Decoder;

/// Pixels of a row, and rows.
pub(crate) const SIZE_PX: [u32; 2] = [64, 48];
/// The height at which a part is clear of the resin.
pub(crate) const CLEAR_UM: i32 = 20_000;
/// Height of a layer.
pub(crate) const LAYER_UM: i32 = 50;
pub(crate) const BAUD: u32 = 3_000_000;
/// The daemon's memory budget.
const BUDGET: &str = "8MiB";

/// The files of the daemon's configuration.
pub(crate) fn files(confirms_plate: bool) -> [(PathBuf, String); 3] {
    let config = format!(
        "socket = \"/run/layerd/control.sock\"\nspool = \"/var/lib/layerd\"\nmemory_budget = \"{BUDGET}\"\nthreads = 1\n\
         machine = \"machine.toml\"\nrecipe = \"recipe.toml\"\n"
    );
    let at = |name: &str| Path::new("/etc/layerd").join(name);
    [
        (at("layerd.toml"), config),
        (at("machine.toml"), machine_text(confirms_plate)),
        (at("recipe.toml"), recipe_text()),
    ]
}

/// Where the daemon keeps its jobs.
pub(crate) fn spool() -> PathBuf {
    "/var/lib/layerd".into()
}

fn machine_text(confirms_plate: bool) -> String {
    let [width_px, height_px] = SIZE_PX;
    format!(
        "name = \"simulated\"\nkind = \"dlp\"\nwidth_px = {width_px}\nheight_px = {height_px}\npixel_um = [20.0, 20.0]\n\
         build_height_um = 60000.0\nclear_height_um = {CLEAR_UM}.0\nconfirm_plate = {confirms_plate}\n\n[link]\npath = \"/dev/ttyACM0\"\n\
         baud = {BAUD}\nflow_control = \"none\"\n"
    )
}

fn recipe_text() -> String {
    format!(
        "name = \"quick\"\nlayer_height_um = {LAYER_UM}.0\nexposure_ms = 300\nbottom_exposure_ms = 6000\nbottom_layers = 1\n\
         transition_layers = 1\nlift_height_um = 2000\nlift_speed_um_s = 20000\nretract_speed_um_s = 20000\n\
         light_off_delay_ms = 10\nwait_before_exposure_ms = 20\n"
    )
}

/// What the machine says of itself.
pub(crate) fn capabilities() -> Capabilities {
    let [width_px, height_px] = SIZE_PX;
    Capabilities {
        name: "Simulated".into(),
        machine: MachineCapabilities::Vat(VatCapabilities {
            width_px,
            height_px,
            pixel_nm: [20_000, 20_000],
            max_position_um: 60_000,
        }),
        layer_slots: 2,
        window_bytes: 4096,
        largest_frame_bytes: 1024,
        encodings: vec![Encoding::RawBit, Encoding::Group4],
        max_exposure_ms: 60_000,
    }
}

/// A part: its build file, and its layers as the slicer makes them.
#[derive(Debug)]
pub(crate) struct Part {
    pub(crate) file: Vec<u8>,
    /// Rows of each layer.
    pub(crate) layers: Vec<Vec<u8>>,
}

/// The parts: one of 30 layers, and shorter ones. A strut is 6 layers thick.
pub(crate) fn parts() -> &'static [Part] {
    static PARTS: OnceLock<Vec<Part>> = OnceLock::new();
    PARTS.get_or_init(|| [25, 7, 3].map(part).into())
}

/// A leaning strut; its nodes are so many layers apart.
fn part(layers: u32) -> Part {
    let directory = tempfile::tempdir().expect("a directory");
    let [source, file] = ["edges.txt", "part.layerd"].map(|name| directory.path().join(name));
    let top_mm = f64::from(layers) * f64::from(LAYER_UM) / 1000.0;
    let text = format!("1 0.15\n0 0 0 0.1 0.07 {top_mm}\n");
    std::fs::write(&source, text).expect("written");
    pack(&[source], &file, &PackOptions::default(), &mut |_| {}).expect("packed");
    let machine = Machine::parse(Path::new("machine.toml"), &machine_text(true)).expect("a machine");
    let recipe = Recipe::parse(Path::new("recipe.toml"), &recipe_text()).expect("a recipe");
    let resolution = Resolution::of(&machine, &recipe);
    let budget = MemoryBudget::new(64 << 20);
    let placed = Placed::open(&file, &resolution).expect("fits").fit(1, 64 << 20).expect("fits");
    let layers = placed.encoded_layers(0, encoding::best(resolution.depth), &budget).expect("in the budget");
    let layers = layers.map(|layer| {
        let layer = layer.expect("computed");
        let mut decoder = Decoder::new(layer.encoding.picture().expect("a picture"), SIZE_PX[0], SIZE_PX[1]);
        decoder.push(&layer.bytes).expect("decodes");
        decoder.finish().expect("is whole").0
    });
    Part { layers: layers.collect(), file: std::fs::read(&file).expect("read") }
}
