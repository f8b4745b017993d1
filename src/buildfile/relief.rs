//! Surfaces with relief: patches, and the height maps that displace them. `primitive/patch.rs` stores patches, `store/maps.rs` maps.
//! `docs/build-file.md` describes both.

use std::sync::Arc;

use bincode::{Decode, Encode};
use glam::{DMat3, DVec3};

use super::model::{Bounds, QUANTUM_FRACTIONS, Triangle};
pub use crate::solid::Tile;
use crate::solid::{HeightMap, Lift, PatchCorner, PatchShape};

/// Fractions of the unit square in which texture coordinates are given.
pub const TEXTURE_FRACTIONS: f64 = (1 << 22) as f64;

/// Fractions in which factors of a displacement are given.
pub const FACTOR_FRACTIONS: f64 = (1 << 16) as f64;

/// The unit in which directions are given.
pub const DIRECTION_UNIT: f64 = i16::MAX as f64;

/// A corner of a patch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Corner {
    /// Position of the flat triangle's corner, in fractions of a quantum ([`QUANTUM_FRACTIONS`]).
    pub at: [i64; 3],
    /// The direction of displacement, and the normal of a curved patch, in units of 1/32767. Its length has no meaning.
    pub direction: [i16; 3],
    /// Texture coordinates u and v, in units of 2⁻²² of the map's width and height.
    pub texture: [i32; 2],
    /// What the displacement is multiplied by, in units of 2⁻¹⁶.
    pub factor: i32,
}

/// A triangle whose surface is displaced, curved or given a thickness, as the [`Relief`] says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Patch {
    /// Bounds of z of all that is printed of it, quanta.
    pub z: [i32; 2],
    /// Corners, counter-clockwise seen from outside.
    pub corners: [Corner; 3],
    /// Which of [`Relief::displacements`] applies, counted from 1; 0 if none does.
    pub displacement: u8,
    /// Bit `i` is set if no neighbour continues the surface beyond the edge from corner `i` to the next: there is none, or one with another
    /// direction, texture coordinate, factor or displacement at one of the two corners.
    pub seams: u8,
}

/// The header of a surface with relief. A point is solid if its winding number is above 0, as in a [`Surface`](super::Surface).
#[derive(Clone, Debug, PartialEq, Encode, Decode)]
pub struct Relief {
    /// The smallest box of whole quanta around all that is printed of all patches, divided into facets of 20 µm.
    pub bounds: Bounds,
    /// Bounds of [`Patch::z`] of all patches.
    pub z_reach: [i32; 2],
    /// Number of patches.
    pub patch_count: u64,
    /// Whether patches are curved (PN triangles; Vlachos et al. 2001) instead of flat.
    pub is_curved: bool,
    /// Thickness of a shell inwards from the surface, micrometres; 0 if the surface encloses a solid.
    pub shell_um: f64,
    /// At most [`Relief::MAX_DISPLACEMENTS`].
    pub displacements: Vec<Displacement>,
    /// At most [`Relief::MAX_MAPS`].
    pub maps: Vec<MapHeader>,
}

/// How a map displaces the patches that name it: by `factor · (height · value + offset)` along `frame · direction`, where the value of the
/// map is 0 to 1 and the direction has unit length.
#[derive(Clone, Copy, Debug, PartialEq, Encode, Decode)]
pub struct Displacement {
    /// Index of the map in [`Relief::maps`].
    pub map: u16,
    /// Displacement where the map is 1, without the offset, micrometres. It may be negative.
    pub height_um: f64,
    /// Displacement where the map is 0, micrometres.
    pub offset_um: f64,
    /// Columns of a matrix that a transformation of the displaced shape applies to unit directions.
    pub frame: [[f64; 3]; 3],
}

/// A height map, which is stored as a grey PNG.
#[derive(Clone, Copy, Debug, PartialEq, Encode, Decode)]
pub struct MapHeader {
    /// Columns and rows, texels.
    pub size: [u32; 2],
    /// What lies beyond the unit square, along u and v.
    pub tiles: [Tile; 2],
    /// Whether a point has the value of the nearest texel, instead of one interpolated between four.
    pub is_nearest: bool,
    /// Length of a texel on the surface, micrometres: the root of the mean area of one.
    pub texel_um: f64,
    /// How often the map may be halved before it is sampled: the bounds of patches hold up to there.
    pub coarsest_level: u8,
    /// Length of the PNG, bytes.
    pub bytes: u32,
    /// CRC-32 (IEEE) of the PNG.
    pub crc: u32,
}

impl Relief {
    /// Most displacements: each takes 90 bytes of the header.
    pub const MAX_DISPLACEMENTS: usize = 32;

    /// Most maps.
    pub const MAX_MAPS: usize = 16;

    /// Most texels of all maps of a part: a check before a print decodes all of them, one after the other, in some ten seconds, and
    /// a print with pixels as fine as the texels holds them, in 640 MiB.
    pub const MAX_TEXELS: u64 = 4 * MapHeader::MAX_TEXELS;

    /// What its patches are evaluated with; `maps` are those of the header, in order.
    ///
    /// # Errors
    /// A text if a displacement names a map that is not there.
    pub(crate) fn shape(&self, maps: &[Arc<HeightMap>], quantum_um: f64) -> Result<ReliefShape, String> {
        let lift = |displacement: &Displacement| {
            let map = maps
                .get(usize::from(displacement.map))
                .ok_or_else(|| format!("there is no map {}", displacement.map))?;
            Ok(displacement.lift(Arc::clone(map), quantum_um))
        };
        Ok(ReliefShape {
            lifts: self.displacements.iter().map(lift).collect::<Result<_, String>>()?,
            is_curved: self.is_curved,
            thickness: self.shell_um / quantum_um,
        })
    }

    /// The map that displaces a patch, as an index of [`Relief::maps`].
    pub(crate) fn map_of(&self, patch: &Patch) -> Option<usize> {
        let displacement = usize::from(patch.displacement).checked_sub(1).and_then(|at| self.displacements.get(at));
        displacement.map(|displacement| usize::from(displacement.map))
    }

    /// How often the map of a patch may be halved.
    pub(crate) fn coarsest(&self, patch: &Patch) -> u8 {
        self.map_of(patch).and_then(|map| self.maps.get(map)).map_or(0, |map| map.coarsest_level)
    }

    /// Texels around a box of texture coordinates that a map halved `level` times may read for it, besides those it needs itself.
    pub(crate) fn margin(level: u8) -> i64 {
        2 << level
    }
}

impl MapHeader {
    /// Most texels of a map, those of 8192 × 8192: a check before a print decodes it at its full size, into some 160 MiB. On a
    /// surface of 200 × 200 mm its texels are then 24 µm long, as fine as the pixels of fine printers.
    pub const MAX_TEXELS: u64 = 1 << 26;

    /// Number of texels.
    pub(super) fn texel_count(&self) -> u64 {
        u64::from(self.size[0]) * u64::from(self.size[1])
    }

    /// Most bytes of its PNG: a row of a single texel takes 3 without compression, and there are some bytes around them.
    pub(super) fn max_bytes(&self) -> u64 {
        3 * self.texel_count() + (64 << 10)
    }

    /// Most halvings: of the largest map, one texel is left.
    pub(super) const MAX_LEVEL: u8 = 15;

    /// How often the map is halved before it is sampled in pixels of `pixel_um`: a texel is then at most as long as a pixel. The nearest
    /// texel is always one of the map itself.
    pub(crate) fn level(&self, pixel_um: f64) -> u8 {
        let halvings = (pixel_um / self.texel_um).log2().floor();
        if self.is_nearest { 0 } else { (halvings.max(0.0) as u8).min(self.coarsest_level) }
    }

    /// Columns and rows once it has been halved `level` times.
    pub(crate) fn size_at(&self, level: u8) -> [usize; 2] {
        self.size.map(|count| (f64::from(count) / f64::from(1_u32 << level)).round().max(1.0) as usize)
    }
}

impl Patch {
    /// Largest texture coordinate, in units of 2⁻²²: that of 500 maps side by side.
    pub(super) const MAX_TEXTURE: i32 = 500 << 22;

    /// Largest factor of a displacement, in units of 2⁻¹⁶: 1000.
    pub(super) const MAX_FACTOR: i32 = 1000 << 16;

    /// # Errors
    /// A text if a number is out of range.
    pub(super) fn check_range(&self, relief: &Relief) -> Result<(), String> {
        Triangle { corners: self.corners.map(|corner| corner.at) }.check_range()?;
        let is_wild = |corner: &Corner| {
            corner.texture.iter().any(|at| at.unsigned_abs() > Self::MAX_TEXTURE as u32)
                || corner.factor.unsigned_abs() > Self::MAX_FACTOR as u32
        };
        if self.corners.iter().any(is_wild) {
            return Err(format!("{self:?} has a texture coordinate beyond ±500 or a factor beyond ±1000"));
        }
        if usize::from(self.displacement) > relief.displacements.len() || self.seams > 7 || self.z[0] > self.z[1] {
            return Err(format!("{self:?} contradicts itself or the {} displacements", relief.displacements.len()));
        }
        Ok(())
    }
}

/// What patches are evaluated with. Lengths are in quanta.
#[derive(Clone, Debug)]
pub(crate) struct ReliefShape {
    /// Those of the displacements, in order.
    pub(crate) lifts: Vec<Lift>,
    pub(crate) is_curved: bool,
    /// Thickness of a shell; 0 of a solid.
    pub(crate) thickness: f64,
}

impl ReliefShape {
    /// The surfaces of a patch: one, or the outer and the inner side of a shell.
    pub(crate) fn sides(&self, patch: &Patch) -> impl Iterator<Item = PatchShape<'_>> {
        let corners = patch.corners.map(|corner| PatchCorner {
            at: DVec3::from(corner.at.map(|at| at as f64 / QUANTUM_FRACTIONS as f64)),
            direction: DVec3::from(corner.direction.map(|part| f64::from(part) / DIRECTION_UNIT)).normalize_or_zero(),
            texture: corner.texture.map(|at| f64::from(at) / TEXTURE_FRACTIONS),
            factor: f64::from(corner.factor) / FACTOR_FRACTIONS,
        });
        let seams = [0, 1, 2].map(|edge| patch.seams >> edge & 1 != 0);
        let lift = usize::from(patch.displacement).checked_sub(1).and_then(|number| self.lifts.get(number));
        let outer = PatchShape::new(corners, seams, lift, self.is_curved);
        std::iter::once(outer).chain((self.thickness > 0.0).then(|| outer.inner(self.thickness)))
    }

    /// A box around all that is printed of a patch, also with maps that are halved up to `coarsest` times.
    pub(crate) fn bounds(&self, patch: &Patch, coarsest: u8) -> [DVec3; 2] {
        let boxes = self.sides(patch).map(|side| side.bounds(Relief::margin(coarsest)));
        boxes.reduce(|[low, high], [also_low, also_high]| [low.min(also_low), high.max(also_high)]).unwrap_or_default()
    }
}

/// A box as whole quanta, with so many to `spare`; `None` beyond ±2³⁰ quanta.
pub(crate) fn whole_bounds([low, high]: [DVec3; 2], spare: f64) -> Option<Bounds> {
    const MOST: f64 = (1 << 30) as f64;
    let (low, high) = (low.floor() - spare, high.ceil() + spare);
    // False if any of them is NaN.
    let in_range = low.cmpge(DVec3::splat(-MOST)).all() && high.cmple(DVec3::splat(MOST)).all();
    let whole = |corner: DVec3| corner.to_array().map(|at| at as i32);
    in_range.then(|| Bounds { min: whole(low), max: whole(high) })
}

impl Displacement {
    /// The frame of directions that lie as they are.
    pub const UPRIGHT: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

    /// The displacement by a map, for evaluation.
    pub(crate) fn lift(&self, map: Arc<HeightMap>, quantum_um: f64) -> Lift {
        let [height, offset] = [self.height_um, self.offset_um].map(|um| um / quantum_um);
        Lift::new(map, height, offset, DMat3::from_cols_array_2d(&self.frame))
    }
}
