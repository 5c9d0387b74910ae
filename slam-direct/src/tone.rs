//! Brings dark, hazy and noisy recordings to the contrast and noise for which thresholds in grey levels are meant.
//!
//! Several thresholds are in grey levels of a well exposed image: the gradient of a point, the noise of a patch, and
//! the residual that counts as agreement. A dark or hazy image is stretched by one monotone curve, the same for all
//! frames of a map; patches with a gain and offset of their own do not notice it. The curve stretches noise too.
//! Where there is more than recordings usually have, images are smoothed, which costs the finest detail. A well
//! exposed image without such noise stays as it is, bit for bit.

use geometry::GrayImage;

/// What is done to the images of a map.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tone {
    exposure: Exposure,
    /// Intensities that are brought to black and to white.
    range: [f32; 2],
    /// Of every intensity in steps of one [`FINE`]th.
    curve: Vec<u8>,
    /// Whether images are smoothed before.
    smooths: bool,
}

/// What is wrong with the light in an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Exposure {
    Dark,
    Hazy,
    Good,
}

/// Steps of the curve to one grey level: smoothed images have levels in between.
const FINE: usize = 16;
/// Deviation of the noise after stretching, grey levels, above which images are smoothed. Recordings have less: a hand-held camera
/// 0.7, a street from a car 1.7 at most, rendered pavement whose grain looks like noise 4.7. With noise of 4 drawn into them
/// smoothing makes four of five recordings more exact and none less, with 2 two of five less.
const NOISY: f32 = 5.0;
/// The same below which they are smoothed no more.
const CALM: f32 = 4.0;
/// The median of the absolute values of a normal distribution, in deviations.
const MEDIAN_OF_NORMAL: f32 = 0.6745;

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
    /// The correction of an image, given that of the one before it; `None` where there is none.
    pub fn following(before: Option<Self>, image: &GrayImage) -> Option<Self> {
        let [black, median, white] = quantiles(image);
        let was = before.as_ref().map(|tone| tone.exposure);
        let limits = if was == Some(Exposure::Dark) { BRIGHT } else { DARK };
        let is_dark = white < limits.0 || median < limits.1;
        let is_hazy = white - black < if was == Some(Exposure::Hazy) { CLEAR } else { HAZY };
        if white < BLACK || !is_dark && white - black < BLANK {
            return before;
        }
        let (exposure, range) = match (is_dark, is_hazy) {
            (true, _) => (Exposure::Dark, [0.0, white]),
            (false, true) => {
                let margin = MARGIN * (white - black);
                (Exposure::Hazy, [(black - margin).max(1.0), white + margin])
            }
            (false, false) => (Exposure::Good, [0.0, 255.0]),
        };
        let noise = noise(image);
        let is_near = |tone: &Self| tone.exposure == exposure && tone.is_near(range, noise);
        if let Some(tone) = before.filter(is_near) {
            return Some(tone);
        }
        let is_fine = exposure == Exposure::Good && stretched(noise, range[1] - range[0]) <= NOISY;
        (!is_fine).then(|| Self::new(exposure, range, median, noise))
    }

    fn new(exposure: Exposure, [black, white]: [f32; 2], median: f32, noise: f32) -> Self {
        let width = (white - black).clamp(255.0 / MAX_GAIN, 255.0);
        let share = ((median - black) / width).clamp(0.01, 0.9);
        let exponent = match exposure {
            Exposure::Good => 1.0,
            _ => ((MIDDLE / 255.0).ln() / share.ln()).clamp(MIN_EXPONENT, 1.0),
        };
        // The curve begins where its slope is bounded: black is mostly noise.
        let begin = 0.03 * width + 1.0;
        let raised = |v: f32| (v + begin).powf(exponent);
        let (low, high) = (raised(0.0), raised(width));
        let of = |step: usize| {
            let v = (step as f32 / FINE as f32 - black).max(0.0);
            (255.0 * (raised(v) - low) / (high - low)).round().clamp(0.0, 255.0) as u8
        };
        let curve = (0..=255 * FINE).map(of).collect();
        Self { exposure, range: [black, black + width], curve, smooths: stretched(noise, width) > NOISY }
    }

    /// Whether it does for an image of this range and noise too.
    fn is_near(&self, [black, white]: [f32; 2], noise: f32) -> bool {
        let (own, other) = (self.range[1] - self.range[0], white - black);
        let shift = (black - self.range[0]).abs();
        let is_like = (own / other).max(other / own) <= HYSTERESIS && shift <= (HYSTERESIS - 1.0) * own;
        let noise = stretched(noise, own);
        is_like && if self.smooths { noise > CALM } else { noise <= NOISY }
    }

    /// The image by the curve.
    pub fn apply(&self, image: &GrayImage) -> GrayImage {
        let data = match self.smooths {
            true => smoothed(image).into_iter().map(|step| self.curve[usize::from(step)]).collect(),
            false => image.data().iter().map(|&v| self.curve[FINE * usize::from(v)]).collect(),
        };
        GrayImage::from_vec(image.width(), image.height(), data).unwrap_or_else(|| image.clone())
    }
}

/// What becomes of noise where a range of so many grey levels is brought to all there are.
fn stretched(noise: f32, width: f32) -> f32 {
    noise * 255.0 / width
}

/// An image smoothed by 1-2-1 in both directions, in steps of one [`FINE`]th, its sum of weights; the border repeats itself.
fn smoothed(image: &GrayImage) -> Vec<u16> {
    let (width, height) = (image.width(), image.height());
    let three = |before: u16, here: u16, after: u16| before + 2 * here + after;
    let mut out = Vec::with_capacity(width * height);
    let mut columns = vec![0_u16; width];
    for y in 0..height {
        let rows = [y.saturating_sub(1), y, (y + 1).min(height - 1)].map(|y| image.row(y));
        for (x, sum) in columns.iter_mut().enumerate() {
            *sum = three(rows[0][x].into(), rows[1][x].into(), rows[2][x].into());
        }
        let at = |x: usize| three(columns[x.saturating_sub(1)], columns[x], columns[(x + 1).min(width - 1)]);
        out.extend((0..width).map(at));
    }
    out
}

/// Deviation of an image's noise, grey levels: what the mask of Immerkær (CVIU 1996), which straight edges and even slopes do not
/// pass, leaves in the median.
fn noise(image: &GrayImage) -> f32 {
    let inner = |size: usize| (1..size.saturating_sub(1)).step_by(3);
    let mut left = Vec::new();
    for y in inner(image.height()) {
        let rows = [y - 1, y, y + 1].map(|y| image.row(y));
        let second =
            |row: &[u8], x: usize| i32::from(row[x - 1]) - 2 * i32::from(row[x]) + i32::from(row[x + 1]);
        left.extend(
            inner(image.width())
                .map(|x| (second(rows[0], x) - 2 * second(rows[1], x) + second(rows[2], x)).unsigned_abs()),
        );
    }
    let middle = left.len() / 2;
    if left.is_empty() {
        return 0.0;
    }
    // The squares of the mask's weights sum up to 36.
    *left.select_nth_unstable(middle).1 as f32 / 6.0 / MEDIAN_OF_NORMAL
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
        let value = |i: usize| {
            let share = i as f32 / (width * height) as f32;
            least + (share * (f32::from(most) - f32::from(least))) as u8
        };
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

    /// A scene as bright as this, with noise of this deviation.
    fn scene(gain: f32, deviation: f32) -> GrayImage {
        let (width, height, mut random) = (160, 120, geometry::Random::new(1));
        let value = |i: usize| {
            let (x, y) = ((i % width) as f32, (i / width) as f32);
            let edges = if (x / 20.0) as u32 % 2 == (y / 15.0) as u32 % 2 { 60.0 } else { 0.0 };
            120.0 + edges + 40.0 * (0.07 * x + 0.05 * y).sin()
        };
        let noisy =
            |i| (gain * value(i) + deviation * random.normal() as f32).round().clamp(0.0, 255.0) as u8;
        GrayImage::from_vec(width, height, (0..width * height).map(noisy).collect()).unwrap()
    }

    #[test]
    fn noise_is_distinguished_from_edges() {
        for deviation in [0.0, 1.0, 2.0, 4.0] {
            let found = noise(&scene(1.0, deviation));
            assert!((found - deviation).abs() < 0.25 * deviation + 0.3, "{found} of {deviation}");
        }
    }

    #[test]
    fn dark_images_are_smoothed_where_their_noise_would_be_stretched_beyond_what_is_borne() {
        let clean = Tone::following(None, &scene(0.125, 0.0)).expect("it is dark");
        assert!(!clean.smooths);
        let image = scene(0.125, 1.0);
        let tone = Tone::following(None, &image).expect("it is dark");
        let stretched = Tone { smooths: false, ..tone.clone() };
        let (smooth, raw) = (noise(&tone.apply(&image)), noise(&stretched.apply(&image)));
        assert!(tone.smooths && raw > NOISY && smooth < 0.5 * raw, "{smooth} of {raw}");
        // What is even stays what it is, to the border.
        let even = GrayImage::filled(160, 120, 20);
        assert!(tone.apply(&even) == stretched.apply(&even));
    }

    #[test]
    fn a_noisy_image_is_smoothed_and_nothing_else() {
        assert_eq!(Tone::following(None, &scene(1.0, 2.0)), None);
        let noisy = scene(1.0, 8.0);
        let tone = Tone::following(None, &noisy).expect("it is noisy");
        let smooth = tone.apply(&noisy);
        assert!(tone.smooths && noise(&smooth) < 0.5 * noise(&noisy));
        let mean = |image: &GrayImage| {
            image.data().iter().map(|&v| f64::from(v)).sum::<f64>() / image.data().len() as f64
        };
        assert!((mean(&smooth) - mean(&noisy)).abs() < 0.5, "it is as bright as before");
        assert_eq!(Tone::following(Some(tone.clone()), &scene(1.0, 4.7)), Some(tone.clone()));
        assert_eq!(Tone::following(None, &scene(1.0, 4.7)), None);
        assert_eq!(Tone::following(Some(tone), &scene(1.0, 2.0)), None);
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
        assert_eq!(dark.exposure, Exposure::Dark);
        assert_ne!(Tone::following(Some(dark), &haze), Some(tone.clone()), "its white is still dark");
        assert_eq!(Tone::following(Some(tone), &ramp(20, 180)), None);
        assert_eq!(Tone::following(None, &ramp(130, 138)), None);
    }
}
