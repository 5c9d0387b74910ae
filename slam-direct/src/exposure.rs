//! Undoes jumps of the exposure between two frames.
//!
//! Patches have a gain and an offset of their own, and alignment starts with those of the frame before, so they
//! follow an exposure that changes slowly. After a jump by a factor, agreement, noise and gradients, which are all
//! measured in grey levels, are those of another picture. Two frames in a row show nearly the same, so the images
//! alone show such a jump: the same factor all over. It is undone until the exposure jumps back. Without jumps no
//! pixel of a recording changes.

use geometry::{GrayImage, median};

/// Columns and rows of the parts of an image whose brightness is compared: the camera moves by a small part of one from frame to
/// frame.
const PARTS: (usize, usize) = (8, 6);
/// Every how many pixels one is looked at, in each direction: enough for a mean.
const STRIDE: usize = 4;
/// The factor from which a change is a jump. Recordings whose exposure glides change by 1.13 at the most from one frame to the next,
/// and by 1.23 where a camera of 10 Hz turns quickly.
const JUMP: f32 = 1.5;
/// Share of the parts that change the same way, by the root of that factor at the least. What enters the view changes some.
const ALL_OVER: f32 = 0.75;
/// Means outside of these grey levels say nothing: black stays black, white stays white.
const INFORMATIVE: std::ops::RangeInclusive<f32> = 6.0..=240.0;
/// Parts that must say something, share of all.
const ENOUGH: f32 = 0.25;
/// An exposure that is within this factor of the first one is that one.
const SAME: f32 = 1.15;
/// The factors that are undone at the most: quantisation grows with them.
const MOST: f32 = 8.0;

/// Keeps the exposure of a recording where it began.
#[derive(Clone, Debug, Default)]
pub(crate) struct Exposure {
    /// Mean grey level of each part of the frame before, as it came.
    before: Vec<f32>,
    /// Logarithm of the factor by which frames come brighter than those that it began with.
    log_gain: f32,
}

impl Exposure {
    /// The next image as it would have been taken with the exposure that was begun with.
    pub fn even(&mut self, image: GrayImage) -> GrayImage {
        let means = means(&image);
        if let Some(jump) = jump(&self.before, &means) {
            let log_gain = self.log_gain + jump;
            self.log_gain = if log_gain.abs() < SAME.ln() { 0.0 } else { log_gain };
        }
        self.before = means;
        if self.log_gain == 0.0 {
            return image;
        }
        let factor = (-self.log_gain).exp().clamp(1.0 / MOST, MOST);
        let table: [u8; 256] = std::array::from_fn(|v| (factor * v as f32).round().min(255.0) as u8);
        let mut image = image;
        image.data_mut().iter_mut().for_each(|value| *value = table[usize::from(*value)]);
        image
    }
}

/// Logarithm of the factor by which one frame's brightness jumps to the next one's; nothing where it does not.
fn jump(before: &[f32], now: &[f32]) -> Option<f32> {
    let informative = before
        .iter()
        .zip(now)
        .filter(|(before, now)| INFORMATIVE.contains(*before) && INFORMATIVE.contains(*now));
    let mut changes: Vec<f32> = informative.map(|(before, now)| (now / before).ln()).collect();
    if (changes.len() as f32) < ENOUGH * (PARTS.0 * PARTS.1) as f32 {
        return None;
    }
    let middle = median(&mut changes)?;
    let similar = changes.iter().filter(|change| **change * middle.signum() >= 0.5 * JUMP.ln()).count();
    (middle.abs() >= JUMP.ln() && similar as f32 >= ALL_OVER * changes.len() as f32).then_some(middle)
}

/// Mean grey level of each part of an image, in the order of rows.
fn means(image: &GrayImage) -> Vec<f32> {
    let mut sums = [(0_u32, 0_u32); PARTS.0 * PARTS.1];
    for y in (0..image.height()).step_by(STRIDE) {
        let row = y * PARTS.1 / image.height();
        for (x, value) in image.row(y).iter().enumerate().step_by(STRIDE) {
            let (sum, count) = &mut sums[row * PARTS.0 + x * PARTS.0 / image.width()];
            (*sum, *count) = (*sum + u32::from(*value), *count + 1);
        }
    }
    sums.iter().map(|&(sum, count)| sum as f32 / count.max(1) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A scene that has moved by so many pixels, as bright as this.
    fn scene(shift: f32, gain: f32) -> GrayImage {
        let value = |x: usize, y: usize| {
            let (u, v) = (x as f32 + shift, y as f32);
            60.0 + 25.0 * (0.05 * u).sin() + 20.0 * (0.08 * v + 0.02 * u).cos()
        };
        let data = (0..240).flat_map(|y| (0..320).map(move |x| (gain * value(x, y)).round() as u8)).collect();
        GrayImage::from_vec(320, 240, data).expect("an image")
    }

    fn difference(one: &GrayImage, other: &GrayImage) -> f32 {
        let differences = one.data().iter().zip(other.data()).map(|(a, b)| (*a as f32 - *b as f32).abs());
        differences.sum::<f32>() / one.data().len() as f32
    }

    #[test]
    fn jumps_are_undone_and_taken_back() {
        let mut exposure = Exposure::default();
        for (i, gain) in [1.0, 1.0, 0.25, 0.25, 0.5, 2.0, 2.0, 0.25, 1.0, 1.0].into_iter().enumerate() {
            let shift = 6.0 * i as f32;
            let even = exposure.even(scene(shift, gain));
            let off = difference(&even, &scene(shift, 1.0));
            assert!(off < 4.0, "frame {i}: {off}");
        }
        assert_eq!(exposure.log_gain, 0.0, "the first exposure is back");
        let last = scene(70.0, 1.0);
        assert!(exposure.even(last.clone()) == last);
    }

    #[test]
    fn what_glides_or_comes_into_view_is_left_as_it_is() {
        let mut exposure = Exposure::default();
        for i in 0..30 {
            let image = scene(15.0 * i as f32, 0.4 * 1.13_f32.powi(i.min(15)));
            assert!(exposure.even(image.clone()) == image, "frame {i}");
        }
        // A white wall comes to fill the left half at once, and is gone again.
        let mut with_wall = scene(500.0, 1.0);
        (0..240).for_each(|y| (0..160).for_each(|x| with_wall.set(x, y, 235)));
        for image in [scene(490.0, 1.0), with_wall, scene(510.0, 1.0)] {
            exposure.before = means(&scene(490.0, 1.0));
            assert!(exposure.even(image.clone()) == image);
        }
    }

    #[test]
    fn darkness_says_nothing_of_the_exposure() {
        let mut exposure = Exposure::default();
        for image in [scene(0.0, 1.0), GrayImage::filled(320, 240, 0), scene(5.0, 1.0)] {
            assert!(exposure.even(image.clone()) == image);
        }
    }
}
