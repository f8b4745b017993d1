//! What a pack tells of its progress.

/// How far packing has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PackProgress {
    /// Said before each source whose struts, with those of the sources before it, may not fit memory.
    Space {
        /// Temporary space needed beside the build file, at most; without what the sources before it have taken.
        temporary_bytes: u64,
        /// Space needed for the build file itself, about.
        output_bytes: u64,
        /// Space that is free there.
        free_bytes: u64,
    },
    /// Source bytes read, of all.
    Reading {
        /// Bytes read.
        done: u64,
        /// Bytes in all.
        total: u64,
    },
    /// Bytes of sorted runs joined to longer ones, of all: only where memory is little for so many struts.
    Joining {
        /// Bytes joined.
        done: u64,
        /// Bytes in all.
        total: u64,
    },
    /// Struts written, of all.
    Writing {
        /// Struts written.
        done: u64,
        /// Struts in all.
        total: u64,
    },
}
