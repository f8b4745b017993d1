//! What is printed: small machines of each kind, quick recipes, some parts, and the layers that the slicer makes of them.

mod laser;
mod vat;

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use layerd::buildfile::{DisplacementOptions, PackOptions, Tile, pack};
use layerd::config::{Machine, Recipe};
use layerd::device::ScanTimes;
use layerd::device::encoding::{best, choose_vectors};
use layerd::link::message::Capabilities;
use layerd::pipeline::{EncodedLayer, Placed, Resolution};
use layerd::stream::MemoryBudget;
use layerd_wire::encoding::{LaserParameters, Vector};

pub(crate) use laser::Filling;
pub(crate) use vat::CLEAR_UM;

/// Height of a layer, micrometres.
pub(crate) const LAYER_UM: i32 = 50;
pub(crate) const BAUD: u32 = 3_000_000;
/// Memory in which the parts are sliced here.
const SLICING_BYTES: u64 = 64 << 20;

/// The kind of the machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Resin in a vat.
    Vat,
    /// A laser and a bed of powder, with a recipe that fills areas in this way.
    Laser(Filling),
}

/// What a part is packed from.
pub(crate) enum Source {
    /// An edge text.
    Edges(String),
    /// An STL text.
    Solid(String),
    /// An OBJ text, and a height map as PNG that displaces it by up to 20 µm.
    Rough(String, Vec<u8>),
}

/// A part: its build file, and its layers as the slicer makes them.
#[derive(Debug)]
pub(crate) struct Part {
    pub(crate) file: Vec<u8>,
    pub(crate) layers: Vec<Layer>,
}

/// A layer as the slicer makes it.
#[derive(Debug, PartialEq)]
pub(crate) enum Layer {
    /// Its rows.
    Picture(Vec<u8>),
    Vectors(Scanned),
}

/// A layer of scan vectors.
#[derive(Debug, PartialEq)]
pub(crate) struct Scanned {
    /// In the order in which they are marked, with what the laser does for them.
    pub(crate) vectors: Vec<(Vector, LaserParameters)>,
    pub(crate) times: ScanTimes,
    /// Length as it is sent.
    pub(crate) encoded_bytes: u32,
    /// What the device compares it with.
    pub(crate) crc32: u32,
}

impl Layer {
    /// The layer as scan vectors, if it is one.
    pub(crate) fn scanned(&self) -> Option<&Scanned> {
        match self {
            Self::Picture(_) => None,
            Self::Vectors(scanned) => Some(scanned),
        }
    }
}

/// Where the daemon keeps its jobs.
pub(crate) fn spool() -> PathBuf {
    "/var/lib/layerd".into()
}

impl Kind {
    pub(crate) fn is_laser(self) -> bool {
        matches!(self, Self::Laser(_))
    }

    /// The files of the daemon's configuration.
    pub(crate) fn files(self, confirms_plate: bool) -> [(PathBuf, String); 3] {
        let budget = match self {
            Self::Vat => vat::BUDGET,
            Self::Laser(_) => laser::BUDGET,
        };
        let config = format!(
            "socket = \"/run/layerd/control.sock\"\nspool = \"/var/lib/layerd\"\nmemory_budget = \"{budget}\"\nthreads = 1\n\
             machine = \"machine.toml\"\nrecipe = \"recipe.toml\"\n"
        );
        let at = |name: &str| Path::new("/etc/layerd").join(name);
        let machine = format!(
            "{}\n[link]\npath = \"/dev/ttyACM0\"\nbaud = {BAUD}\nflow_control = \"none\"\n",
            self.machine_text(confirms_plate)
        );
        [(at("layerd.toml"), config), (at("machine.toml"), machine), (at("recipe.toml"), self.recipe_text())]
    }

    /// What the machine says of itself.
    pub(crate) fn capabilities(self) -> Capabilities {
        let (machine, encodings) = match self {
            Self::Vat => vat::capabilities(),
            Self::Laser(filling) => laser::capabilities(filling),
        };
        Capabilities {
            name: "Simulated".into(),
            machine,
            layer_slots: 2,
            window_bytes: 4096,
            largest_frame_bytes: 1024,
            encodings,
            max_exposure_ms: 60_000,
        }
    }

    /// The parts, the one with most layers first; the second of a vat machine is a solid with a rough surface, the third of a laser machine a
    /// solid.
    pub(crate) fn parts(self) -> &'static [Part] {
        static VAT: OnceLock<Vec<Part>> = OnceLock::new();
        static ZIGZAG: OnceLock<Vec<Part>> = OnceLock::new();
        static CHESSBOARD: OnceLock<Vec<Part>> = OnceLock::new();
        let (parts, sources) = match self {
            Self::Vat => (&VAT, vat::sources()),
            Self::Laser(Filling::Zigzag) => (&ZIGZAG, laser::sources()),
            Self::Laser(Filling::Chessboard) => (&CHESSBOARD, laser::sources()),
        };
        parts.get_or_init(|| sources.iter().map(|source| self.part(source)).collect())
    }

    fn machine_text(self, confirms_plate: bool) -> String {
        match self {
            Self::Vat => vat::machine_text(confirms_plate),
            Self::Laser(_) => laser::machine_text(confirms_plate),
        }
    }

    fn recipe_text(self) -> String {
        match self {
            Self::Vat => vat::recipe_text(),
            Self::Laser(filling) => laser::recipe_text(filling),
        }
    }

    fn part(self, source: &Source) -> Part {
        let directory = tempfile::tempdir().expect("a directory");
        let written = |name: &str, bytes: &[u8]| {
            let path = directory.path().join(name);
            std::fs::write(&path, bytes).expect("written");
            path
        };
        let mut options = PackOptions::default();
        let path = match source {
            Source::Edges(text) => written("edges.txt", text.as_bytes()),
            Source::Solid(text) => written("solid.stl", text.as_bytes()),
            Source::Rough(text, map) => {
                let map = written("map.png", map);
                options.relief.map = Some(DisplacementOptions { map, tile: Tile::Wrap });
                options.relief.height_mm = Some(0.02);
                written("solid.obj", text.as_bytes())
            }
        };
        let file = directory.path().join("part.layerd");
        pack(&[path], &file, &options, &mut |_| {}).expect("packed");
        let [_, (_, machine), (_, recipe)] = self.files(true);
        let machine = Machine::parse(Path::new("machine.toml"), &machine).expect("a machine");
        let recipe = Recipe::parse(Path::new("recipe.toml"), &recipe).expect("a recipe");
        let resolution = Resolution::of(&machine, &recipe);
        let budget = MemoryBudget::new(SLICING_BYTES);
        let placed = Placed::open(&file, &resolution).expect("fits").fit(1, SLICING_BYTES).expect("fits");
        let choice = match self {
            Self::Vat => best(resolution.depth),
            Self::Laser(_) => choose_vectors(&self.capabilities().encodings).expect("of vectors"),
        };
        let layers = placed.encoded_layers(0, choice, &budget).expect("in the budget");
        let layers = layers.map(|layer| self.decoded(&layer.expect("computed"))).collect();
        Part { layers, file: std::fs::read(&file).expect("read") }
    }

    fn decoded(self, layer: &EncodedLayer) -> Layer {
        match self {
            Self::Vat => Layer::Picture(vat::decoded(layer)),
            Self::Laser(_) => Layer::Vectors(laser::decoded(layer)),
        }
    }
}
