//! Loops that features find in a finished map: places that the camera saw once more from another side, or with more drift than
//! direct alignment bears. What the keyframes at both ends make of each other is a claim like a merge, and is judged like one.

use crate::merging::{Input, MergingParams, refusal};
use crate::run::Progress;
use map::{Edge, KeyframeId, Map, PlaceCandidate, PlaceIndex};
use merge::prepared::PreparedMap;
use merge::verification::{Place, TestedPlace, meet};
use place_recog::{BowIndex, Proposal, Vocabulary, ranked};
use serde::Serialize;
use slam_direct::{ClosingParams, Trajectory, close_loop};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

/// Keyframes on each side of one that belong to its end of a loop.
const REACH: usize = 12;
/// Edges within which keyframes see one place already.
const JOINED: usize = 4;
/// Old keyframes that words propose for each.
const PROPOSED: usize = 10;
/// Features that two keyframes share at the least, to be worth a verdict: half of what a meeting needs.
const LEAST_SHARED: usize = 12;
/// Rounds of places that are asked of a pair of ends.
const ROUNDS: usize = 2;
/// Most pairs of ends that are judged without a loop, in a map: each takes about a second.
const FUTILE: usize = 5;

/// A pair of ends of which it was asked whether they are one place.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Revisit {
    /// The frame by which the place was proposed, where the camera came back.
    pub frame: u64,
    /// The earlier frame that shares features with it.
    pub earlier_frame: u64,
    /// Why the map was not corrected by it; nothing where it was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
}

/// Closes the loops of a map that features find and that stand the tests of a merge, and tells what became of each place that was proposed.
/// Maps of several agents stay as they are.
pub fn closed(mut map: Map, params: &ClosingParams, progress: &dyn Progress) -> (Map, Vec<Revisit>) {
    let mut revisits = Vec::new();
    if !params.enabled || map.agents.len() != 1 || map.keyframes.len() <= params.search.min_gap as usize {
        return (map, revisits);
    }
    let vocabulary = Vocabulary::shipped();
    // Of a copy, whose keyframes are given words: without a loop the map stays as it is, to the last byte.
    let Ok(input) = Input::of(map.clone(), Path::new(""), &vocabulary) else { return (map, revisits) };
    let mut proposals = proposals(&input, &vocabulary, params);
    if proposals.is_empty() {
        return (map, revisits);
    }
    progress.stage("looking for places that were seen twice");
    let merging = merging();
    let mut futile = 0;
    while let Some(best) = proposals.first().copied().filter(|_| futile < FUTILE) {
        let ends = Ends::of(&map, &best);
        let (places, others): (Vec<Proposal>, _) = proposals.into_iter().partition(|p| ends.contain(p));
        proposals = others;
        let found = ends.loops(&map, &input, &places, &merging);
        let closed =
            found.and_then(|found| close_loop(&mut map, found, params).map_err(|why| why.to_string()));
        let frame = |id| map.keyframes.get(&id).map_or(0, |keyframe| keyframe.frame_index);
        let (frame, earlier_frame) = (frame(best.query), frame(best.keyframe));
        revisits.push(Revisit { frame, earlier_frame, refused: closed.clone().err() });
        if closed.is_err() {
            futile += 1;
            continue;
        }
        let joined = Joined::of(&map);
        proposals.retain(|p| !joined.see_one_place(p.query, p.keyframe));
    }
    (map, revisits)
}

/// As maps are merged; fewer places are asked of one pair of ends, for they are few.
fn merging() -> MergingParams {
    let mut params = MergingParams::default();
    params.verification.rounds = ROUNDS;
    params
}

/// Pairs of keyframes that may show one place and are not known to, by the features that they share, most first.
fn proposals(input: &Input, vocabulary: &Arc<Vocabulary>, params: &ClosingParams) -> Vec<Proposal> {
    let (joined, trajectory) = (Joined::of(&input.map), Trajectory::of_map(&input.map));
    let mut index = BowIndex::new(Arc::clone(vocabulary), Default::default());
    let mut found = Vec::new();
    let mut waiting = input.words.iter().peekable();
    for (&query, words) in input.words.iter() {
        let is_old = |old: KeyframeId| query.0 >= old.0 + params.search.min_gap;
        while let Some((&old, words)) = waiting.next_if(|(old, _)| is_old(**old)) {
            index.add(old, words);
        }
        let keyframe = input.map.keyframes.get(&query);
        let depth = keyframe.and_then(|k| Some(k.semi_dense.median_depth()? * k.world_from_keyframe.scale));
        let Some(distance) = depth else { continue };
        let near = joined.near(query);
        let may_meet = |old| trajectory.may_meet(old, query, distance, params.max_drift);
        let places = index.query_among(words, PROPOSED, &|old| !near.contains(&old) && may_meet(old));
        let proposal = |place: PlaceCandidate| Proposal {
            keyframe: place.keyframe,
            query,
            score: place.score,
            shared: None,
        };
        found.extend(places.into_iter().map(proposal));
    }
    found.sort_by(|a, b| b.score.total_cmp(&a.score).then((a.query, a.keyframe).cmp(&(b.query, b.keyframe))));
    let mut found = ranked(found, input.directed(), input.directed(), &Default::default());
    found.retain(|proposal| proposal.shared.is_some_and(|shared| shared >= LEAST_SHARED));
    found
}

/// Which keyframes see one place, by the edges of a map.
struct Joined(BTreeMap<KeyframeId, BTreeSet<KeyframeId>>);

impl Joined {
    fn of(map: &Map) -> Self {
        let mut joined: BTreeMap<KeyframeId, BTreeSet<KeyframeId>> = BTreeMap::new();
        for edge in &map.edges {
            joined.entry(edge.from).or_default().insert(edge.to);
            joined.entry(edge.to).or_default().insert(edge.from);
        }
        Self(joined)
    }

    /// Those within [`JOINED`] edges.
    fn near(&self, keyframe: KeyframeId) -> BTreeSet<KeyframeId> {
        let mut near = BTreeSet::from([keyframe]);
        let mut newest = near.clone();
        for _ in 0..JOINED {
            let next = newest.iter().filter_map(|id| self.0.get(id)).flatten();
            newest = next.copied().filter(|id| !near.contains(id)).collect();
            near.extend(&newest);
        }
        near
    }

    fn see_one_place(&self, a: KeyframeId, b: KeyframeId) -> bool {
        self.near(a).contains(&b)
    }
}

/// The keyframes at both ends of a loop.
struct Ends {
    old: BTreeSet<KeyframeId>,
    new: BTreeSet<KeyframeId>,
}

impl Ends {
    /// Those around two keyframes, in order of time, none of them in both.
    fn of(map: &Map, proposal: &Proposal) -> Self {
        let ids: Vec<KeyframeId> = map.keyframes.keys().copied().collect();
        let at = |id: KeyframeId| ids.partition_point(|other| *other < id);
        let (old, new) = (at(proposal.keyframe), at(proposal.query));
        let reach = REACH.min((new - old - 1) / 2);
        let around = |at: usize| ids[at.saturating_sub(reach)..ids.len().min(at + reach + 1)].iter().copied();
        Self { old: around(old).collect(), new: around(new).collect() }
    }

    fn contain(&self, proposal: &Proposal) -> bool {
        self.old.contains(&proposal.keyframe) && self.new.contains(&proposal.query)
    }

    /// The edges between both ends, where these are one place by all that a merge asks; else why they are not.
    fn loops(
        &self,
        map: &Map,
        input: &Input,
        places: &[Proposal],
        params: &MergingParams,
    ) -> Result<Vec<Edge>, String> {
        let [old, new] = [&self.old, &self.new].map(|end| part(map, end));
        let [old, new] = [&old, &new].map(|part| PreparedMap::new(part, &input.features, &params.key_points));
        let places: Vec<Place> =
            places.iter().map(|p| Place { source: p.query, target: p.keyframe }).collect();
        let tested = meet(&new, &old, &places, &params.verification, &params.further);
        let accepted = tested.iter().find_map(|tested| tested.outcome.accepted());
        match accepted.and_then(|evaluated| evaluated.joined.clone()) {
            Some(joined) => Ok(joined.edges),
            None => Err(why_not(tested)),
        }
    }
}

/// Why none of the places was accepted: the refusal of the one that came farthest.
fn why_not(tested: Vec<TestedPlace>) -> String {
    let stage = |tested: &TestedPlace| {
        (tested.outcome.is_undecided(), tested.outcome.evaluated().is_some(), tested.match_count)
    };
    let farthest = tested.iter().max_by_key(|tested| stage(tested));
    let why = farthest.and_then(|tested| refusal(&tested.outcome));
    why.unwrap_or_else(|| "its keyframes show no place of the other end".to_owned())
}

/// Some keyframes of a map and the edges between them.
fn part(map: &Map, keyframes: &BTreeSet<KeyframeId>) -> Map {
    let mut part = Map { frames: Vec::new(), ..map.clone() };
    part.keyframes.retain(|id, _| keyframes.contains(id));
    part.edges.retain(|edge| keyframes.contains(&edge.from) && keyframes.contains(&edge.to));
    part
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::importing::semi_dense;
    use crate::run::progress::Silent;
    use geometry::{Image, Pinhole, Se3, Sim3};
    use loopbox_tests::{World, render, trajectory};
    use map::{EdgeKind, Keyframe};
    use nalgebra::UnitQuaternion;

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 260.0, fy: 260.0, cx: 159.5, cy: 119.5 };

    /// Keyframes of a camera that goes round a group of boxes and comes back to its begin, with exact depth; each step is too long by
    /// `drift`.
    fn round(drift: f64) -> (Map, Vec<Se3>) {
        let world = World::yard(5).with_grain(4.0, 5);
        let truth = trajectory::orbit(46, 4.0, 1.1);
        let mut map = Map::new(CAMERA);
        let mut pose = truth[0];
        let everywhere = Image::filled(CAMERA.width, CAMERA.height, true);
        for (number, seen) in truth.iter().enumerate() {
            if number > 0 {
                let step = truth[number - 1].inverse() * *seen;
                let turn = UnitQuaternion::from_euler_angles(0.0, 0.1 * drift, 0.0);
                pose = pose * Se3::new(turn * step.rotation, step.translation * (1.0 + drift));
            }
            let (image, inverse_depth) = render(&world, &CAMERA, seen);
            let distance = |x, y| {
                let inverse_depth = inverse_depth.get(x, y);
                (inverse_depth > 0.0).then(|| f64::from(inverse_depth).recip())
            };
            let depths = semi_dense(&image, &everywhere, distance, |inverse_depth| 0.01 * inverse_depth);
            let id = KeyframeId(number as u32);
            let mut keyframe =
                Keyframe::of_image(id, number as f64, number as u64, Sim3::from(pose), image.into());
            keyframe.semi_dense = depths.into();
            map.keyframes.insert(id, keyframe);
        }
        let keyframes: Vec<&Keyframe> = map.keyframes.values().collect();
        let edges = keyframes.windows(2).map(|k| Edge::odometry(k[0], k[1], [0.05, 0.005, 0.01]));
        map.edges = edges.collect();
        (map, truth)
    }

    /// How far from the truth the last keyframe lies as seen from the first, metres.
    fn gap(map: &Map, truth: &[Se3]) -> f64 {
        let poses: Vec<Sim3> = map.keyframes.values().map(|keyframe| keyframe.world_from_keyframe).collect();
        let found = poses[0].inverse() * poses[poses.len() - 1];
        (found.translation - (truth[0].inverse() * truth[truth.len() - 1]).translation).norm()
    }

    #[test]
    fn a_place_that_is_seen_again_closes_the_loop() {
        let (map, truth) = round(0.03);
        let before = gap(&map, &truth);
        let (closed, revisits) = closed(map, &ClosingParams::default(), &Silent);
        assert!(
            revisits.iter().any(|one| one.refused.is_none() && one.frame >= one.earlier_frame + 15),
            "{revisits:?}"
        );
        let loops: Vec<&Edge> = closed.edges.iter().filter(|edge| edge.kind == EdgeKind::Loop).collect();
        assert!(!loops.is_empty());
        assert!(loops.iter().all(|edge| edge.from.0.abs_diff(edge.to.0) >= 15), "{loops:?}");
        let after = gap(&closed, &truth);
        assert!(before > 0.3 && after < 0.2 * before, "{before} m, then {after} m");
    }

    #[test]
    fn more_drift_than_the_path_explains_closes_nothing() {
        let (map, _) = round(0.03);
        let params = ClosingParams { max_drift: 0.005, ..ClosingParams::default() };
        let poses = |map: &Map| map.keyframes.values().map(|k| k.world_from_keyframe).collect::<Vec<_>>();
        let before = poses(&map);
        let (closed, revisits) = closed(map, &params, &Silent);
        assert_eq!((poses(&closed), closed.edges.len()), (before, 45));
        assert!(revisits.iter().all(|one| one.refused.is_some()), "{revisits:?}");
    }
}
