//! The bodies of a part, and the threads that draw them. `slicer` draws their pixels, `scan/contours.rs` their field.

use std::sync::Arc;

use super::body::Body;
use super::workers::Workers;
use super::{SliceError, Slicer};
use crate::buildfile::BuildFile;
use crate::solid::Effort;
use crate::stream::{Charge, MemoryBudget};

/// Bodies that are all drawn in the same way: `B` is a trait object.
pub(super) struct Bodies<B: Body + ?Sized> {
    bodies: Vec<Box<B>>,
    workers: Workers,
    _files: Charge,
}

impl<B: Body + ?Sized> Bodies<B> {
    /// The bodies that `body` makes of the sources, and `threads` threads. Their memory is charged to `budget`, and `file_bytes` for the files
    /// that they are read from.
    ///
    /// # Errors
    /// [`SliceError`] if the memory is not free, a body cannot be drawn or `threads` is out of range.
    pub(super) fn new<S>(
        sources: Vec<S>,
        file_bytes: u64,
        threads: usize,
        budget: &MemoryBudget,
        mut body: impl FnMut(S) -> Result<Box<B>, SliceError>,
    ) -> Result<Self, SliceError> {
        if !(1..=Slicer::MAX_THREADS).contains(&threads) {
            return Err(SliceError::BadThreads { threads, max: Slicer::MAX_THREADS });
        }
        let files = budget.charge("the open build file", file_bytes)?;
        let bodies: Result<_, _> = sources.into_iter().map(&mut body).collect();
        Ok(Self { bodies: bodies?, workers: Workers::new(threads)?, _files: files })
    }

    /// Moves the plane of all bodies up to `z_um`, micrometres. It never moves down.
    ///
    /// # Errors
    /// As [`Body::advance`].
    pub(super) fn advance(&mut self, z_um: f64) -> Result<(), SliceError> {
        self.bodies.iter_mut().try_for_each(|body| body.advance(z_um, &self.workers))
    }

    /// Most rows in a band that the brushes of all bodies take; `None` if there are no bodies.
    pub(super) fn rows_per_band(&self) -> Option<usize> {
        self.bodies.iter().map(|body| body.rows_per_band()).min()
    }

    /// The bodies and the threads.
    pub(super) fn parts(&mut self) -> (&mut [Box<B>], &Workers) {
        (&mut self.bodies, &self.workers)
    }

    /// Number of primitives within reach of the plane.
    pub(super) fn active_count(&self) -> usize {
        self.bodies.iter().map(|body| body.active_count()).sum()
    }

    /// Work since the bodies were made.
    pub(super) fn effort(&self) -> Effort {
        self.bodies.iter().map(|body| body.effort()).sum()
    }
}

/// Memory of the open build files, each counted once, and of what `threads` threads need to read their chunks, bytes.
pub(super) fn file_bytes<'a>(read: impl IntoIterator<Item = &'a Arc<BuildFile>>, threads: usize) -> u64 {
    let mut files: Vec<&Arc<BuildFile>> = Vec::new();
    for file in read {
        if !files.iter().any(|known| Arc::ptr_eq(known, file)) {
            files.push(file);
        }
    }
    files.into_iter().map(|file| (file.memory_bytes() + threads * file.scratch_bytes()) as u64).sum()
}
