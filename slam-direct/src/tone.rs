//! Dark and hazy recordings brought to the contrast that thresholds in grey levels are meant for.
//!
//! Gradients that make a point, the noise of a patch and what passes for agreement are all measured in grey levels of a
//! well exposed image. A dark or hazy one is stretched by one monotone curve, the same for all frames of a map, which patches
//! with gain and offset of their own do not notice; a well exposed one stays as it is, bit for bit.

use geometry::GrayImage;

/// A curve of intensities.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tone {
    /// Intensities that are brought to black and to white.
    range: [f32; 2],
    curve: [u8; 256],
}

/// An image whose brightest hundredth lies below this, or whose median below the other, is dark; grey levels.
const DARK: (f32, f32) = (128.0, 32.0);
/// The same above which it is dark no more.
const BRIGHT: (f32, f32) = (192.0, 48.0);
/// Below this there is nothing to see.
const BLACK: f32 = 16.0;
/// An image that is not dark and whose darkest and brightest hundredth are nearer than this is hazy; grey levels. Public recordings
/// of twenty cameras have them at 132 and more.
const HAZY: f32 = 96.0;
/// The same above which it is hazy no more.
const CLEAR: f32 = 128.0;
/// What later frames may exceed the range of a hazy one by on either side, as a share of it.
const MARGIN: f32 = 0.125;
/// Below this haze hides everything.
const BLANK: f32 = 16.0;
/// Gain at most: quantisation grows with it.
const MAX_GAIN: f32 = 8.0;
/// What the median is brought to.
const MIDDLE: f32 = 90.0;
/// Least exponent of the curve.
const MIN_EXPONENT: f32 = 0.45;
/// A curve is kept until the range that it is made for grows or shrinks by more than this factor, or shifts by as much of itself.
const HYSTERESIS: f32 = 1.5;

impl Tone {
    /// The curve for an image, after the one before it; `None` where none is needed.
    pub fn following(before: Option<Self>, image: &GrayImage) -> Option<Self> {
        let [black, median, white] = quantiles(image);
        let was_hazy = before.as_ref().map(Self::is_hazy);
        let limits = if was_hazy == Some(false) { BRIGHT } else { DARK };
        let is_dark = white < limits.0 || median < limits.1;
        let is_hazy = white - black < if was_hazy == Some(true) { CLEAR } else { HAZY };
        if white < BLACK || !is_dark && white - black < BLANK {
            return before;
        }
        let range = match (is_dark, is_hazy) {
            (true, _) => [0.0, white],
            (false, true) => {
                let margin = MARGIN * (white - black);
                [(black - margin).max(1.0), white + margin]
            }
            (false, false) => return None,
        };
        before.filter(|tone| tone.is_near(range)).or_else(|| Some(Self::new(range, median)))
    }

    fn new([black, white]: [f32; 2], median: f32) -> Self {
        let width = (white - black).clamp(255.0 / MAX_GAIN, 255.0);
        let share = ((median - black) / width).clamp(0.01, 0.9);
        let exponent = ((MIDDLE / 255.0).ln() / share.ln()).clamp(MIN_EXPONENT, 1.0);
        // The curve begins where its slope is bounded: black is mostly noise.
        let begin = 0.03 * width + 1.0;
        let raised = |v: f32| (v + begin).powf(exponent);
        let (low, high) = (raised(0.0), raised(width));
        let curve = std::array::from_fn(|v| {
            let v = (v as f32 - black).max(0.0);
            (255.0 * (raised(v) - low) / (high - low)).round().clamp(0.0, 255.0) as u8
        });
        Self { range: [black, black + width], curve }
    }

    /// Whether it was made for haze.
    fn is_hazy(&self) -> bool {
        self.range[0] > 0.0
    }

    /// Whether it does for an image of this range too.
    fn is_near(&self, [black, white]: [f32; 2]) -> bool {
        let (own, other) = (self.range[1] - self.range[0], white - black);
        let shift = (black - self.range[0]).abs();
        (own / other).max(other / own) <= HYSTERESIS && shift <= (HYSTERESIS - 1.0) * own
    }

    /// The image by the curve.
    pub fn apply(&self, image: &GrayImage) -> GrayImage {
        let data = image.data().iter().map(|&v| self.curve[usize::from(v)]).collect();
        GrayImage::from_vec(image.width(), image.height(), data).unwrap_or_else(|| image.clone())
    }
}

/// The intensity that a hundredth of the pixels stays below, the median, and the one that a hundredth exceeds.
fn quantiles(image: &GrayImage) -> [f32; 3] {
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
    [0.01, 0.5, 0.99].map(value)
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
        let [_, median, white] = quantiles(&tone.apply(&dark));
        assert!(white > 220.0 && median > 60.0, "{white} {median}");
        let kept = Tone::following(Some(tone.clone()), &ramp(2, 60));
        assert_eq!(kept, Some(tone.clone()), "a little more light changes nothing");
        assert_eq!(Tone::following(Some(tone.clone()), &ramp(0, 4)), Some(tone.clone()), "nor does a cover");
        assert_eq!(Tone::following(Some(tone), &ramp(10, 240)), None);
        assert_eq!(Tone::following(None, &ramp(0, 4)), None);
    }

    #[test]
    fn haze_is_stretched_and_what_is_blank_stays() {
        let haze = ramp(100, 160);
        let tone = Tone::following(None, &haze).expect("it is hazy");
        assert!(tone.curve.windows(2).all(|pair| pair[0] <= pair[1]));
        let [black, _, white] = quantiles(&tone.apply(&haze));
        assert!(black < 32.0 && white > 223.0, "{black} {white}");
        for near in [ramp(106, 160), ramp(95, 170), ramp(130, 138)] {
            assert_eq!(Tone::following(Some(tone.clone()), &near), Some(tone.clone()));
        }
        let dark = Tone::following(Some(tone.clone()), &ramp(2, 50)).expect("it is dark");
        assert!(!dark.is_hazy());
        assert_ne!(Tone::following(Some(dark), &haze), Some(tone.clone()), "its white is still dark");
        assert_eq!(Tone::following(Some(tone), &ramp(20, 180)), None);
        assert_eq!(Tone::following(None, &ramp(130, 138)), None);
    }
}
