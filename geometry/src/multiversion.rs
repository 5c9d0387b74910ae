//! Functions compiled for more than one kind of processor.

/// Compiles a free function a second time for AVX2, which is taken where the processor has it.
///
/// Rust neither fuses nor reorders arithmetic, so both give the same results to the bit. What the function calls is
/// compiled with it only if it is inlined.
///
/// ```
/// geometry::multiversion! {
///     /// The sum of the products.
///     pub fn dot(a: &[f32], b: &[f32]) -> f32 {
///         a.iter().zip(b).map(|(a, b)| a * b).sum()
///     }
/// }
/// assert_eq!(dot(&[1.0, 2.0], &[3.0, 4.0]), 11.0);
/// ```
///
/// A function that names a first parameter in brackets is given what makes [`Lanes`](crate::lanes::Lanes) on that processor:
///
/// ```
/// use geometry::lanes::{Lanes, Processor};
///
/// geometry::multiversion! {
///     /// The sum of eight products.
///     pub fn dot_of_eight[processor](a: &[f32; 8], b: &[f32; 8]) -> f32 {
///         (processor.load(a) * processor.load(b)).sum()
///     }
/// }
/// assert_eq!(dot_of_eight(&[1.0; 8], &[2.0; 8]), 16.0);
/// ```
#[macro_export]
macro_rules! multiversion {
    (
        $(#[$attribute:meta])*
        $visibility:vis fn $name:ident($($argument:ident: $kind:ty),* $(,)?) $(-> $result:ty)? $body:block
    ) => {
        $(#[$attribute])*
        $visibility fn $name($($argument: $kind),*) $(-> $result)? {
            #[inline(always)]
            fn plain($($argument: $kind),*) $(-> $result)? $body

            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn wide($($argument: $kind),*) $(-> $result)? {
                    plain($($argument),*)
                }
                if std::arch::is_x86_feature_detected!("avx2") {
                    // SAFETY: the processor has what the function is compiled for.
                    return unsafe { wide($($argument),*) };
                }
            }
            plain($($argument),*)
        }
    };
    (
        $(#[$attribute:meta])*
        $visibility:vis fn $name:ident[$processor:ident]($($argument:ident: $kind:ty),* $(,)?) $(-> $result:ty)? $body:block
    ) => {
        $(#[$attribute])*
        $visibility fn $name($($argument: $kind),*) $(-> $result)? {
            #[inline(always)]
            fn plain($processor: impl $crate::lanes::Processor, $($argument: $kind),*) $(-> $result)? $body

            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn wide($($argument: $kind),*) $(-> $result)? {
                    // SAFETY: called where there is such a processor only.
                    plain(unsafe { $crate::lanes::Avx2::new() }, $($argument),*)
                }
                if std::arch::is_x86_feature_detected!("avx2") {
                    // SAFETY: the processor has what the function is compiled for.
                    return unsafe { wide($($argument),*) };
                }
            }
            plain($crate::lanes::Portable, $($argument),*)
        }
    };
}

#[cfg(test)]
mod tests {
    /// Sums in lanes, with a division and a root: what compilers fuse and reorder where they may.
    #[inline(always)]
    fn lengths(vectors: &[[f32; 2]]) -> [f32; 8] {
        let mut sums = [0.0; 8];
        for (i, [x, y]) in vectors.iter().enumerate() {
            sums[i % 8] += (x * x + y * y).sqrt() / (x * y + 3.0);
        }
        sums
    }

    multiversion! {
        fn lengths_as_the_processor_likes(vectors: &[[f32; 2]]) -> [f32; 8] {
            lengths(vectors)
        }
    }

    #[test]
    fn both_give_the_same_bits() {
        let value = |i: u32| (i as f32 * 0.7).sin() * 10.0 + 11.0;
        let vectors: Vec<[f32; 2]> = (0..10_000).map(|i| [value(i), value(3 * i + 1)]).collect();
        assert_eq!(
            lengths(&vectors).map(f32::to_bits),
            lengths_as_the_processor_likes(&vectors).map(f32::to_bits)
        );
    }
}
