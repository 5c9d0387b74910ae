//! Eight numbers that the processor works on side by side, written out for loops that compilers do not vectorise.
//!
//! [`multiversion`](crate::multiversion) gives a [`Processor`] to a function: [`Portable`] on any processor, [`Avx2`]
//! where there is AVX2. Both do the same arithmetic in the same order, so results are the same to the bit.

use std::ops::{Add, Mul, Sub};

/// Numbers side by side.
pub const LANES: usize = 8;

/// The kind of processor, which makes [`Lanes`].
pub trait Processor: Copy {
    /// The numbers.
    type Lanes: Lanes;

    /// A number in all places.
    fn splat(self, value: f32) -> Self::Lanes;

    /// Numbers from memory.
    fn load(self, values: &[f32; LANES]) -> Self::Lanes;

    /// Bytes from memory, as numbers.
    fn load_bytes(self, bytes: &[u8; LANES]) -> Self::Lanes;
}

/// Eight numbers; arithmetic is place by place.
pub trait Lanes: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// The numbers in their order.
    fn to_array(self) -> [f32; LANES];

    /// Their sum, in their order.
    #[inline(always)]
    fn sum(self) -> f32 {
        self.to_array().iter().sum()
    }
}

/// Any processor.
#[derive(Clone, Copy, Debug)]
pub struct Portable;

/// The numbers of [`Portable`].
#[derive(Clone, Copy, Debug)]
pub struct Array([f32; LANES]);

impl Processor for Portable {
    type Lanes = Array;

    #[inline(always)]
    fn splat(self, value: f32) -> Array {
        Array([value; LANES])
    }

    #[inline(always)]
    fn load(self, values: &[f32; LANES]) -> Array {
        Array(*values)
    }

    #[inline(always)]
    fn load_bytes(self, bytes: &[u8; LANES]) -> Array {
        Array(bytes.map(f32::from))
    }
}

impl Lanes for Array {
    #[inline(always)]
    fn to_array(self) -> [f32; LANES] {
        self.0
    }
}

/// Arithmetic of an [`Array`] and of a register of AVX2.
macro_rules! arithmetic {
    ($operation:ident, $name:ident, $operator:tt, $intrinsic:ident) => {
        impl $operation for Array {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self(std::array::from_fn(|lane| self.0[lane] $operator other.0[lane]))
            }
        }

        #[cfg(target_arch = "x86_64")]
        impl $operation for Register {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                // SAFETY: registers are made by [`Avx2`] alone.
                Self(unsafe { std::arch::x86_64::$intrinsic(self.0, other.0) })
            }
        }
    };
}

arithmetic!(Add, add, +, _mm256_add_ps);
arithmetic!(Sub, sub, -, _mm256_sub_ps);
arithmetic!(Mul, mul, *, _mm256_mul_ps);

#[cfg(target_arch = "x86_64")]
pub use wide::{Avx2, Register};

#[cfg(target_arch = "x86_64")]
mod wide {
    use super::{LANES, Lanes, Processor};
    use std::arch::x86_64::*;

    /// A processor with AVX2: a value of this type proves that its instructions may be used.
    #[derive(Clone, Copy, Debug)]
    pub struct Avx2(());

    /// The numbers of [`Avx2`].
    #[derive(Clone, Copy, Debug)]
    pub struct Register(pub(super) __m256);

    impl Avx2 {
        /// A value that states that this processor has AVX2.
        ///
        /// # Safety
        /// The processor must have AVX2.
        #[inline(always)]
        pub unsafe fn new() -> Self {
            Self(())
        }
    }

    impl Processor for Avx2 {
        type Lanes = Register;

        #[inline(always)]
        fn splat(self, value: f32) -> Register {
            // SAFETY: the processor has AVX2, as there is an `Avx2`.
            Register(unsafe { _mm256_set1_ps(value) })
        }

        #[inline(always)]
        fn load(self, values: &[f32; LANES]) -> Register {
            // SAFETY: the same; eight numbers are there, and need not be aligned.
            Register(unsafe { _mm256_loadu_ps(values.as_ptr()) })
        }

        #[inline(always)]
        fn load_bytes(self, bytes: &[u8; LANES]) -> Register {
            // SAFETY: the same; eight bytes are read, which need not be aligned.
            Register(unsafe {
                _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_loadl_epi64(bytes.as_ptr().cast())))
            })
        }
    }

    impl Lanes for Register {
        #[inline(always)]
        fn to_array(self) -> [f32; LANES] {
            let mut array = [0.0; LANES];
            // SAFETY: registers are made by an `Avx2` alone; eight numbers have room in the array.
            unsafe { _mm256_storeu_ps(array.as_mut_ptr(), self.0) };
            array
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All that lanes can do, once.
    fn worked_out(processor: impl Processor, a: &[f32; LANES], bytes: &[u8; LANES]) -> ([f32; LANES], f32) {
        let (a, b) = (processor.load(a), processor.load_bytes(bytes));
        let c = (a + b * processor.splat(0.3)) * (a - b) - a * b;
        (c.to_array(), c.sum())
    }

    #[test]
    fn lanes_are_numbers_place_by_place() {
        let a = std::array::from_fn(|lane| (lane as f32 - 3.3).powi(3));
        let bytes = [0, 1, 2, 127, 128, 200, 254, 255];
        let (found, sum) = worked_out(Portable, &a, &bytes);
        for (lane, value) in found.into_iter().enumerate() {
            let (a, b) = (a[lane], f32::from(bytes[lane]));
            assert_eq!(value.to_bits(), ((a + b * 0.3) * (a - b) - a * b).to_bits(), "{lane}");
        }
        assert_eq!(sum.to_bits(), found.iter().sum::<f32>().to_bits());
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn registers_give_the_same_bits() {
        if !std::arch::is_x86_feature_detected!("avx2") {
            return;
        }
        // SAFETY: asked before.
        let wide = unsafe { Avx2::new() };
        for seed in 0..100u32 {
            let number = |lane: usize| ((seed as f32 + 1.7) * (lane as f32 + 0.3)).sin() * 1e3;
            let a = std::array::from_fn(number);
            let bytes = std::array::from_fn(|lane| number(lane) as i32 as u8);
            let (plain, wide) = (worked_out(Portable, &a, &bytes), worked_out(wide, &a, &bytes));
            assert_eq!(plain.0.map(f32::to_bits), wide.0.map(f32::to_bits));
            assert_eq!(plain.1.to_bits(), wide.1.to_bits());
        }
    }
}
