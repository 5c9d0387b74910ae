//! Parties with keys on a network without faults.

use crate::hash::ObjectHash;
use crate::keys::{Authority, Keys, Validity};
use crate::node::{Config, Event, Node, Quota};
use crate::publishing::Publisher;
use crate::test_support::{Faults, Network, agent, config, map};
use crate::wire::{MapVersion, Message, Role, VERSIONS};
use map::Identity;
use std::sync::Arc;
use std::time::Duration;

const SECONDS: fn(u64) -> Duration = Duration::from_secs;

fn with_keys(number: usize, keys: &Keys) -> Config {
    Config { signer: Some(keys.signer()), ..config(number, Role::Agent) }
}

/// Three nodes of peers `p0` to `p2`, of which the second tells a map.
fn network() -> (Network, Vec<Keys>) {
    let room = tempfile::tempdir().unwrap();
    let authority = Authority::init(room.path()).unwrap();
    let made = (0..3).map(|number| {
        let (name, folder) = (format!("p{number}"), room.path().join(number.to_string()));
        authority.issue(&name, Validity::days(1).unwrap(), &folder).unwrap();
        Keys::open(&folder).unwrap()
    });
    let keys: Vec<Keys> = made.collect();
    let mut network = Network::new(3, 1, Faults::NONE);
    network.peers = keys.iter().map(|keys| keys.peer().clone()).collect();
    for (number, keys) in keys.iter().enumerate() {
        network.nodes[number] = Node::new(with_keys(number, keys), Arc::clone(&network.stores[number]));
    }
    (network, keys)
}

fn publish(network: &mut Network, agent: Identity, keyframes: u32) {
    network.publish(1, &mut Publisher::new(agent, 100), &map(agent, keyframes), true);
}

fn version(agent: Identity, begun: u64, revision: u64) -> MapVersion {
    MapVersion { agent, begun, revision, newest: 1, size: 90, hash: ObjectHash::of(b"a list of objects") }
}

fn state(version: MapVersion, keys: &Keys) -> Vec<u8> {
    Message::State { version, signature: Some(keys.signer().sign(&version)) }.to_bytes()
}

fn assert_refused(network: &Network, [by, of]: [usize; 2], words: &str) {
    for node in [by, of] {
        let troubles = network.trouble(node);
        assert!(troubles.iter().any(|text| text.contains(words)), "{words}: {node} says {troubles:?}");
    }
}

#[test]
fn what_is_not_a_partys_own_is_refused_and_both_know_why() {
    let (hers, foreign) = (agent(7), agent(7).later(1));
    let (_, keys) = network();
    let mine = version(agent(9), 5, 5);
    let unsigned = Message::State { version: mine, signature: None }.to_bytes();
    let tampered = |keys: &[Keys]| {
        let signature = Some(keys[2].signer().sign(&mine));
        Message::State { version: MapVersion { hash: ObjectHash::of(b"another"), ..mine }, signature }
            .to_bytes()
    };
    type Forged<'a> = &'a dyn Fn(&[Keys]) -> Vec<Vec<u8>>;
    let cases: [(&str, Forged); 7] = [
        ("is not signed", &|_| vec![unsigned.clone()]),
        ("is not that of p2", &|keys| vec![state(mine, &keys[1])]),
        ("is not that of p2", &|keys| vec![tampered(keys)]),
        ("not p2's to tell: that agent is p1's", &|keys| vec![state(version(hers, 1 << 60, 1), &keys[2])]),
        ("not p2's to tell: that agent is p1's", &|keys| vec![state(version(foreign, 1, 1), &keys[2])]),
        ("an older version", &|keys| vec![state(mine, &keys[2]), state(version(agent(9), 5, 4), &keys[2])]),
        ("an older version", &|keys| vec![state(mine, &keys[2]), state(version(agent(9), 4, 9), &keys[2])]),
    ];
    for (words, forged) in cases {
        let (mut network, keys) = network();
        publish(&mut network, hers, 4);
        network.run_until(SECONDS(2), |_| false);
        assert!(network.trouble(0).is_empty(), "{:?}", network.trouble(0));
        forged(&keys).iter().for_each(|bytes| network.forge(2, bytes));
        network.run_until(SECONDS(6), |_| false);
        assert_refused(&network, [0, 2], words);
        assert!(network.whole(0, hers).is_some_and(|whole| whole == map(hers, 4)), "{words}");
    }
    drop(keys);
}

#[test]
fn whose_an_agent_is_outlasts_a_restart() {
    let (mut network, keys) = network();
    publish(&mut network, agent(7), 3);
    assert!(network.run_until(SECONDS(5), |network| network.whole(0, agent(7)).is_some()));
    // The one whose it is is gone when the first comes back.
    network.cut = vec![(0, 1), (1, 0)];
    network.nodes[0] = Node::new(with_keys(0, &keys[0]), Arc::clone(&network.stores[0]));
    let until = network.now + SECONDS(20);
    network.run_until(until, |_| false);
    network.forge(2, &state(version(agent(7), 1 << 60, 1), &keys[2]));
    let until = network.now + SECONDS(3);
    network.run_until(until, |_| false);
    assert_refused(&network, [0, 2], "not p2's to tell: that agent is another party's");
    assert!(network.whole(0, agent(7)).is_some());
}

#[test]
fn a_peer_publishes_no_more_maps_than_it_may() {
    let (mut network, keys) = network();
    let quota = Quota { maps: 2, ..Quota::default() };
    let config = Config { quota, ..with_keys(0, &keys[0]) };
    network.nodes[0] = Node::new(config, Arc::clone(&network.stores[0]));
    network.run_until(SECONDS(2), |_| false);
    for number in 20..30 {
        network.forge(2, &state(version(agent(number), 1, 1), &keys[2]));
    }
    publish(&mut network, agent(7), 3);
    assert!(network.run_until(SECONDS(8), |network| network.whole(0, agent(7)).is_some()));
    assert_refused(&network, [0, 2], "more than 2 maps");
    assert!(network.nodes[0].status(network.now).agents.len() <= 3);
}

#[test]
fn nobody_takes_anothers_place_by_its_name() {
    let (mut network, _) = network();
    publish(&mut network, agent(7), 4);
    network.run_until(SECONDS(2), |_| false);
    let hello = |node, name: &str| {
        let name = name.to_owned();
        Message::Hello { version: VERSIONS[0], node, role: Role::Agent, name, results: None }.to_bytes()
    };
    // A link of its own, on which it says that it is the other one from the beginning.
    let link = 77;
    let peer = network.peers.get(2).cloned();
    network.event(0, Event::Up { link, address: "link 77".into(), peer });
    let node = config(1, Role::Agent).node;
    network.event(0, Event::Received { link, bytes: hello(node, "node 1\x1b[2J") });
    let neighbours = network.nodes[0].status(network.now).neighbours;
    let names: Vec<&str> = neighbours.iter().filter(|n| n.address.is_some()).map(|n| &n.name[..]).collect();
    for name in ["node 1 of p1", "node 2 of p2", "node 1\u{fffd}[2J of p2"] {
        assert!(names.contains(&name), "{names:?}");
    }
    // However many it says it is, few are remembered once they are gone.
    for number in 0..500 {
        let (link, peer) = (1000 + number, network.peers.get(2).cloned());
        network.event(0, Event::Up { link, address: "there".into(), peer });
        let bytes = hello(map::Uuid::from_u128(number.into()), "x");
        network.event(0, Event::Received { link, bytes });
        network.event(0, Event::Down { link });
    }
    assert!(network.nodes[0].status(network.now).neighbours.len() < 80);
}
