//! The response of a sensor from images of one still scene at different exposures.

use geometry::GrayImage;
use nalgebra::Vector2;
use thiserror::Error;

/// Most pixels that are used, spread over the image.
const MAX_PIXELS: usize = 6000;
/// Fewest images.
const MIN_IMAGES: usize = 6;
/// Least ratio of longest and shortest exposure.
const MIN_RATIO: f64 = 4.0;
/// Largest part of the 254 levels between black and white that no pixel shows.
const MAX_MISSING: f64 = 0.3;
/// Least growth from one level to the next, as a share of the mean one: noise must not turn the curve around.
const MIN_GROWTH: f64 = 1e-3;
/// Largest rms of the fit, grey levels.
const MAX_RMS: f64 = 12.0;

/// A response as it was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    /// The inverse response: relative irradiance of each grey level, growing, 0 to 255.
    pub inverse: [f64; 256],
    /// Root mean square difference of `U(I)` and exposure times irradiance, in units of the inverse response.
    pub rms: f64,
    /// How many of the levels 1 to 254 were seen.
    pub levels_seen: usize,
}

/// Why images make no response.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ResponseError {
    /// Too few images.
    #[error(
        "{found} images are too few, {MIN_IMAGES} are needed\nhint: take 30 or more, from very dark to very bright"
    )]
    TooFew {
        /// Images given.
        found: usize,
    },
    /// Images differ in size.
    #[error("image {index} has another size than the first\nhint: take all images in one mode of the camera")]
    Size {
        /// Index of the image.
        index: usize,
    },
    /// An exposure is not positive.
    #[error(
        "the exposure of image {index} is {value}\nhint: give exposure times above zero, in one unit for all"
    )]
    Exposure {
        /// Index of the image.
        index: usize,
        /// What was given.
        value: f64,
    },
    /// Exposures are too alike.
    #[error(
        "the longest exposure is {ratio:.1} times the shortest, at least {MIN_RATIO} times is needed\nhint: sweep the exposure farther"
    )]
    Range {
        /// Longest by shortest.
        ratio: f64,
    },
    /// Too many grey levels do not occur.
    #[error(
        "{missing} of 254 grey levels occur nowhere\nhint: sweep the exposure in smaller steps, from a nearly black to a nearly white image, of a scene with light and dark places"
    )]
    Levels {
        /// Levels that do not occur.
        missing: usize,
    },
    /// The images do not follow one curve.
    #[error(
        "the images do not follow one response curve (rms {rms:.1} of 255)\nhint: keep camera and scene still, the light constant, gain and white balance fixed, and check that the exposures belong to the images"
    )]
    Fit {
        /// Root mean square difference.
        rms: f64,
    },
}

/// Estimates the response: minimises `Σ (U(I_i(x)) − t_i B(x))²` over the inverse response U and the irradiance B (Engel
/// 2016, "A Photometrically Calibrated Benchmark For Monocular Visual Odometry", §2.2.1). White pixels say only
/// that they are bright, black ones that they are dark: neither counts.
///
/// # Errors
/// When the images do not determine a response.
pub fn estimate_response(images: &[(GrayImage, f64)]) -> Result<Response, ResponseError> {
    check(images)?;
    let samples = samples(images);
    let seen = counts(&samples);
    let missing = (1..255).filter(|level| seen[*level] == 0).count();
    if missing as f64 > MAX_MISSING * 254.0 {
        return Err(ResponseError::Levels { missing });
    }
    let inverse = best_inverse(&samples, &seen).ok_or(ResponseError::Levels { missing })?;
    let rms = rms(&samples, &inverse);
    if rms > MAX_RMS {
        return Err(ResponseError::Fit { rms });
    }
    Ok(Response { inverse: increasing(&inverse), rms, levels_seen: 254 - missing })
}

/// The text of `pcalib.txt`, as [`read_photometric`](crate::read_photometric) reads it.
pub fn format_response(response: &Response) -> String {
    let values: Vec<String> = response.inverse.iter().map(|value| format!("{value:.6}")).collect();
    values.join(" ") + "\n"
}

fn check(images: &[(GrayImage, f64)]) -> Result<(), ResponseError> {
    if images.len() < MIN_IMAGES {
        return Err(ResponseError::TooFew { found: images.len() });
    }
    let size = (images[0].0.width(), images[0].0.height());
    for (index, (image, exposure)) in images.iter().enumerate() {
        if (image.width(), image.height()) != size {
            return Err(ResponseError::Size { index });
        }
        if !(exposure.is_finite() && *exposure > 0.0) {
            return Err(ResponseError::Exposure { index, value: *exposure });
        }
    }
    let exposures = || images.iter().map(|(_, exposure)| *exposure);
    let ratio = exposures().fold(0.0, f64::max) / exposures().fold(f64::INFINITY, f64::min);
    if ratio < MIN_RATIO { Err(ResponseError::Range { ratio }) } else { Ok(()) }
}

/// Of some pixels what each image shows there: level and exposure, without black and white.
fn samples(images: &[(GrayImage, f64)]) -> Vec<Vec<(u8, f64)>> {
    let pixels = images[0].0.data().len();
    let step = pixels.div_ceil(MAX_PIXELS).max(1);
    let longest = images.iter().map(|(_, exposure)| *exposure).fold(0.0, f64::max);
    let of_pixel = |i: usize| {
        let all = images.iter().map(|(image, exposure)| (image.data()[i], exposure / longest));
        all.filter(|(level, _)| (1..255).contains(level)).collect::<Vec<_>>()
    };
    (0..pixels).step_by(step).map(of_pixel).filter(|sample| sample.len() >= 2).collect()
}

fn counts(samples: &[Vec<(u8, f64)>]) -> [usize; 256] {
    let mut seen = [0; 256];
    samples.iter().flatten().for_each(|(level, _)| seen[*level as usize] += 1);
    seen
}

/// The irradiance that fits one pixel best, for a given inverse response.
fn irradiance(sample: &[(u8, f64)], inverse: &[f64; 256]) -> f64 {
    let above: f64 = sample.iter().map(|(level, t)| t * inverse[*level as usize]).sum();
    above / sample.iter().map(|(_, t)| t * t).sum::<f64>()
}

/// The inverse response with the least `Σ (U(I) − t B)²` for its size `Σ U(I)²`. With the best B put in, that is
/// `uᵀ (D − Σ s sᵀ / Σ t²) u` where D counts levels and s adds up a pixel's exposures by level: an eigenvalue problem.
fn best_inverse(samples: &[Vec<(u8, f64)>], seen: &[usize; 256]) -> Option<[f64; 256]> {
    let levels: Vec<usize> = (1..255).filter(|level| seen[*level] > 0).collect();
    let n = levels.len();
    let mut place = [0; 256];
    levels.iter().enumerate().for_each(|(i, level)| place[*level] = i);
    let mut sum = vec![0.0; n * n];
    for sample in samples {
        let weight = 1.0 / sample.iter().map(|(_, t)| t * t).sum::<f64>();
        for (a, s) in sample {
            for (b, t) in sample {
                sum[place[*a as usize] * n + place[*b as usize]] += s * t * weight;
            }
        }
    }
    let root: Vec<f64> = levels.iter().map(|level| (seen[*level] as f64).sqrt()).collect();
    let matrix = faer::Mat::<f64>::from_fn(n, n, |i, j| sum[i * n + j] / (root[i] * root[j]));
    let eigen = matrix.self_adjoint_eigen(faer::Side::Lower).ok()?;
    let vector = eigen.U().col(n - 1);
    let sign = (0..n).map(|i| vector[i]).sum::<f64>().signum();
    let known: Vec<(f64, f64)> =
        levels.iter().enumerate().map(|(i, level)| (*level as f64, sign * vector[i] / root[i])).collect();
    let mut inverse: [f64; 256] = std::array::from_fn(|level| interpolated(&known, level as f64));
    let scale = 255.0 / inverse[255];
    inverse.iter_mut().for_each(|value| *value *= scale);
    inverse.iter().all(|value| value.is_finite()).then_some(inverse)
}

/// Between the known levels by a straight line; beyond them as the last 16 go.
fn interpolated(known: &[(f64, f64)], level: f64) -> f64 {
    let after = known.partition_point(|(at, _)| *at < level);
    let line = |a: (f64, f64), b: (f64, f64)| a.1 + (b.1 - a.1) * (level - a.0) / (b.0 - a.0).max(1e-9);
    let last = known.len().saturating_sub(1);
    match known.get(after) {
        Some(&(at, value)) if at == level => value,
        Some(&next) if after > 0 => line(known[after - 1], next),
        Some(_) => line(known[0], known[last.min(4)]).max(0.0),
        None => line(known[last.saturating_sub(16)], known[last]),
    }
}

fn rms(samples: &[Vec<(u8, f64)>], inverse: &[f64; 256]) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for sample in samples {
        let irradiance = irradiance(sample, inverse);
        for (level, t) in sample {
            sum += (inverse[*level as usize] - t * irradiance).powi(2);
            count += 1;
        }
    }
    (sum / count.max(1) as f64).sqrt()
}

/// The curve made to grow (pool adjacent violators), from 0 to 255.
fn increasing(values: &[f64; 256]) -> [f64; 256] {
    let mut blocks: Vec<Vector2<f64>> = Vec::new();
    for value in values {
        let mut block = Vector2::new(*value, 1.0);
        while let Some(before) = blocks.last().filter(|before| before.x / before.y >= block.x / block.y) {
            block += *before;
            blocks.pop();
        }
        blocks.push(block);
    }
    let flat = blocks.iter().flat_map(|block| std::iter::repeat_n(block.x / block.y, block.y as usize));
    let flat: Vec<f64> = flat.collect();
    let (first, last) = (flat[0], flat[255]);
    let least = MIN_GROWTH * (last - first).max(1e-9) / 255.0;
    let mut out = [0.0; 256];
    for level in 1..256 {
        out[level] = out[level - 1] + (flat[level] - flat[level - 1]).max(least);
    }
    let scale = 255.0 / out[255];
    out.map(|value| value * scale)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solver::tests::Noise;

    /// A scene of irradiance 0.02 to 1 seen through `response` (of 0–1 to 0–1); what is brighter than white is white in
    /// spite of the noise.
    fn sweep(response: impl Fn(f64) -> f64, noise: f64) -> Vec<(GrayImage, f64)> {
        let mut random = Noise::new(11);
        let scene: Vec<f64> = (0..64 * 48).map(|_| 0.02 + 0.98 * random.uniform().powi(2)).collect();
        (0..40)
            .map(|i| {
                let exposure = 0.05 * 1.13f64.powi(i);
                let level = |b: &f64, r: f64| {
                    (255.0 * response(b * exposure) + noise * r).round().clamp(0.0, 255.0) as u8
                };
                let data = scene.iter().map(|b| level(b, random.normal())).collect();
                (GrayImage::from_vec(64, 48, data).unwrap(), exposure)
            })
            .collect()
    }

    #[test]
    fn a_gamma_is_found_again() {
        for gamma in [1.0, 2.2] {
            let found = estimate_response(&sweep(|light| light.powf(1.0 / gamma), 1.0)).unwrap();
            for level in 5..250 {
                let truth = 255.0 * (level as f64 / 255.0).powf(gamma);
                let error = (found.inverse[level] - truth).abs();
                assert!(error < 3.0, "gamma {gamma}: level {level} is {error:.2} of 255 off");
            }
            assert!(found.inverse.windows(2).all(|pair| pair[1] > pair[0]));
        }
    }

    #[test]
    fn useless_sweeps_are_refused() {
        let images = sweep(|light| light, 1.0);
        let message = |images: &[(GrayImage, f64)]| estimate_response(images).unwrap_err().to_string();
        assert!(message(&images[..3]).contains("too few"));
        assert!(message(&images[..8]).contains("longest exposure"));
        let mut wrong = images.clone();
        wrong[2].1 = f64::NAN;
        assert!(message(&wrong).contains("exposure of image 2"));
        let mut shuffled = images.clone();
        let exposures: Vec<f64> = images.iter().map(|(_, exposure)| *exposure).collect();
        shuffled.iter_mut().enumerate().for_each(|(i, image)| image.1 = exposures[(i * 17) % 40]);
        assert!(message(&shuffled).contains("one response curve"));
        let dark: Vec<_> = images
            .iter()
            .map(|(image, t)| (GrayImage::filled(64, 48, image.data()[0] / 9 + 1), *t))
            .collect();
        assert!(message(&dark).contains("grey levels occur nowhere"));
    }
}
