//! A working map as a perfect tracker would leave it: rendered keyframes with exact depth.

use crate::local_map::{KeyframeState, LocalMap, PointRef, PointState, SeenAt};
use crate::mask::Mask;
use crate::select::select;
use geometry::{GrayImage, Image, Pyramid, Se3, Sim3};
use loopbox_tests::{Recording, World, render};
use map::{PlaceIndex, SemiDense};
use place_recog::ThumbnailIndex;

/// Relative standard deviation claimed for the depths.
const DEPTH_SIGMA: f64 = 0.01;

/// A map in all its forms.
pub(super) struct Scene {
    pub local: LocalMap,
    pub places: ThumbnailIndex,
}

impl Scene {
    /// Keyframes at the poses of a path; points are seen by keyframes at most `memory` earlier or later, as if
    /// older ones were never found again.
    pub fn render(world: &World, path: &[Se3], memory: usize) -> Self {
        let camera = Recording::SMALL_CAMERA;
        let mut local = LocalMap::new(camera);
        let mut places = ThumbnailIndex::default();
        let depths: Vec<Image<f32>> = path
            .iter()
            .enumerate()
            .map(|(index, pose)| {
                let (image, depth) = render(world, &camera, pose);
                places.add(LocalMap::id(index), &image);
                let mut state =
                    KeyframeState::new(index as f64, index as u64, Pyramid::new(image, 5), pose.inverse());
                state.points = points(&local, &state, &depth);
                local.push(state);
                let semi_dense = semi_dense(local.keyframes[index].pyramid.base(), &depth);
                local.keyframes[index].semi_dense = semi_dense.into();
                depth
            })
            .collect();
        let mut scene = Self { local, places };
        for host in 0..path.len() {
            let near = |&(k, _): &(usize, _)| k != host && k.abs_diff(host) <= memory;
            for (observer, depth) in depths.iter().enumerate().filter(near) {
                scene.observe(host, observer, depth);
            }
        }
        scene
    }

    /// Lets a keyframe see another's points where they are in its view and nothing hides them.
    fn observe(&mut self, host: usize, observer: usize, depth: &Image<f32>) {
        let map = &self.local;
        let relative =
            map.keyframes[observer].camera_from_world * map.keyframes[host].camera_from_world.inverse();
        let seen: Vec<(PointRef, SeenAt)> = (0..map.keyframes[host].points.len())
            .filter_map(|index| {
                let point = &map.keyframes[host].points[index];
                let x = relative * (point.ray / point.inverse_depth);
                let at = map.camera.project(&x);
                let pixel = [at.x as f32, at.y as f32];
                let inside =
                    x.z > 0.1 && map.keyframes[observer].pyramid.base().contains(pixel[0], pixel[1], 5.0);
                let visible = inside
                    && (depth.get(at.x.round() as usize, at.y.round() as usize) * x.z as f32 - 1.0).abs()
                        < 0.03;
                visible.then_some((
                    PointRef { host, index },
                    SeenAt { keyframe: observer, pixel, information: [4.0, 0.0, 4.0] },
                ))
            })
            .collect();
        seen.into_iter().for_each(|(at, seen)| self.local.observe(at, seen));
    }

    /// Lets every step from keyframe to keyframe err by `step`.
    pub fn drift(&mut self, step: &Sim3) {
        let truth: Vec<Sim3> =
            self.local.keyframes.iter().map(|k| Sim3::from(k.camera_from_world.inverse())).collect();
        let mut drifted = truth[0];
        for keyframe in 1..truth.len() {
            drifted = drifted * truth[keyframe - 1].inverse() * truth[keyframe] * *step;
            let state = &mut self.local.keyframes[keyframe];
            state.camera_from_world = drifted.rigid().inverse();
            for point in &mut state.points {
                point.inverse_depth /= drifted.scale;
                point.variance /= drifted.scale * drifted.scale;
            }
            state.scale *= drifted.scale;
        }
    }

    /// Lets keyframe `to` look exactly like `from`, wherever it is.
    pub fn copy_appearance(&mut self, from: usize, to: usize) {
        self.local.keyframes[to].pyramid = self.local.keyframes[from].pyramid.clone();
        self.local.keyframes[to].semi_dense = self.local.keyframes[from].semi_dense.clone();
        // The index answers with the newest of equals last: a second entry is as good as a replaced one.
        self.places.add(LocalMap::id(to), self.local.keyframes[to].pyramid.base());
    }
}

fn points(map: &LocalMap, state: &KeyframeState, depth: &Image<f32>) -> Vec<PointState> {
    select(state.pyramid.base(), 12, 12.0, &Mask::default(), |_, _| false)
        .into_iter()
        .filter_map(|candidate| {
            let [x, y] = candidate.pixel;
            let inverse_depth = f64::from(depth.get(x as usize, y as usize));
            (inverse_depth > 0.0).then(|| PointState {
                doubt: 0.0,
                pixel: candidate.pixel,
                ray: map.camera.unproject(x.into(), y.into()),
                inverse_depth,
                variance: (DEPTH_SIGMA * inverse_depth).powi(2),
                observations: Vec::new(),
                alive: true,
                searched: 0,
                found: 0,
            })
        })
        .collect()
}

/// The exact depth where the image has gradient.
fn semi_dense(image: &GrayImage, depth: &Image<f32>) -> SemiDense {
    let mut semi_dense = SemiDense::default();
    for y in 1..image.height() - 1 {
        for x in 1..image.width() - 1 {
            let gx = image.get(x + 1, y) as f32 - image.get(x - 1, y) as f32;
            let gy = image.get(x, y + 1) as f32 - image.get(x, y - 1) as f32;
            let inverse_depth = depth.get(x, y);
            if gx.hypot(gy) > 16.0 && inverse_depth > 0.0 {
                semi_dense.pixel.push((y * image.width() + x) as u32);
                semi_dense.inverse_depth.push(inverse_depth);
                semi_dense.variance.push((DEPTH_SIGMA as f32 * inverse_depth).powi(2));
            }
        }
    }
    semi_dense
}
