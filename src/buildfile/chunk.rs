//! One chunk: up to [`CHUNK_STRUTS`] struts as a table of the nodes they share and columns that point into it.
//!
//! ```text
//! 0  u32 struts   4  u32 nodes   8  u8 flags   9  u8 × 7 widths: z y x low high radius_a radius_b
//! 16 i32 z_min    20 i32 y_min   24 i32 x_min  28 u32 radius_a_min   32 u32 radius_b_min
//! 36 columns: z y x (one value a node), low high radius_a [radius_b] [caps] (one value a strut)
//! ```

use super::columns;
use super::index::ChunkEntry;
use super::model::{Bounds, Cap, Caps, Header, Strut};

/// Most struts in one chunk. Few enough that node numbers fit two bytes and the index bounds the active set tightly, enough
/// that a chunk's own cost (40 bytes of index, 36 of head, the compressor's tables) vanishes.
pub const CHUNK_STRUTS: usize = 8192;

/// Most bytes of a chunk once unpacked: the format's own limit.
pub(super) const UNPACKED_LIMIT_BYTES: u32 = 1 << 20;

const HEAD_BYTES: usize = 36;
const FLAG_SECOND_RADIUS: u8 = 1;
const FLAG_CAPS: u8 = 2;
const CAPS: [Cap; 3] = [Cap::Sphere, Cap::Hemisphere, Cap::Butt];

/// Nodes in the file's order: z first, so that ascending nodes ascend in z.
pub(super) fn node_key(node: [i32; 3]) -> [i32; 3] {
    [node[2], node[1], node[0]]
}

/// Buffers of [`encode`] and [`decode`], kept from chunk to chunk.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    nodes: Vec<[i32; 3]>,
    column: Vec<u32>,
    second: Vec<u32>,
    third: Vec<u32>,
}

/// Packs `struts`, which are in file order and at most [`CHUNK_STRUTS`], into `out`.
pub(super) fn encode(struts: &[Strut], scratch: &mut Scratch, out: &mut Vec<u8>) {
    out.clear();
    let nodes = &mut scratch.nodes;
    nodes.clear();
    nodes.extend(struts.iter().flat_map(|strut| [node_key(strut.a), node_key(strut.b)]));
    nodes.sort_unstable();
    nodes.dedup();
    let number = |node| nodes.binary_search(&node_key(node)).unwrap_or_else(|place| place) as u32;

    let mut head = Head { struts: struts.len() as u32, nodes: nodes.len() as u32, ..Head::default() };
    let mut body = Vec::new();
    let mut add = |values: &mut dyn Iterator<Item = u32>| {
        scratch.column.clear();
        scratch.column.extend(values);
        let width = columns::width_bytes(&scratch.column);
        columns::push(&scratch.column, width, &mut body);
        width
    };
    for axis in 0..3 {
        let least = nodes.iter().map(|node| node[axis]).min().unwrap_or(0);
        head.node_min[axis] = least;
        let mut before = least;
        head.widths[axis] = add(&mut nodes.iter().map(|node| {
            let value = node[axis].abs_diff(before);
            if axis == 0 {
                before = node[axis];
            }
            value
        }));
    }
    let mut before = 0;
    head.widths[3] = add(&mut struts.iter().map(|strut| {
        let low = number(strut.a);
        let step = low - before;
        before = low;
        step
    }));
    head.widths[4] = add(&mut struts.iter().map(|strut| number(strut.b) - number(strut.a)));
    head.radius_min[0] = struts.iter().map(|strut| strut.radius_a).min().unwrap_or(0);
    head.widths[5] = add(&mut struts.iter().map(|strut| strut.radius_a - head.radius_min[0]));
    if struts.iter().any(|strut| strut.radius_a != strut.radius_b) {
        head.flags |= FLAG_SECOND_RADIUS;
        head.radius_min[1] = struts.iter().map(|strut| strut.radius_b).min().unwrap_or(0);
        head.widths[6] = add(&mut struts.iter().map(|strut| strut.radius_b - head.radius_min[1]));
    }
    if struts.iter().any(|strut| strut.caps != Caps::default()) {
        head.flags |= FLAG_CAPS;
        body.extend(struts.iter().map(|strut| strut.caps.a as u8 + 3 * strut.caps.b as u8));
    }
    head.write(out);
    out.extend_from_slice(&body);
}

/// Unpacks a chunk and appends its struts to `out`.
///
/// # Errors
/// A text that says how the bytes contradict themselves, their index entry or the file's header. `out` is as before then.
pub(super) fn decode(
    bytes: &[u8],
    header: &Header,
    entry: &ChunkEntry,
    scratch: &mut Scratch,
    out: &mut Vec<Strut>,
) -> Result<(), String> {
    let head = Head::read(bytes).ok_or("it is shorter than a chunk's head")?;
    if head.struts != entry.strut_count {
        return Err(format!("it holds {} struts, but the index says {}", head.struts, entry.strut_count));
    }
    if head.nodes == 0 || head.nodes > 2 * head.struts {
        return Err(format!("{} nodes for {} struts", head.nodes, head.struts));
    }
    if head.flags & !(FLAG_SECOND_RADIUS | FLAG_CAPS) != 0 {
        return Err(format!("unknown flags {:#x}", head.flags));
    }
    let first = out.len();
    let result = decode_columns(&head, &bytes[HEAD_BYTES..], header, scratch, out)
        .and_then(|()| check_against_index(&out[first..], entry));
    if result.is_err() {
        out.truncate(first);
    }
    result
}

fn decode_columns(
    head: &Head,
    mut bytes: &[u8],
    header: &Header,
    scratch: &mut Scratch,
    out: &mut Vec<Strut>,
) -> Result<(), String> {
    const SHORT: &str = "its columns are cut short";
    let Scratch { nodes, column, second, third } = scratch;
    let count = head.struts as usize;
    let columns = [&mut *column, &mut *second, &mut *third];
    for (axis, column) in columns.into_iter().enumerate() {
        bytes = columns::take(bytes, head.nodes as usize, head.widths[axis], column).ok_or(SHORT)?;
    }
    decode_nodes(head, &header.bounds, [column, second, third], nodes)?;

    bytes = columns::take(bytes, count, head.widths[3], column).ok_or(SHORT)?;
    bytes = columns::take(bytes, count, head.widths[4], second).ok_or(SHORT)?;
    bytes = columns::take(bytes, count, head.widths[5], third).ok_or(SHORT)?;
    check_radii(third, head.radius_min[0], header.radius_range)?;
    out.reserve(count);
    let first = out.len();
    let mut low = 0u32;
    for ((step, rise), radius) in column.iter().zip(&*second).zip(&*third) {
        low = low.saturating_add(*step);
        let ends = nodes.get(low as usize).zip(nodes.get(low.saturating_add(*rise) as usize));
        let (&a, &b) = ends.ok_or_else(|| format!("a strut names node {low} + {rise} of {}", nodes.len()))?;
        let radius = radius + head.radius_min[0];
        out.push(Strut { a, b, radius_a: radius, radius_b: radius, caps: Caps::default() });
    }
    if head.flags & FLAG_SECOND_RADIUS != 0 {
        bytes = columns::take(bytes, count, head.widths[6], third).ok_or(SHORT)?;
        check_radii(third, head.radius_min[1], header.radius_range)?;
        for (strut, radius) in out[first..].iter_mut().zip(&*third) {
            strut.radius_b = radius + head.radius_min[1];
        }
    }
    if head.flags & FLAG_CAPS != 0 {
        bytes = columns::take(bytes, count, 1, third).ok_or(SHORT)?;
        for (strut, &code) in out[first..].iter_mut().zip(&*third) {
            let cap = |code: u32| CAPS.get(code as usize).copied().ok_or(format!("unknown cap {code}"));
            strut.caps = Caps { a: cap(code % 3)?, b: cap(code / 3)? };
        }
    }
    if bytes.is_empty() { Ok(()) } else { Err(format!("{} bytes are left over", bytes.len())) }
}

/// Turns the three node columns (z as steps, y and x as offsets) into nodes inside `bounds`.
fn decode_nodes(
    head: &Head,
    bounds: &Bounds,
    columns: [&mut Vec<u32>; 3],
    nodes: &mut Vec<[i32; 3]>,
) -> Result<(), String> {
    let [z, y, x] = columns;
    let rise: u64 = z.iter().map(|&step| u64::from(step)).sum();
    let largest = |column: &[u32]| column.iter().copied().max().map_or(0, u64::from);
    for (axis, extent) in [(2, rise), (1, largest(y)), (0, largest(x))] {
        let least = i64::from(head.node_min[2 - axis]);
        // Neither sum can overflow: at most 16,384 steps below 2³² above an i32.
        let most = least + extent as i64;
        if least < i64::from(bounds.min[axis]) || most > i64::from(bounds.max[axis]) {
            let name = ["x", "y", "z"][axis];
            return Err(format!(
                "its nodes reach from {name} = {least} to {most} quanta, outside the header's bounds {} to {}",
                bounds.min[axis], bounds.max[axis]
            ));
        }
    }
    nodes.clear();
    let mut height = head.node_min[0];
    nodes.extend(z.iter().zip(&*y).zip(&*x).map(|((step, y), x)| {
        height = height.wrapping_add_unsigned(*step);
        [head.node_min[2].wrapping_add_unsigned(*x), head.node_min[1].wrapping_add_unsigned(*y), height]
    }));
    Ok(())
}

fn check_radii(offsets: &[u32], least: u32, range: [u32; 2]) -> Result<(), String> {
    let most = u64::from(least) + u64::from(offsets.iter().copied().max().unwrap_or(0));
    if least < range[0] || most > u64::from(range[1]) {
        return Err(format!("radii from {least} to {most} quanta, but the header says {} to {}", range[0], range[1]));
    }
    Ok(())
}

fn check_against_index(struts: &[Strut], entry: &ChunkEntry) -> Result<(), String> {
    let found = ChunkEntry::describe(struts);
    let said = ChunkEntry { offset: 0, packed_bytes: 0, unpacked_bytes: 0, crc: 0, ..*entry };
    if found == said {
        return Ok(());
    }
    Err(format!(
        "it holds {} balls and z from {}..{} to {} quanta, but the index says {} balls and {}..{} to {}",
        found.ball_count,
        found.z_low_min,
        found.z_low_max,
        found.z_high_max,
        said.ball_count,
        said.z_low_min,
        said.z_low_max,
        said.z_high_max
    ))
}

#[derive(Default)]
struct Head {
    struts: u32,
    nodes: u32,
    flags: u8,
    widths: [u8; 7],
    /// z, y, x.
    node_min: [i32; 3],
    radius_min: [u32; 2],
}

impl Head {
    fn write(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.struts.to_le_bytes());
        out.extend_from_slice(&self.nodes.to_le_bytes());
        out.push(self.flags);
        out.extend_from_slice(&self.widths);
        self.node_min.iter().for_each(|value| out.extend_from_slice(&value.to_le_bytes()));
        self.radius_min.iter().for_each(|value| out.extend_from_slice(&value.to_le_bytes()));
    }

    fn read(bytes: &[u8]) -> Option<Self> {
        let head = bytes.first_chunk::<HEAD_BYTES>()?;
        let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
        let mut widths = [0; 7];
        widths.copy_from_slice(&head[9..16]);
        Some(Self {
            struts: word(0),
            nodes: word(4),
            flags: head[8],
            widths,
            node_min: [16, 20, 24].map(|at| word(at) as i32),
            radius_min: [word(28), word(32)],
        })
    }
}
