//! Merges several sorted runs into one. `sort` calls it.

use std::fs::File;
use std::io;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::sync::Arc;

use crate::buildfile::primitive::{Key, Sortable};

/// One sorted run while it is read: keys in memory, then the rest of it in a file.
struct Run<K> {
    keys: Vec<K>,
    /// Index of the next key in `keys`.
    next: usize,
    /// Bytes of the file that are still to be read.
    left: Range<u64>,
}

/// Merges runs with a tree of losers (Knuth, The Art of Computer Programming 3, §5.4.1): one comparison for each level and key.
pub(in crate::buildfile) struct Merge<P: Sortable> {
    file: Option<Arc<File>>,
    runs: Vec<Run<P::Key>>,
    /// The smallest remaining key of each run; [`Key::END`] after its last.
    heads: Vec<P::Key>,
    /// Node n has the children 2n and 2n + 1. Leaf k, at index runs.len() + k, is run k. A node holds the run that lost there; node 0
    /// holds the winner.
    tree: Vec<u32>,
    bytes: Vec<u8>,
    buffer_keys: usize,
}

impl<P: Sortable> Merge<P> {
    /// Merges sorted runs in memory.
    pub(super) fn of_memory(runs: Vec<Vec<P::Key>>) -> Self {
        let runs = runs.into_iter().map(|keys| Run { keys, next: 0, left: 0..0 }).collect();
        let mut merge =
            Self { file: None, runs, heads: Vec::new(), tree: Vec::new(), bytes: Vec::new(), buffer_keys: 0 };
        merge.heads = merge.runs.iter().map(|run| run.keys.first().copied().unwrap_or(P::Key::END)).collect();
        merge.build();
        merge
    }

    /// Merges sorted runs of a file, with a buffer of so many bytes for each.
    ///
    /// # Errors
    /// If a run cannot be read.
    pub(super) fn of_file(file: Arc<File>, runs: &[Range<u64>], buffer_bytes: usize) -> io::Result<Self> {
        let buffer_keys = (buffer_bytes / P::Key::BYTES).max(1);
        let runs = runs.iter().map(|range| Run { keys: Vec::new(), next: 0, left: range.clone() });
        let mut merge = Self {
            file: Some(file),
            runs: runs.collect(),
            heads: Vec::new(),
            tree: Vec::new(),
            bytes: Vec::new(),
            buffer_keys,
        };
        for number in 0..merge.runs.len() {
            let head = merge.refill(number)?;
            merge.heads.push(head);
        }
        merge.build();
        Ok(merge)
    }

    /// Bytes of all remaining keys in a run.
    pub(super) fn bytes_left(&self) -> u64 {
        let in_memory = |run: &Run<P::Key>| (run.keys.len() - run.next) as u64 * P::Key::BYTES as u64;
        self.runs.iter().map(|run| in_memory(run) + run.left.end - run.left.start).sum()
    }

    /// Takes the smallest key; [`Key::END`] if none is left.
    ///
    /// # Errors
    /// If a run cannot be read.
    pub(super) fn next_key(&mut self) -> io::Result<P::Key> {
        let Some(&winner) = self.tree.first() else { return Ok(P::Key::END) };
        let winner = winner as usize;
        let least = self.heads[winner];
        let run = &mut self.runs[winner];
        run.next += 1;
        self.heads[winner] = match run.keys.get(run.next) {
            Some(key) => *key,
            None => self.refill(winner)?,
        };
        self.replay(winner);
        Ok(least)
    }

    /// Reads on in a run whose keys are used up, and returns its head.
    fn refill(&mut self, number: usize) -> io::Result<P::Key> {
        let run = &mut self.runs[number];
        run.next = 0;
        run.keys.clear();
        let Some(file) = self.file.as_ref().filter(|_| !run.left.is_empty()) else {
            // Runs in memory are large: free one as soon as it is used up.
            run.keys = Vec::new();
            return Ok(P::Key::END);
        };
        let length = (run.left.end - run.left.start).min((self.buffer_keys * P::Key::BYTES) as u64);
        self.bytes.resize(length as usize, 0);
        file.read_exact_at(&mut self.bytes, run.left.start)?;
        run.left.start += length;
        run.keys.reserve_exact(self.bytes.len() / P::Key::BYTES);
        run.keys.extend(self.bytes.chunks_exact(P::Key::BYTES).map(P::Key::from_bytes));
        Ok(run.keys.first().copied().unwrap_or(P::Key::END))
    }

    /// Plays the whole tournament.
    fn build(&mut self) {
        let count = self.runs.len();
        // The winner of each node, leaves last.
        let mut winners: Vec<u32> = (0..2 * count as u32).map(|place| place.wrapping_sub(count as u32)).collect();
        self.tree = vec![0; count];
        for node in (1..count).rev() {
            let (one, other) = (winners[2 * node], winners[2 * node + 1]);
            let first = self.heads[one as usize] <= self.heads[other as usize];
            (winners[node], self.tree[node]) = if first { (one, other) } else { (other, one) };
        }
        if let Some(top) = self.tree.first_mut() {
            *top = winners[1];
        }
    }

    /// Replays the matches on the path from the last winner's leaf to the root, after that run got a new head.
    fn replay(&mut self, run: usize) {
        let mut winner = run as u32;
        let mut head = self.heads[run];
        let mut node = (self.runs.len() + run) / 2;
        while node > 0 {
            let other = self.tree[node];
            let challenger = self.heads[other as usize];
            if challenger < head {
                self.tree[node] = winner;
                (winner, head) = (other, challenger);
            }
            node /= 2;
        }
        self.tree[0] = winner;
    }
}

impl<P: Sortable> Iterator for Merge<P> {
    type Item = io::Result<P>;

    fn next(&mut self) -> Option<Self::Item> {
        match self.next_key() {
            Ok(key) => (key != P::Key::END).then(|| Ok(P::of_key(&key))),
            Err(error) => Some(Err(error)),
        }
    }
}
