//! The maps that a run made after losses, joined where they show one place: as the maps of several agents are.

use crate::fragments::{in_order, most_frames_first};
use crate::merging::MergingParams;
use crate::run::{Progress, surface_judge};
use map::Map;
use std::sync::Arc;

/// Joins the fragments of a run where they hang together. The map that most frames have a pose in comes first; those
/// that saw no place of another stay apart, and those that `moves` says may be of something that moves: they show it in all places that it was at.
/// A fragment alone stays as it is, to the last bit.
pub fn joined(fragments: Vec<Map>, moves: impl Fn(&Map) -> bool, progress: &dyn Progress) -> Vec<Map> {
    use crate::merging::{Input, merge};

    if fragments.len() < 2 {
        return fragments;
    }
    progress.stage("joining the parts of the run");
    let vocabulary = place_recog::Vocabulary::shipped();
    let mut apart = Vec::new();
    let mut inputs = Vec::new();
    for map in fragments {
        if moves(&map) {
            apart.push(map);
            continue;
        }
        // One without depth or with no feature cannot be recognised, and is a result all the same.
        match Input::of(map, std::path::Path::new(""), &vocabulary) {
            Ok(input) => inputs.push(input),
            Err(refused) => apart.push(*refused.map),
        }
    }
    let joined = match inputs.len() {
        0 | 1 => None,
        _ => merge(&inputs, &vocabulary, &merging(), &mut |_| Ok(()))
            .inspect_err(|error| progress.warn(&format!("the parts of the run are not joined: {error:#}")))
            .ok(),
    };
    let maps = match joined {
        Some(merging) => merging.fused.into_iter().map(|fused| in_order(fused.map)).collect(),
        None => inputs.into_iter().map(|input| Arc::unwrap_or_clone(input.map)).collect::<Vec<_>>(),
    };
    most_frames_first(maps.into_iter().chain(apart).collect())
}

/// How they are merged, and how the two ends of a loop are. What they see must tell that it is one place, as where the camera is found again while the run goes on: what was
/// not believed then is not joined in the end because little differs.
pub(super) fn merging() -> MergingParams {
    let mut params = MergingParams { joint: false, ..MergingParams::default() };
    params.verification.acceptance.min_undecided_change = 0.0;
    params.further.place.prior = surface_judge::prior();
    params
}
