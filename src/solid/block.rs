//! Struts as the active set holds them: quantised, in columns, so that several are prepared at once.

/// One strut or ball, in quanta.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record {
    /// The lower end.
    pub a: [i32; 3],
    /// The upper end; that of a ball is `a`.
    pub b: [i32; 3],
    /// What the solid makes of radii and caps: see [`super::Shape::ends`].
    pub ends: [u32; 2],
}

impl Record {
    /// The lower end, the unit vector to the upper one and the length, in units of which `quantum` is a quantum's length; a
    /// ball has the zero vector and length 0.
    pub(super) fn axis(&self, quantum: f64) -> ([f64; 3], [f64; 3], f64) {
        let [a, b] = [self.a, self.b].map(|node| node.map(|x| f64::from(x) * quantum));
        let (u, length) = super::direction(a, b);
        (a, u, length)
    }
}

/// Up to [`Block::LEN`] records, one column for each number.
#[derive(Clone, Debug)]
pub struct Block {
    pub(super) a: [[i32; Block::LEN]; 3],
    pub(super) b: [[i32; Block::LEN]; 3],
    pub(super) ends: [[u32; Block::LEN]; 2],
    len: usize,
}

impl Default for Block {
    fn default() -> Self {
        Self { a: [[0; Self::LEN]; 3], b: [[0; Self::LEN]; 3], ends: [[0; Self::LEN]; 2], len: 0 }
    }
}

impl Block {
    /// Records of a block: 2 KiB, small enough that a nearly empty bucket wastes little, large enough that its own cost is
    /// nothing.
    pub const LEN: usize = 64;

    /// Records held.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether it holds none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Adds a record; `false` where the block is full.
    pub fn push(&mut self, record: Record) -> bool {
        let at = self.len;
        if at == Self::LEN {
            return false;
        }
        self.len += 1;
        self.set(at, record);
        true
    }

    /// The record at a place below `len`.
    pub fn get(&self, at: usize) -> Record {
        debug_assert!(at < self.len);
        Record {
            a: [self.a[0][at], self.a[1][at], self.a[2][at]],
            b: [self.b[0][at], self.b[1][at], self.b[2][at]],
            ends: [self.ends[0][at], self.ends[1][at]],
        }
    }

    /// Replaces the record at a place below `len`.
    pub fn set(&mut self, at: usize, record: Record) {
        debug_assert!(at < self.len);
        for axis in 0..3 {
            (self.a[axis][at], self.b[axis][at]) = (record.a[axis], record.b[axis]);
        }
        (self.ends[0][at], self.ends[1][at]) = (record.ends[0], record.ends[1]);
    }

    /// How many records end below `z`, quanta.
    pub fn count_below(&self, z: i32) -> usize {
        self.b[2][..self.len].iter().filter(|top| **top < z).count()
    }

    /// Keeps the first `len` records.
    pub fn truncate(&mut self, len: usize) {
        self.len = self.len.min(len);
    }
}
