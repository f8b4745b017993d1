//! What surfaces enclose more than once. Around them is put a box that is turned inside out: what is still solid then has a winding number
//! above 1. `inspection` draws it; `tests/surface/inspected.rs` tests it.

use std::sync::Arc;

use super::BodySource;
use super::body::source::{BodyPrimitive, ChunkSource, ChunkSpan};
use crate::buildfile::{Bounds, BuildFile, Corner, MapHeader, Patch, QUANTUM_FRACTIONS, Relief, Surface, Triangle};
use crate::solid::HeightMap;

/// How far the box lies from the bounds, micrometres: facets may leave them by some micrometres, or by the height of a texel.
const ROOM_UM: f64 = 1000.0;

/// Sides of the box, upright triangles. It needs no top and no bottom: a plane cuts only its sides.
const SIDES: usize = 8;

/// A body of which only what its surface encloses more than once is solid; `None` of a lattice, and of a shell, whose sides may overlap
/// anywhere.
pub(super) fn enclosed_twice(body: BodySource) -> Option<BodySource> {
    Some(match body {
        BodySource::Surface(source) => {
            let Surface { bounds, .. } = source.header().clone();
            let room = room(source.quantum_um());
            let sides = sides(&bounds, [bounds.min[2] - room, bounds.max[2] + room], room);
            let sides = sides.map(|corners| Triangle::new(corners.map(|corner| corner.map(fractions)))).to_vec();
            BodySource::Surface(Box::new(InBox { source, sides }))
        }
        BodySource::Relief(source) => {
            let Relief { bounds, z_reach: [low, high], shell_um, .. } = source.header().clone();
            if shell_um > 0.0 {
                return None;
            }
            let corner = |at: [i32; 3]| Corner { at: at.map(fractions), direction: [0; 3], texture: [0; 2], factor: 0 };
            let room = room(source.quantum_um());
            let z = [low - room, high + room];
            let patch = |corners: [[i32; 3]; 3]| Patch {
                z: [z[0] - 1, z[1] + 1],
                corners: corners.map(corner),
                displacement: 0,
                seams: 0,
            };
            let sides = sides(&bounds, z, room).map(patch).to_vec();
            BodySource::Relief(Box::new(InBox { source, sides }))
        }
        BodySource::Lattice(_) | BodySource::Joined(_) | BodySource::Clipped { .. } => return None,
    })
}

/// How far the box lies from the bounds, quanta.
fn room(quantum_um: f64) -> i32 {
    // At least a few quanta, because bounds are rounded; the cast saturates.
    ((ROOM_UM / quantum_um).ceil() as i32).clamp(4, 1 << 29)
}

fn fractions(quanta: i32) -> i64 {
    i64::from(quanta) * QUANTUM_FRACTIONS
}

/// The upright sides of a box around bounds, each as two triangles that are seen from inside. Each triangle reaches down to the lower end.
fn sides(bounds: &Bounds, [low, high]: [i32; 2], room: i32) -> [[[i32; 3]; 3]; SIDES] {
    let [x, y] = [0, 1].map(|axis| [bounds.min[axis] - room, bounds.max[axis] + room]);
    // Counter-clockwise, seen from above.
    let corners = [[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]];
    std::array::from_fn(|number| {
        let ([ax, ay], [bx, by]) = (corners[number / 2], corners[(number / 2 + 1) % 4]);
        match number % 2 {
            0 => [[ax, ay, low], [bx, by, high], [bx, by, low]],
            _ => [[ax, ay, low], [ax, ay, high], [bx, by, high]],
        }
    })
}

/// The primitives of a source, and the sides of a box, which are the first chunk.
struct InBox<P: BodyPrimitive> {
    source: Box<dyn ChunkSource<P>>,
    sides: Vec<P>,
}

impl<P: BodyPrimitive> ChunkSource<P> for InBox<P> {
    fn header(&self) -> &P::Header {
        self.source.header()
    }

    fn quantum_um(&self) -> f64 {
        self.source.quantum_um()
    }

    fn chunk_count(&self) -> usize {
        self.source.chunk_count() + 1
    }

    fn chunk_primitives(&self) -> usize {
        self.source.chunk_primitives().max(SIDES)
    }

    fn chunk_span(&self, chunk: usize) -> ChunkSpan {
        match chunk.checked_sub(1) {
            Some(chunk) => self.source.chunk_span(chunk),
            None => {
                let [lowest_z, highest_z] = self.sides[0].z_range();
                ChunkSpan { lowest_z, highest_z }
            }
        }
    }

    fn peak_active(&self) -> u64 {
        self.source.peak_active() + SIDES as u64
    }

    fn file(&self) -> Option<&Arc<BuildFile>> {
        self.source.file()
    }

    fn memory_bytes(&self) -> u64 {
        self.source.memory_bytes() + (size_of::<Self>() + SIDES * size_of::<P>()) as u64
    }

    fn read_chunk(&self, chunk: usize, primitives: &mut Vec<P>) -> anyhow::Result<()> {
        match chunk.checked_sub(1) {
            Some(chunk) => self.source.read_chunk(chunk, primitives),
            None => {
                primitives.clear();
                primitives.extend_from_slice(&self.sides);
                Ok(())
            }
        }
    }

    fn read_maps(&self, level: &dyn Fn(&MapHeader) -> u8) -> anyhow::Result<Vec<Arc<HeightMap>>> {
        self.source.read_maps(level)
    }
}
