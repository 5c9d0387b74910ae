//! The map as a cloud of points.

use crate::{AgentId, Colors, Keyframe, Map};
use geometry::sensor::Shift;
use geometry::{Pinhole, Sim3};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The largest relative variance of a point that is exported by default: a depth known to 10 %.
pub const DEFAULT_MAX_RELATIVE_VARIANCE: f32 = 0.01;

/// The largest confidence given: beyond it the variance says nothing that f32 could hold.
const MAX_CONFIDENCE: f32 = 1e6;

/// Which of a map's points a cloud holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudSelection {
    /// The largest `variance / inverse_depth²`, see [`Keyframe::cloud`].
    pub max_relative_variance: f32,
    /// Edge of the cubes of which each keeps its surest point alone, map units; `None` keeps all points.
    pub voxel: Option<f64>,
    /// About how many points there are at the most, without `voxel`: of more an even choice of each keyframe's. `None` keeps all
    /// points.
    pub most: Option<usize>,
}

impl Default for CloudSelection {
    fn default() -> Self {
        DEFAULT_MAX_RELATIVE_VARIANCE.into()
    }
}

impl From<f32> for CloudSelection {
    /// All points up to a relative variance.
    fn from(max_relative_variance: f32) -> Self {
        Self { max_relative_variance, voxel: None, most: None }
    }
}

/// Points of the cloud among the results of a run or merge, at the most: as many as viewers show with ease, some 110 MB. A
/// long run has many times as many, mostly of the same surfaces.
const MOST_OF_RESULTS: usize = 5_000_000;

impl CloudSelection {
    /// The selection for the cloud in the results of a run or merge.
    pub fn of_results(max_relative_variance: f32) -> Self {
        Self { most: Some(MOST_OF_RESULTS), ..max_relative_variance.into() }
    }

    /// The points of a map that are selected.
    pub(super) fn points(self, map: &Map) -> Box<dyn Iterator<Item = CloudPoint> + '_> {
        let bound = self.max_relative_variance;
        match (self.voxel, self.most) {
            (Some(voxel), _) => Box::new(map.thinned_cloud(bound, voxel)),
            (None, None) => Box::new(map.cloud(bound)),
            (None, Some(_)) => {
                let choice = self.chosen(map).choice;
                let keyframes = map.keyframes.values();
                Box::new(keyframes.flat_map(move |keyframe| keyframe.world_cloud(map, bound, choice)))
            }
        }
    }

    /// How many of a map's points are selected without a voxel, and which.
    pub(super) fn chosen(self, map: &Map) -> Chosen {
        let size = |keyframe: &Keyframe| {
            let size = keyframe.cloud_size(self.max_relative_variance);
            keyframe.rest();
            size
        };
        let keyframes: Vec<&Keyframe> = map.keyframes.values().collect();
        let sizes: Vec<usize> = keyframes.into_par_iter().map(size).collect();
        let choice = self.most.map_or(Choice::ALL, |most| Choice::new(sizes.iter().sum(), most));
        Chosen { choice, count: sizes.into_iter().map(|size| choice.count(size)).sum() }
    }
}

/// An even choice of a map's points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Chosen {
    /// Which of each keyframe.
    pub choice: Choice,
    /// How many these are.
    pub count: usize,
}

/// `kept` of every `of` points, as evenly as whole numbers are, the first among them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Choice {
    kept: usize,
    of: usize,
}

impl Choice {
    /// All points.
    pub const ALL: Self = Self { kept: 1, of: 1 };

    /// A selection of `most` of `all` points, or of all if they are not more.
    pub fn new(all: usize, most: usize) -> Self {
        if all > most { Self { kept: most.max(1), of: all } } else { Self::ALL }
    }

    /// The number of selected points among `points`.
    pub fn count(self, points: usize) -> usize {
        points
            .checked_sub(1)
            .map_or(0, |others| 1 + (others as u128 * self.kept as u128 / self.of as u128) as usize)
    }

    /// Those that are chosen.
    pub fn among<T>(self, points: impl Iterator<Item = T>) -> impl Iterator<Item = T> {
        let mut due = self.of - self.kept;
        points.filter(move |_| {
            due += self.kept;
            let is_due = due >= self.of;
            due -= if is_due { self.of } else { 0 };
            is_due
        })
    }
}

/// A point of the map in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudPoint {
    /// Position in the world, map units.
    pub position: Vector3<f64>,
    /// Intensity of its pixel, 0–255; 0 of a scan's point.
    pub intensity: u8,
    /// Red, green and blue of its pixel, where its keyframe has colours.
    pub color: Option<[u8; 3]>,
    /// Inverse depth over its standard deviation: the depth is known to one part in `confidence`.
    /// At most 10⁶, which is that of a scan's point.
    pub confidence: f32,
    /// Whose keyframe it is from.
    pub agent: AgentId,
}

impl Keyframe {
    /// The points of the inverse-depth map in the keyframe's own camera frame and unit, in memory
    /// order of the image: those with `variance / inverse_depth² ≤ max_relative_variance`.
    ///
    /// The ratio is the squared relative error of the depth and has no unit, so one bound serves near and far points
    /// and keyframes of any scale. With 0.01 a depth is known to 10 %. `camera` is the agent's camera,
    /// [`Map::camera`], and `shift` the shift between its image and an ideal one, [`Map::image_shift`].
    pub fn cloud(
        &self,
        camera: &Pinhole,
        shift: Shift,
        max_relative_variance: f32,
    ) -> impl Iterator<Item = CloudPoint> + '_ {
        self.chosen_cloud(camera, shift, max_relative_variance, Choice::ALL)
    }

    fn chosen_cloud(
        &self,
        camera: &Pinhole,
        shift: Shift,
        max_relative_variance: f32,
        choice: Choice,
    ) -> impl Iterator<Item = CloudPoint> + '_ {
        choice.among(self.depths_within(max_relative_variance)).map(self.point_of(
            camera,
            shift,
            self.colors(),
        ))
    }

    /// About `count` points of [`cloud`](Self::cloud), evenly along it, of the image as it is, without colours.
    pub(crate) fn sparse_cloud(
        &self,
        camera: &Pinhole,
        max_relative_variance: f32,
        count: usize,
    ) -> impl Iterator<Item = CloudPoint> + '_ {
        let depths = || self.depths_within(max_relative_variance);
        let step = depths().count().div_ceil(count).max(1);
        depths().step_by(step).map(self.point_of(camera, Shift::none(*camera), None))
    }

    /// Pixel, inverse depth and variance where the ratio that [`cloud`](Self::cloud) asks for is within the bound.
    fn depths_within(&self, max_relative_variance: f32) -> impl Iterator<Item = (u32, f32, f32)> + '_ {
        let pixels = self.image.data().len();
        // Written so that a NaN is refused.
        self.semi_dense
            .iter()
            .filter(move |&(pixel, d, v)| v / (d * d) <= max_relative_variance && (pixel as usize) < pixels)
    }

    /// How a depth of the keyframe becomes a point in its own frame.
    fn point_of(
        &self,
        camera: &Pinhole,
        shift: Shift,
        colors: Option<Colors>,
    ) -> impl Fn((u32, f32, f32)) -> CloudPoint + use<'_> {
        let (camera, agent) = (*camera, self.agent);
        let (intensities, width) = (self.image.data(), camera.width as u32);
        move |(pixel, inverse_depth, variance)| {
            let relative_variance = variance / (inverse_depth * inverse_depth);
            let (column, row) = (pixel % width, pixel / width);
            let [x, y] = [column, row].map(|place| place as f32);
            let intensity = intensities[pixel as usize];
            let [dx, dy] = shift.to_undistorted([x, y], inverse_depth);
            let ray = camera.unproject(f64::from(x + dx), f64::from(y + dy));
            CloudPoint {
                position: ray / f64::from(inverse_depth),
                intensity,
                color: colors.as_ref().map(|colors| colors.at(column as usize, row as usize, intensity)),
                confidence: relative_variance.sqrt().recip().min(MAX_CONFIDENCE),
                agent,
            }
        }
    }

    /// A choice of the same points and of those of a scan, in the world of the map that the keyframe is in.
    pub(super) fn world_cloud(
        &self,
        map: &Map,
        max_relative_variance: f32,
        choice: Choice,
    ) -> impl Iterator<Item = CloudPoint> + '_ {
        let Sim3 { rotation, translation, scale } = self.world_from_keyframe;
        // Of millions of points a matrix moves each faster than a quaternion.
        let turned = rotation.to_rotation_matrix().into_inner() * scale;
        let taken_by = map.camera_of(self).zip(map.image_shift(self));
        let of_image =
            taken_by.map(|(camera, shift)| self.chosen_cloud(camera, shift, max_relative_variance, choice));
        of_image
            .into_iter()
            .flatten()
            .chain(choice.among(self.scan_cloud()))
            .map(move |point| CloudPoint { position: turned * point.position + translation, ..point })
    }

    /// How many points [`world_cloud`](Self::world_cloud) gives.
    pub(super) fn cloud_size(&self, max_relative_variance: f32) -> usize {
        let of_image = self.depths_within(max_relative_variance).count();
        of_image + self.scan.as_ref().map_or(0, |scan| scan.len())
    }

    /// The points of a LiDAR's keyframe in its own frame; none of a camera's.
    pub fn scan_cloud(&self) -> impl Iterator<Item = CloudPoint> + '_ {
        let agent = self.agent;
        self.scan.iter().flat_map(|scan| scan.points()).map(move |point| CloudPoint {
            position: Vector3::from(point.map(f64::from)),
            intensity: 0,
            color: None,
            confidence: MAX_CONFIDENCE,
            agent,
        })
    }
}

impl Map {
    /// The points of all keyframes in the world, keyframe by keyframe:
    /// `world_from_keyframe * (ray(pixel) / inverse_depth)` for each pixel that
    /// [`Keyframe::cloud`] keeps, and `world_from_keyframe * point` for each of a scan.
    pub fn cloud(&self, max_relative_variance: f32) -> impl Iterator<Item = CloudPoint> + '_ {
        let keyframes = self.keyframes.values();
        keyframes.flat_map(move |keyframe| keyframe.world_cloud(self, max_relative_variance, Choice::ALL))
    }

    /// The surest point of [`cloud`](Self::cloud) in each cube of edge `voxel` (map units), of equally sure ones the
    /// first; in order of the cubes.
    pub fn thinned_cloud(&self, max_relative_variance: f32, voxel: f64) -> impl Iterator<Item = CloudPoint> {
        let mut surest: BTreeMap<[i64; 3], CloudPoint> = BTreeMap::new();
        for point in self.cloud(max_relative_variance) {
            let cube = point.position.map(|value| (value / voxel).floor() as i64).into();
            let kept = surest.entry(cube).or_insert(point);
            if point.confidence > kept.confidence {
                *kept = point;
            }
        }
        surest.into_values()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{lidar_map, sample_map};

    #[test]
    fn scans_lie_where_their_keyframes_do() {
        let map = lidar_map(2);
        let mut cloud = map.cloud(0.0);
        for keyframe in map.keyframes.values() {
            for p in keyframe.scan.as_ref().unwrap().points() {
                let expected = keyframe.world_from_keyframe * nalgebra::Vector3::from(p.map(f64::from));
                assert!((cloud.next().unwrap().position - expected).norm() < 1e-9);
            }
        }
        assert!(cloud.next().is_none());
    }

    #[test]
    fn points_project_back_to_their_pixels() {
        let map = sample_map(2);
        let mut cloud = map.cloud(f32::INFINITY);
        for keyframe in map.keyframes.values() {
            let keyframe_from_world = keyframe.world_from_keyframe.inverse();
            for (pixel, inverse_depth, variance) in keyframe.semi_dense.iter() {
                let point = cloud.next().unwrap();
                let local = keyframe_from_world * point.position;
                let camera = map.camera(keyframe);
                let found = camera.project(&local);
                let index = pixel as usize;
                assert!((found.x - (index % camera.width) as f64).abs() < 1e-9);
                assert!((found.y - (index / camera.width) as f64).abs() < 1e-9);
                assert!((local.z * f64::from(inverse_depth) - 1.0).abs() < 1e-9);
                assert_eq!(point.intensity, keyframe.image.data()[index]);
                let confidence = inverse_depth / variance.sqrt();
                assert!((point.confidence - confidence).abs() <= 1e-4 * confidence);
            }
        }
        assert!(cloud.next().is_none());
        let size = |bound| map.keyframes.values().map(|keyframe| keyframe.cloud_size(bound)).sum::<usize>();
        let counted = |bound| map.cloud(bound).count();
        assert_eq!([f32::INFINITY, 1e-3, 0.0].map(size), [f32::INFINITY, 1e-3, 0.0].map(counted));
    }

    #[test]
    fn of_too_many_points_as_many_as_are_wanted_are_chosen_evenly() {
        let map = sample_map(3);
        let all = CloudSelection::from(f32::INFINITY);
        let count = all.points(&map).count();
        for most in [count, count - 1, count * 2 / 3, count / 3, 1] {
            let few = CloudSelection { most: Some(most), ..all };
            let chosen = few.chosen(&map);
            assert_eq!(chosen.count, few.points(&map).count());
            assert!(chosen.count.abs_diff(most) <= map.keyframes.len());
            let mut file = Vec::new();
            assert_eq!(crate::write_ply(&mut file, &map, few).unwrap(), chosen.count);
            let header = format!("element vertex {}\n", chosen.count);
            assert!(file.windows(header.len()).any(|part| part == header.as_bytes()));
        }
    }

    #[test]
    fn a_choice_is_even() {
        assert_eq!(Choice::new(5, 5), Choice::ALL);
        let chosen = |all: usize, most: usize| Choice::new(all, most).among(0..all).collect::<Vec<_>>();
        assert_eq!(chosen(7, 7).len(), 7);
        assert_eq!(chosen(10, 5), [0, 2, 4, 6, 8]);
        assert_eq!(chosen(8, 6), [0, 2, 3, 4, 6, 7]);
        assert_eq!(chosen(9, 2), [0, 5]);
        let choice = Choice::new(1000, 370);
        assert!((0..300).all(|size| choice.count(size) == choice.among(0..size).count()));
    }

    #[test]
    fn the_bound_is_on_the_squared_relative_error_of_depth() {
        let mut map = sample_map(1);
        let keyframe = map.keyframes.values_mut().next().unwrap();
        let count = keyframe.semi_dense.len();
        for i in 0..count {
            let sigma = keyframe.semi_dense.inverse_depth[i] * if i == 0 { 0.11 } else { 0.09 };
            keyframe.semi_dense.variance[i] = sigma * sigma;
        }
        assert_eq!(map.cloud(0.01).count(), count - 1);
        assert_eq!(map.cloud(0.0).count(), 0);
    }

    #[test]
    fn a_thinned_cloud_has_the_surest_point_of_each_cube() {
        let (map, voxel) = (sample_map(3), 0.2);
        let cube = |p: &CloudPoint| p.position.map(|value| (value / voxel).floor() as i64);
        let (all, thinned): (Vec<_>, Vec<_>) =
            (map.cloud(f32::INFINITY).collect(), map.thinned_cloud(f32::INFINITY, voxel).collect());
        assert!(!thinned.is_empty() && thinned.len() < all.len());
        for point in &all {
            let of_cube: Vec<_> = thinned.iter().filter(|kept| cube(kept) == cube(point)).collect();
            assert!(of_cube.len() == 1 && of_cube[0].confidence >= point.confidence);
        }
    }

    #[test]
    fn certain_points_have_a_finite_confidence() {
        let mut map = sample_map(1);
        map.keyframes.values_mut().for_each(|keyframe| keyframe.semi_dense.variance.fill(0.0));
        assert!(map.cloud(0.01).all(|point| point.confidence == 1e6));
    }
}
