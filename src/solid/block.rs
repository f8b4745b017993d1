//! Struts as the active set holds them: quantised and in columns, so that the kernels can prepare several at once.
//! `slice/body/lattice/active.rs` keeps its struts in blocks.

/// One strut or ball, in quanta.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct StrutRecord {
    /// The lower end.
    pub(crate) a: [i32; 3],
    /// The upper end; of a ball it equals `a`.
    pub(crate) b: [i32; 3],
    /// Radii and caps in the form that the solid uses: see [`super::Shape::ends`].
    pub(crate) ends: [u32; 2],
    /// How much of it is of the material that is drawn, at both ends, in parts of [`WHOLE_SHARE`].
    pub(crate) shares: [u16; 2],
}

/// The share of a strut that is of one material.
pub(crate) const WHOLE_SHARE: u16 = u16::MAX;

impl StrutRecord {
    /// The lower end, the unit vector to the upper end, and the length, in the unit in which a quantum has length `quantum`. A ball
    /// has the zero vector and length 0.
    pub(super) fn axis(&self, quantum: f64) -> ([f64; 3], [f64; 3], f64) {
        let [a, b] = [self.a, self.b].map(|node| node.map(|x| f64::from(x) * quantum));
        let (u, length) = super::direction(a, b);
        (a, u, length)
    }

    /// The shares at both ends, as numbers up to 1.
    pub(super) fn shares(&self) -> [f32; 2] {
        self.shares.map(|share| f32::from(share) / f32::from(WHOLE_SHARE))
    }
}

/// Up to [`Block::LEN`] records, with a column for each number.
#[derive(Clone, Debug)]
pub(crate) struct Block {
    pub(super) a: [[i32; Block::LEN]; 3],
    pub(super) b: [[i32; Block::LEN]; 3],
    pub(super) ends: [[u32; Block::LEN]; 2],
    /// `None` if all are whole.
    pub(super) shares: Option<Box<Shares>>,
    len: usize,
}

/// A column for the share at each end.
pub(super) type Shares = [[u16; Block::LEN]; 2];

impl Default for Block {
    fn default() -> Self {
        Self { a: [[0; Self::LEN]; 3], b: [[0; Self::LEN]; 3], ends: [[0; Self::LEN]; 2], shares: None, len: 0 }
    }
}

impl Block {
    /// Records in a full block, 2 KiB. Small enough that a nearly empty bucket wastes little; large enough that the cost of a block
    /// itself does not matter.
    pub(crate) const LEN: usize = 64;

    /// Most memory of the shares of a block, bytes.
    pub(crate) const SHARES_BYTES: usize = size_of::<Shares>();

    /// Number of records.
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// Adds a record; returns `false` if the block is full.
    pub(crate) fn push(&mut self, record: StrutRecord) -> bool {
        let at = self.len;
        if at == Self::LEN {
            return false;
        }
        self.len += 1;
        self.set(at, record);
        true
    }

    /// The record at index `at`, which must be below `len`.
    pub(crate) fn get(&self, at: usize) -> StrutRecord {
        debug_assert!(at < self.len);
        StrutRecord {
            a: [self.a[0][at], self.a[1][at], self.a[2][at]],
            b: [self.b[0][at], self.b[1][at], self.b[2][at]],
            ends: [self.ends[0][at], self.ends[1][at]],
            shares: self.shares.as_ref().map_or([WHOLE_SHARE; 2], |shares| [shares[0][at], shares[1][at]]),
        }
    }

    /// Replaces the record at index `at`, which must be below `len`.
    pub(crate) fn set(&mut self, at: usize, record: StrutRecord) {
        debug_assert!(at < self.len);
        for axis in 0..3 {
            (self.a[axis][at], self.b[axis][at]) = (record.a[axis], record.b[axis]);
        }
        (self.ends[0][at], self.ends[1][at]) = (record.ends[0], record.ends[1]);
        if record.shares != [WHOLE_SHARE; 2] && self.shares.is_none() {
            self.shares = Some(Box::new([[WHOLE_SHARE; Self::LEN]; 2]));
        }
        if let Some(shares) = &mut self.shares {
            (shares[0][at], shares[1][at]) = (record.shares[0], record.shares[1]);
        }
    }

    /// Number of records whose upper end lies below `z`, quanta.
    pub(crate) fn count_below(&self, z: i32) -> usize {
        self.b[2][..self.len].iter().filter(|top| **top < z).count()
    }

    /// Keeps the first `len` records.
    pub(crate) fn truncate(&mut self, len: usize) {
        self.len = self.len.min(len);
    }
}
