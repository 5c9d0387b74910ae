//! A piece of surface.

use crate::keyframe::transformed;
use geometry::Se3;
use nalgebra::Vector3;

/// A piece of surface in a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surfel {
    /// Middle of its points, metres.
    pub middle: [f32; 3],
    /// Unit axes of their scatter, the narrowest first: the normal of what is flat.
    pub axes: [[f32; 3]; 3],
    /// Standard deviations along the axes, metres.
    pub deviations: [f32; 3],
    /// Whether it is flat.
    pub is_flat: bool,
    /// Its cell.
    pub cell: [i32; 3],
}

impl Surfel {
    /// The same as seen in another frame; the cell stays that of its own map.
    pub fn moved(&self, pose: &Se3) -> Self {
        let turned = |axis: [f32; 3]| {
            let v = pose.rotation * Vector3::from(axis.map(f64::from));
            [v.x as f32, v.y as f32, v.z as f32]
        };
        Self { middle: transformed(pose, self.middle), axes: self.axes.map(turned), ..*self }
    }
}
