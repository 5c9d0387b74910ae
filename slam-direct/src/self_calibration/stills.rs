//! The positions of points in keyframes without the effect of a rolling shutter, which bends images in step with the
//! camera's motion. What remains of that would count as distortion of the lens.

use geometry::sensor::{Sensor, Twist};
use map::{AgentInfo, Keyframe, KeyframeId, Map, Observation, Point};
use nalgebra::Vector2;
use std::collections::BTreeMap;

/// The keyframes whose sensor was not read at once, with how it moved meanwhile, in the keyframe's unit.
pub(super) struct Stills<'a> {
    map: &'a Map,
    rolling: BTreeMap<KeyframeId, (Sensor, Twist)>,
}

impl<'a> Stills<'a> {
    /// Of the keyframes of a map, as it knows its sensors.
    pub fn of(map: &'a Map) -> Self {
        let sensors: BTreeMap<_, Sensor> = (map.agents.iter())
            .filter_map(|(&id, about)| Some((id, AgentInfo::image_sensor(about)?)))
            .filter(|(_, sensor)| sensor.is_rolling())
            .collect();
        if sensors.is_empty() {
            return Self { map, rolling: BTreeMap::new() };
        }
        let rolling = |(keyframe, motion): (&Keyframe, Twist)| {
            Some((keyframe.id, (*sensors.get(&keyframe.agent)?, motion)))
        };
        Self { map, rolling: map.keyframes.values().zip(map.motions()).filter_map(rolling).collect() }
    }

    /// A point in the image of its host.
    pub fn host(&self, host: &Keyframe, point: &Point) -> Vector2<f64> {
        self.still(host.id, point.pixel, || Some(f64::from(point.inverse_depth)))
            .unwrap_or(exact(point.pixel))
    }

    /// A point of `host` in the image of a keyframe that sees it; nothing where it lies behind that one.
    pub fn seen(&self, host: &Keyframe, point: &Point, seen: &Observation) -> Option<Vector2<f64>> {
        self.still(seen.keyframe, seen.pixel, || {
            let ray = self.map.camera(host).unproject(point.pixel[0].into(), point.pixel[1].into());
            let world_from_other = self.map.keyframes.get(&seen.keyframe)?.world_from_keyframe;
            let other_from_host = world_from_other.inverse() * host.world_from_keyframe;
            let depth = (other_from_host * (ray / f64::from(point.inverse_depth))).z;
            (depth > 0.0).then(|| 1.0 / depth)
        })
    }

    /// What `keyframe` shows at a pixel, of this inverse depth in it.
    fn still(
        &self,
        keyframe: KeyframeId,
        pixel: [f32; 2],
        inverse_depth: impl FnOnce() -> Option<f64>,
    ) -> Option<Vector2<f64>> {
        let Some((sensor, motion)) = self.rolling.get(&keyframe) else { return Some(exact(pixel)) };
        let distorted = pixel.map(f64::from);
        Some(exact(pixel) - sensor.velocity(distorted, motion, inverse_depth()?) * sensor.delay(distorted))
    }
}

fn exact(pixel: [f32; 2]) -> Vector2<f64> {
    Vector2::from(pixel.map(f64::from))
}
