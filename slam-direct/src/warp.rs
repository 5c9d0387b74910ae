//! How a small patch of a keyframe looks from another pose.

use geometry::{Pinhole, Se3};
use nalgebra::{Vector2, Vector3};

/// The affine map from a view's pixels to its host's around one point, and the pyramid levels at which
/// both have about one resolution.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Warp {
    /// Row-major 2×2: host pixels per view pixel, both at level 0.
    pub host_from_view: [f32; 4],
    /// Level to sample the host at.
    pub host_level: usize,
    /// Level to search the view at.
    pub view_level: usize,
}

impl Warp {
    /// The same warp with both images sampled `levels` coarser.
    pub fn coarser(&self, levels: usize) -> Self {
        Self { host_level: self.host_level + levels, view_level: self.view_level + levels, ..*self }
    }
}

/// Beyond this magnification a patch no longer looks like itself.
const MAX_MAGNIFICATION: f64 = 4.0;

impl Warp {
    /// No change between the two.
    #[cfg(test)]
    pub fn identity() -> Self {
        Self { host_from_view: [1.0, 0.0, 0.0, 1.0], host_level: 0, view_level: 0 }
    }

    /// The warp of the patch at host ray `ray` (z = 1) with inverse depth `inverse_depth`, parallel to
    /// the host's image plane, and its projection in the view. `None` when it is behind the view,
    /// seen too obliquely or magnified out of recognition.
    pub fn new(
        camera: &Pinhole,
        view_from_host: &Se3,
        rotation: &nalgebra::Matrix3<f64>,
        ray: &Vector3<f64>,
        inverse_depth: f64,
    ) -> Option<(Self, Vector2<f64>)> {
        let x = rotation * ray + view_from_host.translation * inverse_depth;
        if x.z < 0.02 {
            return None;
        }
        let iz = 1.0 / x.z;
        let pixel = Vector2::new(camera.fx * x.x * iz + camera.cx, camera.fy * x.y * iz + camera.cy);
        // Columns: motion in the view for one host pixel along x and y, d(pixel)/d(x) · R · e / f.
        let column = |c: usize, f: f64| {
            let d = rotation.column(c) / f;
            let (px, py) = (x.x * iz, x.y * iz);
            Vector2::new(camera.fx * iz * (d.x - px * d.z), camera.fy * iz * (d.y - py * d.z))
        };
        let (a, b) = (column(0, camera.fx), column(1, camera.fy));
        let det = a.x * b.y - b.x * a.y;
        let magnification = det.abs().sqrt();
        if det <= 0.0 || !(1.0 / MAX_MAGNIFICATION..=MAX_MAGNIFICATION).contains(&magnification) {
            return None;
        }
        let inverse = [b.y / det, -b.x / det, -a.y / det, a.x / det].map(|v| v as f32);
        let octaves = magnification.log2().round() as i32;
        let warp = Self {
            host_from_view: inverse,
            host_level: (-octaves).max(0) as usize,
            view_level: octaves.max(0) as usize,
        };
        Some((warp, pixel))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    #[test]
    fn linearises_the_projection() {
        let camera = Pinhole { width: 640, height: 480, fx: 500.0, fy: 480.0, cx: 320.0, cy: 240.0 };
        let view_from_host = Se3::exp(&Vector6::new(0.2, -0.1, 0.3, 0.05, -0.1, 0.2));
        let (pixel, inverse_depth) = ([200.0, 150.0], 0.4);
        let project =
            |u: f64, v: f64| camera.project(&(view_from_host * (camera.unproject(u, v) / inverse_depth)));
        let ray = camera.unproject(pixel[0], pixel[1]);
        let rotation = view_from_host.rotation_matrix();
        let (warp, at) = Warp::new(&camera, &view_from_host, &rotation, &ray, inverse_depth).unwrap();
        assert!((at - project(pixel[0], pixel[1])).norm() < 1e-9);
        let m = warp.host_from_view;
        for (du, dv) in [(0.01, 0.0), (0.0, 0.01)] {
            let moved = project(pixel[0] + du, pixel[1] + dv) - at;
            let back = [
                m[0] as f64 * moved.x + m[1] as f64 * moved.y,
                m[2] as f64 * moved.x + m[3] as f64 * moved.y,
            ];
            assert!((back[0] - du).abs() < 1e-4 && (back[1] - dv).abs() < 1e-4, "{back:?}");
        }
    }
}
