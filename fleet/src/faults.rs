//! What goes wrong on disks and threads, and what must not come of it.

use crate::assembling::Assembler;
use crate::hash::ObjectHash;
use crate::manifest::{Kind, Manifest, PageRef};
use crate::node::{Config, Event, Node};
use crate::publishing::Publisher;
use crate::store::{Cut, FolderStore, Store};
use crate::test_support::{Faults, Network, agent, config, map};
use crate::wire::{MAX_PART, MapVersion, Message, Role};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

const SECONDS: fn(u64) -> Duration = Duration::from_secs;

fn open(folder: &Path) -> Arc<dyn Store> {
    Arc::new(FolderStore::open(folder).unwrap())
}

/// A station and an agent with folders, of which the agent tells a map of eight keyframes.
fn publishing_network(room: &Path) -> Network {
    let stores = ["station", "agent"].map(|name| open(&room.join(name)));
    let mut network = Network::with_stores(stores.into(), 21, Faults::NONE);
    network.publish(1, &mut Publisher::new(agent(7), 100), &map(agent(7), 8), true);
    // It is told once it is on the disk.
    network.event(1, Event::Tick);
    network
}

/// The file of an image of the map.
fn image(network: &Network, folder: &Path) -> (ObjectHash, PathBuf) {
    let published = network.nodes[1].own_maps().remove(0);
    let entry = published.entries.iter().filter(|entry| entry.kind == Kind::Image).nth(3).unwrap();
    let name = entry.hash.to_string();
    (entry.hash, folder.join("objects").join(&name[..2]).join(name))
}

/// The station is killed and started again.
fn restart(network: &mut Network, room: &Path) {
    network.stores[0] = Arc::new(crate::store::MemoryStore::default());
    network.restart(0);
    network.stores[0] = open(&room.join("station"));
    network.restart(0);
}

#[test]
fn an_object_that_is_missing_or_corrupt_here_is_no_fault_of_its_publisher() {
    let room = tempfile::tempdir().unwrap();
    let mut network = publishing_network(room.path());
    assert!(network.run_until(SECONDS(20), |network| network.nodes[1].is_acknowledged()));
    let snapshot = network.nodes[0].snapshots().next().unwrap();
    let (_, file) = image(&network, &room.path().join("station"));
    let mut bytes = std::fs::read(&file).unwrap();
    bytes[50] ^= 1;
    std::fs::write(&file, bytes).unwrap();
    let made = Assembler::default().assemble(agent(7), &snapshot.entries, &*network.stores[0], None);
    let made = made.expect("the agent told no lie").expect("all else is there");
    assert!(!made.whole && made.missing == 1);
    // It is fetched again.
    let end = network.now + SECONDS(20);
    assert!(network.run_until(end, |network| network.whole(0, agent(7)).is_some()));
}

#[test]
fn a_banned_peer_is_accepted_again_after_some_minutes() {
    let room = tempfile::tempdir().unwrap();
    let mut network = publishing_network(room.path());
    assert!(network.run_until(SECONDS(20), |network| network.nodes[1].is_acknowledged()));
    network.event(0, Event::Ban { agent: agent(7), reason: "it cannot be decoded".into() });
    let end = network.now + SECONDS(60);
    assert!(!network.run_until(end, |network| network.whole(0, agent(7)).is_some()));
    let end = network.now + SECONDS(600);
    assert!(network.run_until(end, |network| network.whole(0, agent(7)).is_some()));
}

#[test]
fn what_is_missing_after_a_power_cut_is_not_acknowledged_and_is_fetched_again() {
    for is_empty in [true, false] {
        let room = tempfile::tempdir().unwrap();
        let mut network = publishing_network(room.path());
        assert!(network.run_until(SECONDS(20), |network| network.nodes[1].is_acknowledged()));
        let (_, file) = image(&network, &room.path().join("station"));
        if is_empty {
            std::fs::write(&file, b"").unwrap()
        } else {
            std::fs::remove_file(&file).unwrap()
        }
        restart(&mut network, room.path());
        let lacks = |network: &Network| network.whole(0, agent(7)).is_none();
        assert!(lacks(&network), "an empty file is believed");
        let mut is_acknowledged_early = false;
        let end = network.now + SECONDS(20);
        let is_whole = network.run_until(end, |network| {
            let link = network.nodes[1].status(network.now).neighbours;
            let is_there = link.iter().any(|link| link.address.is_some() && link.lacks.is_some());
            is_acknowledged_early |= is_there && network.nodes[1].is_acknowledged() && lacks(network);
            !lacks(network)
        });
        assert!(is_whole && !is_acknowledged_early, "{is_whole} {is_acknowledged_early}");
        let end = network.now + SECONDS(5);
        assert!(network.run_until(end, |network| network.nodes[1].is_acknowledged()));
    }
}

#[test]
fn a_rotten_file_of_an_agent_costs_that_object_and_no_link() {
    let room = tempfile::tempdir().unwrap();
    let mut network = publishing_network(room.path());
    let (hash, file) = image(&network, &room.path().join("agent"));
    let whole = std::fs::read(&file).unwrap();
    let mut bytes = whole.clone();
    bytes[50] ^= 1;
    std::fs::write(&file, bytes).unwrap();
    network.run_until(SECONDS(30), |_| false);
    let snapshot = network.nodes[0].snapshots().next().unwrap();
    assert_eq!((network.closed, snapshot.missing), (0, 1));
    // Told again, the file is whole again.
    network.publish(1, &mut Publisher::new(agent(7), 200), &map(agent(7), 8), true);
    let end = network.now + SECONDS(60);
    assert!(network.run_until(end, |network| network.nodes[1].is_acknowledged()));
    assert!(network.stores[1].get(&hash).is_some());
}

/// Others hear it last just before it stands still, and it them a beat before.
#[test]
fn a_node_that_stood_still_for_less_than_others_bear_closes_no_link() {
    let mut network = Network::new(4, 22, Faults::NONE);
    network.run_until(Duration::from_millis(3950), |_| false);
    network.forge(0, &Message::Stored { agent: agent(9), begun: 1, revision: 1, missing: 1 }.to_bytes());
    network.stall(0, Duration::from_millis(7800));
    network.run_until(SECONDS(30), |_| false);
    assert_eq!(network.closed, 0);
}

/// A disk that keeps nothing for half a minute.
#[test]
fn while_a_disk_stalls_links_stay_and_nothing_is_acknowledged() {
    let disks = [Cut::default(), Cut::default()];
    let on = |disk: &Cut| {
        Arc::new(FolderStore::on(Box::new(disk.clone()), Path::new("/there")).unwrap()) as Arc<dyn Store>
    };
    let mut network = Network::with_stores(disks.iter().map(on).collect(), 23, Faults::NONE);
    network.settles = false;
    disks[0].set_stalled(true);
    network.publish(1, &mut Publisher::new(agent(7), 100), &map(agent(7), 8), true);
    let until = |network: &mut Network, time: Duration, done: fn(&Network) -> bool| {
        let end = network.now + time;
        // The other disk is as slow as the machine.
        network.run_until(end, |network| {
            std::thread::sleep(Duration::from_micros(200));
            done(network)
        })
    };
    assert!(until(&mut network, SECONDS(30), |network| network.whole(0, agent(7)).is_some()));
    assert!(!until(&mut network, SECONDS(30), |network| network.nodes[1].is_acknowledged()));
    assert_eq!(network.closed, 0);
    disks[0].set_stalled(false);
    assert!(until(&mut network, SECONDS(100), |network| network.nodes[1].is_acknowledged()));
    // And what is acknowledged outlasts a power cut.
    let after = Node::new(config(0, Role::Station), on(&disks[0].cut()));
    assert!(after.snapshots().next().is_some_and(|snapshot| snapshot.missing == 0));
}

/// Who reads a version of a map has all of it until he is done.
#[test]
fn what_a_later_version_needs_no_more_stays_as_long_as_somebody_reads() {
    let mut network = Network::new(2, 28, Faults::NONE);
    let (mut publisher, mut map) = (Publisher::new(agent(7), 100), map(agent(7), 4));
    network.publish(1, &mut publisher, &map, false);
    assert!(network.run_until(SECONDS(20), |network| network.nodes[1].is_acknowledged()));
    let pin = network.stores[0].pin();
    let before = network.nodes[0].snapshots().next().unwrap().entries;
    map.keyframes.values_mut().for_each(|keyframe| keyframe.world_from_keyframe.translation.x += 1.0);
    network.publish(1, &mut publisher, &map, false);
    let end = network.now + SECONDS(20);
    assert!(network.run_until(end, |network| network.nodes[1].is_acknowledged()));
    let end = network.now + SECONDS(2);
    network.run_until(end, |_| false);
    let gone = |network: &Network| {
        before.iter().filter(|e| !e.kind.is_preview() && !network.stores[0].has(&e.hash)).count()
    };
    assert_eq!(gone(&network), 0);
    drop(pin);
    let end = network.now + SECONDS(1);
    network.run_until(end, |_| false);
    assert_eq!(gone(&network), 1, "the poses");
}

/// Neighbours of the first that say this as often as they may, for a minute.
fn flood(network: &mut Network, mut says: impl FnMut(u64) -> Vec<u8>) {
    for number in 0..60 * 100 {
        network.forge(2, &says(number));
        let end = network.now + Duration::from_millis(10);
        network.run_until(end, |_| false);
    }
}

#[test]
fn acknowledgements_of_maps_that_nobody_publishes_are_not_kept() {
    let mut network = Network::new(3, 24, Faults::NONE);
    network.publish(0, &mut Publisher::new(agent(9), 100), &map(agent(9), 1), true);
    network.run_until(SECONDS(2), |_| false);
    let stored = |number: u64| {
        let agent = agent(1000 + u128::from(number));
        Message::Stored { agent, begun: 1 << 40, revision: number, missing: 0 }.to_bytes()
    };
    flood(&mut network, stored);
    assert!(network.nodes[0].remembered() < 10, "{}", network.nodes[0].remembered());
    assert_eq!(network.closed, 0);
}

#[test]
fn lists_of_more_objects_than_one_may_tell_are_refused_before_they_are_kept() {
    let mut network = Network::new(2, 25, Faults::NONE);
    let pages = vec![PageRef { size: 5000, hash: ObjectHash::of(b"a page") }; 9000];
    let manifest = Manifest { agent: agent(7), begun: 5, revision: 1, finished: false, pages };
    let bytes = manifest.to_bytes();
    let hash = ObjectHash::of(&bytes);
    let version =
        MapVersion { agent: agent(7), begun: 5, revision: 1, newest: 1, size: bytes.len() as u32, hash };
    network.run_until(SECONDS(2), |_| false);
    network.forge(1, &Message::State { version, signature: None }.to_bytes());
    for (offset, part) in (0..).step_by(MAX_PART).zip(bytes.chunks(MAX_PART)) {
        network.forge(1, &Message::Part { hash, offset, bytes: part.to_vec() }.to_bytes());
    }
    let end = network.now + SECONDS(5);
    network.run_until(end, |_| false);
    assert!(network.trouble(0).iter().any(|text| text.contains("9000 pages")), "{:?}", network.trouble(0));
    assert!(!network.stores[0].has(&hash));
}

/// However many others there are: of a version of a map only what it has new is looked at, and none of it is read again.
#[test]
fn a_version_costs_as_much_among_many_maps_as_among_few() {
    let cost = |agents: usize| {
        let mut network = Network::new(agents + 1, 26, Faults { rate: 1e9, ..Faults::NONE });
        let mut maps: Vec<_> =
            (1..=agents as u128).map(|a| (Publisher::new(agent(a), 1), map(agent(a), 6))).collect();
        for (number, (publisher, map)) in maps.iter_mut().enumerate() {
            network.publish(number + 1, publisher, map, false);
        }
        let all =
            |network: &Network| (1..=agents).all(|node| network.nodes[node].is_acknowledged_by_station());
        assert!(network.run_until(SECONDS(60), all));
        let before = network.nodes[0].looked_at();
        for keyframe in maps[0].1.keyframes.values_mut() {
            keyframe.world_from_keyframe.translation.x += 1.0;
        }
        let (publisher, map) = &mut maps[0];
        network.publish(1, publisher, map, true);
        let end = network.now + SECONDS(60);
        assert!(network.run_until(end, all));
        network.nodes[0].looked_at() - before
    };
    let (few, many) = (cost(2), cost(12));
    assert_eq!(few, many);
    // One page of those that are not of keyframes is new, beside the manifest.
    assert!(few < 40, "{few}");
}

/// The next version of the protocol in a fleet of this one, and one that is too new.
#[test]
fn versions_of_a_fleet_are_distinguished_by_what_they_have_in_common() {
    let mut network = Network::new(4, 27, Faults::NONE);
    let versions = [[3, 3], [3, 4], [3, 5], [4, 5]];
    for (number, versions) in versions.into_iter().enumerate() {
        let role = if number == 0 { Role::Station } else { Role::Agent };
        let config = Config { versions, ..config(number, role) };
        network.nodes[number] = Node::new(config, Arc::clone(&network.stores[number]));
    }
    for number in 1..4 {
        let agent = agent(number as u128);
        network.publish(number, &mut Publisher::new(agent, 100), &map(agent, 2), true);
    }
    network.run_until(SECONDS(5), |_| false);
    // What only the newer ones know is nothing to the others, and rubbish from one's own is rubbish.
    network.forge(2, &[77; 30]);
    network.run_until(SECONDS(10), |_| false);
    let has = |node: usize, of: u128| network.whole(node, agent(of)).is_some();
    assert!(has(0, 1) && has(0, 2) && has(1, 2) && has(2, 1) && has(1, 3) && has(2, 3));
    assert!(!has(0, 3));
    let reported = |node: usize| network.trouble(node).concat();
    assert!(
        reported(0).contains("speaks versions 4 to 5 of the protocol, this one 3 to 3"),
        "{}",
        reported(0)
    );
    assert!(reported(1).is_empty(), "{}", reported(1));
    assert!(reported(3).contains("no message"), "{}", reported(3));
}
