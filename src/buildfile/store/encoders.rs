//! Threads that lay out and compress chunks. Chunks come back in the order in which they were sent. `chunker` uses them.

use std::io;
use std::num::NonZero;

use crossbeam::channel::{Receiver, Sender, bounded};

use super::chunk::MAX_UNPACKED_BYTES;
use super::index::ChunkEntry;
use super::packer::Packer;
use crate::buildfile::primitive::{Primitive, Unpacked};

/// Chunks sent to a thread and not yet received back: one being compressed and one queued, so that the thread does not wait for the
/// writer.
const MAX_CHUNKS_PER_THREAD: usize = 2;

/// Most threads: merging and handing out a chunk takes about as long as compressing one, so more threads would idle.
const MAX_THREADS: usize = 4;

/// A compressed chunk.
pub(super) struct Encoded<P> {
    /// Its index entry; offset and body are still 0.
    pub(super) entry: ChunkEntry,
    pub(super) packed: Vec<u8>,
    /// The primitives, returned so that their buffer can be used again.
    pub(super) primitives: Vec<P>,
}

/// The threads. They end when this is dropped.
pub(super) struct Encoders<P> {
    threads: Vec<Ends<P>>,
    sent: usize,
    received: usize,
}

/// The ends of one thread's queues.
struct Ends<P> {
    jobs: Sender<Vec<P>>,
    encoded: Receiver<io::Result<Encoded<P>>>,
}

impl<P: Primitive> Encoders<P> {
    /// Starts `count` threads, at most [`MAX_THREADS`].
    ///
    /// # Errors
    /// If a thread cannot be started.
    pub(super) fn new(count: NonZero<usize>) -> io::Result<Self> {
        let threads = (0..count.get().min(MAX_THREADS)).map(|_| start()).collect::<io::Result<_>>()?;
        Ok(Self { threads, sent: 0, received: 0 })
    }

    /// Whether a chunk must be received before another may be sent.
    pub(super) fn is_full(&self) -> bool {
        self.sent - self.received == MAX_CHUNKS_PER_THREAD * self.threads.len()
    }

    /// Sends the primitives of one chunk. Call it only if [`Encoders::is_full`] is false.
    ///
    /// # Errors
    /// If the thread has ended.
    pub(super) fn send(&mut self, primitives: Vec<P>) -> io::Result<()> {
        let thread = &self.threads[self.sent % self.threads.len()];
        thread.jobs.send(primitives).map_err(|_| ended())?;
        self.sent += 1;
        Ok(())
    }

    /// Waits for the oldest chunk; `None` if all were received.
    ///
    /// # Errors
    /// If it could not be compressed.
    pub(super) fn receive(&mut self) -> io::Result<Option<Encoded<P>>> {
        if self.received == self.sent {
            return Ok(None);
        }
        // Chunks are sent to the threads in turn, so the oldest comes from the thread whose turn it is.
        let thread = &self.threads[self.received % self.threads.len()];
        self.received += 1;
        thread.encoded.recv().unwrap_or_else(|_| Err(ended())).map(Some)
    }
}

fn ended() -> io::Error {
    io::Error::other("a compressing thread has ended early; this is a fault of layerd")
}

fn start<P: Primitive>() -> io::Result<Ends<P>> {
    let (sender, jobs) = bounded::<Vec<P>>(MAX_CHUNKS_PER_THREAD);
    let (results, encoded) = bounded(MAX_CHUNKS_PER_THREAD);
    std::thread::Builder::new().name("pack chunks".into()).spawn(move || {
        let mut packer = Packer::new();
        let mut unpacked = Unpacked::default();
        for primitives in jobs {
            let encoded = match &mut packer {
                Ok(packer) => encode(primitives, packer, &mut unpacked),
                Err(error) => Err(io::Error::other(error.to_string())),
            };
            if results.send(encoded).is_err() {
                break;
            }
        }
    })?;
    Ok(Ends { jobs: sender, encoded })
}

fn encode<P: Primitive>(primitives: Vec<P>, packer: &mut Packer, unpacked: &mut Unpacked) -> io::Result<Encoded<P>> {
    unpacked.clear();
    P::encode(&primitives, unpacked);
    debug_assert!(
        unpacked.bytes.len() <= MAX_UNPACKED_BYTES as usize,
        "8192 triangles need at most 63 bytes each, struts 37"
    );
    let packed = packer.pack(unpacked)?;
    let entry = ChunkEntry {
        packed_bytes: packed.len() as u32,
        unpacked_bytes: unpacked.bytes.len() as u32,
        crc: crc32fast::hash(&packed),
        ..ChunkEntry::describe(&primitives, 0)
    };
    Ok(Encoded { entry, packed, primitives })
}
