//! What is refused, and what all are told.

use super::*;

#[test]
fn an_older_map_of_an_agent_does_not_take_the_place_of_a_newer() {
    let (mut network, map, _) = publishing_network(6, 10, Faults::NONE);
    assert!(network.run_until(SECONDS(10), |network| network.nodes[1].is_acknowledged()));
    // The run is repeated, by a clock that is right, and by one that is not.
    for (begun, keyframes, expected) in [(200, 3, 3), (50, 5, 3)] {
        let mut again = Publisher::new(agent(7), begun);
        network.publish(1, &mut again, &first(&map, keyframes), false);
        let until = network.now + SECONDS(5);
        network.run_until(until, |_| false);
        assert_eq!(network.whole(0, agent(7)).unwrap().keyframes.len(), expected);
    }
    // Another epoch is another map.
    let later = agent(7).later(1);
    let mut publisher = Publisher::new(later, 300);
    network.publish(1, &mut publisher, &crate::test_support::map(later, 2), true);
    let until = network.now + SECONDS(5);
    network.run_until(until, |_| false);
    assert_eq!(network.whole(0, later).unwrap().keyframes.len(), 2);
    assert_eq!(network.whole(0, agent(7)).unwrap().keyframes.len(), 3);
}

#[test]
fn a_neighbour_that_sends_rubbish_loses_its_own_link_and_receives_the_reason() {
    let hash = crate::hash::ObjectHash::of(b"no object");
    let state = |agent, hash, size| {
        let version = MapVersion { agent, begun: 1 << 60, revision: 1, newest: 1, size, hash };
        Message::State { version, signature: None }.to_bytes()
    };
    let cases: [(Vec<u8>, &str); 3] = [
        (vec![99; 50], "no message"),
        (vec![0xff; 1 << 17], "no message"),
        (state(agent(7), hash, 10), "which another one tells"),
    ];
    for (bytes, words) in cases {
        // Node 1 tells a map, node 2 is hostile.
        let mut network = Network::new(3, 11, Faults { rate: 300e3, ..Faults::NONE });
        let map = map(agent(7), 10);
        let mut publisher = Publisher::new(agent(7), 100);
        network.publish(1, &mut publisher, &map, true);
        network.run_until(SECONDS(2), |_| false);
        network.forge(2, &bytes);
        network.run_until(SECONDS(6), |_| false);
        assert!(network.run_until(SECONDS(40), |network| network.nodes[1].is_acknowledged()), "{words}");
        assert!(network.whole(0, agent(7)).unwrap() == map);
        assert!(network.trouble(0).iter().any(|text| text.contains(words)), "{:?}", network.trouble(0));
        assert!(network.trouble(2).iter().any(|text| text.contains(words)), "{:?}", network.trouble(2));
        assert!(network.closed >= 1);
    }
}

/// A version of a map whose first list has an object of a kind that only newer versions know.
fn of_a_newer_version(agent: map::Identity) -> crate::publishing::Publication {
    use crate::hash::ObjectHash;
    use crate::manifest::{Manifest, PageRef};
    let mut published = Publisher::new(agent, 1).publish(&lidar_map(agent, 3), true).unwrap().unwrap();
    let bytes_of =
        |hash: ObjectHash| published.objects.iter().find(|(name, _)| *name == hash).unwrap().1.to_vec();
    let mut manifest = Manifest::from_bytes(&bytes_of(published.version.hash)).unwrap();
    let mut page = bytes_of(manifest.pages[0].hash);
    page[6] = 99;
    manifest.pages[0] = PageRef { size: page.len() as u32, hash: ObjectHash::of(&page) };
    let list = manifest.to_bytes();
    published.manifest = manifest;
    published.version =
        MapVersion { size: list.len() as u32, hash: ObjectHash::of(&list), ..published.version };
    for bytes in [page, list] {
        published.objects.push((ObjectHash::of(&bytes), bytes.into()));
    }
    published
}

#[test]
fn a_map_of_a_newer_version_is_refused_by_name_and_others_are_not() {
    let mut network = Network::new(3, 15, Faults { rate: 300e3, ..Faults::NONE });
    let map = lidar_map(agent(7), 4);
    network.publish(1, &mut Publisher::new(agent(7), 100), &map, true);
    network.event(2, Event::Publish(Box::new(of_a_newer_version(agent(8)))));
    assert!(network.run_until(SECONDS(20), |network| network.whole(0, agent(7)).is_some()));
    assert!(network.whole(0, agent(7)).unwrap() == map);
    for node in [0, 2] {
        let reported = network.trouble(node);
        assert!(
            reported.iter().any(|text| text.contains("objects of kind 99 are not known")),
            "{reported:?}"
        );
    }
}

#[test]
fn a_peer_with_ones_own_name_is_refused() {
    let (mut network, map, _) = publishing_network(3, 12, Faults::NONE);
    network.run_until(SECONDS(2), |_| false);
    let mut publisher = Publisher::new(agent(7), 1 << 50);
    network.publish(0, &mut publisher, &map, true);
    network.run_until(SECONDS(4), |_| false);
    let reported = [network.trouble(0), network.trouble(1)].concat();
    assert!(reported.iter().any(|text| text.contains("two runs of one recording")), "{reported:?}");
}

/// Makes the first of a network a station that takes no more of an agent than this.
fn limit(network: &mut Network, quota: crate::node::Quota) {
    let config = crate::node::Config { quota, ..crate::test_support::config(0, crate::wire::Role::Station) };
    network.nodes[0] = crate::node::Node::new(config, Arc::clone(&network.stores[0]));
}

#[test]
fn a_map_beyond_the_quota_is_refused() {
    let (mut network, _, _) = publishing_network(8, 13, Faults::NONE);
    limit(&mut network, crate::node::Quota { bytes: 1 << 30, keyframes: 7, maps: 1 });
    network.run_until(SECONDS(5), |_| false);
    assert!(network.trouble(1).iter().any(|text| text.contains("8 keyframes")), "{:?}", network.trouble(1));
    // A LiDAR's keyframes count as a camera's, those of all its maps together, and so do their bytes.
    for (keyframes, bytes, words) in [(9, 1 << 30, "10 keyframes"), (99, 9000, "bytes, more than the 9000")] {
        let mut network = Network::new(2, 13, Faults::NONE);
        limit(&mut network, crate::node::Quota { bytes, keyframes, maps: 2 });
        for name in [7, 8] {
            network.publish(1, &mut Publisher::new(agent(name), 1), &lidar_map(agent(name), 5), true);
        }
        network.run_until(SECONDS(5), |_| false);
        assert!(network.trouble(1).iter().any(|text| text.contains(words)), "{:?}", network.trouble(1));
    }
}

#[test]
fn what_was_found_out_comes_to_all_and_only_the_newest_stays() {
    let faults = Faults { loss: 0.2, twice: 0.1, delay: [MILLIS(5), MILLIS(50)], rate: 1e6 };
    let mut network = Network::new(3, 14, faults);
    network.run_until(SECONDS(3), |_| false);
    let found = |revision: u64| {
        let agent = crate::merge_results::PlacedAgent {
            agent: agent(7).to_string(),
            name: "x".repeat(9000),
            keyframes: revision as usize,
            whole: true,
            root: agent(7).to_string(),
            root_from_agent: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0],
        };
        crate::merge_results::MergeResults { agents: vec![agent], pair_verdicts: Vec::new() }
    };
    for revision in 1..=5 {
        network.event(0, Event::Results { revision, found: found(revision).into() });
        let until = network.now + MILLIS(700);
        network.run_until(until, |_| false);
    }
    let until = network.now + SECONDS(10);
    network.run_until(until, |_| false);
    for node in [1, 2] {
        let last = network.notices[node].iter().rev().find_map(|notice| match notice {
            Notice::Results { bytes, .. } => crate::merge_results::MergeResults::from_bytes(bytes).ok(),
            _ => None,
        });
        assert_eq!(last, Some(found(5)));
    }
}

/// Of so many agents that all of it would be more than one message of findings may hold.
#[test]
fn each_receives_its_place_however_many_others_there_are() {
    use crate::merge_results::{ACCEPTED, MergeResults, PairVerdict, PlacedAgent};
    let (mut network, ..) = publishing_network(1, 3, Faults { rate: 1e7, ..Faults::NONE });
    assert!(network.run_until(SECONDS(10), |network| network.nodes[1].is_acknowledged()));
    let all: Vec<String> = (0..300).map(|number| agent(7 + number).to_string()).collect();
    let mut found = MergeResults::default();
    for (number, name) in all.iter().enumerate() {
        found.agents.push(PlacedAgent {
            agent: name.clone(),
            name: format!("agent-{number}"),
            keyframes: 9,
            whole: true,
            root: all[0].clone(),
            root_from_agent: [number as f64, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0],
        });
        found.pair_verdicts.extend(all[..number].iter().map(|other| PairVerdict {
            names: [other.clone(), name.clone()],
            agents: [other.clone(), name.clone()],
            verdict: ACCEPTED.into(),
            why: Some(format!("{other} and {name} are alike at {number} places")),
            pending: false,
        }));
    }
    assert!(found.to_bytes().len() > crate::manifest::MAX_LIST as usize);
    network.event(0, Event::Results { revision: 1, found: found.into() });
    let is_received = |network: &Network| {
        let received = network.notices[1].iter().find_map(|notice| match notice {
            Notice::Results { bytes, .. } => MergeResults::from_bytes(bytes).ok(),
            _ => None,
        });
        received.is_some_and(|received| received.agents.len() == 300 && received.pair_verdicts.len() == 299)
    };
    let end = network.now + SECONDS(10);
    assert!(network.run_until(end, is_received), "{:?}", network.trouble(0));
}

#[test]
fn a_part_that_does_not_fit_is_no_part() {
    let bytes: Vec<u8> = (0..9000).map(|i| i as u8).collect();
    let hash = crate::hash::ObjectHash::of(&bytes);
    let mut fetch = link::Fetch::default();
    fetch.set_queue(vec![link::ObjectRef { hash, size: 9000 }]);
    assert!(!fetch.requests(Duration::ZERO).is_empty());
    let mut handle = |offset: u32, part: &[u8]| fetch.handle_part(MILLIS(1), &hash, offset, part);
    for (offset, length) in [(8192, 4096), (u32::MAX, 10), (5, 4096), (0, 100), (4096, 5000)] {
        assert_eq!(handle(offset, &vec![0; length]), link::PartOutcome::Unwanted, "{offset} {length}");
    }
    assert_eq!(handle(8192, &bytes[8192..]), link::PartOutcome::More);
    assert_eq!(handle(8192, &bytes[8192..]), link::PartOutcome::Unwanted);
    assert_eq!(handle(0, &bytes[..8192]), link::PartOutcome::Whole(bytes.clone()));
}
