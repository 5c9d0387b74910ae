//! Keyframes as an ideal camera would have taken them.
//!
//! A map stores images as the agent got them, undistorted by the calibration. Its agent's provenance has what the
//! recording revealed beyond that: the remaining distortion of the lens, and the readout time. Code that compares
//! places in two images undoes both.

use crate::{AgentId, AgentInfo, FramePose, Keyframe, Map, SemiDense};
use geometry::sensor::{CoarseDepth, Lens, Rectification, Sensor, Shift, Twist, motion};
use geometry::{Pinhole, Sim3};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Where a map says what is left of its lens's distortion, in its agent's provenance.
const LENS: &str = "lens";
/// Where it says how long its camera takes to read an image, from the first column to the last and from the first row to the
/// last, seconds.
const READOUT: [&str; 2] = ["readout columns", "readout rows"];
/// Standard deviation of the one that is not zero, seconds.
const READOUT_DEVIATION: &str = "readout deviation";

impl AgentInfo {
    /// The sensor of its images; ideal if the provenance has none. `None` for a LiDAR.
    pub fn image_sensor(&self) -> Option<Sensor> {
        let camera = *self.camera()?;
        let value_of = |key: &str| self.provenance.get(key);
        let lens =
            value_of(LENS).and_then(|text| Lens::from_text(camera, text)).unwrap_or(Lens::ideal(camera));
        let seconds = |text: &String| text.parse().ok().filter(|time: &f64| time.is_finite());
        let seconds_of = |key: &str| value_of(key).and_then(seconds).unwrap_or(0.0);
        let readout_deviation = seconds_of(READOUT_DEVIATION);
        Some(Sensor { lens, readout: READOUT.map(seconds_of), readout_deviation })
    }
}

/// The entries of an agent's provenance that describe a sensor.
pub fn sensor_entries(sensor: &Sensor) -> [(&'static str, String); 4] {
    let [columns, rows] = sensor.readout.map(|time| format!("{time:?}"));
    let deviation = format!("{:?}", sensor.readout_deviation);
    [(LENS, sensor.lens.to_text()), (READOUT[0], columns), (READOUT[1], rows), (READOUT_DEVIATION, deviation)]
}

/// A keyframe as an ideal pinhole camera that reads all rows at once would have taken it.
#[derive(Clone, Debug)]
pub struct Rectified {
    /// The keyframe; image, depths and points are in their places, colours and features are left out.
    pub keyframe: Keyframe,
    /// The rectification that moved them.
    pub rectification: Rectification,
}

impl Map {
    /// The motion of the camera at a keyframe, in its unit: from the frame before it to the one after. Zero where one
    /// of them is not known.
    pub fn motion_at(&self, keyframe: &Keyframe) -> Twist {
        match self.agents.len() {
            1 => self.motion_among(&self.frames, keyframe),
            _ => self.motion_among(&self.frames_of(keyframe.agent), keyframe),
        }
    }

    /// The same at every keyframe, in their order.
    pub fn motions(&self) -> Vec<Twist> {
        if self.agents.len() == 1 {
            return self.keyframes.values().map(|k| self.motion_among(&self.frames, k)).collect();
        }
        let frames: BTreeMap<AgentId, Vec<FramePose>> =
            self.agents.keys().map(|&agent| (agent, self.frames_of(agent))).collect();
        let of = |keyframe: &Keyframe| frames.get(&keyframe.agent).map_or(&[][..], Vec::as_slice);
        self.keyframes.values().map(|keyframe| self.motion_among(of(keyframe), keyframe)).collect()
    }

    /// How the camera moved at a keyframe among its agent's `frames`.
    fn motion_among(&self, frames: &[FramePose], keyframe: &Keyframe) -> Twist {
        let own = frames.partition_point(|frame| frame.timestamp < keyframe.timestamp);
        let (before, after) = (own.checked_sub(1).and_then(|i| frames.get(i)), frames.get(own + 1));
        let pose = |frame: &FramePose| {
            let reference = self.keyframes.get(&frame.reference)?.world_from_keyframe;
            let own_from_frame =
                keyframe.world_from_keyframe.inverse() * reference * Sim3::from(frame.keyframe_from_frame);
            Some(own_from_frame.rigid().inverse())
        };
        let (Some(before), Some(after)) = (before, after) else { return Twist::zeros() };
        match (pose(before), pose(after)) {
            (Some(from), Some(to)) => motion(&from, &to, after.timestamp - before.timestamp),
            _ => Twist::zeros(),
        }
    }

    /// An agent's frames.
    fn frames_of(&self, agent: AgentId) -> Vec<FramePose> {
        let is_own =
            |frame: &&FramePose| self.keyframes.get(&frame.reference).map(|k| k.agent) == Some(agent);
        self.frames.iter().filter(is_own).copied().collect()
    }

    /// How far a keyframe's image is off an ideal camera's, not at all where it does not matter; `None` of a LiDAR's.
    pub fn image_shift(&self, keyframe: &Keyframe) -> Option<Shift> {
        let sensor = self.agents.get(&keyframe.agent)?.image_sensor()?;
        Some(match sensor.is_ideal() {
            true => Shift::none(sensor.lens.camera),
            false => Shift::new(&sensor, &self.motion_at(keyframe)),
        })
    }

    /// A camera's keyframe as an ideal camera would have taken it; `None` where its own differs by less than matters,
    /// and for a LiDAR's.
    pub fn rectified(&self, keyframe: &Keyframe) -> Option<Rectified> {
        let sensor = self.agents.get(&keyframe.agent)?.image_sensor()?;
        rectified(keyframe, &sensor, &self.motion_at(keyframe))
    }

    /// The conversion of a keyframe's image to that of an ideal camera, for callers that need only this; `None` as
    /// with [`rectified`](Self::rectified).
    pub fn rectification(&self, keyframe: &Keyframe) -> Option<Rectification> {
        let sensor = self.agents.get(&keyframe.agent)?.image_sensor()?;
        rectification(keyframe, &sensor, &self.motion_at(keyframe))
    }
}

/// A keyframe with this `motion`, in its unit, as an ideal camera would have taken it; `None` where its own differs
/// by less than matters.
pub fn rectified(keyframe: &Keyframe, sensor: &Sensor, motion: &Twist) -> Option<Rectified> {
    let rectification = rectification(keyframe, sensor, motion)?;
    let mut points = keyframe.points.clone();
    for point in &mut points {
        point.pixel = rectification.pixel_at(point.pixel, point.inverse_depth);
    }
    let keyframe = Keyframe {
        image: Arc::new(rectification.image(&keyframe.image)),
        semi_dense: rectified_depths(&keyframe.semi_dense, &sensor.lens.camera, &rectification).into(),
        color: None,
        scan: None,
        points,
        features: None,
        words: None,
        ..*keyframe
    };
    Some(Rectified { keyframe, rectification })
}

/// What makes a keyframe's image that of an ideal camera; `None` where it is, as far as it matters.
fn rectification(keyframe: &Keyframe, sensor: &Sensor, motion: &Twist) -> Option<Rectification> {
    let camera = &sensor.lens.camera;
    let place = |pixel: u32| [(pixel as usize % camera.width) as f32, (pixel as usize / camera.width) as f32];
    let depths = keyframe.semi_dense.iter().map(|(pixel, inverse_depth, _)| (place(pixel), inverse_depth));
    (!sensor.is_ideal()).then(|| Rectification::new(sensor, motion, CoarseDepth::new(camera, depths)))
}

/// Depths at the pixels in which the ideal camera sees them; where two meet, that of the smaller variance.
pub fn rectified_depths(depths: &SemiDense, camera: &Pinhole, rectification: &Rectification) -> SemiDense {
    let width = camera.width;
    let mut all: Vec<(u32, f32, f32)> = depths
        .iter()
        .filter_map(|(pixel, inverse_depth, variance)| {
            let distorted = [(pixel as usize % width) as f32, (pixel as usize / width) as f32];
            let [x, y] = rectification.pixel_at(distorted, inverse_depth).map(f32::round);
            let is_inside = x >= 0.0 && y >= 0.0 && x < width as f32 && y < camera.height as f32;
            is_inside.then(|| ((y as usize * width + x as usize) as u32, inverse_depth, variance))
        })
        .collect();
    all.sort_by(|a, b| a.0.cmp(&b.0).then(a.2.total_cmp(&b.2)));
    all.dedup_by_key(|depth| depth.0);
    SemiDense {
        pixel: all.iter().map(|depth| depth.0).collect(),
        inverse_depth: all.iter().map(|depth| depth.1).collect(),
        variance: all.iter().map(|depth| depth.2).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{random_map, sample_camera, sample_map};

    fn describe(map: &mut Map, sensor: &Sensor) {
        let about = map.agents.values_mut().next().unwrap();
        about.provenance.extend(sensor_entries(sensor).map(|(key, value)| (key.to_owned(), value)));
    }

    #[test]
    fn a_sensor_is_written_and_read() {
        let mut map = sample_map(4);
        let camera = *map.agents.values().next().unwrap().camera().unwrap();
        assert_eq!(map.agents.values().next().unwrap().image_sensor(), Some(Sensor::ideal(camera)));
        let sensor =
            Sensor { readout_deviation: 0.0003, ..Sensor::ideal(camera).with([-0.0123, 0.0, 0.0241]) };
        describe(&mut map, &sensor);
        assert_eq!(map.agents.values().next().unwrap().image_sensor(), Some(sensor));
    }

    #[test]
    fn agents_move_in_a_common_map_as_they_did_in_their_own() {
        let [one, other] = [sample_map(4), random_map(AgentInfo::new("other", sample_camera()), 3, 8)];
        let united = Map::unite(vec![one.clone(), other.clone()]).unwrap();
        let own: Vec<Twist> = [&one, &other].iter().flat_map(|map| map.motions()).collect();
        assert!(own.iter().any(|motion| *motion != Twist::zeros()));
        assert_eq!(united.motions(), own);
        let alone = |keyframe| united.motion_at(keyframe);
        assert_eq!(united.keyframes.values().map(alone).collect::<Vec<_>>(), own);
    }

    #[test]
    fn what_an_ideal_camera_took_stays_as_it_is() {
        let map = sample_map(4);
        assert!(map.keyframes.values().all(|keyframe| map.rectified(keyframe).is_none()));
    }

    /// A pixel with depth is the same point of the world before and after.
    #[test]
    fn depths_and_points_go_where_an_ideal_camera_sees_them() {
        let mut map = sample_map(4);
        let camera = *map.agents.values().next().unwrap().camera().unwrap();
        // The corner moves by two pixels.
        let corner = 0.5 * (camera.width as f64).hypot(camera.height as f64);
        describe(&mut map, &Sensor::ideal(camera).with([-2.0 / corner, 0.0, 0.0]));
        for keyframe in map.keyframes.values() {
            let ideal = map.rectified(keyframe).expect("two pixels matter").keyframe;
            assert!(!ideal.semi_dense.is_empty() && ideal.semi_dense.pixel.is_sorted());
            let shift = map.image_shift(keyframe).unwrap();
            let exact: Vec<_> =
                keyframe.cloud(&camera, shift, f32::INFINITY).map(|point| point.position).collect();
            for point in ideal.cloud(&camera, Shift::none(camera), f32::INFINITY) {
                let apart = exact.iter().map(|other| (other - point.position).norm() / other.z);
                // Depths lie on whole pixels.
                assert!(apart.fold(f64::INFINITY, f64::min) < 0.75 / camera.fx);
            }
            for (before, after) in keyframe.points.iter().zip(&ideal.points) {
                let middle = [camera.cx as f32, camera.cy as f32];
                let reach = |[x, y]: [f32; 2]| (x - middle[0]).hypot(y - middle[1]);
                assert!(reach(after.pixel) <= reach(before.pixel), "all goes towards the middle");
            }
        }
    }
}
