//! Which instruction set the inner loops run on: written once, compiled for several, chosen at run time.
//!
//! Only `+ − × ÷ √`, fused multiply-add, comparisons and selects, lane by lane in a fixed order: IEEE 754 makes every one of
//! them exact to the last bit, so every instruction set of a processor gives equal bits. Whether products are fused with sums is the same
//! for all of them: where the processor can, always, else never; emulated, it would cost more than all the rest.

/// The instruction set the kernels run on. All that a processor can choose from give equal bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InstructionSet(Set);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Set {
    /// What the compiler may assume for the target: SSE2 on x86-64, NEON on aarch64.
    Baseline,
    /// With FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// Vectors stay as long as AVX2's; more registers and masks are what is gained.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl InstructionSet {
    /// The one that every processor of this architecture has.
    pub const PORTABLE: Self = Self(Set::Baseline);

    /// Those that this processor has, the fastest last.
    pub fn available() -> Vec<Self> {
        #[cfg(target_arch = "x86_64")]
        {
            use std::is_x86_feature_detected as has;
            if has!("avx2") && has!("fma") {
                let avx512 = has!("avx512f") && has!("avx512vl") && has!("avx512bw") && has!("avx512dq");
                // AVX-512 comes first, so that it is not chosen: a layer takes about twice as long as with AVX2.
                return avx512.then_some(Self(Set::Avx512)).into_iter().chain([Self(Set::Avx2)]).collect();
            }
        }
        vec![Self::PORTABLE]
    }

    /// The fastest that this processor has.
    pub fn detect() -> Self {
        Self::available().pop().unwrap_or(Self::PORTABLE)
    }

    /// Runs `work` compiled for this instruction set; `work` must be `#[inline(always)]` to profit.
    #[inline(always)]
    pub(super) fn run(self, work: impl Work) {
        match self.0 {
            Set::Baseline => work.run::<BASELINE_FUSES>(),
            #[cfg(target_arch = "x86_64")]
            #[allow(unsafe_code, reason = "calls code compiled for AVX2; see the proof")]
            // SAFETY: `Set::Avx2` is private to this module and made only by `available`, after the processor said it has AVX2 and FMA.
            Set::Avx2 => unsafe { run_avx2(work) },
            #[cfg(target_arch = "x86_64")]
            #[allow(unsafe_code, reason = "calls code compiled for AVX-512; see the proof")]
            // SAFETY: `Set::Avx512` is private to this module and made only by `available`, after the processor said it has all
            // the features that `run_avx512` enables.
            Set::Avx512 => unsafe { run_avx512(work) },
        }
    }
}

/// Whether the baseline has an instruction that fuses.
const BASELINE_FUSES: bool = cfg!(target_arch = "aarch64");

/// Code to be compiled for each instruction set.
pub(super) trait Work {
    /// Does it; where `FUSED`, with [`super::vector::multiply_add`] in one instruction.
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
