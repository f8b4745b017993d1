//! Struts and balls as primitives. `tests/buildfile.rs` writes and reads them.

mod chunk;
mod key;

use super::{Primitive, Scratch, Sortable, Unpacked};
use crate::buildfile::model::{Lattice, Strut};
use key::{SharedKey, StrutKey};

/// Size of a strut in a build file, bytes: the most that large files take in practice.
pub(in crate::buildfile) const EXPECTED_STRUT_BYTES: u64 = 10;

impl Primitive for Strut {
    type Body = Lattice;

    /// So many take 288 KiB: a chunk is decoded within a level-2 cache, and the index bounds the active set closely.
    const CHUNK_PRIMITIVES: usize = 8192;

    const SCRATCH_BYTES: usize = size_of::<[i32; 3]>() + chunk::COLUMNS * size_of::<u32>();

    fn z_range(&self) -> [i32; 2] {
        [self.a[2], self.b[2]]
    }

    fn is_ball(&self) -> bool {
        Self::is_ball(self)
    }

    fn encode(struts: &[Self], out: &mut Unpacked) {
        chunk::encode(struts, out);
    }

    fn decode(
        bytes: &[u8],
        count: u32,
        lattice: &Lattice,
        scratch: &mut Scratch,
        out: &mut Vec<Self>,
    ) -> Result<(), String> {
        chunk::decode(bytes, count, lattice, scratch, out)
    }
}

impl Sortable for Strut {
    type Key = StrutKey;

    fn key(&self) -> StrutKey {
        StrutKey::of(self)
    }

    fn of_key(key: &StrutKey) -> Self {
        key.strut()
    }
}

/// A strut of which a part may be of another material, as the sort takes it. Others take less memory.
#[derive(Clone, Copy, Debug)]
pub(in crate::buildfile) struct SharedStrut(pub(in crate::buildfile) Strut);

impl Sortable for SharedStrut {
    type Key = SharedKey;

    fn key(&self) -> SharedKey {
        SharedKey::of(&self.0)
    }

    fn of_key(key: &SharedKey) -> Self {
        Self(key.strut())
    }
}
