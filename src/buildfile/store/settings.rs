//! What a writer must know before the first primitive, and why it may fail. `tests/buildfile.rs` shows both.

use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use super::format::MAX_SOURCE_NAME_BYTES;
use crate::buildfile::materials::Materials;
use crate::buildfile::model::{
    BodyHeader, Bounds, Clip, Header, Joint, Keeps, Lattice, Placement, Surface, printed_bounds,
};
use crate::buildfile::relief::{Displacement, MapHeader, Relief};
use crate::solid::MAX_RADIUS;

/// Settings of a build file.
#[derive(Clone, Debug, PartialEq)]
pub struct WriterSettings {
    /// Length of one quantum, micrometres.
    pub quantum_um: f64,
    /// Position of the part on the plate.
    pub placement: Placement,
    /// SHA-256 of the source.
    pub source_digest: [u8; 32],
    /// Name of the source, cut to at most 255 bytes.
    pub source_name: String,
    /// The materials of the bodies.
    pub materials: Option<Materials>,
    /// The bodies of the part, in this order; 1 to [`Header::MAX_BODIES`].
    pub bodies: Vec<BodySettings>,
}

/// Settings of one body.
#[derive(Clone, Debug, PartialEq)]
pub enum BodySettings {
    /// Struts and balls.
    Lattice {
        /// How they are joined.
        joint: Joint,
        /// Upper limit of all radii, quanta.
        largest_radius: u32,
    },
    /// Triangles.
    Surface,
    /// Patches.
    Relief(ReliefSettings),
    /// Triangles that clip the body before, which is a lattice.
    Clip {
        /// What they leave of it.
        keeps: Keeps,
    },
}

/// Settings of a surface with relief.
#[derive(Clone, Debug, PartialEq)]
pub struct ReliefSettings {
    /// Whether patches are curved.
    pub is_curved: bool,
    /// Thickness of a shell, micrometres; 0 of a solid.
    pub shell_um: f64,
    /// Displacements, at most [`Relief::MAX_DISPLACEMENTS`].
    pub displacements: Vec<Displacement>,
    /// Maps, at most [`Relief::MAX_MAPS`].
    pub maps: Vec<ReliefMap>,
}

/// A height map as it is stored.
#[derive(Clone, Debug, PartialEq)]
pub struct ReliefMap {
    /// What the header says of it.
    pub header: MapHeader,
    /// The file that it describes.
    pub png: Arc<[u8]>,
}

impl ReliefSettings {
    /// The header of a relief without patches.
    pub(in crate::buildfile) fn header(&self) -> Relief {
        Relief {
            bounds: Bounds::EMPTY,
            z_reach: [i32::MAX, i32::MIN],
            patch_count: 0,
            is_curved: self.is_curved,
            shell_um: self.shell_um,
            displacements: self.displacements.clone(),
            maps: self.maps.iter().map(|map| map.header).collect(),
        }
    }
}

/// A build file could not be written. No file stays behind.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// Writing failed.
    #[error("cannot write {}: {source}", path.display())]
    Io {
        /// The build file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A clip leaves nothing of its lattice.
    #[error("cannot write {}: the clip of body {body} leaves nothing of its lattice", path.display())]
    NothingLeft {
        /// The build file.
        path: PathBuf,
        /// The body of the clip, counted from 0.
        body: usize,
    },
    /// A primitive or the settings are not allowed in a build file.
    #[error("cannot write {}: {problem}", path.display())]
    Refused {
        /// The build file.
        path: PathBuf,
        /// What is wrong and what is allowed.
        problem: String,
    },
}

impl WriterSettings {
    /// The header of a file without bodies.
    pub(super) fn header(self) -> Header {
        let Self { quantum_um, placement, source_digest, mut source_name, materials, .. } = self;
        let ends = (0..=MAX_SOURCE_NAME_BYTES.min(source_name.len())).rev();
        let end = ends.into_iter().find(|&end| source_name.is_char_boundary(end)).unwrap_or(0);
        source_name.truncate(end);
        Header {
            quantum_um,
            bounds: Bounds::EMPTY,
            bottom_um: 0.0,
            placement,
            source_digest,
            source_name,
            materials,
            bodies: Vec::new(),
        }
    }
}

impl BodySettings {
    /// The height maps of the body, as PNG.
    pub(super) fn maps(&self) -> impl Iterator<Item = &Arc<[u8]>> {
        let maps = match self {
            Self::Lattice { .. } | Self::Surface | Self::Clip { .. } => &[][..],
            Self::Relief(relief) => &relief.maps,
        };
        maps.iter().map(|map| &map.png)
    }

    /// The header of the smallest such body: one ball of the largest radius, one triangle, or one patch.
    fn smallest(&self) -> BodyHeader {
        let surface = Surface { bounds: Bounds { min: [0; 3], max: [1; 3] }, triangle_count: 1 };
        match self {
            Self::Lattice { joint, largest_radius } => BodyHeader::Lattice(smallest_lattice(*joint, *largest_radius)),
            Self::Surface => BodyHeader::Surface(surface),
            Self::Clip { keeps } => BodyHeader::Clip(Clip { keeps: *keeps, bounds: surface.bounds, surface }),
            Self::Relief(settings) => BodyHeader::Relief(Relief {
                bounds: surface.bounds,
                z_reach: [0, 1],
                patch_count: 1,
                ..settings.header()
            }),
        }
    }

    /// `header` with the smallest bodies of these settings: it has the length of the final header, and is valid if the settings are.
    pub(super) fn smallest_header(header: &Header, bodies: &[Self]) -> Header {
        let bodies: Vec<_> = bodies.iter().map(Self::smallest).collect();
        Header { bounds: printed_bounds(&bodies), bodies, ..header.clone() }
    }
}

/// The header of one ball.
pub(super) fn smallest_lattice(joint: Joint, radius: u32) -> Lattice {
    let reached = radius.min(MAX_RADIUS) as i32;
    Lattice {
        joint,
        bounds: Bounds { min: [-reached; 3], max: [reached; 3] },
        radius_range: [radius; 2],
        strut_count: 0,
        ball_count: 1,
        node_count: 0,
        is_graded: false,
    }
}
