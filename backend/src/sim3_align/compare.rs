//! What two keyframes say of each other at a given relative pose: nothing is moved.
//!
//! Alignment tells how well two keyframes *can* fit. This tells whether they *do* at a motion that comes from
//! elsewhere, and keeps what contradicts apart from what is not seen: a surface that hides a point is no
//! contradiction, a surface seen behind where the point should be is one.

use super::KeyframeView;
use super::level_depth::{DepthPoint, LevelDepth};
use crate::params;
use geometry::{GrayImage, Pinhole, Sim3};
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

params! {
    /// Parameters of the comparison of two keyframes at a given relative pose.
    pub struct CompareParams {
        /// Pyramid level that is looked at. Range 0–8; errors of a given motion below two pixels of this level do
        /// not matter.
        pub level: usize = 2,
        /// Most source points compared, evenly spread over those with depth. Range 100–1000000.
        pub max_points: usize = 1500,
        /// Half the width of the window in the target that is searched for what a point should meet, pixels of the
        /// level. Range 1–8; wider forgives larger errors of the motion, and more contradictions.
        pub radius: usize = 2,
        /// Relative difference of two inverse depths from which on they contradict each other, if it also exceeds
        /// `deviations`. Range 0.05–1; a motion's scale may be off by some of it.
        pub relative_gap: f64 = 0.15,
        /// The same in standard deviations of the difference. Range 1–20.
        pub deviations: f64 = 4.0,
        /// A point is missing where the target's contrast within the window is below this share of the source's at
        /// the point. Range 0–1.
        pub contrast_share: f64 = 0.3,
    }
}

/// How many of a source's points meet what in the target.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Comparison {
    /// Points compared.
    pub points: usize,
    /// Those that project into the target.
    pub seen: usize,
    /// Of these: the target has the same depth there.
    pub agree: usize,
    /// The target sees a surface behind the point: it looks through where the point should be.
    pub through: usize,
    /// The target sees a surface in front of the point, which may hide it.
    pub hidden: usize,
    /// The target has no depth there and too little contrast for what the source sees.
    pub missing: usize,
}

impl Comparison {
    /// Both together.
    pub fn plus(self, other: Self) -> Self {
        Self {
            points: self.points + other.points,
            seen: self.seen + other.seen,
            agree: self.agree + other.agree,
            through: self.through + other.through,
            hidden: self.hidden + other.hidden,
            missing: self.missing + other.missing,
        }
    }

    /// Share of points that the target looks through, of those whose depth it knows and that are not hidden; 0 where
    /// there are none.
    pub fn through_share(&self) -> f64 {
        self.through as f64 / (self.through + self.agree).max(1) as f64
    }

    /// Share of points whose contrast is missing, of those seen and not hidden; 0 where there are none.
    pub fn missing_share(&self) -> f64 {
        self.missing as f64 / (self.seen - self.hidden).max(1) as f64
    }
}

/// What the points of `source` meet in `target`, one way.
pub fn compare(
    source: &KeyframeView,
    target: &KeyframeView,
    target_from_source: &Sim3,
    params: &CompareParams,
) -> Comparison {
    let level = params.level.min(source.levels().min(target.levels()) - 1);
    let (from, to) = (source.camera().at_level(level), target.camera().at_level(level));
    let (image, depth) = (target.pyramid().level(level), target.depth(level));
    let own = source.pyramid().level(level);
    let all = &source.depth(level).points;
    let stride = all.len().div_ceil(params.max_points.max(1)).max(1);
    let mut found = Comparison::default();
    for point in all.iter().step_by(stride) {
        found.points += 1;
        let Some(moved) = Moved::new(point, [&from, &to], target_from_source) else { continue };
        let (x, y) = (moved.pixel.x.round(), moved.pixel.y.round());
        let inside = |v: f64, size: usize| v >= 0.0 && v < size as f64;
        if !(inside(x, image.width()) && inside(y, image.height())) {
            continue;
        }
        found.seen += 1;
        let window = Window::new([x as usize, y as usize], params.radius, image);
        match window.depth(depth, &moved, params) {
            Some(Met::Agrees) => found.agree += 1,
            Some(Met::Behind) => found.through += 1,
            Some(Met::Before) => found.hidden += 1,
            None => {
                let wanted = params.contrast_share * contrast(own, point.x as usize, point.y as usize);
                found.missing += usize::from(window.contrast(image) < wanted);
            }
        }
    }
    found
}

/// A source point where the target should see it.
pub(super) struct Moved {
    /// Pixel of the level; it may lie outside the image.
    pub pixel: Vector2<f64>,
    inverse_depth: f64,
    /// Standard deviation of the inverse depth.
    deviation: f64,
}

impl Moved {
    /// The point by the cameras `[source, target]` of the level; `None` where it is behind the target.
    pub(super) fn new(
        point: &DepthPoint,
        [from, to]: [&Pinhole; 2],
        target_from_source: &Sim3,
    ) -> Option<Self> {
        let inverse_depth = f64::from(point.inverse_depth);
        let moved =
            *target_from_source * (from.unproject(f64::from(point.x), f64::from(point.y)) / inverse_depth);
        // The relative deviation of the inverse depth stays with the point.
        let relative = f64::from(point.variance).sqrt() / inverse_depth;
        let there = moved.z.recip();
        (moved.z > 0.0).then(|| Self {
            pixel: to.project(&moved),
            inverse_depth: there,
            deviation: there * relative,
        })
    }
}

/// Where the target's depths lie, seen from a point.
pub(super) enum Met {
    Agrees,
    Behind,
    Before,
}

/// A window of an image.
pub(super) struct Window {
    x: std::ops::RangeInclusive<usize>,
    y: std::ops::RangeInclusive<usize>,
}

impl Window {
    pub(super) fn new([x, y]: [usize; 2], radius: usize, image: &GrayImage) -> Self {
        let range = |v: usize, size: usize| v.saturating_sub(radius)..=(v + radius).min(size - 1);
        Self { x: range(x, image.width()), y: range(y, image.height()) }
    }

    /// What the depths of the window are to a point's; nothing where there are none. Where some agree, the
    /// others are of another surface beside it.
    pub(super) fn depth(&self, depth: &LevelDepth, moved: &Moved, params: &CompareParams) -> Option<Met> {
        let (here, deviation) = (moved.inverse_depth, moved.deviation);
        let (mut behind, mut before) = (0, 0);
        for y in self.y.clone() {
            for x in self.x.clone() {
                let Some(DepthPoint { inverse_depth, variance, .. }) = depth.at(x, y) else { continue };
                let other = f64::from(*inverse_depth);
                let sigma = (deviation * deviation + f64::from(*variance)).sqrt();
                let gap = here - other;
                let limit = (params.relative_gap * here.max(other)).max(params.deviations * sigma);
                if gap.abs() <= limit {
                    return Some(Met::Agrees);
                }
                if gap > 0.0 {
                    behind += 1;
                } else {
                    before += 1;
                }
            }
        }
        match (behind, before) {
            (0, 0) => None,
            // A surface before it anywhere near may hide it.
            (_, 0) => Some(Met::Behind),
            _ => Some(Met::Before),
        }
    }

    /// The largest contrast of its pixels.
    fn contrast(&self, image: &GrayImage) -> f64 {
        let pixels = self.y.clone().flat_map(|y| self.x.clone().map(move |x| (x, y)));
        pixels.map(|(x, y)| contrast(image, x, y)).fold(0.0, f64::max)
    }
}

/// Length of the gradient at a pixel, grey levels a pixel.
fn contrast(image: &GrayImage, x: usize, y: usize) -> f64 {
    let (left, right) = (x.saturating_sub(1), (x + 1).min(image.width() - 1));
    let (top, bottom) = (y.saturating_sub(1), (y + 1).min(image.height() - 1));
    let difference = |a: u8, b: u8| f64::from(i16::from(b) - i16::from(a)) / 2.0;
    difference(image.get(left, y), image.get(right, y))
        .hypot(difference(image.get(x, top), image.get(x, bottom)))
}
