//! Progress of [`pack`](super::pack).

/// A step of packing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PackProgress {
    /// Comes before a source if its struts and triangles, together with those of earlier sources, may not fit memory.
    Space {
        /// Temporary space needed in the directory of the build file, at most, without what earlier sources have taken.
        temporary_bytes: u64,
        /// Size of the build file, about.
        output_bytes: u64,
        /// Free space in that directory.
        free_bytes: u64,
    },
    /// Sources are being read for the first time, to find out how large the part is. Happens only if its size is given.
    Measuring {
        /// Bytes read.
        done: u64,
        /// Bytes in total.
        total: u64,
    },
    /// Sources are being read.
    Reading {
        /// Bytes read.
        done: u64,
        /// Bytes in total.
        total: u64,
    },
    /// Sorted runs are being merged into longer ones. Happens only if there is little memory for so many struts or triangles.
    Joining {
        /// Bytes merged.
        done: u64,
        /// Bytes in total.
        total: u64,
    },
    /// The build file is being written.
    Writing {
        /// Struts and triangles written.
        done: u64,
        /// Struts and triangles in total.
        total: u64,
    },
}
