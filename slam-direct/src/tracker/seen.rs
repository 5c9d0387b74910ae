//! The departure of frames from keyframes, by the motion of the keyframes' points in the image.

use crate::align::ReferencePoint;
use crate::keyframes::Departure;
use crate::local_map::LocalMap;
use crate::mapping;
use geometry::Se3;
use geometry::sensor::Twist;
use std::collections::BTreeMap;

/// The points of keyframes that were asked for, as the keyframes see them; of one state of a map, frame after frame.
#[derive(Default)]
pub(super) struct SeenPoints {
    /// With the keyframe's motion, which is learnt meanwhile.
    of: BTreeMap<usize, (Twist, Vec<ReferencePoint>)>,
}

impl SeenPoints {
    /// How far a pose is from a keyframe's.
    pub fn departure(
        &mut self,
        map: &LocalMap,
        keyframe: usize,
        camera_from_world: &Se3,
        overlap: f32,
    ) -> Option<Departure> {
        let state = &map.keyframes[keyframe];
        let now = || (state.motion, map.reference_points(keyframe));
        let (motion, points) = self.of.entry(keyframe).or_insert_with(now);
        if *motion != state.motion {
            (*motion, *points) = now();
        }
        let relative = *camera_from_world * state.camera_from_world.inverse();
        let (flow, parallax) = mapping::median_flow(&map.camera, points, &relative)?;
        let width = map.camera.width as f32;
        Some(Departure { flow: flow / width, parallax: parallax / width, overlap })
    }
}
