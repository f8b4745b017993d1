//! The instruction set of the inner loops: they are written once, compiled for several sets, and one is chosen at run time.
//!
//! The loops use only `+ − × ÷ √`, fused multiply-add, comparisons and selects, lane by lane in a fixed order. IEEE 754 defines each
//! result to the last bit, so all instruction sets of a processor give equal bits. Products and sums are fused on all of them if the
//! processor can fuse, and on none otherwise: emulating it would take longer than everything else. `tests/exact/` compares them.

/// The instruction set that the kernels run on. All sets of one processor give equal bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InstructionSet(Set);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Set {
    /// What every processor of the target has: SSE2 on x86-64, NEON on aarch64.
    Baseline,
    /// With FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// Vectors as long as those of AVX2, but more registers, and masks.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl InstructionSet {
    /// The set that every processor of this architecture has.
    pub const PORTABLE: Self = Self(Set::Baseline);

    /// The sets of this processor, the fastest last.
    pub fn available() -> Vec<Self> {
        #[cfg(target_arch = "x86_64")]
        {
            use std::is_x86_feature_detected as has;
            if has!("avx2") && has!("fma") {
                let avx512 = has!("avx512f") && has!("avx512vl") && has!("avx512bw") && has!("avx512dq");
                // AVX-512 comes first so that it is not chosen: with it a layer takes about twice as long as with AVX2.
                return avx512.then_some(Self(Set::Avx512)).into_iter().chain([Self(Set::Avx2)]).collect();
            }
        }
        vec![Self::PORTABLE]
    }

    /// The fastest set of this processor.
    pub fn detect() -> Self {
        Self::available().pop().unwrap_or(Self::PORTABLE)
    }

    /// Runs `work` compiled for this instruction set. It has an effect only if everything in `work` is `#[inline(always)]`.
    #[inline(always)]
    pub(super) fn run(self, work: impl Work) {
        match self.0 {
            Set::Baseline => work.run::<BASELINE_FUSES>(),
            #[cfg(target_arch = "x86_64")]
            #[allow(unsafe_code, reason = "calls code compiled for AVX2; see the proof")]
            // SAFETY: `Set::Avx2` is private to this module. Only `available` makes it, after it found that the processor has AVX2
            // and FMA.
            Set::Avx2 => unsafe { run_avx2(work) },
            #[cfg(target_arch = "x86_64")]
            #[allow(unsafe_code, reason = "calls code compiled for AVX-512; see the proof")]
            // SAFETY: `Set::Avx512` is private to this module. Only `available` makes it, after it found that the processor has all
            // features that `run_avx512` enables.
            Set::Avx512 => unsafe { run_avx512(work) },
        }
    }
}

/// Whether the baseline has a fused multiply-add instruction.
const BASELINE_FUSES: bool = cfg!(target_arch = "aarch64");

/// Code that is compiled for each instruction set.
pub(super) trait Work {
    /// Runs the code. If `FUSED`, [`super::vector::multiply_add`] is one instruction.
    fn run<const FUSED: bool>(self);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn run_avx2(work: impl Work) {
    work.run::<true>();
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,avx512f,avx512vl,avx512bw,avx512dq")]
fn run_avx512(work: impl Work) {
    work.run::<true>();
}
