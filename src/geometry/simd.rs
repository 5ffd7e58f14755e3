//! Work that runs in the widest vector unit there is, with the same bits on every one.
//!
//! What is computed is written over a fixed number of lanes, in a fixed order, and nothing is fused: so every kernel
//! gives the same bits, and only the speed differs.

/// The vector instructions that a piece of work is compiled for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Kernel(Width);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Width {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Kernel {
    /// The kernels that this processor can run, the fastest one last; never empty.
    pub fn available() -> Vec<Self> {
        #[cfg_attr(not(target_arch = "x86_64"), expect(unused_mut, reason = "there is but one"))]
        let mut kernels = vec![Self(Width::Portable)];
        #[cfg(target_arch = "x86_64")]
        {
            if std::arch::is_x86_feature_detected!("avx2") {
                kernels.push(Self(Width::Avx2));
            }
            if std::arch::is_x86_feature_detected!("avx512f") {
                kernels.push(Self(Width::Avx512));
            }
        }
        kernels
    }

    /// The fastest kernel that this processor can run.
    pub fn fastest() -> Self {
        Self::available().pop().unwrap_or(Self(Width::Portable))
    }

    /// What it is called in results.
    pub fn name(self) -> &'static str {
        match self.0 {
            Width::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Width::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Width::Avx512 => "avx512",
        }
    }

    /// Does `work` with these instructions.
    #[inline]
    pub fn run<W: Work>(self, work: W) -> W::Output {
        match self.0 {
            Width::Portable => work.run(),
            #[cfg(target_arch = "x86_64")]
            #[expect(
                unsafe_code,
                reason = "`available` makes this kernel only where the processor has the instructions"
            )]
            Width::Avx2 => unsafe { run_avx2(work) },
            #[cfg(target_arch = "x86_64")]
            #[expect(
                unsafe_code,
                reason = "`available` makes this kernel only where the processor has the instructions"
            )]
            Width::Avx512 => unsafe { run_avx512(work) },
        }
    }
}

/// Something to compute with the instructions of a kernel.
pub trait Work {
    /// What comes of it.
    type Output;

    /// Computes it. Only what is inlined here is compiled for each kernel: mark it, and all that it calls,
    /// `#[inline(always)]`.
    fn run(self) -> Self::Output;
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
fn run_avx512<W: Work>(work: W) -> W::Output {
    work.run()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn run_avx2<W: Work>(work: W) -> W::Output {
    work.run()
}

/// Numbers that are computed side by side.
pub const LANE_COUNT: usize = 16;
