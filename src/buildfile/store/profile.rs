//! The z profile: how many struts are active in each slab of the part's height.
//!
//! A strut is active from `z_low − reach` to `z_high + reach` (Liu et al. 2021, §4). The profile counts, for each slab, the
//! intervals that begin and that end in it; so the number active anywhere inside a slab is at most all that began up to its
//! end less all that ended before its start. Slabs grow as the part does, pairwise, which keeps that bound exact per slab.

/// Most slabs: 64 KiB before compression, and still one slab for every one or two layers of a usual print.
pub(super) const SLAB_LIMIT: usize = 4096;

/// Builds a profile from struts in ascending z.
#[derive(Debug, Default)]
pub(super) struct ProfileBuilder {
    start: i64,
    height: i64,
    slabs: Vec<[u64; 2]>,
}

impl ProfileBuilder {
    /// Counts one interval of activity, quanta, both ends inside; none may begin below the first one.
    pub(super) fn add(&mut self, low: i64, high: i64) {
        if self.height == 0 {
            (self.start, self.height) = (low, 1);
        }
        while (high - self.start) / self.height >= SLAB_LIMIT as i64 {
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

    /// Most struts active at any one z.
    pub(super) fn peak_active(&self) -> u64 {
        let (mut begun, mut ended, mut peak) = (0, 0, 0);
        for [begins, ends] in &self.slabs {
            begun += begins;
            peak = peak.max(begun - ended);
            ended += ends;
        }
        peak
    }

    /// Appends the finished profile: u64 slabs, i64 start, i64 slab height, then all begins and all ends as u64.
    pub(super) fn append_to(&self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(&(self.slabs.len() as u64).to_le_bytes());
        bytes.extend_from_slice(&self.start.to_le_bytes());
        bytes.extend_from_slice(&self.height.max(1).to_le_bytes());
        for k in 0..2 {
            self.slabs.iter().for_each(|slab| bytes.extend_from_slice(&slab[k].to_le_bytes()));
        }
    }
}

/// Largest profile of one body in bytes.
pub(super) const LIMIT_BYTES: usize = 24 + 16 * SLAB_LIMIT;

/// Most struts active at any one z of each body, from the profiles of bodies of `totals` struts, one behind another.
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
        if *slabs > SLAB_LIMIT as u64 {
            return Err(format!("{slabs} slabs: allowed are {SLAB_LIMIT}"));
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
    let lying = || format!("its slabs do not count {total} struts");
    let (mut begun, mut ended, mut peak) = (0u64, 0u64, 0);
    for (begin, end) in begins.iter().zip(ends) {
        begun = begun.checked_add(*begin).ok_or_else(lying)?;
        peak = peak.max(begun - ended);
        ended = ended.checked_add(*end).filter(|ended| *ended <= begun).ok_or_else(lying)?;
    }
    if begun != total || ended != total {
        return Err(lying());
    }
    Ok(peak)
}
