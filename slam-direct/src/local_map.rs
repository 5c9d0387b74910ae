//! The working form of keyframes: image pyramids, points with observations, covisibility.

use crate::align::ReferencePoint;
use crate::mask::Mask;
use geometry::sensor::{Sensor, Twist};
use geometry::{GrayImage, Pinhole, Pyramid, Se3, Sim3, median};
use map::{KeyframeId, SemiDense, Shared};
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::sync::Arc;

mod split;

/// A point of a keyframe.
#[derive(Clone, Debug)]
pub(crate) struct PointState {
    /// Pixel in the host, level 0.
    pub pixel: [f32; 2],
    /// Ray through it, z = 1.
    pub ray: Vector3<f64>,
    /// Inverse depth, 1/map unit.
    pub inverse_depth: f64,
    /// Its variance by the noise of what sees it, were all poses exact: what observations weigh by.
    pub variance: f64,
    /// Its variance by the poses of the keyframes that see it, and by the uncertainty of their rotations. Many points
    /// share these errors, and they decide whether its depth is known at all.
    pub doubt: f64,
    /// Who sees it where.
    pub observations: Vec<SeenAt>,
    /// False once it proved wrong; its place is kept so that indices stay valid.
    pub alive: bool,
    /// Times it was looked for / found in tracked frames.
    pub searched: u32,
    pub found: u32,
}

impl PointState {
    /// Standard deviation of a depth, as a share of it, up to which it is known. A view gets its scale from the
    /// depths that it sees, and passes it on to new depths. With a tenth at each of four such steps, the scale stays
    /// within a factor of 1.5, which is two deviations of the four (ln 1.5 = 2 · 0.1 · √4).
    pub const KNOWN: f64 = 0.1;

    /// Whether its depth is known, so that it determines the scale of a translation.
    pub fn is_known(&self) -> bool {
        self.variance + self.doubt < (Self::KNOWN * self.inverse_depth).powi(2)
    }
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

/// A map point found in a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Matched {
    pub at: PointRef,
    pub pixel: [f32; 2],
    pub information: [f32; 3],
    pub rmse: f32,
    /// Squared normalised residual under the frame's pose.
    pub squared: f64,
    /// Whether it agrees with that pose.
    pub inlier: bool,
}

/// A frame close to a keyframe, kept until the keyframe's semi-dense depth is computed: its short baseline
/// finds the pixels that longer ones sharpen.
#[derive(Clone, Debug)]
pub(crate) struct Companion {
    pub image: Arc<GrayImage>,
    /// Translation in the keyframe's unit.
    pub frame_from_keyframe: Se3,
    /// How the camera moved; its υ in the keyframe's unit.
    pub motion: Twist,
    /// Baseline over the keyframe's median depth.
    pub parallax: f64,
}

/// Companions of keyframes whose depth is not begun yet, each keyframe's in order of their baseline.
pub(crate) type Companions = BTreeMap<usize, Vec<Companion>>;

/// A keyframe at work.
#[derive(Clone, Debug)]
pub(crate) struct KeyframeState {
    pub timestamp: f64,
    pub frame_index: u64,
    pub pyramid: Pyramid,
    pub camera_from_world: Se3,
    /// World units per unit of the keyframe: the scale of its Sim(3) pose. What is measured around it and published (frames, semi-dense
    /// depth) is in its unit, and stays as it is when the world's scale here changes.
    pub scale: f64,
    /// How the camera moved; its υ in the keyframe's unit.
    pub motion: Twist,
    /// Inverse depth of its pixels, 1/unit of the keyframe; empty until it is computed.
    pub semi_dense: Shared<SemiDense>,
    /// Points hosted here; depths in world units.
    pub points: Vec<PointState>,
    /// Points hosted elsewhere and seen here.
    pub seen: Vec<PointRef>,
}

impl KeyframeState {
    /// A keyframe without points, of the world's unit.
    pub fn new(timestamp: f64, frame_index: u64, pyramid: Pyramid, camera_from_world: Se3) -> Self {
        Self {
            timestamp,
            frame_index,
            pyramid,
            camera_from_world,
            scale: 1.0,
            motion: Twist::zeros(),
            semi_dense: Shared::default(),
            points: Vec::new(),
            seen: Vec::new(),
        }
    }

    /// Gives back what memory the keyframe does not need while nothing is mapped here.
    pub fn rest(&mut self) {
        self.pyramid.rest();
        self.points.iter_mut().for_each(|point| point.observations.shrink_to_fit());
        self.points.shrink_to_fit();
        self.seen.shrink_to_fit();
    }

    /// How the camera moved, in map units.
    pub fn motion_in_world(&self) -> Twist {
        let mut motion = self.motion;
        motion.fixed_rows_mut::<3>(0).scale_mut(self.scale);
        motion
    }
}

/// How often points were looked for and found in tracked frames.
#[derive(Clone, Debug, Default)]
pub(crate) struct Counts {
    /// `[searched, found]` of each point of a host, as far as the last one counted.
    by_host: BTreeMap<usize, Vec<[u32; 2]>>,
}

impl Counts {
    /// Counts the points that a frame was searched for, and those of them that were found.
    pub fn add(&mut self, searched: &[PointRef], matched: &[Matched]) {
        searched.iter().for_each(|&at| self.entry(at)[0] += 1);
        matched.iter().filter(|m| m.inlier).for_each(|m| self.entry(m.at)[1] += 1);
    }

    /// Keyframes whose points were counted.
    pub fn hosts(&self) -> impl Iterator<Item = usize> + '_ {
        self.by_host.keys().copied()
    }

    fn entry(&mut self, at: PointRef) -> &mut [u32; 2] {
        let counts = self.by_host.entry(at.host).or_default();
        if counts.len() <= at.index {
            counts.resize(at.index + 1, [0; 2]);
        }
        &mut counts[at.index]
    }
}

/// All keyframes of the agent; index = `KeyframeId`.
#[derive(Clone, Debug)]
pub(crate) struct LocalMap {
    pub camera: Pinhole,
    /// The camera as the images proved to show it. Rays of points are by it; pixels are those of the images.
    pub sensor: Sensor,
    /// The part of the images that moves with the camera; it gets no new points.
    pub mask: Arc<Mask>,
    pub keyframes: Vec<Shared<KeyframeState>>,
}

impl LocalMap {
    pub fn new(camera: Pinhole) -> Self {
        Self { camera, sensor: Sensor::ideal(camera), mask: Arc::default(), keyframes: Vec::new() }
    }

    pub fn point(&self, at: PointRef) -> &PointState {
        &self.keyframes[at.host].points[at.index]
    }

    pub fn point_mut(&mut self, at: PointRef) -> &mut PointState {
        &mut self.keyframes[at.host].points[at.index]
    }

    /// Takes a sensor over: the rays of all points follow.
    pub fn set_sensor(&mut self, sensor: Sensor) {
        self.sensor = sensor;
        for host in self.keyframes.iter_mut().map(|keyframe| &mut **keyframe) {
            let motion = host.motion_in_world();
            for point in &mut host.points {
                point.ray = sensor.ray(point.pixel.map(f64::from), &motion, point.inverse_depth);
            }
        }
    }

    /// Where an ideal camera at a keyframe sees what its image shows at `pixel`, of this inverse depth.
    pub fn undistorted_pixel(&self, keyframe: usize, pixel: [f32; 2], inverse_depth: f64) -> [f64; 2] {
        let motion = self.keyframes[keyframe].motion_in_world();
        self.sensor.undistorted_pixel(pixel.map(f64::from), &motion, inverse_depth)
    }

    /// Where a keyframe's image shows what an ideal camera there sees at `pixel`, of this inverse depth.
    pub fn distorted_pixel(&self, keyframe: usize, pixel: [f64; 2], inverse_depth: f64) -> [f64; 2] {
        self.sensor.distorted_pixel(pixel, &self.keyframes[keyframe].motion_in_world(), inverse_depth)
    }

    /// The ray through a pixel of a keyframe, z = 1, of this inverse depth.
    pub fn ray(&self, keyframe: usize, pixel: [f32; 2], inverse_depth: f64) -> Vector3<f64> {
        let [x, y] = self.undistorted_pixel(keyframe, pixel, inverse_depth);
        self.camera.unproject(x, y)
    }

    /// Index → public name.
    pub fn id(index: usize) -> KeyframeId {
        KeyframeId(index as u32)
    }

    /// Adds a keyframe; gives its index.
    pub fn push(&mut self, keyframe: KeyframeState) -> usize {
        self.keyframes.push(keyframe.into());
        self.keyframes.len() - 1
    }

    /// Takes in the keyframes of another map of the same camera, behind its own, with all their points: `own_from_other` maps
    /// that map's world into this one's.
    pub fn append(&mut self, other: LocalMap, own_from_other: &Sim3) {
        let (count, scale) = (self.keyframes.len(), own_from_other.scale);
        let other_from_own = own_from_other.rigid().inverse();
        let behind = |at: &PointRef| PointRef { host: at.host + count, ..*at };
        for mut state in other.keyframes {
            let inner = &mut *state;
            // Lengths of the other world are multiplied by the scale, then it is turned and moved.
            inner.camera_from_world.translation *= scale;
            inner.camera_from_world = (inner.camera_from_world * other_from_own).renormalized();
            inner.scale *= scale;
            for point in &mut inner.points {
                point.inverse_depth /= scale;
                point.variance /= scale * scale;
                point.doubt /= scale * scale;
                point.observations.iter_mut().for_each(|seen| seen.keyframe += count);
            }
            inner.seen = inner.seen.iter().map(behind).collect();
            self.keyframes.push(state);
        }
        if other.sensor != self.sensor {
            self.set_sensor(self.sensor);
        }
    }

    /// Pose and scale of a keyframe.
    pub fn world_from_keyframe(&self, keyframe: usize) -> Sim3 {
        let state = &self.keyframes[keyframe];
        let rigid = state.camera_from_world.inverse();
        Sim3::new(rigid.rotation, rigid.translation, state.scale)
    }

    /// A pose of the world relative to a keyframe, in the keyframe's unit.
    pub fn keyframe_from_frame(&self, keyframe: usize, camera_from_world: &Se3) -> Se3 {
        let state = &self.keyframes[keyframe];
        let relative = (*camera_from_world * state.camera_from_world.inverse()).inverse();
        Se3::new(relative.rotation, relative.translation / state.scale)
    }

    /// The pose `camera_from_world` of a frame that is known relative to a keyframe, in the keyframe's unit: what
    /// [`keyframe_from_frame`](Self::keyframe_from_frame) undoes.
    pub fn camera_from_world(&self, keyframe: usize, keyframe_from_frame: &Se3) -> Se3 {
        let state = &self.keyframes[keyframe];
        let Se3 { rotation, translation } = *keyframe_from_frame;
        Se3::new(rotation, translation * state.scale).inverse() * state.camera_from_world
    }

    /// At most `count` keyframes that look at about what a keyframe looks at, in order; the keyframe among them.
    /// `depth` is the distance at which it looks, map units.
    pub fn around(&self, keyframe: usize, depth: f64, count: usize) -> Vec<usize> {
        self.around_among(keyframe, depth, count, |_| true)
    }

    /// The same of those that are `admitted`.
    pub fn around_among(
        &self,
        keyframe: usize,
        depth: f64,
        count: usize,
        admitted: impl Fn(usize) -> bool,
    ) -> Vec<usize> {
        let candidates: Vec<usize> = (0..self.keyframes.len()).filter(|&index| admitted(index)).collect();
        if candidates.len() <= count {
            return candidates;
        }
        let focus = |state: &KeyframeState| {
            let ahead = Vector3::z() * depth - state.camera_from_world.translation;
            state.camera_from_world.rotation.inverse() * ahead
        };
        let here = focus(&self.keyframes[keyframe]);
        let away = |index: usize| ((focus(&self.keyframes[index]) - here).norm_squared(), index);
        let mut all: Vec<(f64, usize)> = candidates.into_iter().map(away).collect();
        all.select_nth_unstable_by(count - 1, |a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
        let mut near: Vec<usize> = all[..count].iter().map(|a| a.1).collect();
        near.sort_unstable();
        near
    }

    /// Living points a keyframe hosts or sees.
    pub fn points_of(&self, keyframe: usize) -> impl Iterator<Item = PointRef> + '_ {
        let state = &self.keyframes[keyframe];
        let hosted = (0..state.points.len()).map(move |index| PointRef { host: keyframe, index });
        hosted.chain(state.seen.iter().copied()).filter(|&at| self.point(at).alive)
    }

    /// Whether there is anything to track against at a keyframe.
    pub fn has_points(&self, keyframe: usize) -> bool {
        self.points_of(keyframe).next().is_some()
    }

    /// The keyframe's points as it sees them, for direct alignment.
    pub fn reference_points(&self, keyframe: usize) -> Vec<ReferencePoint> {
        let state = &self.keyframes[keyframe];
        let motion = state.motion_in_world();
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
                let inverse_depth = point.inverse_depth / x.z;
                let pixel =
                    self.sensor.distorted_pixel(self.camera.project(&x).into(), &motion, inverse_depth);
                Some(ReferencePoint {
                    pixel: pixel.map(|v| v as f32),
                    inverse_depth: inverse_depth as f32,
                    variance: (point.variance / (x.z * x.z)) as f32,
                })
            })
            .collect()
    }

    /// Median distance of what a keyframe looks at, map units.
    pub fn median_depth(&self, keyframe: usize) -> Option<f64> {
        let mut depths: Vec<f32> = self.reference_points(keyframe).iter().map(|p| p.inverse_depth).collect();
        median(&mut depths).map(|inverse| 1.0 / f64::from(inverse))
    }

    /// Keyframes that share points with `keyframe`, most first: `(index, shared points)`.
    pub fn covisible(&self, keyframe: usize) -> Vec<(usize, usize)> {
        let mut sharing = Vec::new();
        for at in self.points_of(keyframe) {
            let watchers = self.point(at).observations.iter().map(|o| o.keyframe);
            sharing.extend(watchers.chain([at.host]).filter(|&k| k != keyframe));
        }
        sharing.sort_unstable();
        let mut all: Vec<_> =
            sharing.chunk_by(|a, b| a == b).map(|shared| (shared[0], shared.len())).collect();
        all.sort_by(|a, b| b.1.cmp(&a.1).then(b.0.cmp(&a.0)));
        all
    }

    /// Adds up how often points were looked for and found.
    pub fn count(&mut self, counts: &Counts) {
        for (&host, counts) in &counts.by_host {
            for (point, [searched, found]) in self.keyframes[host].points.iter_mut().zip(counts) {
                point.searched += searched;
                point.found += found;
            }
        }
    }

    /// Records that `keyframe` sees a point.
    pub fn observe(&mut self, at: PointRef, seen: SeenAt) {
        let keyframe = seen.keyframe;
        self.point_mut(at).observations.push(seen);
        self.keyframes[keyframe].seen.push(at);
    }
}

#[cfg(test)]
mod tests;
