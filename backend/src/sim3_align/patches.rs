//! Patches of one keyframe that are not in another at a given relative pose.
//!
//! What two keyframes of one place disagree in is noise, edges of what hides and what gleams: it lies scattered, and where
//! depths contradict each other by mistake the images still look alike. A thing that one place has and the other has not
//! is looked through as a whole, and what is seen instead looks otherwise (*absent*). What is flat, a notice or a wall,
//! looks otherwise alone (*unlike*): blur, noise and the angle of view make all patches of a pair less alike, so that a
//! patch is unlike where it is an outlier among those of its pair.

use super::KeyframeView;
use super::compare::{CompareParams, Met, Moved, Window};
use super::residual::sample;
use crate::params;
use geometry::{GrayImage, Sim3};
use nalgebra::Vector2;

params! {
    /// Parameters of the comparison of two keyframes patch by patch.
    pub struct PatchParams {
        /// Patches, which are square, along the width of an image. Range 4–64; fewer overlook small things, more leave
        /// too few points in each.
        pub columns: usize = 16,
        /// The finest pyramid level whose image is at most so wide is looked at, pixels. Range 40–2000; ten pixels a
        /// patch tell one look from another.
        pub max_width: usize = 200,
        /// Fewest points of a patch that are seen and not hidden. Range 4–1000; a tenth of a patch of ten pixels.
        pub min_points: usize = 12,
        /// A patch is looked through where more than this share of its points is. Range 0–1.
        pub through_share: f64 = 0.5,
        /// It looks the same where its intensities correlate with those in the target at least so much, at the shift
        /// within the window that suits best. Range 0–1.
        pub min_correlation: f64 = 0.5,
        /// A patch is unlike where one minus its correlation is above this, and above `outlier` times the median of its pair
        /// of keyframes. Range 0–2.
        pub min_dissimilarity: f64 = 0.6,
        /// See `min_dissimilarity`. Range 1–100; of right pairs, held by hand or rendered, 0.4 % of the points at most lie in
        /// such patches.
        pub outlier: f64 = 8.0,
        /// Least contrast of a patch whose look is asked, standard deviation of its intensities, grey levels. Range 0–100;
        /// half again the image noise.
        pub min_contrast: f64 = 6.0,
        /// Standard deviation of the image noise, grey levels, which lowers the correlation of what has no contrast. Range
        /// 0.5–20 (Engel 2014: 4).
        pub image_noise: f64 = 4.0,
    }
}

/// How many patches of a source are not in the target.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PatchComparison {
    /// Patches compared.
    pub patches: usize,
    /// Those that the target looks through, and that look otherwise there.
    pub absent: usize,
    /// Points of the patches compared.
    pub points: usize,
    /// Points of those that are absent.
    pub absent_points: usize,
    /// Patches with contrast that are unlike.
    pub unlike: usize,
    /// Points of patches with contrast.
    pub contrast_points: usize,
    /// Points of those that are unlike.
    pub unlike_points: usize,
}

impl PatchComparison {
    /// Both together.
    pub fn plus(self, other: Self) -> Self {
        Self {
            patches: self.patches + other.patches,
            absent: self.absent + other.absent,
            points: self.points + other.points,
            absent_points: self.absent_points + other.absent_points,
            unlike: self.unlike + other.unlike,
            contrast_points: self.contrast_points + other.contrast_points,
            unlike_points: self.unlike_points + other.unlike_points,
        }
    }

    /// Share of the points of all patches that lie in absent ones; 0 where there are none.
    pub fn absent_share(&self) -> f64 {
        self.absent_points as f64 / self.points.max(1) as f64
    }

    /// Share of the points of all patches with contrast that lie in unlike ones; 0 where there are none.
    pub fn unlike_share(&self) -> f64 {
        self.unlike_points as f64 / self.contrast_points.max(1) as f64
    }
}

/// A point of a patch: its intensity, and where the target should see it.
struct Seen {
    intensity: f64,
    pixel: Vector2<f64>,
    through: bool,
}

/// What becomes of the patches of `source` in `target`, one way. Depths are compared as `compare` says, at another level.
pub fn compare_patches(
    source: &KeyframeView,
    target: &KeyframeView,
    target_from_source: &Sim3,
    compare: &CompareParams,
    params: &PatchParams,
) -> PatchComparison {
    let last = source.levels().min(target.levels()) - 1;
    let width = source.pyramid().level(0).width();
    let level = (0..last).find(|&level| width >> level <= params.max_width).unwrap_or(last);
    let (from, to) = (source.camera().at_level(level), target.camera().at_level(level));
    let (own, image) = (source.pyramid().level(level), target.pyramid().level(level));
    let depth = target.depth(level);
    let side = own.width().div_ceil(params.columns.max(1)).max(1);
    let (columns, rows) = (own.width().div_ceil(side), own.height().div_ceil(side));
    let mut patches: Vec<Vec<Seen>> = (0..columns * rows).map(|_| Vec::new()).collect();
    for point in &source.depth(level).points {
        let Some(moved) = Moved::new(point, [&from, &to], target_from_source) else { continue };
        let pixel = moved.pixel;
        let margin = compare.radius as f64;
        let inside = |v: f64, size: usize| v >= margin && v < size as f64 - 1.0 - margin;
        if !(inside(pixel.x, image.width()) && inside(pixel.y, image.height())) {
            continue;
        }
        let window = Window::new([pixel.x.round() as usize, pixel.y.round() as usize], compare.radius, image);
        let met = window.depth(depth, &moved, compare);
        if matches!(met, Some(Met::Before)) {
            continue;
        }
        let (x, y) = (usize::from(point.x), usize::from(point.y));
        patches[y / side * columns + x / side].push(Seen {
            intensity: f64::from(own.get(x, y)),
            pixel,
            through: matches!(met, Some(Met::Behind)),
        });
    }
    patches.retain(|patch| patch.len() >= params.min_points.max(1));
    judge(&patches, image, compare.radius, params)
}

/// What becomes of patches, by where their points should be in an image.
fn judge(patches: &[Vec<Seen>], image: &GrayImage, radius: usize, params: &PatchParams) -> PatchComparison {
    let mut found = PatchComparison::default();
    // Points and dissimilarity of each patch with contrast.
    let mut looks: Vec<(usize, f64)> = Vec::new();
    for patch in patches {
        found.patches += 1;
        found.points += patch.len();
        let through = patch.iter().filter(|seen| seen.through).count();
        let is_through = through as f64 > params.through_share * patch.len() as f64;
        let has_contrast = contrast(patch) > params.min_contrast;
        if !(is_through || has_contrast) {
            continue;
        }
        let correlation = correlation(patch, image, radius, params);
        if is_through && correlation < params.min_correlation {
            found.absent += 1;
            found.absent_points += patch.len();
        }
        if has_contrast {
            looks.push((patch.len(), 1.0 - correlation));
        }
    }
    let mut sorted: Vec<f64> = looks.iter().map(|(_, dissimilarity)| *dissimilarity).collect();
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    let limit = params.min_dissimilarity.max(params.outlier * median);
    for (points, dissimilarity) in looks {
        found.contrast_points += points;
        if dissimilarity > limit {
            found.unlike += 1;
            found.unlike_points += points;
        }
    }
    found
}

/// Standard deviation of a patch's intensities, grey levels.
fn contrast(patch: &[Seen]) -> f64 {
    let n = patch.len().max(1) as f64;
    let mean = patch.iter().map(|seen| seen.intensity).sum::<f64>() / n;
    (patch.iter().map(|seen| (seen.intensity - mean).powi(2)).sum::<f64>() / n).sqrt()
}

/// The largest correlation of a patch's intensities with those of an image, −1 to 1, at shifts of up to `radius` pixels; any
/// that is high enough that the rest would not matter.
fn correlation(patch: &[Seen], image: &GrayImage, radius: usize, params: &PatchParams) -> f64 {
    let reach = radius as i32;
    let noise = params.image_noise * params.image_noise;
    let shifts = (-reach..=reach).flat_map(|y| (-reach..=reach).map(move |x| Vector2::new(x, y)));
    let at = |shift: Vector2<i32>| {
        let pairs = patch.iter().filter_map(|seen| {
            let pixel = seen.pixel + shift.cast::<f64>();
            Some([seen.intensity, sample(image, pixel.x, pixel.y)?.0])
        });
        let (mut n, mut sum, mut squares, mut product) = (0.0, [0.0; 2], [0.0; 2], 0.0);
        for [a, b] in pairs {
            n += 1.0;
            sum = [sum[0] + a, sum[1] + b];
            squares = [squares[0] + a * a, squares[1] + b * b];
            product += a * b;
        }
        let n = f64::max(n, 1.0);
        let deviation = |k: usize| (squares[k] / n - (sum[k] / n).powi(2) + noise).sqrt();
        (product / n - sum[0] * sum[1] / (n * n)) / (deviation(0) * deviation(1))
    };
    // Where half of the patches are more alike than this, the median does not decide; where not, it is another's.
    let enough = params.min_correlation.max(1.0 - params.min_dissimilarity / params.outlier.max(1.0));
    let mut best = at(Vector2::zeros());
    for shift in shifts {
        if best >= enough {
            break;
        }
        best = best.max(at(shift));
    }
    best
}
