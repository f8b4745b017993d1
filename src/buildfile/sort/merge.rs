//! Several sorted runs as one, the least record first.

use std::fs::File;
use std::io;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::sync::Arc;

use super::key::SortKey;
use crate::buildfile::model::Strut;

/// One sorted run as it is read: records in memory, then what is left of it in a file.
struct Run {
    records: Vec<SortKey>,
    /// The next of `records`.
    next: usize,
    /// Bytes of the file that are still to be read.
    left: Range<u64>,
}

/// Merges runs through a tree of losers (Knuth, The Art of Computer Programming 3, §5.4.1): one comparison a level a record.
pub(in crate::buildfile) struct Merge {
    file: Option<Arc<File>>,
    runs: Vec<Run>,
    /// Each run's least record that was not taken yet; [`SortKey::END`] behind its last.
    heads: Vec<SortKey>,
    /// Node n has the children 2n and 2n + 1, and leaf k, at runs.len() + k, is run k. A node holds the run that lost there;
    /// node 0 holds the winner.
    tree: Vec<u32>,
    bytes: Vec<u8>,
    buffer_records: usize,
}

impl Merge {
    /// Merges sorted runs in memory.
    pub(super) fn of_memory(runs: Vec<Vec<SortKey>>) -> Self {
        let runs = runs.into_iter().map(|records| Run { records, next: 0, left: 0..0 }).collect();
        let mut merge =
            Self { file: None, runs, heads: Vec::new(), tree: Vec::new(), bytes: Vec::new(), buffer_records: 0 };
        merge.heads = merge.runs.iter().map(|run| run.records.first().copied().unwrap_or(SortKey::END)).collect();
        merge.build();
        merge
    }

    /// Merges sorted runs of a file, with a buffer of so many bytes for each.
    ///
    /// # Errors
    /// Where a run cannot be read.
    pub(super) fn of_file(file: Arc<File>, runs: &[Range<u64>], buffer_bytes: usize) -> io::Result<Self> {
        let buffer_records = (buffer_bytes / SortKey::BYTES).max(1);
        let runs = runs.iter().map(|range| Run { records: Vec::new(), next: 0, left: range.clone() });
        let mut merge = Self {
            file: Some(file),
            runs: runs.collect(),
            heads: Vec::new(),
            tree: Vec::new(),
            bytes: Vec::new(),
            buffer_records,
        };
        for number in 0..merge.runs.len() {
            let head = merge.refill(number)?;
            merge.heads.push(head);
        }
        merge.build();
        Ok(merge)
    }

    /// Bytes of all records that were not taken yet, as a run holds them.
    pub(super) fn bytes_left(&self) -> u64 {
        let left =
            |run: &Run| (run.records.len() - run.next) as u64 * SortKey::BYTES as u64 + run.left.end - run.left.start;
        self.runs.iter().map(left).sum()
    }

    /// Takes the least record; [`SortKey::END`] where none is left.
    ///
    /// # Errors
    /// Where a run cannot be read.
    pub(super) fn next_record(&mut self) -> io::Result<SortKey> {
        let Some(&winner) = self.tree.first() else { return Ok(SortKey::END) };
        let winner = winner as usize;
        let least = self.heads[winner];
        let run = &mut self.runs[winner];
        run.next += 1;
        self.heads[winner] = match run.records.get(run.next) {
            Some(record) => *record,
            None => self.refill(winner)?,
        };
        self.replay(winner);
        Ok(least)
    }

    /// Reads on in a run whose records are used up, and returns its head.
    fn refill(&mut self, number: usize) -> io::Result<SortKey> {
        let run = &mut self.runs[number];
        run.next = 0;
        run.records.clear();
        let Some(file) = self.file.as_ref().filter(|_| !run.left.is_empty()) else {
            // Memory runs are large: what was taken makes room.
            run.records = Vec::new();
            return Ok(SortKey::END);
        };
        let length = (run.left.end - run.left.start).min((self.buffer_records * SortKey::BYTES) as u64);
        self.bytes.resize(length as usize, 0);
        file.read_exact_at(&mut self.bytes, run.left.start)?;
        run.left.start += length;
        run.records.reserve_exact(self.bytes.len() / SortKey::BYTES);
        run.records.extend(self.bytes.as_chunks().0.iter().map(SortKey::from_bytes));
        Ok(run.records.first().copied().unwrap_or(SortKey::END))
    }

    /// Plays the whole tournament.
    fn build(&mut self) {
        let count = self.runs.len();
        // Winners of all nodes, leaves last; losers stay where they lost.
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

    /// Lets the new head of the run that won play its way up.
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

impl Iterator for Merge {
    type Item = io::Result<Strut>;

    fn next(&mut self) -> Option<Self::Item> {
        match self.next_record() {
            Ok(record) => (record != SortKey::END).then(|| Ok(record.strut())),
            Err(error) => Some(Err(error)),
        }
    }
}
