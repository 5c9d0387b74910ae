use super::*;
use fleet::hash::ObjectHash;
use fleet::lossy_codec::digest::Digest;
use fleet::manifest::Entry;
use fleet::merge_results::PairVerdict;
use fleet::store::MemoryStore;
use map::Uuid;
use place_recog::{WordBag, WordId};
use std::time::Duration;

fn agent(number: u128) -> Identity {
    Identity { uuid: Uuid::from_u128(number), epoch: 0 }
}

/// A map of one keyframe of which nothing is here but its lists.
fn listed(number: u128, kinds: &[Kind]) -> MapSnapshot {
    let object = |&kind: &Kind| {
        let hash = ObjectHash::of(&[kind as u8, number as u8]);
        Entry { kind, number: 0, revision: 0, size: 9, hash }
    };
    let entries: Vec<Entry> = kinds.iter().map(object).collect();
    let missing = entries.len();
    snapshot(number, entries, missing)
}

fn snapshot(number: u128, entries: Vec<Entry>, missing: usize) -> MapSnapshot {
    let (agent, entries) = (agent(number), entries.into());
    MapSnapshot { agent, begun: 0, entries, missing, came: 0, finished: false, is_near: true }
}

/// A map of three keyframes that look like those of every other such map, of which nothing but the digests is here.
fn digested(number: u128, store: &MemoryStore) -> MapSnapshot {
    let mut entries = Vec::new();
    for keyframe in 0..3 {
        let words = WordBag::new((0..40).map(|word| WordId(100 * keyframe + word)));
        let (timestamp, linked, samples) = (f64::from(keyframe), Vec::new(), vec![(9, 0.5)]);
        let digest = Digest { timestamp, frame_index: 0, linked, words, samples };
        let digest = digest.to_bytes(KeyframeId(keyframe));
        store.put(&ObjectHash::of(&digest), digest.clone().into());
        let features = [number as u8, keyframe as u8];
        for (kind, bytes) in [(Kind::Digest, &digest[..]), (Kind::Features, &features)] {
            let (hash, size) = (ObjectHash::of(bytes), bytes.len() as u32);
            entries.push(Entry { kind, number: keyframe, revision: 0, size, hash });
        }
    }
    snapshot(number, entries, 3)
}

const CAMERA: [Kind; 3] = [Kind::Digest, Kind::Depth, Kind::Image];
const LIDAR: [Kind; 2] = [Kind::Depth, Kind::Scan];

fn plan(all: &[MapSnapshot], own: &[Identity], elsewhere: &[[Identity; 2]]) -> Plan {
    let mut prefetcher = Prefetcher::new(Vocabulary::shipped());
    let elsewhere = elsewhere.iter().copied().collect();
    prefetcher.plan(all, own, &MemoryStore::default(), &elsewhere, &Components::default())
}

#[test]
fn who_can_meet_nobody_is_fetched_and_cameras_do_not_meet_lidars() {
    let (camera, lidar) = (listed(1, &CAMERA), listed(2, &LIDAR));
    // To whomever the pair is left, there is nothing to look at.
    let both = plan(&[camera.clone(), lidar.clone()], &[], &[[agent(1), agent(2)]]);
    assert_eq!(both.released, [agent(1), agent(2)].into());
    assert!(both.ready.is_none() && both.wanted.values().all(|(objects, rest)| objects.is_empty() && *rest));
    // What is one's own is needed where another comes that it may meet.
    let own = [agent(2)];
    let together = plan(&[camera.clone(), lidar.clone()], &own, &[]);
    assert_eq!(together.released, [agent(1)].into());
    let together = plan(&[camera.clone(), lidar, listed(3, &LIDAR)], &own, &[]);
    assert_eq!(together.released, [agent(1), agent(2), agent(3)].into());
    // Cameras are asked for their digests first.
    let cameras = plan(&[camera, listed(4, &CAMERA)], &[], &[]);
    assert!(cameras.released.is_empty());
    assert_eq!(cameras.wanted[&agent(4)], (vec![(Kind::Digest, 0)], false));
}

/// Two agents of LiDARs without a station: one looks, and the other waits for what it finds.
#[test]
fn lidars_that_another_one_looks_at_are_left_to_it() {
    let pair = [agent(2), agent(3)];
    let (own, other) = (listed(3, &LIDAR), listed(2, &LIDAR));
    assert!(plan(&[own.clone(), other.clone()], &[agent(3)], &[pair]).released.is_empty());
    assert_eq!(plan(&[own, other], &[agent(3)], &[]).released, pair.into());
}

/// One is gone or stands still, and nobody knows for how long: what is asked of it stays asked, and all of the other is
/// fetched meanwhile.
#[test]
fn who_is_not_there_keeps_nobody() {
    let store = MemoryStore::default();
    let maps = [1, 2].map(|number| digested(number, &store));
    let mut prefetcher = Prefetcher::new(Vocabulary::shipped());
    let mut plan = |near: [bool; 2]| {
        let maps =
            maps.iter().zip(near).map(|(snapshot, is_near)| MapSnapshot { is_near, ..snapshot.clone() });
        let components = Components::default();
        prefetcher.plan(&maps.collect::<Vec<_>>(), &[], &store, &BTreeSet::new(), &components)
    };
    let features: Vec<(Kind, u32)> = (0..3).map(|number| (Kind::Features, number)).collect();
    let fetches = |plan: &Plan, number: u128| {
        let (objects, rest) = &plan.wanted[&agent(number)];
        (objects.iter().all(|object| features.contains(object)) && !objects.is_empty(), *rest)
    };
    // While both are there, all else of either waits for what is to be seen of both.
    let both = plan([true, true]);
    assert_eq!((fetches(&both, 1), fetches(&both, 2)), ((true, false), (true, false)));
    let one = plan([true, false]);
    assert_eq!((fetches(&one, 1), fetches(&one, 2)), ((true, true), (true, false)));
    assert_eq!(one.released, [agent(1)].into());
    // The pair is not forgotten when it is back.
    assert_eq!(fetches(&plan([true, true]), 2), (true, false));
}

/// While pairs are looked at others become ready, and agents go.
#[test]
fn only_pairs_that_were_looked_at_get_an_outcome() {
    let store = MemoryStore::default();
    let maps = [1, 2, 3].map(|number| {
        let map = digested(number, &store);
        let features = (0..3).map(|keyframe| [number as u8, keyframe]);
        features.for_each(|bytes| store.put(&ObjectHash::of(&bytes), bytes.as_slice().into()));
        map
    });
    let mut prefetcher = Prefetcher::new(Vocabulary::shipped());
    let ready = |prefetcher: &mut Prefetcher, maps: &[MapSnapshot], looked_at: &BTreeSet<[Identity; 2]>| {
        let plan = prefetcher.plan(maps, &[], &store, looked_at, &Components::default());
        plan.pairs.into_iter().map(|(names, _)| names).collect::<BTreeSet<_>>()
    };
    let looked_at = ready(&mut prefetcher, &maps[..2], &BTreeSet::new());
    assert_eq!(looked_at, [[agent(1), agent(2)]].into());
    let meanwhile = ready(&mut prefetcher, &maps, &looked_at);
    assert_eq!(meanwhile, [[agent(1), agent(3)], [agent(2), agent(3)]].into());
    let are_ready = |prefetcher: &Prefetcher| {
        let ready = prefetcher.pairs.iter().filter(|(_, pair)| pair.is_ready());
        ready.map(|(names, _)| *names).collect::<BTreeSet<_>>()
    };
    prefetcher.record_outcome(&[], &looked_at, &store);
    assert_eq!(are_ready(&prefetcher), meanwhile);
    let pair = ready(&mut prefetcher, &maps[..2], &meanwhile);
    assert_eq!(pair, looked_at);
    prefetcher.record_outcome(&[], &meanwhile, &store);
    assert_eq!(are_ready(&prefetcher), looked_at.union(&meanwhile).copied().collect());
}

/// Nobody is fetched for good before it was looked at what it may be compared with.
#[test]
fn many_maps_that_come_at_once_are_verified_in_batches() {
    let store = MemoryStore::default();
    let maps: Vec<MapSnapshot> = (1..=40).map(|number| digested(number, &store)).collect();
    let mut prefetcher = Prefetcher::new(Vocabulary::shipped());
    let mut plan = || prefetcher.plan(&maps, &[], &store, &BTreeSet::new(), &Components::default());
    let first = plan();
    assert!(first.is_cut && first.released.is_empty());
    let second = plan();
    assert!(!second.is_cut && second.released.is_empty());
    assert!(second.wanted.values().all(|(objects, _)| !objects.is_empty()));
}

/// A map that grows among many would never be here, and if its agent broke down, nowhere.
#[test]
fn a_map_does_not_wait_for_its_pairs_for_good() {
    let store = MemoryStore::default();
    let maps: Vec<MapSnapshot> = (1..=40).map(|number| digested(number, &store)).collect();
    let mut prefetcher = Prefetcher::new(Vocabulary::shipped());
    let nobody = (BTreeSet::new(), Components::default());
    let plan = |prefetcher: &mut Prefetcher| prefetcher.plan(&maps, &[], &store, &nobody.0, &nobody.1);
    assert!(plan(&mut prefetcher).released.is_empty());
    let since = |seconds: u64| Instant::now().checked_sub(Duration::from_secs(seconds));
    for (agent, known_map) in &mut prefetcher.agents {
        known_map.since = since(if agent.uuid.as_u128() == 7 { 180 } else { 170 });
    }
    let waited = plan(&mut prefetcher);
    // What its pairs ask for still comes first.
    assert!(waited.released == [agent(7)].into() && !waited.wanted[&agent(7)].0.is_empty());
}

/// All of their maps says how they lie to each other; of who is alone a part may say where it is.
#[test]
fn who_hang_together_are_fetched_and_compared_with_others_only() {
    let store = MemoryStore::default();
    let maps = [1, 2, 3].map(|number| digested(number, &store));
    let components = Components::of_one(&[agent(1), agent(2)]);
    let mut prefetcher = Prefetcher::new(Vocabulary::shipped());
    let plan = prefetcher.plan(&maps, &[], &store, &BTreeSet::new(), &components);
    assert_eq!(plan.released, [agent(1), agent(2)].into());
    let all = plan.wanted.values().map(|(objects, rest)| (objects.is_empty(), *rest));
    assert_eq!(all.collect::<Vec<_>>(), [(false, true), (false, true), (false, false)]);
    let pair = prefetcher.plan(&maps[..2], &[], &store, &BTreeSet::new(), &components);
    assert!(pair.wanted.values().all(|(objects, rest)| objects.is_empty() && *rest));
    // Also while they grow: nobody asks for further digests.
    let grown = [listed(1, &CAMERA), listed(2, &CAMERA)];
    let mut prefetcher = Prefetcher::new(Vocabulary::shipped());
    let grown = prefetcher.plan(&grown, &[], &store, &BTreeSet::new(), &components);
    assert_eq!(grown.released, [agent(1), agent(2)].into());
}

/// Without a station: a pair is left to one that is not there.
#[test]
fn who_is_to_look_and_is_not_there_keeps_nobody() {
    let away = MapSnapshot { is_near: false, ..listed(1, &LIDAR) };
    let maps = [away, listed(2, &LIDAR), listed(3, &LIDAR)];
    let released = plan(&maps, &[agent(2)], &[[agent(1), agent(2)]]).released;
    assert_eq!(released, [agent(2), agent(3)].into());
}

/// What another one found of agents 1 and 2, or is still looking at.
fn found(pending: bool) -> MergeResults {
    let agents = [agent(2), agent(1)].map(|agent| agent.to_string());
    let (names, verdict) = (["b".into(), "a".into()], "undecided".into());
    let pair_verdict = PairVerdict { names, agents, verdict, why: None, pending };
    MergeResults { agents: Vec::new(), pair_verdicts: vec![pair_verdict] }
}

#[test]
fn one_of_two_looks_and_the_other_waits_for_what_it_says() {
    let pair = [agent(1), agent(2)];
    let left = |own: &[Identity], remote_results: &[Arc<MergeResults>]| {
        let mut prefetcher = Prefetcher::new(Vocabulary::shipped());
        prefetcher.left_to_others(&pair, own, remote_results).contains(&pair)
    };
    assert!(!left(&[agent(1)], &[]));
    assert!(left(&[agent(2)], &[]));
    // A station has no map of its own, and whoever has both looks at them.
    assert!(!left(&[], &[]) && !left(&pair, &[]));
    assert!(left(&[agent(2)], &[found(true).into()]));
    assert!(!left(&[agent(2)], &[found(false).into()]));
}
