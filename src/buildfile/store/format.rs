//! The frame around the chunks: prelude and header at the front; index, profile and footer at the end. `docs/build-file.md` describes
//! every byte. `reader` and `writer` use it.

use super::maps;
use crate::buildfile::materials::Materials;
use crate::buildfile::model::{
    BodyHeader, Bounds, Clip, Header, Joint, Lattice, Placement, QUANTA_UM, Surface, printed_bounds,
};
use crate::buildfile::relief::{Displacement, MapHeader, Relief};
use crate::codec;
use crate::solid::{MAX_RADIUS, MAX_RADIUS_SHARE};

/// First bytes of every build file. A transfer in text mode would change the byte with the high bit or one of the line ends.
pub(super) const MAGIC: [u8; 8] = *b"\x89LYD\r\n\x1a\n";

/// Last bytes of every complete build file.
pub(super) const END_MAGIC: [u8; 8] = *b"LYD-END\n";

/// The version that this code writes and reads. Earlier ones were never released.
pub(super) const VERSION: u32 = 4;

/// Length of the prelude: magic, version, length and CRC of the header.
pub(super) const PRELUDE_BYTES: usize = 20;

/// Bytes that [`check_beginning`] examines: magic and version.
pub(crate) const BEGINNING_BYTES: usize = 12;

/// Checks that a file that begins with these bytes can be a build file of the current version. If there are fewer than
/// [`BEGINNING_BYTES`], only those are checked.
///
/// # Errors
/// A text that says what is wrong and what to do.
pub(crate) fn check_beginning(bytes: &[u8]) -> Result<(), String> {
    let magic = &bytes[..bytes.len().min(MAGIC.len())];
    if !MAGIC.starts_with(magic) {
        return Err("it is not a build file (.layerd); make one with `layerctl pack`".into());
    }
    if let Some(&[a, b, c, d]) = bytes.get(MAGIC.len()..BEGINNING_BYTES) {
        let version = u32::from_le_bytes([a, b, c, d]);
        if version != VERSION {
            return Err(format!(
                "it is a build file of version {version}; this layerd reads version {VERSION}: pack the part again"
            ));
        }
    }
    Ok(())
}

/// Longest header: that of a relief with the most displacements and maps takes 4,000 bytes, and few parts have more than one.
pub(super) const MAX_HEADER_BYTES: u32 = 16 << 10;

/// Longest source name: the longest file name of usual file systems.
pub(super) const MAX_SOURCE_NAME_BYTES: usize = 255;

/// Prelude and header.
///
/// # Errors
/// A text if the header cannot be encoded.
pub(super) fn front(header: &Header) -> Result<Vec<u8>, String> {
    let body = codec::encode(header).map_err(|error| error.to_string())?;
    let mut bytes = Vec::with_capacity(PRELUDE_BYTES + body.len());
    bytes.extend_from_slice(&MAGIC);
    bytes.extend_from_slice(&VERSION.to_le_bytes());
    bytes.extend_from_slice(&(body.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&crc32fast::hash(&body).to_le_bytes());
    bytes.extend_from_slice(&body);
    Ok(bytes)
}

/// The last bytes of a file: they locate index and profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Footer {
    /// Offset of the index. The index ends where the profile begins.
    pub(super) index_offset: u64,
    /// Number of entries in the index.
    pub(super) chunk_count: u32,
    /// CRC-32 of the index.
    pub(super) index_crc: u32,
    /// Compressed length of the profile. The profile ends where the footer begins.
    pub(super) profile_bytes: u32,
    /// CRC-32 of the compressed profile.
    pub(super) profile_crc: u32,
}

impl Footer {
    /// Length of a footer, including its CRC and the end magic.
    pub(super) const BYTES: usize = 36;

    pub(super) fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        bytes[0..8].copy_from_slice(&self.index_offset.to_le_bytes());
        for (at, word) in
            [(8, self.chunk_count), (12, self.index_crc), (16, self.profile_bytes), (20, self.profile_crc)]
        {
            bytes[at..at + 4].copy_from_slice(&word.to_le_bytes());
        }
        let crc = crc32fast::hash(&bytes[..24]);
        bytes[24..28].copy_from_slice(&crc.to_le_bytes());
        bytes[28..36].copy_from_slice(&END_MAGIC);
        bytes
    }

    /// # Errors
    /// A text that says what is wrong with these bytes.
    pub(super) fn from_bytes(bytes: &[u8; Self::BYTES]) -> Result<Self, String> {
        if bytes[28..36] != END_MAGIC {
            return Err("it does not end as a build file does; it was cut short or is still being written".into());
        }
        let word = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        if crc32fast::hash(&bytes[..24]) != word(24) {
            return Err("its footer is corrupt (CRC)".into());
        }
        let index_offset = u64::from(word(0)) | u64::from(word(4)) << 32;
        Ok(Self {
            index_offset,
            chunk_count: word(8),
            index_crc: word(12),
            profile_bytes: word(16),
            profile_crc: word(20),
        })
    }
}

/// Checks everything in a header that can be checked without the rest of the file.
///
/// # Errors
/// A text that names the field, what was found and what is allowed.
pub(super) fn check_header(header: &Header) -> Result<(), String> {
    let Header { quantum_um, bounds, bottom_um, placement, source_name, materials, bodies, .. } = header;
    if !QUANTA_UM.contains(quantum_um) {
        return Err(format!("quantum_um = {quantum_um}: allowed is 0.001 to 1000"));
    }
    if !(1..=Header::MAX_BODIES).contains(&bodies.len()) {
        return Err(format!("{} bodies: allowed are 1 to {}", bodies.len(), Header::MAX_BODIES));
    }
    let mut bulge_um = 0.0_f64;
    for (number, body) in bodies.iter().enumerate() {
        match body {
            BodyHeader::Lattice(lattice) => {
                check_lattice(lattice, *quantum_um)?;
                bulge_um = bulge_um.max(lattice.bulge_um(*quantum_um));
            }
            BodyHeader::Surface(surface) => check_surface(surface)?,
            BodyHeader::Relief(relief) => check_relief(relief, *quantum_um)?,
            BodyHeader::Clip(clip) => check_clip(clip, &bodies[..number], *quantum_um)?,
        }
    }
    if let Some(materials) = materials {
        check_materials(materials, header)?;
    }
    let texel_count: u64 = bodies.iter().flat_map(BodyHeader::maps).map(MapHeader::texel_count).sum();
    if texel_count > Relief::MAX_TEXELS {
        let most = Relief::MAX_TEXELS;
        return Err(format!(
            "its height maps have {texel_count} texels together: a part may have {most}, because all are decoded before a print"
        ));
    }
    let joined = printed_bounds(bodies);
    if joined != *bounds {
        return Err(format!("bounds {bounds:?}: those of its bodies are {joined:?}"));
    }
    let (low_um, high_um) = (bounds.bottom_um(*quantum_um), f64::from(bounds.max[2]) * quantum_um);
    let allowed_um = low_um - bulge_um..=high_um + bulge_um;
    if !allowed_um.contains(bottom_um) {
        let (least, most) = allowed_um.into_inner();
        return Err(format!("bottom_um = {bottom_um}: allowed is {least} to {most}, as the bounds say"));
    }
    if let Placement::At { x_mm, y_mm } = placement
        && !(x_mm.is_finite() && y_mm.is_finite())
    {
        return Err(format!("placement at {x_mm}, {y_mm} mm is no place"));
    }
    if source_name.len() > MAX_SOURCE_NAME_BYTES {
        return Err(format!("a source name of {} bytes: allowed are {MAX_SOURCE_NAME_BYTES}", source_name.len()));
    }
    Ok(())
}

fn check_lattice(lattice: &Lattice, quantum_um: f64) -> Result<(), String> {
    let Lattice { joint, bounds, radius_range: [least, most], strut_count, ball_count, node_count, .. } = lattice;
    if *least == 0 || least > most || *most > MAX_RADIUS {
        return Err(format!(
            "radius_range = {least} to {most} quanta: allowed is 1 to {MAX_RADIUS}, in ascending order"
        ));
    }
    if let Joint::Elliptic { least, .. } = joint
        && !least.iter().all(|share| *share > 0.0 && *share < 1.0)
    {
        return Err(format!("a blend from {least:?} of the isovalue on: allowed is above 0 and below 1"));
    }
    if let Some(support_um) = joint.support_um() {
        let largest_um = f64::from(*most) * quantum_um;
        if !support_um.is_finite() || largest_um >= MAX_RADIUS_SHARE * support_um {
            return Err(format!(
                "support R = {support_um} µm, but the largest radius, {largest_um} µm, must be below {MAX_RADIUS_SHARE} R"
            ));
        }
        // Activity is counted in 64-bit quanta; a support beyond any coordinate has no use.
        if support_um / quantum_um > f64::from(i32::MAX) {
            return Err(format!("support R = {support_um} µm is beyond the range of coordinates"));
        }
    }
    let thickness = 2 * i64::from(*most);
    if (0..3).any(|axis| i64::from(bounds.max[axis]) - i64::from(bounds.min[axis]) < thickness) {
        return Err(format!(
            "bounds {:?} to {:?} are too narrow for a radius of {most} quanta on both sides",
            bounds.min, bounds.max
        ));
    }
    if strut_count.checked_add(*ball_count).is_none_or(|total| total == 0) {
        return Err(format!("{strut_count} struts and {ball_count} balls: nothing to print"));
    }
    if node_count / 2 > lattice.total() {
        return Err(format!("{node_count} nodes are more than its struts have ends"));
    }
    Ok(())
}

fn check_materials(materials: &Materials, header: &Header) -> Result<(), String> {
    let Materials { names, of_bodies, .. } = materials;
    if !(1..=Materials::MAX_COUNT).contains(&names.len()) {
        return Err(format!("{} materials: allowed are 1 to {}", names.len(), Materials::MAX_COUNT));
    }
    for (number, name) in names.iter().enumerate() {
        check_material_name(name)?;
        if names[..number].contains(name) {
            return Err(format!("two materials have the name `{name}`"));
        }
    }
    if of_bodies.len() != header.bodies.len() || of_bodies.iter().any(|number| usize::from(*number) >= names.len()) {
        return Err(format!("materials {of_bodies:?} of {} bodies, of {} materials", header.bodies.len(), names.len()));
    }
    let joined = header.joined().unwrap_or(0..0);
    let lattices = || header.lattices().take(joined.len());
    if lattices().zip(lattices().skip(1)).any(|(one, next)| one.joint != next.joint) {
        return Err("lattices of different materials that are not joined in the same way".into());
    }
    if !of_bodies[joined.clone()].is_sorted_by(|one, next| one < next) {
        return Err(format!("lattices of materials {:?}: each has one body, in ascending order", &of_bodies[joined]));
    }
    if let Some(Joint::Elliptic { least: [one, other], .. }) = lattices().next().map(|lattice| lattice.joint)
        && joined.len() > 2
        && one != other
    {
        return Err(format!("blends from {one} and {other} of the isovalue on, of {} materials", joined.len()));
    }
    Ok(())
}

/// # Errors
/// A text if a material cannot have this name.
pub(in crate::buildfile) fn check_material_name(name: &str) -> Result<(), String> {
    if name.is_empty() || name.len() > Materials::MAX_NAME_BYTES || name.chars().any(char::is_control) {
        let most = Materials::MAX_NAME_BYTES;
        return Err(format!("a material named {name:?}: a name has 1 to {most} bytes, and no control characters"));
    }
    Ok(())
}

fn check_surface(surface: &Surface) -> Result<(), String> {
    check_box(&surface.bounds)?;
    if surface.triangle_count == 0 {
        return Err("a surface without triangles".into());
    }
    Ok(())
}

/// A clip, which follows these bodies.
fn check_clip(clip: &Clip, before: &[BodyHeader], quantum_um: f64) -> Result<(), String> {
    check_surface(&clip.surface)?;
    let Some(BodyHeader::Lattice(lattice)) = before.last() else {
        return Err(format!("body {} is a clip, but the body before it is no lattice", before.len()));
    };
    let most = clip.limits(lattice, quantum_um);
    if most.is_none_or(|most| clip.bounds.common(&most) != Some(clip.bounds)) {
        return Err(format!("bounds {:?} of what a clip leaves are beyond its lattice or its surface", clip.bounds));
    }
    Ok(())
}

/// The bounds of a surface. A corner has at most 2³⁰ quanta.
fn check_box(Bounds { min, max }: &Bounds) -> Result<(), String> {
    let in_range = |at: &i32| at.unsigned_abs() <= 1 << 30;
    if (0..3).any(|axis| min[axis] > max[axis]) || !min.iter().chain(max).all(in_range) {
        return Err(format!("bounds {min:?} to {max:?} quanta of a surface: allowed are ±2³⁰, in ascending order"));
    }
    Ok(())
}

fn check_relief(relief: &Relief, quantum_um: f64) -> Result<(), String> {
    let Relief { bounds, z_reach, patch_count, shell_um, displacements, maps, .. } = relief;
    check_box(bounds)?;
    if z_reach[0] > bounds.min[2] || z_reach[1] < bounds.max[2] {
        return Err(format!(
            "patches from z {} to {} quanta do not reach its bounds {bounds:?}",
            z_reach[0], z_reach[1]
        ));
    }
    if *patch_count == 0 {
        return Err("a relief without patches".into());
    }
    let longest_um = f64::from(1 << 30) * quantum_um;
    if !(0.0..=longest_um).contains(shell_um) {
        return Err(format!("shell_um = {shell_um}: allowed is 0 to {longest_um}"));
    }
    if displacements.len() > Relief::MAX_DISPLACEMENTS || maps.len() > Relief::MAX_MAPS {
        return Err(format!(
            "{} displacements by {} maps: allowed are {} by {}",
            displacements.len(),
            maps.len(),
            Relief::MAX_DISPLACEMENTS,
            Relief::MAX_MAPS
        ));
    }
    for Displacement { map, height_um, offset_um, frame } in displacements {
        let in_range = |value: &f64, most: f64| (-most..=most).contains(value);
        if usize::from(*map) >= maps.len()
            || ![height_um, offset_um].into_iter().all(|length_um| in_range(length_um, longest_um))
            || !frame.as_flattened().iter().all(|part| in_range(part, 1e6))
        {
            return Err(format!(
                "a displacement by map {map}, {height_um} µm high from {offset_um} µm on, is out of range"
            ));
        }
    }
    for map in maps {
        let MapHeader { size, texel_um, coarsest_level, bytes, .. } = map;
        let has_size = size.iter().all(|count| (1..=maps::MAX_SIDE).contains(count));
        if !has_size || !texel_um.is_finite() || *texel_um <= 0.0 || *coarsest_level > MapHeader::MAX_LEVEL {
            return Err(format!("a map of {} × {} texels of {texel_um} µm is out of range", size[0], size[1]));
        }
        if map.texel_count() > MapHeader::MAX_TEXELS {
            return Err(format!(
                "a map of {} × {} texels: it may have {}, because it is decoded as a whole before a print",
                size[0],
                size[1],
                MapHeader::MAX_TEXELS
            ));
        }
        if u64::from(*bytes) > map.max_bytes() {
            return Err(format!("a PNG of {bytes} bytes for a map of {} × {} texels is too long", size[0], size[1]));
        }
    }
    Ok(())
}
