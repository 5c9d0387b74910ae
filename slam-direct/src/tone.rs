//! Dark recordings brought to the contrast that thresholds in grey levels are meant for.
//!
//! Gradients that make a point, the noise of a patch and what passes for agreement are all measured in grey levels of a
//! well exposed image. A dark one is brightened by one monotone curve, the same for all frames of a map, which patches
//! with gain and offset of their own do not notice; a well exposed one stays as it is, bit for bit.

use geometry::GrayImage;

/// A curve of intensities.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tone {
    /// Intensity that is brought to white.
    white: f32,
    curve: [u8; 256],
}

/// An image whose brightest hundredth lies below this, or whose median below the other, is dark; grey levels.
const DARK: (f32, f32) = (128.0, 32.0);
/// The same above which it is dark no more.
const BRIGHT: (f32, f32) = (192.0, 48.0);
/// Below this there is nothing to see.
const BLACK: f32 = 16.0;
/// Gain at most: quantisation grows with it.
const MAX_GAIN: f32 = 8.0;
/// What the median is brought to.
const MIDDLE: f32 = 90.0;
/// Least exponent of the curve.
const MIN_EXPONENT: f32 = 0.45;
/// A curve is kept until white changes by more than this factor.
const HYSTERESIS: f32 = 1.5;

impl Tone {
    /// The curve for an image, after the one before it; `None` where none is needed.
    pub fn following(before: Option<Self>, image: &GrayImage) -> Option<Self> {
        let (white, median) = quantiles(image);
        if white < BLACK {
            return before;
        }
        let dark = |limits: (f32, f32)| white < limits.0 || median < limits.1;
        match before {
            None => dark(DARK).then(|| Self::new(white, median)),
            Some(_) if !dark(BRIGHT) => None,
            Some(tone) if (white / tone.white).max(tone.white / white) <= HYSTERESIS => Some(tone),
            Some(_) => Some(Self::new(white, median)),
        }
    }

    fn new(white: f32, median: f32) -> Self {
        let white = white.clamp(255.0 / MAX_GAIN, 255.0);
        let share = (median / white).clamp(0.01, 0.9);
        let exponent = ((MIDDLE / 255.0).ln() / share.ln()).clamp(MIN_EXPONENT, 1.0);
        // The curve begins where its slope is bounded: black is mostly noise.
        let begin = 0.03 * white + 1.0;
        let raised = |v: f32| (v + begin).powf(exponent);
        let (low, high) = (raised(0.0), raised(white));
        let curve = std::array::from_fn(|v| {
            (255.0 * (raised(v as f32) - low) / (high - low)).round().clamp(0.0, 255.0) as u8
        });
        Self { white, curve }
    }

    /// The image by the curve.
    pub fn apply(&self, image: &GrayImage) -> GrayImage {
        let data = image.data().iter().map(|&v| self.curve[usize::from(v)]).collect();
        GrayImage::from_vec(image.width(), image.height(), data).unwrap_or_else(|| image.clone())
    }
}

/// The intensity that a hundredth of the pixels exceeds, and the median.
fn quantiles(image: &GrayImage) -> (f32, f32) {
    let mut counts = [0usize; 256];
    let mut total = 0;
    for &v in image.data().iter().step_by(7) {
        counts[usize::from(v)] += 1;
        total += 1;
    }
    let at = |share: f32| {
        let mut left = (share * total as f32) as usize;
        counts.iter().position(|&count| {
            let here = left < count;
            left = left.saturating_sub(count);
            here
        })
    };
    let value = |share| at(share).unwrap_or(255) as f32;
    (value(0.99), value(0.5))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(least: u8, most: u8) -> GrayImage {
        let (width, height) = (64, 48);
        let value =
            |i: usize| least + ((i * 37 % 4001) as f32 / 4001.0 * (f32::from(most) - f32::from(least))) as u8;
        GrayImage::from_vec(width, height, (0..width * height).map(value).collect()).unwrap()
    }

    #[test]
    fn a_well_exposed_image_stays() {
        assert_eq!(Tone::following(None, &ramp(10, 240)), None);
    }

    #[test]
    fn a_dark_image_is_brightened_and_order_kept() {
        let dark = ramp(2, 50);
        let tone = Tone::following(None, &dark).expect("it is dark");
        assert!(tone.curve.windows(2).all(|pair| pair[0] <= pair[1]));
        let (white, median) = quantiles(&tone.apply(&dark));
        assert!(white > 220.0 && median > 60.0, "{white} {median}");
        let kept = Tone::following(Some(tone.clone()), &ramp(2, 60));
        assert_eq!(kept, Some(tone.clone()), "a little more light changes nothing");
        assert_eq!(Tone::following(Some(tone.clone()), &ramp(0, 4)), Some(tone.clone()), "nor does a cover");
        assert_eq!(Tone::following(Some(tone), &ramp(10, 240)), None);
        assert_eq!(Tone::following(None, &ramp(0, 4)), None);
    }
}
