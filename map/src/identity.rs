//! Identity: the permanent names of an agent and of a keyframe, the same in every file and every merge.

use geometry::{GrayImage, Pinhole};
use serde::{Deserialize, Serialize};
use std::fmt;
use uuid::Uuid;

/// The namespace of the UUIDs that are made of content (RFC 9562, §6.5): itself the version 5 of `loopbox.map` in the
/// namespace of domain names.
const NAMESPACE: Uuid = Uuid::from_u128(0x9fea_1e30_0325_535e_83d1_0f31_376e_4918);

/// The identity of one map of one agent: who made it, and which of that agent's maps it is.
///
/// An agent begins another map after a loss or on request. That is its next epoch, in which keyframes are numbered
/// anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Identity {
    /// The agent.
    pub uuid: Uuid,
    /// Which of its maps, from 0.
    pub epoch: u32,
}

/// The permanent name of a keyframe; a [`KeyframeId`](crate::KeyframeId) is valid within one file only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct KeyframeName {
    /// Whose it is, and of which map.
    pub agent: Identity,
    /// Its id in the agent's own map.
    pub number: u32,
}

impl Identity {
    /// A live agent: a random UUID (version 4) of 16 random `bytes`. No two live cameras see the same, and no one can
    /// run them again.
    pub fn random(bytes: [u8; 16]) -> Self {
        Self::first(uuid::Builder::from_random_bytes(bytes).into_uuid())
    }

    /// The agent of a recording: a UUID (version 5) of the recording's start, which is its camera (pixels) and its
    /// first image with its time stamp (seconds). So a recording that is run again is the same agent, on any machine,
    /// whatever its folder and the parameters are.
    pub fn of_recording(camera: &Pinhole, timestamp: f64, image: &GrayImage) -> Self {
        let Pinhole { width, height, fx, fy, cx, cy } = *camera;
        let mut content = Vec::with_capacity(image.data().len() + 64);
        for size in [width, height, image.width(), image.height()] {
            content.extend((size as u64).to_le_bytes());
        }
        for number in [fx, fy, cx, cy, timestamp] {
            content.extend(number.to_le_bytes());
        }
        content.extend(image.data());
        Self::first(Uuid::new_v5(&NAMESPACE, &content))
    }

    /// The same of a LiDAR's recording: of its first scan that can be used, `points` in metres, and its time stamp.
    pub fn of_scans(timestamp: f64, points: &[[f32; 3]]) -> Self {
        let mut content = b"scan".to_vec();
        content.extend(timestamp.to_le_bytes());
        content.extend(points.iter().flatten().flat_map(|number| number.to_le_bytes()));
        Self::first(Uuid::new_v5(&NAMESPACE, &content))
    }

    /// An agent of which no more is known than its name and its camera: a UUID (version 5) of these.
    pub(crate) fn of_name(name: &str, camera: &Pinhole) -> Self {
        let Pinhole { width, height, fx, fy, cx, cy } = camera;
        let text = format!("{name}\n{width} {height} {fx} {fy} {cx} {cy}");
        Self::first(Uuid::new_v5(&NAMESPACE, text.as_bytes()))
    }

    fn first(uuid: Uuid) -> Self {
        Self { uuid, epoch: 0 }
    }

    /// The same agent's map that is `count` later.
    pub fn later(self, count: u32) -> Self {
        Self { epoch: self.epoch.saturating_add(count), ..self }
    }
}

impl fmt::Display for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.uuid, self.epoch)
    }
}

impl fmt::Display for KeyframeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.agent, self.number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 4, height: 3, fx: 2.0, fy: 2.0, cx: 1.5, cy: 1.0 };

    #[test]
    fn the_namespace_is_what_it_says() {
        assert_eq!(Uuid::new_v5(&Uuid::NAMESPACE_DNS, b"loopbox.map"), NAMESPACE);
    }

    #[test]
    fn a_recording_is_one_agent_whatever_it_is_called_and_others_are_others() {
        let image = GrayImage::filled(4, 3, 7);
        let of = |camera: &Pinhole, time, image: &GrayImage| Identity::of_recording(camera, time, image);
        let one = of(&CAMERA, 1.5, &image);
        assert_eq!(one, of(&CAMERA, 1.5, &image.clone()));
        assert_eq!(one.uuid.get_version_num(), 5);
        let others = [
            of(&Pinhole { fx: 2.5, ..CAMERA }, 1.5, &image),
            of(&CAMERA, 1.75, &image),
            of(&CAMERA, 1.5, &GrayImage::filled(4, 3, 8)),
            one.later(1),
            Identity::random([3; 16]),
        ];
        assert!(others.iter().all(|other| *other != one));
        assert_eq!(others[4].uuid.get_version_num(), 4);
    }

    #[test]
    fn scans_that_differ_or_were_taken_at_another_time_are_another_agents() {
        let points = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]];
        let one = Identity::of_scans(1.5, &points);
        assert_eq!((one, one.epoch), (Identity::of_scans(1.5, &points), 0));
        assert!(one != Identity::of_scans(1.75, &points) && one != Identity::of_scans(1.5, &points[..1]));
    }

    #[test]
    fn names_are_written_as_paths() {
        let agent = Identity { uuid: Uuid::nil(), epoch: 2 };
        let name = KeyframeName { agent, number: 41 };
        assert_eq!(name.to_string(), "00000000-0000-0000-0000-000000000000/2/41");
    }
}
