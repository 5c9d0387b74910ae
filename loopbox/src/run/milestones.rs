//! How a long run goes, said now and then: its log tells afterwards when what happened.

use crate::counting::counted;

/// The moments when it is said first, seconds; after them every hour.
const FIRST: [f64; 3] = [600.0, 1800.0, HOUR];
const HOUR: f64 = 3600.0;

/// Until when it was said.
#[derive(Debug, Default)]
pub struct Milestones {
    reported_s: f64,
}

/// How a run goes.
#[derive(Clone, Copy, Debug)]
pub struct Standing {
    /// Seconds since it began.
    pub wall_s: f64,
    /// Frames processed.
    pub frames: u64,
    /// Frames dropped because tracking was late.
    pub dropped: u64,
    /// Keyframes of the map.
    pub keyframes: usize,
    /// How often tracking was lost.
    pub losses: u64,
    /// Resident memory, bytes.
    pub memory: Option<u64>,
}

impl Milestones {
    /// Whether it is time to say how a run goes that has taken so many seconds; true once at each moment.
    pub fn is_due(&mut self, wall_s: f64) -> bool {
        let first = FIRST.into_iter().find(|moment| *moment > self.reported_s);
        let next = first.unwrap_or_else(|| ((self.reported_s / HOUR).floor() + 1.0) * HOUR);
        let is_due = wall_s >= next;
        if is_due {
            self.reported_s = wall_s;
        }
        is_due
    }
}

impl Standing {
    /// The same for people.
    pub fn text(&self) -> String {
        let Self { wall_s, frames, dropped, keyframes, losses, memory } = *self;
        let after = match wall_s {
            ..HOUR => format!("{:.0} min", wall_s / 60.0),
            _ => format!("{:.0} h", wall_s / HOUR),
        };
        let memory = memory.map_or(String::new(), |bytes| format!(", {} MiB", bytes >> 20));
        format!(
            "after {after}: {}, {dropped} dropped, {}, lost {}{memory}",
            counted(frames, "frame", "frames"),
            counted(keyframes, "keyframe", "keyframes"),
            counted(losses, "time", "times"),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_reported_three_times_in_the_first_hour_and_then_once_in_each() {
        let mut milestones = Milestones::default();
        let said: Vec<u32> = (0..5 * 360)
            .map(|i| i * 10)
            .filter(|&seconds| milestones.is_due(f64::from(seconds) + 3.0))
            .collect();
        assert_eq!(said, [600, 1800, 3600, 7200, 10_800, 14_400]);
        // Whoever was away for some hours is told once.
        let mut milestones = Milestones::default();
        assert_eq!(
            [9000.0, 9001.0, 10_799.0, 10_801.0].map(|s| milestones.is_due(s)),
            [true, false, false, true]
        );
    }

    #[test]
    fn it_is_a_line_of_a_log() {
        let standing = Standing {
            wall_s: 7200.4,
            frames: 215_812,
            dropped: 12,
            keyframes: 1,
            losses: 3,
            memory: Some(412 << 20),
        };
        assert_eq!(
            standing.text(),
            "after 2 h: 215812 frames, 12 dropped, 1 keyframe, lost 3 times, 412 MiB"
        );
        let early = Standing { wall_s: 601.0, memory: None, ..standing };
        assert!(early.text().starts_with("after 10 min: ") && early.text().ends_with("lost 3 times"));
    }
}
