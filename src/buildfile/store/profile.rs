//! The profile: how many primitives are active in each slab of the height of a body.
//!
//! A strut is active from `z_low − reach` to `z_high + reach` (Liu et al. 2021, Eq. 8), a triangle from `z_low` to `z_high`. For each slab
//! the profile counts the intervals that begin in it and those that end in it. The number of active primitives anywhere in a slab is at most
//! the number of intervals that began up to its end minus the number that ended before its start. When the body outgrows the slabs, they are
//! joined in pairs; the bound then stays exact for each slab. `writer` makes profiles, `opening` reads them.

/// Most slabs of a body. They take 64 KiB before compression, and are as fine as one or two layers of a usual print.
pub(super) const MAX_SLABS: usize = 4096;

/// Builds a profile from primitives in ascending z.
#[derive(Debug, Default)]
pub(super) struct ProfileBuilder {
    start: i64,
    height: i64,
    slabs: Vec<[u64; 2]>,
}

impl ProfileBuilder {
    /// Adds an interval of activity, quanta, including both ends. It must not begin below the first one.
    pub(super) fn add(&mut self, low: i64, high: i64) {
        if self.height == 0 {
            (self.start, self.height) = (low, 1);
        }
        while (high - self.start) / self.height >= MAX_SLABS as i64 {
            self.slabs =
                self.slabs.chunks(2).map(|pair| [0, 1].map(|k| pair.iter().map(|slab| slab[k]).sum())).collect();
            self.height *= 2;
        }
        let [first, last] = [low, high].map(|z| ((z - self.start) / self.height) as usize);
        if last >= self.slabs.len() {
            self.slabs.resize(last + 1, [0; 2]);
        }
        self.slabs[first][0] += 1;
        self.slabs[last][1] += 1;
    }

    /// Most primitives active at any z.
    pub(super) fn peak_active(&self) -> u64 {
        // Each interval begins no later than it ends, so these counts are always consistent.
        sum(self.slabs.iter().copied()).map_or(0, |sums| sums.peak)
    }

    /// Appends the finished profile: u64 number of slabs, i64 start, i64 slab height, then all begins and all ends as u64.
    pub(super) fn append_to(&self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(&(self.slabs.len() as u64).to_le_bytes());
        bytes.extend_from_slice(&self.start.to_le_bytes());
        bytes.extend_from_slice(&self.height.max(1).to_le_bytes());
        for k in 0..2 {
            self.slabs.iter().for_each(|slab| bytes.extend_from_slice(&slab[k].to_le_bytes()));
        }
    }
}

/// Longest profile of one body, bytes.
pub(super) const MAX_BYTES: usize = 24 + 16 * MAX_SLABS;

/// The peak of active primitives of each body. `bytes` are the profiles, one after another; `totals` are the numbers of primitives.
///
/// # Errors
/// A text that says how the bytes contradict themselves or `totals`.
pub(super) fn peaks(bytes: &[u8], totals: impl Iterator<Item = u64>) -> Result<Vec<u64>, String> {
    const CUT: &str = "it is cut short";
    let words: Vec<u64> = bytes.as_chunks::<8>().0.iter().map(|word| u64::from_le_bytes(*word)).collect();
    let mut rest = words.as_slice();
    let mut peaks = Vec::new();
    for total in totals {
        let [slabs, start, height, counts @ ..] = rest else { return Err(CUT.into()) };
        if *slabs > MAX_SLABS as u64 {
            return Err(format!("{slabs} slabs: allowed are {MAX_SLABS}"));
        }
        let (start, height) = (*start as i64, *height as i64);
        if !(1..=1 << 32).contains(&height) || height.count_ones() != 1 || !(-(1 << 33)..=1 << 33).contains(&start) {
            return Err(format!("slabs of {height} quanta from {start}"));
        }
        let (begins, after) = counts.split_at_checked(*slabs as usize).ok_or(CUT)?;
        let (ends, after) = after.split_at_checked(*slabs as usize).ok_or(CUT)?;
        peaks.push(peak(begins, ends, total)?);
        rest = after;
    }
    if !rest.is_empty() || !bytes.len().is_multiple_of(8) {
        return Err("more bytes than its bodies have".into());
    }
    Ok(peaks)
}

fn peak(begins: &[u64], ends: &[u64], total: u64) -> Result<u64, String> {
    let sums = sum(begins.iter().zip(ends).map(|(begun, ended)| [*begun, *ended]));
    let sums = sums.filter(|sums| (sums.begun, sums.ended) == (total, total));
    sums.map(|sums| sums.peak).ok_or_else(|| format!("its slabs do not count {total} primitives"))
}

/// What the slabs of a profile add up to.
struct Sums {
    begun: u64,
    ended: u64,
    /// Most intervals in any one slab.
    peak: u64,
}

/// Adds up the begins and ends of successive slabs; `None` if more intervals end than began, or a count overflows.
fn sum(slabs: impl Iterator<Item = [u64; 2]>) -> Option<Sums> {
    let mut sums = Sums { begun: 0, ended: 0, peak: 0 };
    for [begins, ends] in slabs {
        sums.begun = sums.begun.checked_add(begins)?;
        sums.peak = sums.peak.max(sums.begun - sums.ended);
        sums.ended = sums.ended.checked_add(ends).filter(|ended| *ended <= sums.begun)?;
    }
    Some(sums)
}
