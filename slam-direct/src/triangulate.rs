//! Depth for new points: a search along the epipolar line in other keyframes, then verification.

use crate::local_map::{LocalMap, PointState, SeenAt};
use crate::patch::{Appearance, Template};
use crate::track::{TrackParams, position_information};
use crate::warp::Warp;
use crate::window::{Relative, UNKNOWN, predict, variance_by_rotation};
use backend::params;
use geometry::Se3;
use geometry::sensor::Twist;
use nalgebra::{Matrix3, Vector2, Vector3};

params! {
    /// Parameters of the search for new points' depths.
    pub struct TriangulateParams {
        /// Longest epipolar segment that is searched, pixels. Range 10–5000.
        pub max_length: f64 = 300.0,
        /// The best match must be this many times better than any other on the line. Range 1–10.
        pub uniqueness: f32 = 1.5,
        /// How far from the epipolar line the match may lie, pixels. Range 0.1–20.
        pub max_off_line: f64 = 1.5,
        /// Standard deviation of the inverse depth, relative to itself, above which a point is not kept. Range 0.01–1.
        pub max_relative_sigma: f64 = 0.25,
    }
}

/// Host keyframe and another, related.
struct View {
    keyframe: usize,
    relative: Se3,
    rotation: Matrix3<f64>,
    /// How the other's camera moved, in map units.
    motion: Twist,
}

/// Where a view shows a ray at one inverse depth.
#[derive(Clone, Copy, Default)]
struct Place {
    inverse_depth: f64,
    /// Depth in the view over that in the host.
    depth: f64,
    pixel: [f64; 2],
}

/// Least depth in a view over that in the host of what it shows.
const LEAST_DEPTH: f64 = 0.05;

geometry::multiversion! {
    /// Where a view shows a ray of the host at inverse depths spread evenly over `range`, from its one end in so many steps
    /// to the other.
    fn places(
        map: &LocalMap,
        view: &View,
        ray: &Vector3<f64>,
        range: (f64, f64),
        steps: usize,
    ) -> Vec<Place> {
        // Copies, which no place that is written can change: so that processors work on several side by side.
        let (camera, sensor, motion) = (map.camera, map.sensor, view.motion);
        let (at_infinity, shift) = (view.rotation * ray, view.relative.translation);
        let mut all = vec![Place::default(); steps + 1];
        for (i, place) in (0i32..).zip(&mut all) {
            let inverse_depth = range.0 + (range.1 - range.0) * f64::from(i) / steps as f64;
            let x = at_infinity + shift * inverse_depth;
            let ideal = camera.project(&x).into();
            let pixel = sensor.distorted_pixel(ideal, &motion, inverse_depth / x.z);
            *place = Place { inverse_depth, depth: x.z, pixel };
        }
        all.retain(|place| place.depth > LEAST_DEPTH);
        all
    }
}

/// Finds a candidate's depth by searching `others` in order. The result holds all observations that agree.
pub(crate) struct Triangulator<'a> {
    map: &'a LocalMap,
    host: usize,
    views: Vec<View>,
    params: &'a TriangulateParams,
    track: &'a TrackParams,
}

impl<'a> Triangulator<'a> {
    pub fn new(
        map: &'a LocalMap,
        host: usize,
        others: &[usize],
        params: &'a TriangulateParams,
        track: &'a TrackParams,
    ) -> Self {
        let state = &map.keyframes[host];
        let views = others
            .iter()
            .map(|&keyframe| {
                let other = &map.keyframes[keyframe];
                let relative = other.camera_from_world * state.camera_from_world.inverse();
                let (rotation, motion) = (relative.rotation_matrix(), other.motion_in_world());
                View { keyframe, relative, rotation, motion }
            })
            .collect();
        Self { map, host, views, params, track }
    }

    /// A point at `pixel` of the host with its depth and observations; `None` when no view shows it
    /// unambiguously. `range` is the inverse depth to expect, `(least, most)`.
    pub fn point(&self, pixel: [f32; 2], range: (f64, f64)) -> Option<PointState> {
        // What the translation adds to the ray while the rows are read needs a depth.
        let ray = self.map.ray(self.host, pixel, 0.5 * (range.0 + range.1));
        let mut observations: Vec<SeenAt> = Vec::new();
        let mut inverse_depth = None;
        for view in &self.views {
            let start = match inverse_depth {
                None => match self.search(view, pixel, &ray, range) {
                    Some(start) => start,
                    None => continue,
                },
                Some(d) => d,
            };
            let Some(seen) = self.observe(view, pixel, &ray, start) else { continue };
            observations.push(seen);
            inverse_depth = self.solve_depth(&ray, start, &observations).map(|s| s.0).or(inverse_depth);
            if inverse_depth.is_none() {
                observations.clear();
            }
        }
        let (inverse_depth, variance, worst) = self.solve_depth(&ray, inverse_depth?, &observations)?;
        let by_rotation = observations.iter().filter_map(|seen| {
            let View { relative, rotation, .. } = self.views.iter().find(|v| v.keyframe == seen.keyframe)?;
            let relative = Relative { pose: *relative, rotation: *rotation };
            Some(variance_by_rotation(&self.map.camera, &relative, &ray, inverse_depth))
        });
        let accepted = worst < 9.21 && variance.sqrt() < self.params.max_relative_sigma * inverse_depth;
        accepted.then_some(PointState {
            pixel,
            ray: self.map.ray(self.host, pixel, inverse_depth),
            inverse_depth,
            variance,
            doubt: by_rotation.fold(f64::INFINITY, f64::min).min(UNKNOWN * inverse_depth * inverse_depth),
            observations,
            alive: true,
            searched: 0,
            found: 0,
        })
    }

    /// Best inverse depth along the epipolar segment, to about a pixel.
    fn search(&self, view: &View, pixel: [f32; 2], ray: &Vector3<f64>, range: (f64, f64)) -> Option<f64> {
        let ends = places(self.map, view, ray, range, 1);
        let [far, near] = ends.as_slice() else { return None };
        let length = distance(near, far);
        if length > self.params.max_length {
            return None;
        }
        let middle = 0.5 * (range.0 + range.1);
        let (warp, _) = Warp::new(&self.map.camera, &view.relative, &view.rotation, ray, middle)?;
        let host = &self.map.keyframes[self.host].pyramid;
        let patch = Appearance::cut(host, pixel, &warp)?;
        let other = &self.map.keyframes[view.keyframe].pyramid;
        let steps = (length / (1 << patch.level) as f64 / 0.8).ceil().max(1.0) as usize;
        let places = places(self.map, view, ray, range, steps);
        let pixels: Vec<[f32; 2]> = places.iter().map(|place| place.pixel.map(|v| v as f32)).collect();
        let errors = patch.errors_at(other, &pixels);
        let seen = || places.iter().zip(&errors).filter_map(|(place, error)| Some((place, (*error)?)));
        let (best, least) = seen().min_by(|a, b| a.1.total_cmp(&b.1))?;
        let apart = 3.0 * (1 << patch.level) as f64;
        let rivals = seen().filter(|(place, _)| distance(place, best) > apart);
        let rival = rivals.map(|(_, error)| error).fold(f32::INFINITY, f32::min);
        let unique = rival > self.params.uniqueness * least.max(0.02);
        (unique && least < 0.5).then_some(best.inverse_depth)
    }

    /// The point's exact position in a view, near the epipolar line.
    fn observe(
        &self,
        view: &View,
        pixel: [f32; 2],
        ray: &Vector3<f64>,
        inverse_depth: f64,
    ) -> Option<SeenAt> {
        let (warp, at) = Warp::new(&self.map.camera, &view.relative, &view.rotation, ray, inverse_depth)?;
        let template = Template::cut(&self.map.keyframes[self.host].pyramid, pixel, &warp)?;
        let other = &self.map.keyframes[view.keyframe].pyramid;
        let depth = (view.rotation * ray + view.relative.translation * inverse_depth).z;
        let start =
            self.map.distorted_pixel(view.keyframe, at.into(), inverse_depth / depth).map(|v| v as f32);
        if !other.base().contains(start[0], start[1], 5.0) {
            return None;
        }
        let found = template.align(other, start, 3.0, 12)?;
        if found.unexplained > self.track.max_unexplained {
            return None;
        }
        // Distance from the epipolar line through the start.
        let p = predict(
            &self.map.camera,
            &view.rotation,
            &view.relative.translation,
            ray,
            inverse_depth,
            &self.map.undistorted_pixel(view.keyframe, found.pixel, inverse_depth / depth),
        )?;
        let line = Vector2::from(p.by_inverse_depth);
        let norm = line.norm();
        let off = (p.residual[0] * line.y - p.residual[1] * line.x).abs() / norm.max(1e-9);
        let information = position_information(&found.information, found.rmse, template.level(), self.track);
        (norm > 1e-6 && off < self.params.max_off_line * (1 << template.level()) as f64).then_some(SeenAt {
            keyframe: view.keyframe,
            pixel: found.pixel,
            information,
        })
    }

    /// Least-squares inverse depth on the observations: `(inverse depth, variance, worst squared residual)`.
    fn solve_depth(&self, ray: &Vector3<f64>, start: f64, seen: &[SeenAt]) -> Option<(f64, f64, f64)> {
        let mut d = start;
        let mut information = 0.0;
        let mut worst: f64 = 0.0;
        for _ in 0..4 {
            let (mut h, mut g) = (0.0, 0.0);
            worst = 0.0;
            for s in seen {
                let view = self.views.iter().find(|v| v.keyframe == s.keyframe)?;
                let depth = (view.rotation * ray + view.relative.translation * d).z;
                let p = predict(
                    &self.map.camera,
                    &view.rotation,
                    &view.relative.translation,
                    ray,
                    d,
                    &self.map.undistorted_pixel(s.keyframe, s.pixel, d / depth),
                )?;
                let [a, b, c] = s.information.map(f64::from);
                let (j, r) = (p.by_inverse_depth, p.residual);
                let wj = [a * j[0] + b * j[1], b * j[0] + c * j[1]];
                h += wj[0] * j[0] + wj[1] * j[1];
                g += wj[0] * r[0] + wj[1] * r[1];
                worst = worst.max(crate::window::mahalanobis(&r, &[a, b, c]));
            }
            if h <= 0.0 {
                return None;
            }
            information = h;
            d -= g / h;
        }
        (d > 0.0 && d.is_finite()).then_some((d, 1.0 / information, worst))
    }
}

/// Of two places in the image, pixels.
fn distance(a: &Place, b: &Place) -> f64 {
    (Vector2::from(a.pixel) - Vector2::from(b.pixel)).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::local_map::PointState;
    use crate::mask::Mask;
    use crate::select::select;
    use crate::test_scene::{View, bare_map, pose, quantile};

    /// Inverse depths to expect anywhere in the yard, 1/m.
    const RANGE: (f64, f64) = (0.08, 0.6);

    /// All points found for the first view in the others, and how many were sought.
    fn triangulate(views: &[View]) -> (Vec<PointState>, usize) {
        let map = bare_map(views);
        let others: Vec<usize> = (1..views.len()).collect();
        let (params, track) = (TriangulateParams::default(), TrackParams::default());
        let triangulator = Triangulator::new(&map, 0, &others, &params, &track);
        let searched = select(views[0].pyramid.base(), 12, 12.0, &Mask::default(), |_, _| false);
        let found = searched.iter().filter_map(|c| triangulator.point(c.pixel, RANGE)).collect();
        (found, searched.len())
    }

    /// Relative errors of the points' inverse depths.
    fn errors(points: &[PointState], view: &View) -> Vec<f64> {
        let error = |p: &PointState| (p.inverse_depth / view.depth_at(p.pixel) as f64 - 1.0).abs();
        points.iter().filter(|p| view.smooth_around(p.pixel)).map(error).collect()
    }

    #[test]
    fn depths_from_exact_poses_are_right() {
        let first = pose(0.0, 0.0, 0.0, 0.0, 0.0);
        for others in [
            vec![pose(0.3, 0.0, 0.0, 0.0, 0.0)],
            vec![pose(0.25, 0.05, 0.1, 0.03, 0.0), pose(-0.35, 0.0, 0.0, -0.03, 0.02)],
            vec![pose(0.0, 0.0, 0.5, 0.0, 0.0), pose(0.05, 0.0, 0.9, 0.0, 0.0)],
        ] {
            let views: Vec<View> = [first].into_iter().chain(others).map(View::new).collect();
            let (points, searched) = triangulate(&views);
            assert!(points.len() * 4 > searched, "{} of {searched}", points.len());
            let errors = errors(&points, &views[0]);
            let gross = errors.iter().filter(|&&e| e > 0.1).count() as f64 / errors.len() as f64;
            let median = quantile(errors, 0.5);
            assert!(median < 0.015 && gross < 0.03, "median {median}, gross {gross}");
        }
    }

    #[test]
    fn the_variance_is_honest() {
        let views =
            [pose(0.0, 0.0, 0.0, 0.0, 0.0), pose(0.3, 0.0, 0.0, 0.0, 0.0), pose(-0.3, 0.1, 0.0, 0.0, 0.0)]
                .map(View::new);
        let (points, _) = triangulate(&views);
        let normalised = points
            .iter()
            .filter(|p| views[0].smooth_around(p.pixel))
            .map(|p| (p.inverse_depth - views[0].depth_at(p.pixel) as f64).abs() / p.variance.sqrt());
        let within = quantile(normalised.collect(), 0.9);
        assert!(within < 2.5, "a tenth of the points is more than {within} σ off");
    }

    #[test]
    fn no_depth_without_baseline_or_in_another_place() {
        let here = pose(0.0, 0.0, 0.0, 0.0, 0.0);
        for other in [here, pose(0.0, 0.0, 0.0, 0.1, 0.0), pose(0.0, 0.0, -9.0, 3.1, 0.0)] {
            let (points, searched) = triangulate(&[View::new(here), View::new(other)]);
            assert!(points.len() * 50 < searched, "{} of {searched}", points.len());
        }
    }

    #[test]
    fn a_rotation_as_uncertain_as_the_parallax_gives_no_depth() {
        // Patches that are placed to a tenth of a pixel, and 3 cm to 5 m: two pixels, which a turn of 14° is not known to.
        let track = TrackParams { position_sigma: 0.1, ..TrackParams::default() };
        let count = |yaw: f64| {
            let views = [pose(0.0, 0.0, 0.0, 0.0, 0.0), pose(0.03, 0.0, 0.0, yaw, 0.0)].map(View::new);
            let map = bare_map(&views);
            let params = TriangulateParams::default();
            let triangulator = Triangulator::new(&map, 0, &[1], &params, &track);
            let searched = select(views[0].pyramid.base(), 12, 12.0, &Mask::default(), |_, _| false);
            searched
                .iter()
                .filter_map(|c| triangulator.point(c.pixel, RANGE))
                .filter(PointState::is_known)
                .count()
        };
        let (straight, turning) = (count(0.0), count(0.25));
        assert!(straight > 100 && turning * 10 < straight, "{straight} without a turn, {turning} with one");
    }

    #[test]
    fn least_squares_depth_is_reached_from_a_rough_start() {
        let views =
            [pose(0.0, 0.0, 0.0, 0.0, 0.0), pose(0.3, 0.05, 0.2, 0.02, 0.0), pose(-0.2, 0.0, 0.3, 0.0, 0.0)]
                .map(View::new);
        let map = bare_map(&views);
        let (params, track) = (TriangulateParams::default(), TrackParams::default());
        let triangulator = Triangulator::new(&map, 0, &[1, 2], &params, &track);
        for (pixel, truth) in [([60.0, 90.0], 0.25), ([250.0, 160.0], 0.4)] {
            let ray = map.camera.unproject(pixel[0], pixel[1]);
            let seen = [1, 2].map(|keyframe: usize| {
                let at = map.camera.project(&(views[0].to(&views[keyframe]) * (ray / truth)));
                let pixel = [at.x as f32, at.y as f32];
                SeenAt { keyframe, pixel, information: [1.0, 0.2, 0.5] }
            });
            for start in [0.7 * truth, 1.4 * truth] {
                let (found, variance, worst) = triangulator.solve_depth(&ray, start, &seen).unwrap();
                assert!((found / truth - 1.0).abs() < 1e-4, "{found} from {start}, in truth {truth}");
                assert!(worst < 1e-3 && variance > 0.0, "{worst} {variance}");
            }
            assert!(triangulator.solve_depth(&ray, truth, &[]).is_none(), "nothing seen, nothing known");
        }
    }

    #[test]
    fn the_unit_of_the_poses_is_the_unit_of_the_depths() {
        let mut views = [pose(0.0, 0.0, 0.0, 0.0, 0.0), pose(0.3, 0.0, 0.1, 0.02, 0.0)].map(View::new);
        let (points, _) = triangulate(&views);
        for view in &mut views {
            view.world_from_camera.translation *= 0.25;
        }
        let map = bare_map(&views);
        let (params, track) = (TriangulateParams::default(), TrackParams::default());
        let triangulator = Triangulator::new(&map, 0, &[1], &params, &track);
        for point in points {
            let scaled = triangulator.point(point.pixel, (4.0 * RANGE.0, 4.0 * RANGE.1)).unwrap();
            assert!((scaled.inverse_depth / point.inverse_depth - 4.0).abs() < 1e-3);
        }
    }
}
