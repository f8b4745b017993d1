//! A stand-in for the largest published lattice as edge text, written in a stream: nothing of it is held in memory.
//!
//! Nodes stand on a face-centred cubic grid, each moved by up to a quarter of a grid step along each axis, and are joined to
//! their 12 neighbours. So struts are 0.35 mm long on average, 10 pixels of 35 µm, and there are 6 of them for a node. Places
//! and radii are hashes of grid place and strut number, and lines are shuffled over the whole file by a cipher on the numbers
//! from 0 to the count.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Half the edge of a cubic cell, tenths of a micrometre: nearest neighbours are √2 of it apart.
const STEP: i64 = 2475;

/// Half of the twelve neighbours of a node, in grid steps; the other half has these nodes as its neighbours.
const NEIGHBOURS: [[i64; 3]; 6] = [[1, 1, 0], [-1, 1, 0], [1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]];

/// Least radius, tenths of a micrometre, and how many there are: 21 to 63 µm, 1.2 pixels on average.
const RADII: [u64; 2] = [210, 420];

/// Writes `struts` lines to `path`.
///
/// # Errors
/// Where the file cannot be written.
pub(crate) fn write(path: &Path, struts: u64) -> io::Result<()> {
    let mut out = BufWriter::with_capacity(1 << 20, File::create(path)?);
    writeln!(out, "{struts} 0.04 0.1 0")?;
    let shuffle = Shuffle::new(struts);
    // Half as many nodes along x as grid steps: every second grid place is a node.
    let edge = (struts as f64 / 6.0 * 2.0).cbrt().ceil().max(2.0) as u64 / 2 * 2;
    let mut line = Vec::with_capacity(128);
    for number in 0..struts {
        let strut = shuffle.place(number);
        let (place, neighbour) = (strut / 6, NEIGHBOURS[(strut % 6) as usize]);
        let (i, j, k) = (place % (edge / 2), place / (edge / 2) % edge, place / (edge / 2) / edge);
        let from = [(2 * i + (j + k) % 2) as i64, j as i64, k as i64];
        let to = [0, 1, 2].map(|axis| from[axis] + neighbour[axis]);
        line.clear();
        for value in node(from).into_iter().chain(node(to)) {
            decimal(value, &mut line);
            line.push(b' ');
        }
        decimal(RADII[0] + mix(strut) % RADII[1], &mut line);
        line.push(b'\n');
        out.write_all(&line)?;
    }
    out.flush()
}

/// Where the node of a grid place stands, tenths of a micrometre.
fn node(place: [i64; 3]) -> [u64; 3] {
    let hash = mix(place.iter().fold(0, |hash, &at| mix(hash ^ at as u64)));
    [0, 1, 2].map(|axis| {
        let jitter = ((hash >> (20 * axis) & 0xf_ffff) as i64 * (STEP / 2)) >> 20;
        // A neighbour may stand one step below the first.
        ((place[axis] + 1) * STEP + jitter) as u64
    })
}

/// Appends `value` / 10,000 with four decimals.
fn decimal(value: u64, line: &mut Vec<u8>) {
    let mut digits = [b'0'; 20];
    let (mut at, mut left) = (digits.len(), value);
    while left > 0 || at > digits.len() - 5 {
        at -= 1;
        digits[at] = b'0' + (left % 10) as u8;
        left /= 10;
    }
    let (whole, decimals) = digits[at..].split_at(digits.len() - at - 4);
    line.extend_from_slice(whole);
    line.push(b'.');
    line.extend_from_slice(decimals);
}

/// A permutation of the numbers below a count: four rounds of a Feistel network over the next power of four, walked until the
/// number is below the count (Black & Rogaway 2002).
struct Shuffle {
    count: u64,
    half_bits: u32,
}

impl Shuffle {
    fn new(count: u64) -> Self {
        Self { count, half_bits: (64 - count.leading_zeros()).div_ceil(2).max(1) }
    }

    fn place(&self, mut number: u64) -> u64 {
        let mask = (1 << self.half_bits) - 1;
        loop {
            let (mut left, mut right) = (number >> self.half_bits, number & mask);
            for round in 0..4 {
                (left, right) = (right, left ^ mix(right ^ round << 60) & mask);
            }
            number = left << self.half_bits | right;
            if number < self.count {
                return number;
            }
        }
    }
}

/// The output function of SplitMix64 (Steele, Lea & Flood 2014).
fn mix(state: u64) -> u64 {
    let mut z = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ z >> 31
}
