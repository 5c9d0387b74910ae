//! What is sent of a keyframe before its exact image and depth: as few bytes as places are found and maps are merged by.
//!
//! Three kinds of objects, beside the features, which are few bytes already (the crate `features`):
//!
//! | what | bytes at 640×480 | for what |
//! |---|---|---|
//! | [`digest`] | 1.2 kB | which places look alike, and which keyframes overlap once a motion is known |
//! | [`image`] | 72 kB | matching and alignment |
//! | [`depth`] | 24 kB | the same |
//!
//! They stand in for the exact ones where maps are merged before all of them is there, and are given up once it is.

pub mod depth;
pub mod digest;
pub mod image;
#[cfg(test)]
mod tests;

use map::SemiDense;

/// A step of inverse depth as it is sent: its natural logarithm, so that the error is the same share everywhere. Half a
/// per cent at most half of which is lost: merging counts on errors of 0.4 % at the least, which neighbouring pixels
/// share (`min_depth_deviation` of its key points).
const DEPTH_STEP: f64 = 0.005;

/// The number of steps of an inverse depth above 0.
fn steps(inverse_depth: f32) -> i32 {
    // Positive finite numbers have logarithms of ±104 at most.
    (f64::from(inverse_depth).ln() / DEPTH_STEP).round() as i32
}

/// The inverse depth of so many steps.
fn of_steps(steps: i32) -> f32 {
    (f64::from(steps) * DEPTH_STEP).exp() as f32
}

/// Whether numbers of a pixel can be sent.
fn is_usable((_, inverse_depth, variance): &(u32, f32, f32)) -> bool {
    inverse_depth.is_normal() && *inverse_depth > 0.0 && variance.is_finite() && *variance >= 0.0
}

/// Some pixels of a depth map spread over it, at most `count`: every so-and-so-many-th.
fn spread(depth: &SemiDense, count: usize) -> impl Iterator<Item = (u32, f32, f32)> + '_ {
    let step = depth.len().div_ceil(count).max(1);
    depth.iter().step_by(step).filter(is_usable)
}
