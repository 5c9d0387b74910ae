//! The maps that a LiDAR's run made after losses, joined where they show one place: as the maps of several agents are.

use super::merging::{Input, LidarMergeParams, merge};
use crate::fragments::{in_order, most_frames_first};
use map::Map;
use std::path::PathBuf;

/// Fragments that are compared with each other, those of most frames: every two take up to a second.
const MOST: usize = 12;

/// Joins the fragments of a run where they hang together; the map that most frames have a pose in comes first. One alone stays as it
/// is, to the last bit.
pub(super) fn joined(mut fragments: Vec<Map>) -> Vec<Map> {
    if fragments.len() < 2 {
        return fragments;
    }
    fragments = most_frames_first(fragments);
    let rest = fragments.split_off(fragments.len().min(MOST));
    // In the world of the earliest.
    fragments.sort_by_key(|map| map.frames.first().map(|frame| frame.frame_index));
    // A fragment of nothing, or one that reaches too far, is a result all the same.
    let (mut inputs, mut apart) = (Vec::new(), rest);
    for map in fragments {
        match Input::of(PathBuf::new(), map.clone()) {
            Ok(input) => inputs.push(input),
            Err(_) => apart.push(map),
        }
    }
    let merging = merge(&inputs, &LidarMergeParams::default(), &mut |_| Ok(()));
    let maps: Vec<Map> = match merging {
        Ok(merging) => merging.groups.into_iter().map(|group| group.map).collect(),
        Err(_) => inputs.into_iter().map(|input| input.map).collect(),
    };
    most_frames_first(maps.into_iter().map(in_order).chain(apart).collect())
}
