//! Threads that lay out and compress chunks; chunks come back in the order in which they were sent.

use std::io;
use std::num::NonZero;

use crossbeam::channel::{Receiver, Sender, bounded};

use super::chunk::{self, Unpacked};
use super::index::ChunkEntry;
use super::packer::Packer;
use crate::buildfile::model::Strut;

/// Chunks on their way through each thread: one under way, one waiting, so that no thread waits for the writer.
const CHUNKS_PER_THREAD: usize = 2;

/// Most threads: the one that merges and hands out chunks takes about as long for a chunk as compressing it does.
const MOST_THREADS: usize = 4;

/// A compressed chunk.
pub(super) struct Encoded {
    /// What the index says of it; the offset is still 0.
    pub(super) entry: ChunkEntry,
    pub(super) packed: Vec<u8>,
    /// The struts it was made of, to be cleared and filled again.
    pub(super) struts: Vec<Strut>,
}

/// The threads. They end when this is dropped.
pub(super) struct Encoders {
    threads: Vec<Ends>,
    sent: usize,
    received: usize,
}

/// The ends of one thread's queues.
struct Ends {
    struts: Sender<Vec<Strut>>,
    encoded: Receiver<io::Result<Encoded>>,
}

impl Encoders {
    /// Starts `count` threads, or as many as have a use.
    ///
    /// # Errors
    /// Where a thread cannot be started.
    pub(super) fn new(count: NonZero<usize>) -> io::Result<Self> {
        let threads = (0..count.get().min(MOST_THREADS)).map(|_| start()).collect::<io::Result<_>>()?;
        Ok(Self { threads, sent: 0, received: 0 })
    }

    /// Whether a chunk must be received before another may be sent.
    pub(super) fn is_full(&self) -> bool {
        self.sent - self.received == CHUNKS_PER_THREAD * self.threads.len()
    }

    /// Sends the struts of one chunk, where this is not full.
    ///
    /// # Errors
    /// Where the thread has ended.
    pub(super) fn send(&mut self, struts: Vec<Strut>) -> io::Result<()> {
        let thread = &self.threads[self.sent % self.threads.len()];
        thread.struts.send(struts).map_err(|_| ended())?;
        self.sent += 1;
        Ok(())
    }

    /// Waits for the oldest chunk; `None` where all were received.
    ///
    /// # Errors
    /// Where it could not be compressed.
    pub(super) fn receive(&mut self) -> io::Result<Option<Encoded>> {
        if self.received == self.sent {
            return Ok(None);
        }
        // Chunks are dealt out in turn, so the oldest is the next of the thread whose turn it is.
        let thread = &self.threads[self.received % self.threads.len()];
        self.received += 1;
        thread.encoded.recv().unwrap_or_else(|_| Err(ended())).map(Some)
    }
}

fn ended() -> io::Error {
    io::Error::other("a compressing thread has ended early; this is a fault of layerd")
}

fn start() -> io::Result<Ends> {
    let (struts, jobs) = bounded::<Vec<Strut>>(CHUNKS_PER_THREAD);
    let (results, encoded) = bounded(CHUNKS_PER_THREAD);
    std::thread::Builder::new().name("pack chunks".into()).spawn(move || {
        let mut packer = Packer::new();
        let mut unpacked = Unpacked::default();
        for struts in jobs {
            let encoded = match &mut packer {
                Ok(packer) => encode(struts, packer, &mut unpacked),
                Err(error) => Err(io::Error::other(error.to_string())),
            };
            if results.send(encoded).is_err() {
                break;
            }
        }
    })?;
    Ok(Ends { struts, encoded })
}

fn encode(struts: Vec<Strut>, packer: &mut Packer, unpacked: &mut Unpacked) -> io::Result<Encoded> {
    chunk::encode(&struts, unpacked);
    debug_assert!(
        unpacked.bytes.len() <= chunk::UNPACKED_LIMIT_BYTES as usize,
        "8192 struts need at most 25 bytes each and a node of 12"
    );
    let packed = packer.pack(unpacked)?;
    let entry = ChunkEntry {
        packed_bytes: packed.len() as u32,
        unpacked_bytes: unpacked.bytes.len() as u32,
        crc: crc32fast::hash(&packed),
        ..ChunkEntry::describe(&struts, 0)
    };
    Ok(Encoded { entry, packed, struts })
}
