//! The layout of a chunk of struts: a table of their lower nodes, and for each strut the offset to its upper node.
//!
//! Struts are short, so offsets take few bytes. In a large part a chunk is a thin slice, and few struts of it share an upper node: a
//! table of both ends would hold most upper nodes once for each strut.
//!
//! ```text
//! 0  u32 struts   4  u32 nodes   8  u8 flags   9  u8 × 9 widths: z y x node dz dy dx radius_a radius_b
//! 18 i32 z_min    22 i32 y_min   26 i32 x_min  30 u32 radius_a_min   34 u32 radius_b_min
//! 38 columns: z y x (one value for each lower node), node dz dy dx radius_a [radius_b] [caps] [share_a share_b] (one value for each strut)
//! ```

use crate::buildfile::materials::Shares;
use crate::buildfile::model::{Bounds, Cap, Caps, Lattice, Strut, node_key};
use crate::buildfile::primitive::columns::{self, Scratch, Unpacked};

/// Columns decoded at once.
pub(super) const COLUMNS: usize = 5;

const HEAD_BYTES: usize = 38;
const FLAG_SECOND_RADIUS: u8 = 1;
const FLAG_CAPS: u8 = 2;
const FLAG_SHARES: u8 = 4;
/// Bytes of a share.
const SHARE_WIDTH: u8 = 2;
const CAPS: [Cap; 3] = [Cap::Sphere, Cap::Hemisphere, Cap::Butt];

/// As [`Primitive::encode`](super::Primitive::encode).
pub(super) fn encode(struts: &[Strut], out: &mut Unpacked) {
    out.bytes.resize(HEAD_BYTES, 0);
    let nodes = || struts.chunk_by(|one, next| one.a == next.a).map(|group| node_key(group[0].a));
    let mut head = Head { struts: struts.len() as u32, nodes: nodes().count() as u32, ..Head::default() };
    for axis in 0..3 {
        let least = nodes().map(|node| node[axis]).min().unwrap_or(0);
        head.node_min[axis] = least;
        let mut before = least;
        head.widths[axis] = out.add(nodes().map(|node| {
            let value = node[axis].abs_diff(before);
            if axis == 0 {
                before = node[axis];
            }
            value
        }));
    }
    let mut before = struts.first().map(|strut| strut.a);
    head.widths[3] = out.add(struts.iter().map(|strut| u32::from(before.replace(strut.a) != Some(strut.a))));
    head.widths[4] = out.add(struts.iter().map(|strut| strut.a[2].abs_diff(strut.b[2])));
    for axis in [1, 0] {
        let offset = |strut: &Strut| columns::zigzag(strut.b[axis].wrapping_sub(strut.a[axis]));
        head.widths[6 - axis] = out.add(struts.iter().map(offset));
    }
    head.radius_min[0] = struts.iter().map(|strut| strut.radius_a).min().unwrap_or(0);
    head.widths[7] = out.add(struts.iter().map(|strut| strut.radius_a - head.radius_min[0]));
    if struts.iter().any(|strut| strut.radius_a != strut.radius_b) {
        head.flags |= FLAG_SECOND_RADIUS;
        head.radius_min[1] = struts.iter().map(|strut| strut.radius_b).min().unwrap_or(0);
        head.widths[8] = out.add(struts.iter().map(|strut| strut.radius_b - head.radius_min[1]));
    }
    if struts.iter().any(|strut| strut.caps != Caps::default()) {
        head.flags |= FLAG_CAPS;
        out.planes.push(out.bytes.len());
        out.bytes.extend(struts.iter().map(|strut| strut.caps.a as u8 + 3 * strut.caps.b as u8));
    }
    if struts.iter().any(|strut| strut.shares != Shares::default()) {
        head.flags |= FLAG_SHARES;
        out.add_wide(struts.iter().map(|strut| strut.shares.a.into()), SHARE_WIDTH);
        out.add_wide(struts.iter().map(|strut| strut.shares.b.into()), SHARE_WIDTH);
    }
    out.bytes[..HEAD_BYTES].copy_from_slice(&head.to_bytes());
}

/// As [`Primitive::decode`](super::Primitive::decode).
pub(super) fn decode(
    bytes: &[u8],
    count: u32,
    lattice: &Lattice,
    scratch: &mut Scratch,
    out: &mut Vec<Strut>,
) -> Result<(), String> {
    let head = Head::read(bytes).ok_or("it is shorter than a chunk's head")?;
    if head.struts != count {
        return Err(format!("it holds {} struts, but the index says {count}", head.struts));
    }
    if head.nodes == 0 || head.nodes > head.struts {
        return Err(format!("{} nodes for {} struts", head.nodes, head.struts));
    }
    if head.flags & !(FLAG_SECOND_RADIUS | FLAG_CAPS | FLAG_SHARES) != 0 {
        return Err(format!("unknown flags {:#x}", head.flags));
    }
    decode_columns(&head, &bytes[HEAD_BYTES..], lattice, scratch, out)
}

fn decode_columns(
    head: &Head,
    mut bytes: &[u8],
    lattice: &Lattice,
    scratch: &mut Scratch,
    out: &mut Vec<Strut>,
) -> Result<(), String> {
    const SHORT: &str = "its columns are cut short";
    let Scratch { nodes, columns } = scratch;
    for (column, width) in columns.iter_mut().zip(&head.widths[..3]) {
        bytes = columns::take(bytes, head.nodes as usize, *width, column).ok_or(SHORT)?;
    }
    let [z, y, x, ..] = columns;
    decode_nodes(head, &lattice.bounds, [z, y, x], nodes)?;

    let (count, first) = (head.struts as usize, out.len());
    for (column, width) in columns.iter_mut().zip(&head.widths[3..8]) {
        bytes = columns::take(bytes, count, *width, column).ok_or(SHORT)?;
    }
    let [step, dz, dy, dx, radius, ..] = columns;
    check_radii(radius, head.radius_min[0], lattice.radius_range)?;
    join(nodes, [step, dz, dy, dx, radius], head.radius_min[0], &lattice.bounds, out)?;
    if head.flags & FLAG_SECOND_RADIUS != 0 {
        bytes = columns::take(bytes, count, head.widths[8], radius).ok_or(SHORT)?;
        check_radii(radius, head.radius_min[1], lattice.radius_range)?;
        for (strut, radius) in out[first..].iter_mut().zip(&*radius) {
            strut.radius_b = radius + head.radius_min[1];
            if strut.is_ball() && strut.radius_a != strut.radius_b {
                return Err(format!("a ball of radii {} and {} quanta", strut.radius_a, strut.radius_b));
            }
        }
    }
    if head.flags & FLAG_CAPS != 0 {
        bytes = columns::take(bytes, count, 1, step).ok_or(SHORT)?;
        for (strut, &code) in out[first..].iter_mut().zip(&*step) {
            let cap = |code: u32| CAPS.get(code as usize).copied().ok_or(format!("unknown cap {code}"));
            strut.caps = Caps { a: cap(code % 3)?, b: cap(code / 3)? };
        }
    }
    if head.flags & FLAG_SHARES != 0 {
        bytes = columns::take(bytes, count, SHARE_WIDTH, step).ok_or(SHORT)?;
        bytes = columns::take(bytes, count, SHARE_WIDTH, dz).ok_or(SHORT)?;
        for (strut, (a, b)) in out[first..].iter_mut().zip(step.iter().zip(&*dz)) {
            // Two bytes fit.
            strut.shares = Shares { a: *a as u16, b: *b as u16 };
            if strut.is_ball() && a != b {
                return Err(format!("a ball with shares {a} and {b} of its material"));
            }
        }
        if !lattice.is_graded && out[first..].iter().any(|strut| strut.shares != Shares::default()) {
            return Err(
                "it has struts of which a part is of another material, but the header says that there are none".into(),
            );
        }
    }
    if bytes.is_empty() { Ok(()) } else { Err(format!("{} bytes are left over", bytes.len())) }
}

/// Turns the three node columns (z as steps, y and x as offsets) into nodes inside `bounds`.
fn decode_nodes(head: &Head, bounds: &Bounds, columns: [&[u32]; 3], nodes: &mut Vec<[i32; 3]>) -> Result<(), String> {
    let [z, y, x] = columns;
    let rise: u64 = z.iter().map(|&step| u64::from(step)).sum();
    let largest = |column: &[u32]| column.iter().copied().max().map_or(0, u64::from);
    for (axis, extent) in [(2, rise), (1, largest(y)), (0, largest(x))] {
        let least = i64::from(head.node_min[2 - axis]);
        // The sum cannot overflow: at most 8192 steps below 2³² above an i32.
        check_reach(axis, least, least + extent as i64, bounds)?;
    }
    nodes.clear();
    nodes.reserve_exact(z.len());
    let mut height = head.node_min[0];
    nodes.extend(z.iter().zip(y).zip(x).map(|((step, y), x)| {
        height = height.wrapping_add_unsigned(*step);
        [head.node_min[2].wrapping_add_unsigned(*x), head.node_min[1].wrapping_add_unsigned(*y), height]
    }));
    Ok(())
}

/// Joins lower nodes and columns (step of the lower node's number, offsets dz, dy, dx, radius) to struts inside `bounds`.
fn join(
    nodes: &[[i32; 3]],
    columns: [&[u32]; 5],
    radius_min: u32,
    bounds: &Bounds,
    out: &mut Vec<Strut>,
) -> Result<(), String> {
    let [step, dz, dy, dx, radius] = columns;
    let last: u64 = step.iter().map(|&step| u64::from(step)).sum();
    if last >= nodes.len() as u64 {
        return Err(format!("a strut begins at node {last} of {}", nodes.len()));
    }
    let (mut least, mut most, mut top) = ([i32::MAX; 2], [i32::MIN; 2], i64::MIN);
    let mut node = 0;
    out.reserve(step.len());
    // A loop, as sums that a closure keeps stay in memory.
    for ((((step, dz), dy), dx), radius) in step.iter().zip(dz).zip(dy).zip(dx).zip(radius) {
        node += *step as usize;
        let a = nodes[node];
        let [x, y] = [a[0].wrapping_add(columns::unzigzag(*dx)), a[1].wrapping_add(columns::unzigzag(*dy))];
        least = [least[0].min(x), least[1].min(y)];
        most = [most[0].max(x), most[1].max(y)];
        top = top.max(i64::from(a[2]) + i64::from(*dz));
        let b = [x, y, a[2].wrapping_add_unsigned(*dz)];
        let radius = radius.wrapping_add(radius_min);
        out.push(Strut { a, b, radius_a: radius, radius_b: radius, caps: Caps::default(), shares: Shares::default() });
    }
    for axis in 0..2 {
        check_reach(axis, least[axis].into(), most[axis].into(), bounds)?;
    }
    check_reach(2, i64::from(bounds.min[2]), top, bounds)
}

fn check_reach(axis: usize, least: i64, most: i64, bounds: &Bounds) -> Result<(), String> {
    if least >= i64::from(bounds.min[axis]) && most <= i64::from(bounds.max[axis]) {
        return Ok(());
    }
    let name = ["x", "y", "z"][axis];
    Err(format!(
        "its nodes reach from {name} = {least} to {most} quanta, outside the header's bounds {} to {}",
        bounds.min[axis], bounds.max[axis]
    ))
}

fn check_radii(offsets: &[u32], least: u32, range: [u32; 2]) -> Result<(), String> {
    let most = u64::from(least) + u64::from(offsets.iter().copied().max().unwrap_or(0));
    if least < range[0] || most > u64::from(range[1]) {
        return Err(format!("radii from {least} to {most} quanta, but the header says {} to {}", range[0], range[1]));
    }
    Ok(())
}

#[derive(Default)]
struct Head {
    struts: u32,
    nodes: u32,
    flags: u8,
    /// z, y, x, node, dz, dy, dx, radius a, radius b.
    widths: [u8; 9],
    /// z, y, x.
    node_min: [i32; 3],
    radius_min: [u32; 2],
}

impl Head {
    fn to_bytes(&self) -> [u8; HEAD_BYTES] {
        let mut bytes = [0; HEAD_BYTES];
        bytes[8] = self.flags;
        bytes[9..18].copy_from_slice(&self.widths);
        let words = [(0, self.struts), (4, self.nodes), (30, self.radius_min[0]), (34, self.radius_min[1])];
        let nodes = [18, 22, 26].into_iter().zip(self.node_min.map(|value| value as u32));
        for (at, word) in words.into_iter().chain(nodes) {
            bytes[at..at + 4].copy_from_slice(&word.to_le_bytes());
        }
        bytes
    }

    fn read(bytes: &[u8]) -> Option<Self> {
        let head = bytes.first_chunk::<HEAD_BYTES>()?;
        let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
        let mut widths = [0; 9];
        widths.copy_from_slice(&head[9..18]);
        Some(Self {
            struts: word(0),
            nodes: word(4),
            flags: head[8],
            widths,
            node_min: [18, 22, 26].map(|at| word(at) as i32),
            radius_min: [word(30), word(34)],
        })
    }
}
