//! The active set: the triangles or patches that the plane cuts, in [`Buckets`] of rows. `sweep` adds and retires them, `brush` draws them.

use std::ops::Range;

use crate::slice::body::buckets::Buckets;

/// No place.
const NONE: u32 = u32::MAX;

/// Elements in lists, one for each bucket. Their order has no meaning: only their number and direction count where they are crossed.
#[derive(Debug)]
pub(in crate::slice::body) struct Active<T> {
    place: Buckets,
    /// First element of each bucket.
    heads: Vec<u32>,
    /// Room for as many elements as any plane cuts.
    entries: Vec<Entry<T>>,
    /// First of the entries that are not in use.
    free: u32,
    count: usize,
}

#[derive(Clone, Copy, Debug)]
struct Entry<T> {
    element: T,
    /// First and last row that it reaches. Of two neighbouring buckets that a band looks into, half of the elements do not reach it.
    rows: [u16; 2],
    /// The next of its bucket, or the next that is not in use.
    next: u32,
}

impl<T> Active<T> {
    /// An empty set for a picture of `height` rows. Buckets of the lowest level have `min_rows` rows.
    pub(super) fn new(max_active: usize, height: usize, min_rows: usize) -> Self {
        Self {
            place: Buckets::new(height, min_rows),
            heads: vec![NONE; Buckets::count(height, min_rows)],
            entries: Vec::with_capacity(max_active),
            free: NONE,
            count: 0,
        }
    }

    /// Memory for up to `max_active` elements, bytes.
    pub(super) fn memory_bytes(max_active: u64, height: usize, min_rows: usize) -> u64 {
        let heads = (Buckets::count(height, min_rows) * size_of::<u32>()) as u64;
        max_active.saturating_mul(size_of::<Entry<T>>() as u64).saturating_add(heads)
    }

    /// Number of elements.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Adds an element that reaches these rows. There must be room.
    pub(super) fn add(&mut self, element: T, rows: [i64; 2]) {
        let head = &mut self.heads[self.place.of(rows)];
        let [first, last] = rows;
        let rows = [row(first), row(last)];
        let entry = Entry { element, rows, next: *head };
        if let Some(unused) = self.entries.get_mut(self.free as usize) {
            *head = std::mem::replace(&mut self.free, unused.next);
            *unused = entry;
        } else {
            *head = self.entries.len() as u32;
            self.entries.push(entry);
        }
        self.count += 1;
    }

    /// Takes out the elements that end below `z`; `high` tells where one ends.
    pub(super) fn retire(&mut self, z: f64, high: impl Fn(&T) -> f64) {
        for head in &mut self.heads {
            let mut kept = NONE;
            let mut next = *head;
            while let Some(entry) = self.entries.get_mut(next as usize) {
                let number = std::mem::replace(&mut next, entry.next);
                let list = if high(&entry.element) >= z {
                    &mut kept
                } else {
                    self.count -= 1;
                    &mut self.free
                };
                entry.next = std::mem::replace(list, number);
            }
            *head = kept;
        }
    }

    /// The elements that may reach these rows.
    pub(super) fn reaching(&self, rows: Range<i64>) -> impl Iterator<Item = &T> {
        let entry = |number: u32| self.entries.get(number as usize);
        let [first, last] = [row(rows.start), row(rows.end - 1)];
        self.place
            .reaching(rows)
            .flat_map(move |bucket| std::iter::successors(entry(self.heads[bucket]), move |last| entry(last.next)))
            .filter(move |entry| entry.rows[0] <= last && first <= entry.rows[1])
            .map(|entry| &entry.element)
    }
}

/// A row, which saturates: rows that meet still do.
fn row(row: i64) -> u16 {
    row.clamp(0, u16::MAX.into()) as u16
}
