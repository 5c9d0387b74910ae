//! The maps of one run, in order.

use map::Map;

/// A map with its frames in the order of the recording.
pub(crate) fn in_order(mut map: Map) -> Map {
    map.frames.sort_by_key(|frame| frame.frame_index);
    map
}

/// Maps of one run, that of most frames first.
pub(crate) fn most_frames_first(mut maps: Vec<Map>) -> Vec<Map> {
    // Stable: of equals the earlier one comes first.
    maps.sort_by_key(|map| std::cmp::Reverse(map.frames.len()));
    maps
}
