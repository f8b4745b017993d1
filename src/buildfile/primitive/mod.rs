//! What a body is made of, as sorting and chunks see it: values of a fixed size, ordered by their lowest z.
//!
//! `store` is generic over [`Primitive`], `sort` over [`Sortable`]. A new kind of body brings a key to sort by and columns to store; the external
//! sort, compression, the index and reading stay as they are. Struts ([`strut`]), triangles ([`triangle`]) and patches ([`patch`]) are such primitives. The unit
//! tests in `sort` and `store/chunker.rs` show how they are used.

mod columns;
mod corners;
mod patch;
mod strut;
pub(super) mod triangle;

use std::fmt::Debug;

pub(super) use columns::{Scratch, Unpacked};
pub(super) use patch::EXPECTED_PATCH_BYTES;
pub(super) use strut::{EXPECTED_STRUT_BYTES, SharedStrut};
pub(super) use triangle::EXPECTED_TRIANGLE_BYTES;

/// One element of a body, in quanta.
pub(super) trait Primitive: Copy + Debug + Send + 'static {
    /// What the header says of a body of these primitives.
    type Body;

    /// How many a chunk has when it is written, but for the last of a body. A chunk that is read may have up to
    /// [`MAX_CHUNK_PRIMITIVES`](super::MAX_CHUNK_PRIMITIVES).
    const CHUNK_PRIMITIVES: usize;

    /// Bytes of [`Scratch`] for each primitive of a chunk while [`Primitive::decode`] reads it.
    const SCRATCH_BYTES: usize;

    /// Lowest and highest z of the points that define it.
    fn z_range(&self) -> [i32; 2];

    /// Whether it is a ball. The index counts balls separately.
    fn is_ball(&self) -> bool {
        false
    }

    /// Lays out the primitives of one chunk, which are in file order, in `out`, which is empty.
    fn encode(primitives: &[Self], out: &mut Unpacked);

    /// Appends the `count` primitives of a chunk to `out`. Checks everything that `body` says of a single primitive.
    ///
    /// # Errors
    /// A text that says how the bytes contradict themselves, `count` or `body`. `out` may then hold some of the primitives.
    fn decode(
        bytes: &[u8],
        count: u32,
        body: &Self::Body,
        scratch: &mut Scratch,
        out: &mut Vec<Self>,
    ) -> Result<(), String>;
}

/// A primitive of which there may be more than fit memory.
pub(super) trait Sortable: Copy + Debug + Send + 'static {
    /// The primitive as the sort keeps it. Keys are ordered as the primitives are in a file: by lowest z first.
    type Key: Key;

    /// The key, from which [`Sortable::of_key`] makes the same primitive again.
    fn key(&self) -> Self::Key;

    /// The primitive of a key.
    fn of_key(key: &Self::Key) -> Self;
}

/// A primitive as a record of the external sort, in memory and in temporary files.
pub(super) trait Key: Copy + Ord + Debug + Send + 'static {
    /// Bytes of a record in a temporary file.
    const BYTES: usize;

    /// Greater than the key of every primitive.
    const END: Self;

    /// Appends the [`Key::BYTES`] bytes of the record.
    fn append_to(self, bytes: &mut Vec<u8>);

    /// The record of [`Key::BYTES`] bytes.
    ///
    /// # Panics
    /// If there are more or fewer bytes.
    fn from_bytes(bytes: &[u8]) -> Self;
}
