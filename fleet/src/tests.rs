//! The protocol over a network whose every fault is drawn from a seed.

mod refusing;

use crate::link;
use crate::manifest::Kind;
use crate::node::{Event, Notice};
use crate::publishing::Publisher;
use crate::store::{FolderStore, Objects, Store};
use crate::test_support::{Faults, Network, Random, agent, lidar_map, map};
use crate::wire::{MapVersion, Message};
use map::{KeyframeId, Map};
use std::sync::Arc;
use std::time::Duration;

const MILLIS: fn(u64) -> Duration = Duration::from_millis;
const SECONDS: fn(u64) -> Duration = Duration::from_secs;

/// A map as it was when it had so many keyframes.
fn first(map: &Map, keyframes: usize) -> Map {
    let mut map = map.clone();
    let end = map.keyframes.keys().nth(keyframes).map_or(u32::MAX, |id| id.0);
    map.keyframes.retain(|id, _| id.0 < end);
    map.drop_dangling();
    map
}

/// Two nodes, the second with a map of so many keyframes to tell.
fn publishing_network(keyframes: u32, seed: u64, faults: Faults) -> (Network, Map, Publisher) {
    let mut network = Network::new(2, seed, faults);
    let map = map(agent(7), keyframes);
    let mut publisher = Publisher::new(agent(7), 100);
    network.publish(1, &mut publisher, &map, true);
    (network, map, publisher)
}

#[test]
fn a_map_arrives_bit_by_bit_and_is_acknowledged() {
    let (mut network, map, _) = publishing_network(12, 1, Faults::NONE);
    assert!(
        network.run_until(SECONDS(10), |network| network.nodes[1].is_acknowledged()),
        "{:?}",
        network.notices
    );
    assert!(network.whole(0, agent(7)).unwrap() == map);
    let objects: u64 = 12 * 31_000;
    assert!(network.parts_sent < objects * 2, "{}", network.parts_sent);
    assert!(
        network.sent as f64 <= 1.02 * network.parts_sent as f64,
        "{} {}",
        network.sent,
        network.parts_sent
    );
    assert!(network.now < SECONDS(2), "{:?}", network.now);
    assert!(network.notices[1].iter().any(|notice| matches!(notice, Notice::Stored { .. })));
    assert_eq!(network.nodes[0].status(network.now).neighbours[0].useless, 0);
}

/// A program that has just been started says who it is as soon as there is a link, and not a beat later.
#[test]
fn a_new_neighbour_is_announced_at_once() {
    let (mut network, ..) = publishing_network(1, 1, Faults::NONE);
    let met = |network: &Network| {
        network
            .notices
            .iter()
            .all(|notices| notices.iter().any(|notice| matches!(notice, Notice::Connected { .. })))
    };
    assert!(network.run_until(MILLIS(500), met), "{:?}", network.notices);
}

#[test]
fn a_lidars_map_arrives_bit_by_bit_while_it_grows() {
    let faults = Faults { loss: 0.1, twice: 0.1, delay: [MILLIS(5), MILLIS(90)], rate: 20e3 };
    let mut network = Network::new(2, 9, faults);
    let mut map = lidar_map(agent(7), 12);
    let mut publisher = Publisher::new(agent(7), 100);
    for keyframes in 1..12 {
        network.publish(1, &mut publisher, &first(&map, keyframes), false);
        let until = network.now + MILLIS(100);
        network.run_until(until, |_| false);
    }
    // What is here is a map, of whole keyframes alone.
    let part = |network: &Network| {
        let snapshot = network.nodes[0].snapshots().next()?;
        let mut assembler = crate::assembling::Assembler::default();
        let part = assembler.assemble(agent(7), &snapshot.entries, &*network.stores[0], None).unwrap()?;
        (!part.whole && part.missing > 0 && !part.map.keyframes.is_empty()).then_some(part.map)
    };
    assert!(network.run_until(SECONDS(20), |network| part(network).is_some()));
    let part = part(&network).unwrap();
    assert!(part.keyframes.iter().all(|(id, keyframe)| *keyframe == map.keyframes[id]));
    // A loop was closed: all moved, and no scan is sent again.
    map.keyframes.values_mut().for_each(|keyframe| keyframe.world_from_keyframe.translation.x += 0.5);
    let last = publisher.publish(&map, true).unwrap().unwrap();
    let is_scan = |bytes: &[u8]| map::parts::scan_from_bytes(bytes).is_ok_and(|(_, scan)| scan.len() > 400);
    let scans = last.objects.iter().filter(|(_, bytes)| is_scan(bytes));
    assert_eq!(scans.count(), 1, "only the last keyframe is new");
    let mut again = Publisher::new(agent(7), 200);
    network.publish(1, &mut again, &map, true);
    assert!(network.run_until(SECONDS(100), |network| network.nodes[1].is_acknowledged()));
    assert!(network.whole(0, agent(7)).unwrap() == map);
}

/// A LiDAR's keyframe without a scan is none, and neither is one with another's.
#[test]
fn scans_that_are_not_there_or_of_another_keyframe_are_refused() {
    let map = lidar_map(agent(7), 2);
    let published = Publisher::new(agent(7), 1).publish(&map, true).unwrap().unwrap();
    let store = crate::store::MemoryStore::default();
    for (hash, bytes) in &published.objects {
        store.put(hash, bytes.clone());
    }
    let manifest =
        crate::manifest::Manifest::from_bytes(&store.get(&published.version.hash).unwrap()).unwrap();
    let pages = crate::assembling::pages_of(&manifest, &store).unwrap().unwrap();
    let entries = crate::assembling::in_order(&pages).unwrap();
    let assemble = |entries: &[crate::manifest::Entry]| {
        crate::assembling::Assembler::default().assemble(agent(7), entries, &store, None)
    };
    assert!(assemble(&entries).unwrap().unwrap().map == map);
    let without: Vec<_> = entries.iter().copied().filter(|entry| entry.kind != Kind::Scan).collect();
    assert!(assemble(&without).unwrap_err().contains("has no scan"));
    let mut swapped = entries.clone();
    let scans: Vec<usize> = (0..entries.len()).filter(|&i| entries[i].kind == Kind::Scan).collect();
    swapped[scans[0]].hash = entries[scans[1]].hash;
    assert!(assemble(&swapped).unwrap_err().contains("is listed as that of"));
}

#[test]
fn whatever_is_lost_late_twice_or_overtaken_the_same_map_arrives() {
    for (seed, loss) in [(1, 0.05), (2, 0.2), (3, 0.5)] {
        for delay in [20, 200, 2000] {
            let delay = [MILLIS(delay / 2), MILLIS(delay)];
            let faults = Faults { loss, twice: 0.05, delay, rate: 2e6 };
            let (mut network, map, _) = publishing_network(8, seed, faults);
            let done = network.run_until(SECONDS(600), |network| network.nodes[1].is_acknowledged());
            assert!(done, "{faults:?}: {:?}", network.nodes[0].status(network.now));
            assert!(network.whole(0, agent(7)).unwrap() == map, "{faults:?}");
        }
    }
}

#[test]
fn at_a_loss_of_a_fifth_not_much_more_is_sent() {
    let faults = Faults { loss: 0.2, delay: [MILLIS(10), MILLIS(20)], rate: 2e6, ..Faults::NONE };
    let sent = |faults: Faults, seed: u64| {
        let limit = SECONDS(if faults.loss > 0.0 { 200 } else { 100 });
        let (mut network, ..) = publishing_network(60, seed, faults);
        assert!(network.run_until(limit, |network| network.nodes[1].is_acknowledged()));
        network.parts_sent as f64
    };
    let all = |faults: Faults| (1..=4).map(|seed| sent(faults, seed)).sum::<f64>();
    // What is lost of parts alone makes 1.25; of one network of these it is known to some 0.03.
    let more = all(faults) / all(Faults { rate: 2e6, ..Faults::NONE });
    assert!((1.15..1.3).contains(&more), "{more}");
}

#[test]
fn a_map_that_grows_while_it_is_fetched_arrives_as_it_is_in_the_end() {
    let faults = Faults { loss: 0.1, twice: 0.1, delay: [MILLIS(5), MILLIS(90)], rate: 100e3 };
    let mut network = Network::new(2, 4, faults);
    let mut map = map(agent(7), 14);
    let mut publisher = Publisher::new(agent(7), 100);
    for keyframes in 1..14 {
        network.publish(1, &mut publisher, &first(&map, keyframes), false);
        let until = network.now + MILLIS(400);
        network.run_until(until, |_| false);
    }
    // A loop was closed: all moved, one is in another unit, one is gone.
    for keyframe in map.keyframes.values_mut() {
        keyframe.world_from_keyframe.scale *= 1.01;
    }
    map.keyframes.get_mut(&KeyframeId(5)).unwrap().semi_dense.scale(1.1);
    map.keyframes.remove(&KeyframeId(9));
    map.drop_dangling();
    network.publish(1, &mut publisher, &map, true);
    assert!(network.run_until(SECONDS(100), |network| network.nodes[1].is_acknowledged()));
    assert!(network.whole(0, agent(7)).unwrap() == map);
    let snapshot = network.nodes[0].snapshots().next().unwrap();
    assert!(snapshot.finished);
    // What only earlier versions had is not kept.
    let gone = publisher_object(&first(&map, 3));
    assert!(!network.stores[0].has(&gone), "an early version's manifest is kept");
}

/// The manifest of a map told for the first time.
fn publisher_object(map: &Map) -> crate::hash::ObjectHash {
    Publisher::new(agent(7), 100).publish(map, false).unwrap().unwrap().version.hash
}

#[test]
fn part_of_a_map_is_a_map() {
    let (mut network, map, _) = publishing_network(10, 5, Faults { rate: 60e3, ..Faults::NONE });
    network.run_until(SECONDS(4), |_| false);
    let snapshot = network.nodes[0].snapshots().next().expect("the lists are there");
    assert!(snapshot.missing > 0);
    let mut assembler = crate::assembling::Assembler::default();
    let made = assembler.assemble(agent(7), &snapshot.entries, &*network.stores[0], None).unwrap().unwrap();
    assert!(!made.whole && made.missing > 0 && !made.map.keyframes.is_empty(), "{:?}", made.missing);
    // Those of which image and depth are not here have their places, and all hang together as in the whole map.
    let there = |keyframe: &&map::Keyframe| !keyframe.semi_dense.is_empty();
    assert_eq!(made.map.keyframes.values().filter(there).count(), 10 - made.missing);
    assert_eq!(made.map.keyframes.len(), 10);
    for (id, keyframe) in &made.map.keyframes {
        let whole = &map.keyframes[id];
        assert!(keyframe.semi_dense.is_empty() || keyframe.semi_dense == whole.semi_dense);
        let placed = |keyframe: &map::Keyframe| {
            (keyframe.world_from_keyframe, keyframe.timestamp, keyframe.frame_index)
        };
        assert_eq!(placed(keyframe), placed(whole));
    }
    let ends = |map: &Map| map.edges.iter().map(|edge| (edge.from, edge.to)).collect::<Vec<_>>();
    assert_eq!(ends(&made.map), ends(&map));
}

#[test]
fn keyframes_that_are_preferred_come_first() {
    let (mut network, ..) = publishing_network(30, 5, Faults { rate: 100e3, ..Faults::NONE });
    assert!(network.run_until(SECONDS(4), |network| network.nodes[0].snapshots().next().is_some()));
    let parts = [57, 41].map(|number| [(Kind::Depth, number), (Kind::Image, number)]);
    network.event(0, Event::Prefer { agent: agent(7), objects: parts.concat(), rest: true });
    let has = |network: &Network, number: u32| {
        let snapshot = network.nodes[0].snapshots().next().unwrap();
        let is_exact = |kind: Kind| matches!(kind, Kind::Depth | Kind::Image);
        let mut parts =
            snapshot.entries.iter().filter(|entry| entry.number == number && is_exact(entry.kind));
        parts.all(|entry| network.stores[0].has(&entry.hash))
    };
    assert!(network.run_until(SECONDS(60), |network| has(network, 57)));
    assert!(!has(&network, 41));
    assert!(network.run_until(SECONDS(60), |network| has(network, 41)));
    assert!(!has(&network, 39) && !has(&network, 55));
}

/// So often something came to the first node by which it may be decided what is next, until all of an agent's map was there.
fn arrivals_until_whole(network: &mut Network, number: u128) -> u64 {
    let before = network.nodes[0].arrivals();
    let end = network.now + SECONDS(20);
    assert!(network.run_until(end, |network| network.whole(0, agent(number)).is_some()));
    network.nodes[0].arrivals() - before
}

#[test]
fn what_comes_of_one_map_is_news_whatever_another_one_does_not_send() {
    let mut network = Network::new(3, 3, Faults { rate: 100e3, ..Faults::NONE });
    let maps = [7, 8].map(|number| (map(agent(number), 9), Publisher::new(agent(number), 100)));
    let [(stalled, mut of_stalled), (other, mut of_other)] = maps;
    network.publish(1, &mut of_stalled, &stalled, true);
    network.run_until(SECONDS(1), |_| false);
    let lacking =
        |network: &Network| network.nodes[0].snapshots().next().map_or(0, |snapshot| snapshot.missing);
    assert!(lacking(&network) > 0);
    // One stands still with half of its map told: with its link open at first, without it after a while.
    network.cut = vec![(1, 0), (1, 2)];
    network.publish(2, &mut of_other, &other, false);
    // The lists with the places of keyframes, then all of it.
    assert_eq!(arrivals_until_whole(&mut network, 8), 2);
    network.run_until(SECONDS(30), |_| false);
    assert!(lacking(&network) > 0 && !network.nodes[0].snapshots().next().unwrap().is_near);
    let mut grown = other.clone();
    grown.keyframes.values_mut().for_each(|keyframe| keyframe.world_from_keyframe.scale *= 1.5);
    network.publish(2, &mut of_other, &grown, true);
    let before = network.nodes[0].arrivals();
    let end = network.now + SECONDS(9);
    let has_changed = |network: &Network| network.nodes[0].arrivals() > before;
    assert!(network.run_until(end, has_changed), "nobody learns that more of a map came");
}

#[test]
fn what_was_preferred_is_news_before_all_else_is_there() {
    let (mut network, ..) = publishing_network(30, 5, Faults { rate: 100e3, ..Faults::NONE });
    assert!(network.run_until(SECONDS(4), |network| network.nodes[0].arrivals() == 1));
    let snapshot = network.nodes[0].snapshots().next().expect("the lists are there");
    let objects = vec![(Kind::Depth, 57), (Kind::Image, 57)];
    network.event(0, Event::Prefer { agent: agent(7), objects, rest: true });
    assert!(network.run_until(SECONDS(9), |network| network.nodes[0].arrivals() == 2));
    let is_here = |number: u32| {
        let of_one = snapshot.entries.iter().filter(|entry| entry.number == number);
        let mut exact = of_one.filter(|entry| matches!(entry.kind, Kind::Depth | Kind::Image));
        exact.all(|entry| network.stores[0].has(&entry.hash))
    };
    assert!(is_here(57) && !is_here(1));
    assert_eq!(arrivals_until_whole(&mut network, 7), 1);
}

#[test]
fn what_was_interrupted_resumes_where_it_was() {
    // For 10 s, for 10 minutes, and one way each.
    let cuts = [vec![(0, 1), (1, 0)], vec![(0, 1)], vec![(1, 0)]];
    for (cut, seconds) in cuts.iter().flat_map(|cut| [(cut, 10), (cut, 600)]) {
        let (mut network, map, _) = publishing_network(30, 6, Faults { rate: 100e3, ..Faults::NONE });
        network.run_until(SECONDS(3), |_| false);
        let lacks = |network: &Network| network.nodes[0].snapshots().next().unwrap().missing;
        let before = lacks(&network);
        assert!(before > 20);
        let is_near = |network: &Network| network.nodes[0].snapshots().next().unwrap().is_near;
        assert!(is_near(&network));
        network.cut = cut.clone();
        network.run_until(SECONDS(3 + seconds), |_| false);
        // Who is not heard is not there, however the link looks.
        assert!(!is_near(&network), "{cut:?}");
        network.cut.clear();
        let healed = lacks(&network);
        let since = network.now;
        assert!(
            network.run_until(since + SECONDS(5), |network| lacks(network) < healed),
            "{cut:?} {seconds}"
        );
        assert!(
            network.run_until(since + SECONDS(60), |network| network.nodes[1].is_acknowledged()),
            "{cut:?}"
        );
        assert!(network.whole(0, agent(7)).unwrap() == map);
        let useless = network.nodes[0].status(network.now).neighbours[0].useless;
        assert!(useless <= crate::wire::MAX_PART as u64, "{useless} bytes came again");
    }
}

/// TCP keeps the order and loses nothing: what was asked for before a link stood still comes once it goes on.
#[test]
fn nothing_comes_twice_over_a_link_that_stands_still_for_some_seconds() {
    for (rate, still) in [(1e6, 700), (1e6, 3000), (1e6, 7000), (12.5e6, 1200), (100e3, 5000)] {
        let (mut network, map, _) = publishing_network(60, 8, Faults { rate, ..Faults::NONE });
        let begun = MILLIS(if rate > 1e7 { 100 } else { 800 });
        network.still = Some([begun, begun + MILLIS(still)]);
        network.run_until(begun + MILLIS(still / 2), |_| false);
        assert!(!network.nodes[1].is_acknowledged(), "it is over before the link stands still");
        assert!(network.run_until(SECONDS(60), |network| network.nodes[1].is_acknowledged()));
        assert!(network.whole(0, agent(7)).unwrap() == map);
        let neighbour = network.nodes[0].status(network.now).neighbours[0].clone();
        assert_eq!((neighbour.useless, network.closed), (0, 0), "{rate} bytes/s, {still} ms: {neighbour:?}");
    }
}

#[test]
fn a_slow_link_stays_open_and_states_come_through() {
    // 64 kbit/s.
    let (mut network, map, mut publisher) = publishing_network(6, 7, Faults { rate: 8e3, ..Faults::NONE });
    let mut grown = map.clone();
    grown.keyframes.get_mut(&KeyframeId(1)).unwrap().world_from_keyframe.scale = 2.0;
    network.run_until(SECONDS(10), |_| false);
    network.publish(1, &mut publisher, &grown, true);
    let since = network.now;
    let knows = |network: &Network| {
        let published = network.nodes[0].status(network.now).agents;
        published[0].missing > 0 && network.whole(0, agent(7)).is_none()
    };
    assert!(network.run_until(since + SECONDS(5), knows));
    assert!(network.run_until(SECONDS(100), |network| network.nodes[1].is_acknowledged()));
    assert_eq!(network.closed, 0);
    assert!(network.waited < SECONDS(3), "{:?}", network.waited);
    assert!(network.whole(0, agent(7)).unwrap() == grown);
}

#[test]
fn nothing_acknowledged_is_lost_however_often_somebody_is_killed() {
    let rooms: Vec<_> = (0..2).map(|_| tempfile::tempdir().unwrap()).collect();
    let open = |i: usize| Arc::new(FolderStore::open(rooms[i].path()).unwrap()) as Arc<dyn Store>;
    let faults = Faults { loss: 0.05, twice: 0.05, delay: [MILLIS(1), MILLIS(30)], rate: 400e3 };
    let mut network = Network::with_stores(vec![open(0), open(1)], 8, faults);
    let map = map(agent(7), 20);
    let mut publisher = Publisher::new(agent(7), 100);
    let mut numbers = Random::new(9);
    let mut acknowledged = 0;
    for round in 1..=100 {
        let keyframes = (round / 6).min(19);
        network.publish(1, &mut publisher, &first(&map, keyframes), false);
        let until = network.now + MILLIS(50 + numbers.below(4000));
        network.run_until(until, |_| false);
        let version = |notice: &Notice| match notice {
            Notice::Stored { version, .. } => Some(version.1),
            _ => None,
        };
        acknowledged = network.notices[1].iter().filter_map(version).max().unwrap_or(0).max(acknowledged);
        let killed = numbers.index(2);
        // The system lets go of what a killed process held.
        network.stores[killed] = Arc::new(crate::store::MemoryStore::default());
        network.nodes[killed] = crate::node::Node::new(
            crate::test_support::config(killed, crate::wire::Role::Agent),
            Arc::clone(&network.stores[killed]),
        );
        network.stores[killed] = open(killed);
        network.restart(killed);
        if killed == 0 {
            let published = network.nodes[0].status(network.now).agents;
            let has = network.nodes[0].snapshots().next();
            assert!(
                acknowledged == 0
                    || (published.len() == 1 && has.is_some_and(|snapshot| snapshot.missing == 0))
            );
        }
    }
    assert!(acknowledged > 3, "{acknowledged}");
    network.publish(1, &mut publisher, &map, true);
    let end = network.now + SECONDS(60);
    assert!(network.run_until(end, |network| network.nodes[1].is_acknowledged()));
    assert!(network.whole(0, agent(7)).unwrap() == map);
}
