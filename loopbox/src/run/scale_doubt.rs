//! Where the scale of a trajectory may have changed. What a camera sees does not tell its scale: after a change all lengths are as wrong.
//! But speed and depth change by one factor then, at once, while the image moves as before.

use geometry::{Se3, median};
use map::{AgentId, FramePose, KeyframeId, Map};
use serde::Serialize;
use std::collections::BTreeMap;

/// Seconds over which a speed is told, and between two that are compared. A hand takes longer to bring a camera from a room to a thing in it.
const SPAN: f64 = 0.7;
const APART: f64 = 2.0;
/// Fewest steps that tell a speed.
const STEPS: usize = 4;
/// A change of speed and depth by less is how cameras move: 1.8 in hand-held recordings, drives and flights.
const FACTOR: f64 = 3.0;
/// The speed over the depth, by which the image moves, may change by so much meanwhile: one that stops before something near is no such case.
const RATIO: f64 = 2.5;

/// A frame at which the scale may have changed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ScaleDoubt {
    /// The first frame after the change, to two seconds.
    pub frame: u64,
    /// Its time stamp, seconds.
    pub timestamp: f64,
    /// So many times as large as before lengths are after it; below 1 they shrink.
    pub factor: f64,
}

/// Poses of an agent's frames.
type Placed<'a> = Vec<(Se3, &'a FramePose)>;

/// The camera over a span of time.
struct Span<'a> {
    /// Its frames, of which there is at least one.
    frames: &'a [(Se3, &'a FramePose)],
    /// Map units a second.
    speed: f64,
}

impl Span<'_> {
    /// The time stamp of its first frame, seconds.
    fn begin(&self) -> f64 {
        self.frames[0].1.timestamp
    }
}

/// Times at which the scale of a map's trajectories may have changed, those further apart than what is compared.
pub fn scale_doubts(map: &Map) -> Vec<ScaleDoubt> {
    let mut depths = Depths { map, known: BTreeMap::new() };
    let of_agent = |agent| doubts(&spans(map, &placed(map, agent)), &mut depths);
    map.agents.keys().copied().flat_map(of_agent).collect()
}

/// The same of a trajectory.
fn doubts(spans: &[Span], depths: &mut Depths) -> Vec<ScaleDoubt> {
    let mut doubts: Vec<ScaleDoubt> = Vec::new();
    for (i, before) in spans.iter().enumerate() {
        let Some(after) = spans[i..].iter().find(|span| span.begin() >= before.begin() + APART) else {
            break;
        };
        if after.begin() > before.begin() + APART + SPAN {
            continue;
        }
        let Some(found) = change(before, after, depths) else { continue };
        match doubts.last_mut().filter(|last| found.timestamp < last.timestamp + APART + SPAN) {
            Some(last) if last.factor.ln().abs() >= found.factor.ln().abs() => {}
            Some(last) => *last = found,
            None => doubts.push(found),
        }
    }
    doubts
}

/// Whether speed and depth changed by one factor, and by which: by the lesser of both changes.
fn change(before: &Span, after: &Span, depths: &mut Depths) -> Option<ScaleDoubt> {
    let speed = (after.speed / before.speed).ln();
    if speed.abs() < FACTOR.ln() {
        return None;
    }
    let depth = (depths.of(after)? / depths.of(before)?).ln();
    let least = if speed.abs() < depth.abs() { speed } else { depth };
    let is_one = speed * depth > 0.0 && (speed - depth).abs() <= RATIO.ln() && least.abs() >= FACTOR.ln();
    let FramePose { frame_index: frame, timestamp, .. } = *after.frames[0].1;
    is_one.then(|| ScaleDoubt { frame, timestamp, factor: least.exp() })
}

/// Median depths of keyframes, map units. They are read from the disk, so only of keyframes that are asked for.
struct Depths<'a> {
    map: &'a Map,
    known: BTreeMap<KeyframeId, Option<f32>>,
}

impl Depths<'_> {
    /// The median over a span's frames of the depth that their keyframes see.
    fn of(&mut self, span: &Span) -> Option<f64> {
        let frames = span.frames.iter();
        let mut seen: Vec<f32> = frames.filter_map(|(_, frame)| self.of_keyframe(frame.reference)).collect();
        median(&mut seen).map(f64::from)
    }

    fn of_keyframe(&mut self, id: KeyframeId) -> Option<f32> {
        *self.known.entry(id).or_insert_with(|| {
            let keyframe = self.map.keyframes.get(&id)?;
            let depth = keyframe.semi_dense.median_depth()?;
            keyframe.semi_dense.rest();
            Some((depth * keyframe.world_from_keyframe.scale) as f32)
        })
    }
}

/// The frames of an agent with their poses.
fn placed(map: &Map, agent: AgentId) -> Placed<'_> {
    let is_own = |frame: &&FramePose| map.keyframes.get(&frame.reference).is_some_and(|k| k.agent == agent);
    let frames = map.frames.iter().filter(is_own);
    frames.filter_map(|frame| Some((map.world_from_frame(frame)?.rigid(), frame))).collect()
}

/// Spans of a trajectory that begin with a frame each, tell a speed and see some depth.
fn spans<'a>(map: &Map, placed: &'a Placed) -> Vec<Span<'a>> {
    let speed = |pair: &[(Se3, &FramePose)]| {
        let seconds = pair[1].1.timestamp - pair[0].1.timestamp;
        ((pair[1].0.translation - pair[0].0.translation).norm() / seconds) as f32
    };
    let speeds: Vec<f32> = placed.windows(2).map(speed).collect();
    let has_depth = |(_, frame): &(Se3, &FramePose)| {
        map.keyframes.get(&frame.reference).is_some_and(|keyframe| !keyframe.semi_dense.is_empty())
    };
    let span = |first: usize| {
        let begin = placed[first].1.timestamp;
        // A session behind may begin anew with its times.
        let within = |&&(_, frame): &&(Se3, &FramePose)| (begin..=begin + SPAN).contains(&frame.timestamp);
        let count = placed[first..].iter().take_while(within).count();
        let frames = &placed[first..first + count];
        let mut steps = speeds.get(first..first + count - 1)?.to_vec();
        let speed = f64::from(median(&mut steps).filter(|_| steps.len() >= STEPS)?);
        let is_told = speed > 0.0 && speed.is_finite() && frames.iter().any(has_depth);
        is_told.then_some(Span { frames, speed })
    };
    (0..placed.len()).filter_map(span).collect()
}

/// What to say of a trajectory of this name whose scale may have changed; nothing of others.
pub fn doubtful_scale(name: &str, doubts: &[ScaleDoubt]) -> Option<String> {
    let place = |doubt: &ScaleDoubt| format!("from frame {} on by {:.2}", doubt.frame, doubt.factor);
    let places: Vec<String> = doubts.iter().map(place).collect();
    (!places.is_empty()).then(|| {
        format!(
            "the scale of {name} may have changed, {}: the camera seems as much slower or quicker as what it sees is nearer or farther\n\
             hint: what is known of lengths before does not hold behind; keep part of what was seen in view where the camera turns",
            places.join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{GrayImage, Pinhole, Sim3};
    use map::{Keyframe, SemiDense};
    use nalgebra::Vector3;
    use std::sync::Arc;

    /// A drive at ten frames a second, each a keyframe, of which `at` gives speed and depth at a time.
    fn drive(at: impl Fn(f64) -> (f64, f64)) -> Map {
        let mut map = Map::new(Pinhole { width: 40, height: 30, fx: 30.0, fy: 30.0, cx: 19.5, cy: 14.5 });
        let mut place = 0.0;
        for i in 0..100_u32 {
            let time = f64::from(i) * 0.1;
            let (speed, depth) = at(time);
            place += 0.1 * speed;
            let (id, pose) = (KeyframeId(i), Se3::new(Default::default(), Vector3::new(place, 0.0, 0.0)));
            let image = Arc::new(GrayImage::filled(40, 30, 90));
            let mut keyframe = Keyframe::of_image(id, time, u64::from(i), Sim3::from(pose), image);
            let pixels = 0..200_u32;
            let inverse = pixels.clone().map(|_| (1.0 / depth) as f32).collect::<Vec<f32>>();
            let depth = SemiDense {
                pixel: pixels.collect::<Vec<u32>>().into(),
                inverse_depth: inverse.into(),
                variance: vec![1e-4; 200].into(),
            };
            keyframe.semi_dense = depth.into();
            map.keyframes.insert(id, keyframe);
            map.frames.push(FramePose {
                timestamp: time,
                frame_index: u64::from(i),
                reference: id,
                keyframe_from_frame: Se3::identity(),
            });
        }
        map
    }

    #[test]
    fn speed_and_depth_that_fall_together_at_once_are_doubtful() {
        let collapsed = |time: f64| if time < 5.0 { (0.25, 1.5) } else { (0.02, 0.2) };
        let found = scale_doubts(&drive(collapsed));
        assert_eq!(found.len(), 1, "{found:?}");
        assert!((found[0].timestamp - 5.0).abs() < 2.0 && (0.1..0.2).contains(&found[0].factor), "{found:?}");
        let grown = scale_doubts(&drive(|time| if time < 5.0 { (0.02, 0.2) } else { (0.25, 1.5) }));
        assert!(grown.len() == 1 && grown[0].factor > 5.0, "{grown:?}");
    }

    #[test]
    fn what_cameras_do_is_not() {
        type Motion = fn(f64) -> (f64, f64);
        let motions: [(&str, Motion); 5] = [
            ("an even drive", |_| (0.25, 1.5)),
            ("it stops before something near", |time| if time < 5.0 { (0.25, 1.5) } else { (1e-4, 0.2) }),
            ("a turn to a far view on the way", |time| if time < 5.0 { (0.25, 0.3) } else { (0.25, 3.0) }),
            ("it comes near slowly", |time| (0.3 * (-0.3 * time).exp(), 2.0 * (-0.3 * time).exp())),
            ("it slows down", |time| if time < 5.0 { (0.25, 1.5) } else { (0.05, 1.4) }),
        ];
        for (name, motion) in motions {
            assert_eq!(scale_doubts(&drive(motion)), [], "{name}");
        }
    }

    /// Sessions and agents may begin anew with their times, and what lies between them is no change.
    #[test]
    fn sessions_with_times_of_their_own_are_looked_at_each() {
        let mut map = drive(|time| if time < 5.0 { (0.25, 1.5) } else { (0.02, 0.2) });
        let mut again = map.frames.clone();
        again.truncate(30);
        map.frames.extend(again);
        map.frames.rotate_left(60);
        let found = scale_doubts(&map);
        assert!(found.len() <= 1, "{found:?}");
    }

    #[test]
    fn hardly_any_frames_tell_nothing() {
        let mut map = drive(|_| (0.25, 1.5));
        map.frames.truncate(3);
        assert_eq!(scale_doubts(&map), []);
        map.frames.clear();
        assert_eq!(scale_doubts(&map), []);
    }
}
