//! Keyframes as the agent works on them: image pyramids, points with observations, who sees what.

use crate::align::ReferencePoint;
use crate::track::Matched;
use geometry::{GrayImage, Pinhole, Pyramid, Se3};
use map::KeyframeId;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A point of a keyframe.
#[derive(Clone, Debug)]
pub(crate) struct PointState {
    /// Pixel in the host, level 0.
    pub pixel: [f32; 2],
    /// Ray through it, z = 1.
    pub ray: Vector3<f64>,
    /// Inverse depth, 1/map unit.
    pub inverse_depth: f64,
    /// Its variance.
    pub variance: f64,
    /// Who sees it where.
    pub observations: Vec<SeenAt>,
    /// False once it proved wrong; its place is kept so that indices stay valid.
    pub alive: bool,
    /// Times it was looked for / found in tracked frames.
    pub sought: u32,
    pub found: u32,
}

/// An observation of a point by a keyframe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SeenAt {
    pub keyframe: usize,
    pub pixel: [f32; 2],
    pub information: [f32; 3],
}

/// Names a point: host keyframe and index there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct PointRef {
    pub host: usize,
    pub index: usize,
}

/// A frame close to a keyframe, kept until the keyframe's semi-dense depth is computed: its short baseline
/// finds the pixels that longer ones sharpen.
#[derive(Clone, Debug)]
pub(crate) struct Companion {
    pub image: Arc<GrayImage>,
    pub frame_from_keyframe: Se3,
    /// Baseline over the keyframe's median depth.
    pub parallax: f64,
}

/// A keyframe at work.
#[derive(Clone, Debug)]
pub(crate) struct KeyframeState {
    pub timestamp: f64,
    pub frame_index: u64,
    pub pyramid: Pyramid,
    pub camera_from_world: Se3,
    /// Points hosted here.
    pub points: Vec<PointState>,
    /// Points hosted elsewhere and seen here.
    pub seen: Vec<PointRef>,
    /// Frames close by, in order of their baseline.
    pub companions: Vec<Companion>,
}

impl KeyframeState {
    /// A keyframe without points.
    pub fn new(timestamp: f64, frame_index: u64, pyramid: Pyramid, camera_from_world: Se3) -> Self {
        Self {
            timestamp,
            frame_index,
            pyramid,
            camera_from_world,
            points: Vec::new(),
            seen: Vec::new(),
            companions: Vec::new(),
        }
    }
}

/// All keyframes of the agent; index = `KeyframeId`.
#[derive(Clone, Debug)]
pub(crate) struct LocalMap {
    pub camera: Pinhole,
    pub keyframes: Vec<KeyframeState>,
}

impl LocalMap {
    pub fn new(camera: Pinhole) -> Self {
        Self { camera, keyframes: Vec::new() }
    }

    pub fn point(&self, at: PointRef) -> &PointState {
        &self.keyframes[at.host].points[at.index]
    }

    pub fn point_mut(&mut self, at: PointRef) -> &mut PointState {
        &mut self.keyframes[at.host].points[at.index]
    }

    /// Index → public name.
    pub fn id(index: usize) -> KeyframeId {
        KeyframeId(index as u32)
    }

    /// Living points a keyframe hosts or sees.
    pub fn points_of(&self, keyframe: usize) -> impl Iterator<Item = PointRef> + '_ {
        let state = &self.keyframes[keyframe];
        let hosted = (0..state.points.len()).map(move |index| PointRef { host: keyframe, index });
        hosted.chain(state.seen.iter().copied()).filter(|&at| self.point(at).alive)
    }

    /// The keyframe's points as it sees them, for direct alignment.
    pub fn reference_points(&self, keyframe: usize) -> Vec<ReferencePoint> {
        let state = &self.keyframes[keyframe];
        let mut from_host: BTreeMap<usize, Se3> = BTreeMap::new();
        self.points_of(keyframe)
            .filter_map(|at| {
                let point = self.point(at);
                if at.host == keyframe {
                    return Some(ReferencePoint {
                        pixel: point.pixel,
                        inverse_depth: point.inverse_depth as f32,
                        variance: point.variance as f32,
                    });
                }
                let relative = from_host.entry(at.host).or_insert_with(|| {
                    state.camera_from_world * self.keyframes[at.host].camera_from_world.inverse()
                });
                let x = relative.rotation * point.ray + relative.translation * point.inverse_depth;
                if x.z < 0.02 {
                    return None;
                }
                let pixel = self.camera.project(&x);
                let inverse_depth = point.inverse_depth / x.z;
                Some(ReferencePoint {
                    pixel: [pixel.x as f32, pixel.y as f32],
                    inverse_depth: inverse_depth as f32,
                    variance: (point.variance / (x.z * x.z)) as f32,
                })
            })
            .collect()
    }

    /// Keyframes that share points with `keyframe`, most first: `(index, shared points)`.
    pub fn covisible(&self, keyframe: usize) -> Vec<(usize, usize)> {
        let mut shared: BTreeMap<usize, usize> = BTreeMap::new();
        for at in self.points_of(keyframe) {
            let watchers = self.point(at).observations.iter().map(|o| o.keyframe);
            for other in watchers.chain([at.host]).filter(|&k| k != keyframe) {
                *shared.entry(other).or_default() += 1;
            }
        }
        let mut all: Vec<_> = shared.into_iter().collect();
        all.sort_by(|a, b| b.1.cmp(&a.1).then(b.0.cmp(&a.0)));
        all
    }

    /// Notes which points a frame was searched for, and which of them were found.
    pub fn count_sought(&mut self, sought: &[PointRef], matched: &[Matched]) {
        for &at in sought {
            self.point_mut(at).sought += 1;
        }
        for m in matched.iter().filter(|m| m.inlier) {
            self.point_mut(m.at).found += 1;
        }
    }

    /// Records that `keyframe` sees a point.
    pub fn observe(&mut self, at: PointRef, seen: SeenAt) {
        let keyframe = seen.keyframe;
        self.point_mut(at).observations.push(seen);
        self.keyframes[keyframe].seen.push(at);
    }
}

/// The median; `None` of nothing. Reorders its input.
pub(crate) fn median(values: &mut [f32]) -> Option<f32> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
}
