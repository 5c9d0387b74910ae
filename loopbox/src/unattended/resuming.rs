//! The map that a session goes on in: that of the newest session before it which can be read.

use super::sessions::{Session, Sessions, set_aside};
use super::vitals::Vitals;
use crate::open::{OpenedMap, open_map};
use crate::run::Resume;
use crate::{Level, explained};
use map::Map;
use slam_direct::ResumeMode;
use std::collections::BTreeSet;

/// Frames of earlier sessions that a map keeps when it is gone on with: they are of no use to tracking, and in months
/// they would outgrow all else. Five minutes of them at 30 frames a second.
const FRAMES: usize = 9000;

/// A map to go on in.
pub struct MapToResume {
    /// The session that made it.
    pub session: Session,
    /// The map.
    pub resume: Resume,
}

/// Finds the map to go on in, but not those of the sessions `passed`. One that cannot be read is set aside; one of more than
/// `most` bytes is left, and a new one begun: a session writes all of the map that it goes on in.
pub fn find_map(
    sessions: &Sessions,
    passed: &BTreeSet<u32>,
    most: u64,
    vitals: &Vitals,
) -> Option<MapToResume> {
    let mut history = sessions.history();
    let earlier = sessions.all().into_iter().rev().filter(|session| !passed.contains(&session.number));
    for session in earlier {
        if session.number <= history.left {
            return None;
        }
        if !history.allows(session.number) {
            vitals.report(Level::Warn, &format!(
                "session {}: {} starts read its map and did not come to their first frame; it is left as it is",
                session.number, history.readings
            ));
            continue;
        }
        for map in session.maps() {
            let bytes = std::fs::metadata(&map).map_or(0, |about| about.len());
            if bytes > most {
                let map = map.display();
                vitals
                    .trouble(&format!("{map}: takes more than half of limits.disk_mib, a new map is begun"));
                sessions.keep_history(&history.without_maps_until(session.number));
                return None;
            }
            history = history.reading(session.number);
            sessions.keep_history(&history);
            match open_map(&map) {
                Ok(opened) if can_be_tracked(&opened.map) => {
                    let opened = Some(Box::new(thinned(opened)));
                    let resume = Resume { map, mode: ResumeMode::Mapping, opened };
                    return Some(MapToResume { session, resume });
                }
                Ok(_) => {}
                Err(error) => {
                    let why = explained(&error);
                    let aside = set_aside(&map, &why);
                    let where_to =
                        aside.map_or_else(|e| explained(&e), |to| format!("kept as {}", to.display()));
                    vitals.trouble(&format!("the map cannot be read and is set aside, {where_to}: {why}"));
                }
            }
        }
    }
    None
}

/// Whether any depth of a map had settled when its session ended. One that was killed before is not gone on with, but the
/// one before it.
fn can_be_tracked(map: &Map) -> bool {
    let mut points = map.keyframes.values().flat_map(|keyframe| &keyframe.points);
    points.any(|point| point.inverse_depth > 0.0 && !point.observations.is_empty())
}

/// A map with the newest of its frames.
fn thinned(mut opened: OpenedMap) -> OpenedMap {
    let frames = &mut opened.map.frames;
    frames.drain(..frames.len().saturating_sub(FRAMES));
    opened
}
