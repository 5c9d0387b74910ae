//! Memory grows with the map, not with the recording.

use crate::support::{Case, hand_held};
use std::fs;

/// What a run tells of itself in `run.json`.
struct Use {
    peak_bytes: f64,
    keyframes: f64,
}

fn memory_of(frames: usize) -> Use {
    let case = Case::new(&hand_held(frames));
    let outcome = case.run(&["--threads", "1"]);
    outcome.assert_success();
    let text = fs::read_to_string(case.out().join("run.json")).expect("the run wrote its numbers");
    let numbers: serde_json::Value = serde_json::from_str(&text).expect("run.json is JSON");
    let number = |key: &str| {
        numbers
            .pointer(key)
            .and_then(serde_json::Value::as_f64)
            .unwrap_or_else(|| panic!("run.json has no {key}"))
    };
    Use { peak_bytes: number("/cost/peak_memory_bytes"), keyframes: number("/map/keyframes") }
}

/// Bytes a keyframe of 320 × 240 pixels may cost: its pyramid, inverse depths and variances of every pixel, and
/// its sparse points with their observations.
const KEYFRAME_BYTES: f64 = 320.0 * 240.0 * 16.0;

/// A recording ten times as long of the same place needs no more than its additional keyframes cost.
#[test]
fn memory_does_not_grow_with_the_length_of_a_recording() {
    let (short, long) = (memory_of(60), memory_of(600));
    let grown = long.peak_bytes - short.peak_bytes;
    let allowed = (long.keyframes - short.keyframes).max(0.0) * KEYFRAME_BYTES + 8e6;
    assert!(
        grown <= allowed,
        "{:.1} MB more for {} more keyframes; {:.1} MB allowed",
        grown / 1e6,
        long.keyframes - short.keyframes,
        allowed / 1e6
    );
}
