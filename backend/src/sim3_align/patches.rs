//! Patches of one keyframe that are not in another at a given relative pose.
//!
//! What two keyframes of one place disagree in is noise, edges of what hides and what gleams: it lies scattered, and where
//! depths contradict each other by mistake the images still look alike. A thing that one place has and the other has not
//! is looked through as a whole, and what is seen instead looks otherwise (*absent*). What is flat, a notice or a wall,
//! looks otherwise alone (*unlike*): blur, noise and the angle of view make all patches of a pair less alike, so that a
//! patch is unlike where it is an outlier among those of its pair, and so are most around it: fine stripes seen from aside
//! are unlike in strips at the border of what is seen. Every point is the middle of a patch of its own: of a thing
//! as small as a patch, most patches of a fixed grid would hold half of it and half of what it stands before.

use super::KeyframeView;
use super::compare::{CompareParams, Met, Moved, Window};
use super::residual::sample;
use crate::params;
use geometry::{GrayImage, Sim3};
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

params! {
    /// Parameters of the comparison of two keyframes patch by patch.
    pub struct PatchParams {
        /// Patches, which are square, that the width of an image has room for. Range 4–64; fewer overlook small things, more
        /// leave too few points in each.
        pub columns: usize = 16,
        /// The finest pyramid level whose image is at most so wide is looked at, pixels. Range 40–2000; ten pixels a
        /// patch tell one look from another.
        pub max_width: usize = 200,
        /// Fewest points of a patch that are seen and not hidden. Range 4–1000; a tenth of a patch of eleven pixels.
        pub min_points: usize = 12,
        /// A patch is looked through where more than this share of its points is. Range 0–1.
        pub through_share: f64 = 0.5,
        /// It looks the same where its intensities correlate with those in the target at least so much, at the shift
        /// within the window that suits best. Range 0–1.
        pub min_correlation: f64 = 0.5,
        /// A patch is unlike where one minus its correlation is above this, and above `outlier` times the median of its pair
        /// of keyframes. Range 0–2.
        pub min_dissimilarity: f64 = 0.6,
        /// See `min_dissimilarity`. Range 1–100.
        pub outlier: f64 = 8.0,
        /// Least share of the patches around a point, as far apart as one is wide, that must be unlike with its own. Range 0–1.
        /// Of right pairs, held by hand or rendered, 0.5 % of the points at most are left, without this 2 %.
        pub unlike_around: f64 = 0.6,
        /// Least contrast of a patch whose look is asked, standard deviation of its intensities, grey levels. Range 0–100;
        /// half again the image noise.
        pub min_contrast: f64 = 6.0,
        /// Standard deviation of the image noise, grey levels, which lowers the correlation of what has no contrast. Range
        /// 0.5–20 (Engel 2014: 4).
        pub image_noise: f64 = 4.0,
    }
}

/// How much of sources is not in their targets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PatchComparison {
    /// Comparisons, each one way, in which there are points with a patch around them.
    pub views: usize,
    /// Points with a patch around them.
    pub points: usize,
    /// Those whose patches the target looks through, and that look otherwise there.
    pub absent: usize,
    /// Comparisons, each one way, in which there are such.
    pub absent_views: usize,
    /// Points whose patches have contrast.
    pub with_contrast: usize,
    /// Of these, those whose patches are unlike, with most around them.
    pub unlike: usize,
    /// Comparisons, each one way, in which there are such.
    pub unlike_views: usize,
}

impl PatchComparison {
    /// Both together.
    pub fn plus(self, other: Self) -> Self {
        Self {
            views: self.views + other.views,
            points: self.points + other.points,
            absent: self.absent + other.absent,
            absent_views: self.absent_views + other.absent_views,
            with_contrast: self.with_contrast + other.with_contrast,
            unlike: self.unlike + other.unlike,
            unlike_views: self.unlike_views + other.unlike_views,
        }
    }

    /// Share of the points whose patches are absent; 0 where there are none.
    pub fn absent_share(&self) -> f64 {
        self.absent as f64 / self.points.max(1) as f64
    }

    /// Share of the points with contrast around them whose patches are unlike; 0 where there are none.
    pub fn unlike_share(&self) -> f64 {
        self.unlike as f64 / self.with_contrast.max(1) as f64
    }
}

/// A point of the source that the target sees.
struct Seen {
    /// Its place in the source's image, by rows.
    slot: usize,
    intensity: f64,
    /// Where the target should see it.
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
    let seen = source.depth(level).points.iter().filter_map(|point| {
        let moved = Moved::new(point, [&from, &to], target_from_source)?;
        let pixel = moved.pixel;
        let margin = compare.radius as f64;
        let inside = |v: f64, size: usize| v >= margin && v < size as f64 - 1.0 - margin;
        if !(inside(pixel.x, image.width()) && inside(pixel.y, image.height())) {
            return None;
        }
        let window = Window::new([pixel.x.round() as usize, pixel.y.round() as usize], compare.radius, image);
        let met = window.depth(depth, &moved, compare);
        let (x, y) = (usize::from(point.x), usize::from(point.y));
        // What a nearer surface hides is no contradiction.
        (!matches!(met, Some(Met::Before))).then(|| Seen {
            slot: y * own.width() + x,
            intensity: f64::from(own.get(x, y)),
            pixel,
            through: matches!(met, Some(Met::Behind)),
        })
    });
    let radius = own.width().div_ceil(params.columns.max(1)) / 2;
    let patches = Patches { seen: seen.collect(), width: own.width(), height: own.height(), radius };
    judge(&patches, image, compare.radius, params)
}

/// Points, each with those around it: its patch.
struct Patches {
    seen: Vec<Seen>,
    width: usize,
    height: usize,
    /// Half the width of a patch, pixels.
    radius: usize,
}

impl Patches {
    /// Sums of several values of the points, by their numbers, over the patch of each.
    fn sums<const N: usize>(&self, values: impl Fn(usize) -> [f64; N]) -> Vec<[f64; N]> {
        let mut sums = vec![[0.0; N]; self.width * self.height];
        for (i, seen) in self.seen.iter().enumerate() {
            sums[seen.slot] = values(i);
        }
        let mut before = vec![[0.0; N]; self.width + 1];
        for row in sums.chunks_exact_mut(self.width) {
            let mut sum = [0.0; N];
            for (before, value) in before[1..].iter_mut().zip(&*row) {
                sum = each(sum, *value, |a, b| a + b);
                *before = sum;
            }
            for (i, value) in row.iter_mut().enumerate() {
                let end = (i + self.radius + 1).min(self.width);
                *value = each(before[end], before[i.saturating_sub(self.radius)], |a, b| a - b);
            }
        }
        // All columns at a time.
        let mut above = vec![[0.0; N]; self.width * (self.height + 1)];
        for (y, row) in sums.chunks_exact(self.width).enumerate() {
            let (done, next) = above.split_at_mut((y + 1) * self.width);
            for ((next, done), value) in next.iter_mut().zip(&done[y * self.width..]).zip(row) {
                *next = each(*done, *value, |a, b| a + b);
            }
        }
        let at = |slot: usize| {
            let (x, y) = (slot % self.width, slot / self.width);
            let [top, end] = [y.saturating_sub(self.radius), (y + self.radius + 1).min(self.height)];
            each(above[end * self.width + x], above[top * self.width + x], |a, b| a - b)
        };
        self.seen.iter().map(|seen| at(seen.slot)).collect()
    }

    /// How many points of each patch are so.
    fn counts(&self, of: impl Fn(usize) -> bool) -> Vec<f64> {
        self.sums(|i| [f64::from(u8::from(of(i)))]).into_iter().map(|[count]| count).collect()
    }
}

/// Of every two values that stand at the same place.
#[inline(always)]
fn each<const N: usize>(a: [f64; N], b: [f64; N], of: impl Fn(f64, f64) -> f64) -> [f64; N] {
    std::array::from_fn(|i| of(a[i], b[i]))
}

/// What becomes of patches, by where their points should be in an image.
fn judge(patches: &Patches, image: &GrayImage, radius: usize, params: &PatchParams) -> PatchComparison {
    let counts = patches.counts(|_| true);
    let through = patches.counts(|i| patches.seen[i].through);
    let own = patches.sums(|i| [patches.seen[i].intensity, patches.seen[i].intensity.powi(2)]);
    let own: Vec<Moments> = own.iter().zip(&counts).map(|(sums, count)| Moments::new(sums, *count)).collect();
    let similar = correlations(patches, &own, &counts, image, radius, params);
    let is_patch = |i: usize| counts[i] >= params.min_points as f64;
    let is_absent = |i: usize| {
        is_patch(i) && through[i] > params.through_share * counts[i] && similar[i] < params.min_correlation
    };
    let has_contrast = |i: usize| is_patch(i) && own[i].variance > params.min_contrast.powi(2);
    let all = || 0..patches.seen.len();
    let mut looks: Vec<f64> = all().filter(|&i| has_contrast(i)).map(|i| 1.0 - similar[i]).collect();
    looks.sort_by(f64::total_cmp);
    let median = looks.get(looks.len() / 2).copied().unwrap_or(0.0);
    let limit = params.min_dissimilarity.max(params.outlier * median);
    let is_unlike = |i: usize| has_contrast(i) && 1.0 - similar[i] > limit;
    let (unlike, with_contrast) = (patches.counts(is_unlike), patches.counts(has_contrast));
    let is_unlike_around = |i: usize| is_unlike(i) && unlike[i] > params.unlike_around * with_contrast[i];
    let count = |of: &dyn Fn(usize) -> bool| all().filter(|&i| of(i)).count();
    let (absent, unlike) = (count(&is_absent), count(&is_unlike_around));
    let points = count(&is_patch);
    PatchComparison {
        views: usize::from(points > 0),
        points,
        absent,
        absent_views: usize::from(absent > 0),
        with_contrast: looks.len(),
        unlike,
        unlike_views: usize::from(unlike > 0),
    }
}

/// Mean and variance of something over a patch.
#[derive(Clone, Copy)]
struct Moments {
    mean: f64,
    variance: f64,
}

impl Moments {
    /// Of so many points whose values and their squares have these sums.
    fn new([sum, of_squares]: &[f64; 2], count: f64) -> Self {
        let mean = sum / count;
        Self { mean, variance: (of_squares / count - mean * mean).max(0.0) }
    }
}

/// The largest correlation of each patch's intensities with those of an image, −1 to 1, at shifts of up to `radius` pixels.
fn correlations(
    patches: &Patches,
    own: &[Moments],
    counts: &[f64],
    image: &GrayImage,
    radius: usize,
    params: &PatchParams,
) -> Vec<f64> {
    let reach = radius as i32;
    let noise = params.image_noise * params.image_noise;
    let mut best = vec![-1.0f64; patches.seen.len()];
    for shift in (-reach..=reach).flat_map(|y| (-reach..=reach).map(move |x| Vector2::new(x, y))) {
        let shift = shift.cast::<f64>();
        // Of value, square, and product with the source's; four fit into a register.
        let sums = patches.sums(|i| {
            let Seen { intensity, pixel, .. } = &patches.seen[i];
            let pixel = pixel + shift;
            let value = sample(image, pixel.x, pixel.y).map_or(0.0, |(value, ..)| value);
            [value, value * value, intensity * value, 0.0]
        });
        for (((best, [sum, of_squares, product, _]), own), count) in
            best.iter_mut().zip(sums).zip(own).zip(counts)
        {
            let other = Moments::new(&[sum, of_squares], *count);
            let covariance = product / count - own.mean * other.mean;
            let variances = (own.variance + noise) * (other.variance + noise);
            *best = best.max(covariance / variances.sqrt());
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A patch holds what is at most its radius away, in rows and columns, and no more at the image's border.
    #[test]
    fn sums_are_over_the_square_around_each_point() {
        let (width, height, radius) = (7, 5, 2);
        let value = |slot: usize| ((slot * 37) % 11) as f64;
        let points: Vec<usize> = (0..width * height).filter(|slot| slot % 3 != 1).collect();
        let seen = points.iter().map(|&slot| Seen {
            slot,
            intensity: value(slot),
            pixel: Vector2::zeros(),
            through: false,
        });
        let patches = Patches { seen: seen.collect(), width, height, radius };
        let sums = patches.sums(|i| [patches.seen[i].intensity, 1.0]);
        for (&slot, [sum, count]) in points.iter().zip(sums) {
            let near = |other: &&usize| {
                let rows = (**other / width).abs_diff(slot / width);
                rows.max((**other % width).abs_diff(slot % width)) <= radius
            };
            assert_eq!(sum, points.iter().filter(near).map(|&other| value(other)).sum::<f64>());
            assert_eq!(count, points.iter().filter(near).count() as f64);
        }
    }
}
