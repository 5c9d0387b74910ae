//! Rendered views with exact depth, and working maps made of them.

use crate::align::ReferencePoint;
use crate::local_map::{KeyframeState, LocalMap, PointRef, PointState, SeenAt};
use crate::mask::Mask;
use crate::select::select;
use geometry::{GrayImage, Image, Pinhole, Pyramid, Se3};
use loopbox_tests::{Recording, World, render};
use nalgebra::{UnitQuaternion, Vector3};
use std::sync::LazyLock;

/// The camera of all rendered views.
pub(crate) const CAMERA: Pinhole = Recording::SMALL_CAMERA;

/// Relative standard deviation given to exact depths.
const DEPTH_SIGMA: f64 = 0.005;

/// The rendered world.
pub(crate) fn yard() -> &'static World {
    static YARD: LazyLock<World> = LazyLock::new(|| World::yard(7));
    &YARD
}

/// `world_from_camera` at `(x, y, z)` metres from a place 5 m before the row of boxes, turned right by `yaw`
/// and down by `pitch`, radians.
pub(crate) fn pose(x: f64, y: f64, z: f64, yaw: f64, pitch: f64) -> Se3 {
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw);
    let pitch = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -(0.08 + pitch));
    Se3::new(yaw * pitch, Vector3::new(x, y - 1.3, z + 4.5))
}

/// A rendered view.
pub(crate) struct View {
    pub world_from_camera: Se3,
    pub pyramid: Pyramid,
    pub inverse_depth: Image<f32>,
}

impl View {
    /// The yard as seen from a pose.
    pub fn new(world_from_camera: Se3) -> Self {
        Self::of(yard(), world_from_camera)
    }

    /// A world as seen from a pose.
    pub fn of(world: &World, world_from_camera: Se3) -> Self {
        let (image, inverse_depth) = render(world, &CAMERA, &world_from_camera);
        Self { world_from_camera, pyramid: Pyramid::new(image, 5), inverse_depth }
    }

    /// The exact inverse depth at a whole pixel, 1/m.
    pub fn depth_at(&self, pixel: [f32; 2]) -> f32 {
        self.inverse_depth.get(pixel[0].round() as usize, pixel[1].round() as usize)
    }

    /// Distinct pixels with their exact depth, one for each `block × block` pixels; those at a jump of the
    /// depth are left out: there a patch shows two surfaces.
    pub fn points(&self, block: usize) -> Vec<ReferencePoint> {
        let candidates = select(self.pyramid.base(), block, 12.0, &Mask::default(), |_, _| false);
        let pixels = candidates.into_iter().map(|c| c.pixel).filter(|&pixel| self.smooth_around(pixel));
        pixels
            .map(|pixel| {
                let inverse_depth = self.depth_at(pixel);
                let variance = (DEPTH_SIGMA as f32 * inverse_depth).powi(2);
                ReferencePoint { pixel, inverse_depth, variance }
            })
            .collect()
    }

    /// Whether the depth changes by less than a tenth within a patch around the pixel.
    pub fn smooth_around(&self, pixel: [f32; 2]) -> bool {
        let (x, y) = (pixel[0] as usize, pixel[1] as usize);
        let near = (y - 5..=y + 5).flat_map(|v| (x - 5..=x + 5).map(move |u| self.inverse_depth.get(u, v)));
        let (least, most) = near.fold((f32::INFINITY, 0.0f32), |(l, m), d| (l.min(d), m.max(d)));
        least > 0.0 && most < 1.1 * least
    }

    /// A keyframe without points.
    pub fn keyframe(&self) -> KeyframeState {
        KeyframeState::new(0.0, 0, self.pyramid.clone(), self.world_from_camera.inverse())
    }

    /// The camera's motion from this view to another.
    pub fn to(&self, other: &View) -> Se3 {
        other.world_from_camera.inverse() * self.world_from_camera
    }
}

/// A working map of the views without points.
pub(crate) fn bare_map(views: &[View]) -> LocalMap {
    let mut map = LocalMap::new(CAMERA);
    map.keyframes = views.iter().map(|view| view.keyframe().into()).collect();
    map
}

/// A working map of the views: each hosts points with exact depth, and all others in whose image a point falls
/// (unless something stands before it) have observed it exactly.
pub(crate) fn exact_map(views: &[View], block: usize) -> LocalMap {
    let mut map = bare_map(views);
    for (host, view) in views.iter().enumerate() {
        for (index, point) in view.points(block).into_iter().enumerate() {
            map.keyframes[host].points.push(point_state(point));
            for (keyframe, other) in views.iter().enumerate().filter(|(k, _)| *k != host) {
                let ray = CAMERA.unproject(point.pixel[0] as f64, point.pixel[1] as f64);
                let x = view.to(other) * (ray / point.inverse_depth as f64);
                let at = CAMERA.project(&x);
                let pixel = [at.x as f32, at.y as f32];
                let visible = x.z > 0.1
                    && other.inverse_depth.contains(pixel[0], pixel[1], 6.0)
                    && (other.depth_at(pixel) * x.z as f32 - 1.0).abs() < 0.1;
                if visible {
                    let seen = SeenAt { keyframe, pixel, information: [1.0, 0.0, 1.0] };
                    map.observe(PointRef { host, index }, seen);
                }
            }
        }
    }
    map
}

/// A living point that nobody has seen.
pub(crate) fn point_state(point: ReferencePoint) -> PointState {
    PointState {
        pixel: point.pixel,
        ray: CAMERA.unproject(point.pixel[0] as f64, point.pixel[1] as f64),
        inverse_depth: point.inverse_depth as f64,
        variance: point.variance as f64,
        doubt: 0.0,
        observations: Vec::new(),
        alive: true,
        searched: 0,
        found: 0,
    }
}

/// The image with `gain · I + offset` for each intensity.
pub(crate) fn brightened(image: &GrayImage, gain: f32, offset: f32) -> GrayImage {
    let data = image.data().iter().map(|&v| (gain * v as f32 + offset).round() as u8).collect();
    GrayImage::from_vec(image.width(), image.height(), data).expect("one value per pixel")
}

/// The value below which the share `share` of `values` lies.
pub(crate) fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[(share * (values.len() - 1) as f64) as usize]
}

/// The keyframes of a map without their points, which an agent keeps in its working map.
pub(crate) fn without_points(map: &map::Map) -> Vec<map::Keyframe> {
    let keyframes = map.keyframes.values().cloned();
    keyframes.map(|keyframe| map::Keyframe { points: Vec::new(), ..keyframe }).collect()
}
