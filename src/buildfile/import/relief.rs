//! What is collected of surfaces with relief: patches, and the height maps that displace them. All of it is held in memory until the last
//! source has been read: only then are normals, seams and the length of a texel known. `collect` has one.

use std::io::{BufRead, Seek};
use std::sync::Arc;

use glam::{DMat3, DVec3};

use super::height_map::{self, MapUse, Picture};
use super::holes::ClosedHoles;
use super::rules::Rules;
use super::solid_check::SolidCheck;
use super::{normals, seams};
use crate::buildfile::error::PackError;
use crate::buildfile::model::{Bounds, Triangle};
use crate::buildfile::options::ReliefOptions;
use crate::buildfile::relief::{
    Corner, Displacement, FACTOR_FRACTIONS, MapHeader, Patch, Relief, ReliefShape, TEXTURE_FRACTIONS, Tile,
    whole_bounds,
};
use crate::buildfile::store::{ReliefMap, ReliefSettings, encode_map};
use crate::solid::HeightMap;
use crate::text::{count_text, size_text};

/// Largest texel to which maps are averaged, micrometres: no printer for which relief matters has larger pixels.
const COARSEST_TEXEL_UM: f64 = 200.0;

/// Normals that deviate less from those of their flat triangles make no curve, degrees.
const LEAST_CURVE_DEG: f64 = 0.1;

/// A triangle as its source states it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Face {
    /// Corners, millimetres, which the options transform.
    pub(super) corners: [DVec3; 3],
    /// The direction at each corner, as the file holds it; `None` if the source has none.
    pub(super) directions: Option<[DVec3; 3]>,
    pub(super) textures: Option<[[f64; 2]; 3]>,
    pub(super) factors: [f64; 3],
    /// The displacement, as [`ReliefLane::displacement`] numbered it.
    pub(super) displacement: Option<u8>,
}

impl Face {
    /// A flat triangle.
    pub(super) fn flat(corners: [DVec3; 3]) -> Self {
        Self { corners, directions: None, textures: None, factors: [1.0; 3], displacement: None }
    }

    /// Shows its other side.
    pub(super) fn turn_around(&mut self) {
        self.corners.swap(1, 2);
        self.directions.iter_mut().for_each(|directions| directions.swap(1, 2));
        self.textures.iter_mut().for_each(|textures| textures.swap(1, 2));
        self.factors.swap(1, 2);
    }
}

/// Takes the patches of all sources.
pub(super) struct ReliefLane<'a> {
    rules: &'a Rules,
    is_curved: bool,
    shell_mm: Option<f64>,
    memory_bytes: u64,
    patches: Vec<Patch>,
    /// Where the patches of each finished solid end.
    ends: Vec<usize>,
    solid: SolidCheck,
    closed: ClosedHoles,
    displacements: Vec<Displacement>,
    maps: Vec<Map>,
    /// Memory of the maps, bytes.
    map_bytes: u64,
    /// Texels of the maps.
    texel_count: u64,
}

struct Map {
    size: [u32; 2],
    tiles: [Tile; 2],
    is_nearest: bool,
    texels: Vec<u16>,
}

/// The patches of all sources.
pub(in crate::buildfile) struct CollectedRelief {
    /// In order.
    pub(in crate::buildfile) patches: Vec<Patch>,
    pub(in crate::buildfile) settings: ReliefSettings,
}

/// Memory of a patch until it is written, bytes: itself, and what the larger of two passes needs.
const BYTES_PER_PATCH: u64 = size_of::<Patch>() as u64
    + if normals::BYTES_PER_PATCH > seams::BYTES_PER_PATCH { normals::BYTES_PER_PATCH } else { seams::BYTES_PER_PATCH };

/// A corner without anything.
const BARE: Corner = Corner { at: [0; 3], direction: [0; 3], texture: [0; 2], factor: 0 };

impl<'a> ReliefLane<'a> {
    /// A lane that takes up to `memory_bytes`.
    pub(super) fn new(rules: &'a Rules, options: &ReliefOptions, memory_bytes: u64) -> Self {
        Self {
            rules,
            is_curved: options.is_curved,
            shell_mm: options.shell_mm,
            memory_bytes,
            patches: Vec::new(),
            ends: Vec::new(),
            solid: SolidCheck::default(),
            closed: ClosedHoles::default(),
            displacements: Vec::new(),
            maps: Vec::new(),
            map_bytes: 0,
            texel_count: 0,
        }
    }

    /// Whether any displacement was added.
    pub(super) fn is_displaced(&self) -> bool {
        !self.displacements.is_empty()
    }

    /// A box around their flat triangles.
    pub(super) fn bounds(&self) -> Bounds {
        let triangle = |patch: &Patch| Triangle { corners: patch.corners.map(|corner| corner.at) };
        self.patches.iter().fold(Bounds::EMPTY, |bounds, patch| bounds.joined(&triangle(patch).bounds()))
    }

    /// Number of patches.
    pub(super) fn count(&self) -> u64 {
        self.patches.len() as u64
    }

    /// Adds a height map that `place` names. Returns its number, and whether it has colours.
    ///
    /// # Errors
    /// If it is no PNG, too large, or there are too many maps.
    pub(super) fn map(
        &mut self,
        png: impl BufRead + Seek,
        MapUse { channel, tiles, is_nearest, takes_colours }: MapUse,
        place: &str,
    ) -> Result<(u16, bool), PackError> {
        if self.maps.len() == Relief::MAX_MAPS {
            let problem = format!("there are already {} height maps, the most that a part may have", Relief::MAX_MAPS);
            return Err(PackError::input(place, problem));
        }
        // While a map is encoded, and later decoded, there are two of it.
        let free_bytes = self.memory_bytes.saturating_sub(self.map_bytes) / 2;
        let Picture { size, texels, is_coloured } =
            height_map::read(png, free_bytes, channel).map_err(|problem| PackError::input(place, problem))?;
        if is_coloured && !takes_colours {
            let problem =
                "it has colours, so it holds normals, not heights; a map of heights is grey, or named by `disp`";
            return Err(PackError::input(place, problem));
        }
        let texel_count = self.texel_count + u64::from(size[0]) * u64::from(size[1]);
        if texel_count > Relief::MAX_TEXELS {
            let problem = format!(
                "{} × {} pixels; with it, the height maps of the part have {texel_count}, and may have {}: scale some down",
                size[0],
                size[1],
                Relief::MAX_TEXELS
            );
            return Err(PackError::input(place, problem));
        }
        self.texel_count = texel_count;
        self.map_bytes += HeightMap::bytes(size.map(|count| count as usize)) * 2;
        self.maps.push(Map { size, tiles, is_nearest, texels });
        Ok((self.maps.len() as u16 - 1, is_coloured))
    }

    /// Adds a displacement, and returns its number for [`Face`]. `place` names what states it.
    ///
    /// # Errors
    /// If there are too many.
    pub(super) fn displacement(
        &mut self,
        displacement: Displacement,
        place: &dyn Fn() -> String,
    ) -> Result<u8, PackError> {
        if let Some(number) = self.displacements.iter().position(|other| *other == displacement) {
            return Ok(number as u8 + 1);
        }
        if self.displacements.len() == Relief::MAX_DISPLACEMENTS {
            let most = Relief::MAX_DISPLACEMENTS;
            let problem = format!(
                "there are already {most} displacements of different maps, heights or transforms, the most that a part may have"
            );
            return Err(PackError::input(place(), problem));
        }
        self.displacements.push(displacement);
        Ok(self.displacements.len() as u8)
    }

    /// Adds a triangle; `place` names it in errors.
    ///
    /// # Errors
    /// If a number is out of range, something is missing, or memory does not suffice.
    pub(super) fn face(&mut self, face: &Face, place: &dyn Fn() -> String) -> Result<(), PackError> {
        let needed_bytes = (self.count() + 1).saturating_mul(BYTES_PER_PATCH).saturating_add(self.map_bytes);
        if needed_bytes > self.memory_bytes {
            let [needed, allowed] = [needed_bytes, self.memory_bytes].map(size_text);
            let problem = format!(
                "so far, triangles with relief and maps take {needed}, and --memory allows {allowed}; give more"
            );
            return Err(PackError::input(place(), problem));
        }
        if face.displacement.is_some() && face.textures.is_none() {
            let problem =
                "it has no texture coordinates, which say where a height map applies; export the part with them (UV)";
            return Err(PackError::input(place(), problem));
        }
        let mut corners = [BARE; 3];
        for (number, corner) in corners.iter_mut().enumerate() {
            corner.at = self.rules.corner(face.corners[number], place)?;
            corner.direction = face.directions.map_or([0; 3], |directions| normals::stored(directions[number]));
            // Not kept where they have no meaning: neighbours would differ for nothing.
            let textures = face.textures.filter(|_| face.displacement.is_some());
            corner.texture = textures.map_or(Ok([0; 2]), |textures| texture(textures[number], place))?;
            corner.factor = factor(face.factors[number], place)?;
        }
        self.solid.add(corners.map(|corner| corner.at));
        self.patches.push(Patch { z: [0; 2], corners, displacement: face.displacement.unwrap_or(0), seams: 0 });
        Ok(())
    }

    /// Ends a file or an object, which `place` names. Its holes are closed, unless it is a shell.
    ///
    /// # Errors
    /// If it has to enclose a solid and does not.
    pub(super) fn end_solid(&mut self, place: &str) -> Result<(), PackError> {
        if self.shell_mm.is_some() {
            self.solid = SolidCheck::default();
            self.ends.push(self.patches.len());
            return Ok(());
        }
        for hole in self.solid.holes() {
            for cap in hole.caps() {
                self.solid.add(cap);
                let corners = cap.map(|at| Corner { at, factor: FACTOR_FRACTIONS as i32, ..BARE });
                self.patches.push(Patch { z: [0; 2], corners, displacement: 0, seams: 0 });
            }
            self.closed.add(&hole, place);
        }
        self.ends.push(self.patches.len());
        std::mem::take(&mut self.solid).end(place, self.rules)
    }

    /// All patches; `None` if there are none. Adds notes for the operator.
    ///
    /// # Errors
    /// If a patch reaches too far, or a map cannot be encoded.
    pub(super) fn finish(mut self, notes: &mut Vec<String>) -> Result<Option<CollectedRelief>, PackError> {
        if self.patches.is_empty() {
            return Ok(None);
        }
        notes.extend(self.closed.note(self.rules));
        let mut begin = 0;
        for end in std::mem::take(&mut self.ends) {
            normals::complete(&mut self.patches[std::mem::replace(&mut begin, end)..end]);
        }
        let is_curved = self.is_curved && self.curves(notes);
        seams::mark(&mut self.patches);
        let maps = self.encoded_maps()?;
        let shell_um = self.shell_mm.map_or(0.0, |shell_mm| shell_mm * 1000.0);
        let displacements = std::mem::take(&mut self.displacements);
        let settings = ReliefSettings { is_curved, shell_um, displacements, maps };
        self.sort(&settings.header())?;
        Ok(Some(CollectedRelief { patches: self.patches, settings }))
    }

    /// Whether normals curve any patch.
    fn curves(&self, notes: &mut Vec<String>) -> bool {
        let least = LEAST_CURVE_DEG.to_radians().sin();
        let is_bent = |patch: &&Patch| {
            let [a, b, c] = patch.corners.map(|corner| DVec3::from(corner.at.map(|at| at as f64)));
            let normal = (b - a).cross(c - a).normalize_or_zero();
            let direction = |corner: &Corner| DVec3::from(corner.direction.map(f64::from)).normalize_or_zero();
            patch.corners.iter().any(|corner| direction(corner).cross(normal).length() > least)
        };
        match self.patches.iter().filter(is_bent).count() as u64 {
            0 => {
                notes.push(
                    "--curved changes nothing: the normals are those of the flat triangles. Export the part with smooth normals, or \
                     without any: then they are computed"
                        .into(),
                );
                false
            }
            count => {
                notes.push(format!("{count} of {} are curved by their normals", count_text(self.count(), "triangle")));
                true
            }
        }
    }

    /// The maps as they are stored.
    fn encoded_maps(&self) -> Result<Vec<ReliefMap>, PackError> {
        let mut encoded = Vec::new();
        for (number, Map { size, tiles, is_nearest, texels }) in self.maps.iter().enumerate() {
            let texel_um = self.texel_um(number, *size);
            let halvings = (COARSEST_TEXEL_UM / texel_um).log2().floor();
            let bytes = encode_map(*size, texels).map_err(|problem| PackError::input("a height map", problem))?;
            let header = MapHeader {
                size: *size,
                tiles: *tiles,
                is_nearest: *is_nearest,
                texel_um,
                coarsest_level: halvings.clamp(0.0, f64::from(MapHeader::MAX_LEVEL)) as u8,
                bytes: u32::try_from(bytes.len()).map_err(|_| PackError::input("a height map", "it is too large"))?,
                crc: crc32fast::hash(&bytes),
            };
            encoded.push(ReliefMap { header, png: bytes.into() });
        }
        Ok(encoded)
    }

    /// Length of a texel of a map on the surface, micrometres: the root of the mean area of one.
    fn texel_um(&self, map: usize, size: [u32; 2]) -> f64 {
        let (mut surface, mut texels) = (0.0, 0.0);
        for patch in &self.patches {
            let number = usize::from(patch.displacement).checked_sub(1);
            if number.is_some_and(|number| usize::from(self.displacements[number].map) == map) {
                let [a, b, c] = patch.corners.map(|corner| self.rules.um(corner.at));
                surface += (b - a).cross(c - a).length();
                let [a, b, c] = patch.corners.map(|corner| {
                    [0, 1].map(|axis| f64::from(corner.texture[axis]) / TEXTURE_FRACTIONS * f64::from(size[axis]))
                });
                texels += ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs();
            }
        }
        let length_um = (surface / texels).sqrt();
        // A map that no area of the surface has is sampled as it is.
        if length_um.is_finite() && length_um > 0.0 { length_um } else { COARSEST_TEXEL_UM }
    }

    /// Gives all patches their bounds, and puts them in order.
    fn sort(&mut self, relief: &Relief) -> Result<(), PackError> {
        let maps = self.maps.iter_mut().map(|Map { size, tiles, is_nearest, texels }| {
            let size = size.map(|count| count as usize);
            Arc::new(HeightMap::new(size, *tiles, *is_nearest, std::mem::take(texels)))
        });
        let maps: Vec<_> = maps.collect();
        let shape =
            relief.shape(&maps, self.rules.quantum_um()).map_err(|problem| PackError::input("the relief", problem))?;
        for patch in &mut self.patches {
            patch.z = z_range(patch, relief, &shape, self.rules)?;
        }
        self.patches.sort_unstable();
        Ok(())
    }
}

fn z_range(patch: &Patch, relief: &Relief, shape: &ReliefShape, rules: &Rules) -> Result<[i32; 2], PackError> {
    let bounds = shape.bounds(patch, relief.coarsest(patch));
    whole_bounds(bounds, 1.0).map(|bounds| [bounds.min[2], bounds.max[2]]).ok_or_else(|| {
        let [x, y, z] = rules.source_mm(patch.corners[0].at);
        let place = format!("the triangle at {x:.3}, {y:.3}, {z:.3} mm");
        let problem = "displaced, it is too far from the origin; check the height, or use a larger --quantum";
        PackError::input(place, problem)
    })
}

/// Texture coordinates as a build file holds them.
fn texture(texture: [f64; 2], place: &dyn Fn() -> String) -> Result<[i32; 2], PackError> {
    let fractions = texture.map(|at| (at * TEXTURE_FRACTIONS).round());
    // False if any of them is NaN.
    if fractions.iter().all(|at| at.abs() <= f64::from(Patch::MAX_TEXTURE)) {
        return Ok(fractions.map(|at| at as i32));
    }
    let problem = format!("texture coordinates {:?}, {:?}; allowed are -500 to 500", texture[0], texture[1]);
    Err(PackError::input(place(), problem))
}

fn factor(factor: f64, place: &dyn Fn() -> String) -> Result<i32, PackError> {
    let fractions = (factor * FACTOR_FRACTIONS).round();
    if fractions.abs() <= f64::from(Patch::MAX_FACTOR) {
        return Ok(fractions as i32);
    }
    Err(PackError::input(place(), format!("a displacement factor of {factor:?}; allowed are -1000 to 1000")))
}

/// How a map displaces once the part has been transformed: `transform` leads from millimetres of the source to those of the plate. Returns the
/// displacement, and what directions are to be multiplied by.
pub(super) fn placed(map: u16, height_mm: f64, offset_mm: f64, transform: DMat3) -> (Displacement, DMat3) {
    let scale = transform.determinant().abs().cbrt();
    let turn = transform * (1.0 / scale);
    let is_similar = (turn.transpose() * turn).abs_diff_eq(DMat3::IDENTITY, 1e-6);
    let (scale, frame, turn) = if is_similar {
        (scale, Displacement::UPRIGHT, turn)
    } else {
        (1.0, transform.to_cols_array_2d(), DMat3::IDENTITY)
    };
    let [height_um, offset_um] = [height_mm, offset_mm].map(|mm| mm * scale * 1000.0);
    (Displacement { map, height_um, offset_um, frame }, turn)
}
