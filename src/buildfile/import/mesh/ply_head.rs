//! What the head of a PLY file has to say before anything else of it is read. `ply` asks.

use ply_rs_bw::ply::{ElementDef, Encoding, Header, PropertyType, ScalarType};

/// Names of elements and properties.
pub(super) const VERTEX: &str = "vertex";
pub(super) const FACE: &str = "face";
pub(super) const AXES: [&str; 3] = ["x", "y", "z"];
pub(super) const NORMALS: [&str; 3] = ["nx", "ny", "nz"];
/// Names of texture coordinates that programs write.
pub(super) const TEXTURES: [[&str; 2]; 4] = [["s", "t"], ["u", "v"], ["texture_u", "texture_v"], ["s0", "t0"]];
/// Both are in use.
pub(super) const CORNERS: [&str; 2] = ["vertex_indices", "vertex_index"];

/// Shortest number of a text, with the space or end of line after it. The last one may lack that.
const TEXT_BYTES: u64 = 2;

/// What a head announces.
pub(super) struct Announced {
    pub(super) vertices: u64,
    /// Without them, the vertices are a cloud of points.
    pub(super) has_faces: bool,
    pub(super) has_normals: bool,
    pub(super) has_textures: bool,
}

/// Refuses a head without vertices, and one that announces more than `body_bytes` hold.
///
/// # Errors
/// The problem, for people.
pub(super) fn check(header: &Header, body_bytes: u64) -> Result<Announced, String> {
    let mut wanted_bytes = 0_u64;
    for element in header.elements.values() {
        if element.properties.is_empty() {
            return Err(format!(
                "its head announces {} elements without properties; export the part again",
                element.name
            ));
        }
        let bytes = (element.count as u64).saturating_mul(element_bytes(element, header.encoding));
        wanted_bytes = wanted_bytes.saturating_add(bytes);
    }
    let has_last_end = u64::from(header.encoding == Encoding::Ascii);
    if wanted_bytes > body_bytes + has_last_end {
        return Err(format!(
            "its head announces elements that take {wanted_bytes} bytes or more, but {body_bytes} follow it; is it cut short?"
        ));
    }
    let at = |name| header.elements.get_full(name).filter(|(_, _, element)| element.count > 0);
    let Some((first, _, vertex)) = at(VERTEX) else {
        return Err("it has no vertices; export the part again as a mesh".into());
    };
    if at(FACE).is_some_and(|(second, ..)| second < first) {
        return Err("its faces come before its vertices; export the part again".into());
    }
    for axis in AXES {
        if !matches!(property(vertex, axis), Some(PropertyType::Scalar(_))) {
            return Err(format!("its vertices have no number `{axis}`; export the part again"));
        }
    }
    if at(FACE).is_some_and(|(_, _, face)| !matches!(corners(face), Some(item) if !is_real(item))) {
        let [name, other] = CORNERS;
        return Err(format!("its faces have no list `{name}` or `{other}` of whole numbers; export the part again"));
    }
    let has = |name: &&str| matches!(property(vertex, name), Some(PropertyType::Scalar(_)));
    Ok(Announced {
        vertices: vertex.count as u64,
        has_faces: at(FACE).is_some(),
        has_normals: NORMALS.iter().all(has),
        has_textures: TEXTURES.iter().any(|names| names.iter().all(has)),
    })
}

/// Bytes of a corner of a face, at least.
pub(super) fn corner_bytes(header: &Header) -> u64 {
    let item = header.elements.get(FACE).and_then(corners);
    item.map_or(1, |item| number_bytes(item, header.encoding))
}

fn property<'a>(element: &'a ElementDef, name: &str) -> Option<&'a PropertyType> {
    element.properties.get(name).map(|property| &property.data_type)
}

/// The type of a corner's number.
fn corners(face: &ElementDef) -> Option<&ScalarType> {
    CORNERS.iter().find_map(|name| match property(face, name) {
        Some(PropertyType::List(_, item)) => Some(item),
        _ => None,
    })
}

fn is_real(number: &ScalarType) -> bool {
    matches!(number, ScalarType::Float | ScalarType::Double)
}

/// Bytes of an element, at least: lists may be empty.
fn element_bytes(element: &ElementDef, encoding: Encoding) -> u64 {
    let first = |data_type: &PropertyType| match data_type {
        PropertyType::Scalar(number) | PropertyType::List(number, _) => number_bytes(number, encoding),
    };
    element.properties.values().map(|property| first(&property.data_type)).sum()
}

fn number_bytes(number: &ScalarType, encoding: Encoding) -> u64 {
    match number {
        _ if encoding == Encoding::Ascii => TEXT_BYTES,
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    }
}
