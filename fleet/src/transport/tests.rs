//! Nodes in one process over real connections.

use crate::keys::{Authority, Keys, Validity};
use crate::node::{Event, Notice, Quota};
use crate::publishing::Publisher;
use crate::service::{Service, ServiceOptions};
use crate::store::Store;
use crate::test_support::{agent, map};
use crate::transport::tcp::Tcp;
use crate::transport::{Endpoint, Transport};
use crate::wire::{MAX_MESSAGE, Priority, Role};
use std::io::Write;
use std::net::TcpStream;
use std::path::Path;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

fn start(folder: &Path, role: Role, listen: Option<&str>, dial: &[&Endpoint]) -> (Service, Receiver<Notice>) {
    start_with(folder, role, listen, dial, None)
}

fn start_with(
    folder: &Path,
    role: Role,
    listen: Option<&str>,
    dial: &[&Endpoint],
    keys: Option<Keys>,
) -> (Service, Receiver<Notice>) {
    let (sender, notices) = channel();
    let options = ServiceOptions {
        folder: folder.to_owned(),
        name: format!("{role:?}"),
        role,
        listen: listen.map(|text| text.parse().unwrap()),
        dial: dial.iter().map(|&endpoint| endpoint.clone()).collect(),
        quota: Quota::default(),
        waits: false,
        keys,
    };
    let service = Service::start(options, move |notice| drop(sender.send(notice))).unwrap();
    (service, notices)
}

fn wait(mut done: impl FnMut() -> bool) {
    let end = Instant::now() + Duration::from_secs(60);
    while !done() {
        assert!(Instant::now() < end, "it takes too long");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_map_is_sent_over_a_connection_and_published_again_after_a_restart() {
    let rooms: Vec<_> = (0..3).map(|_| tempfile::tempdir().unwrap()).collect();
    let (station, _) = start(rooms[0].path(), Role::Station, Some("tcp/127.0.0.1:0"), &[]);
    let at = station.listening().unwrap();
    let map = map(agent(7), 8);
    let publication = Publisher::new(agent(7), 5).publish(&map, true).unwrap().unwrap();
    {
        // Nobody is there: it is kept.
        let (lonely, _) = start(rooms[1].path(), Role::Agent, None, &[]);
        lonely.publish(publication);
        wait(|| lonely.store().heads().len() == 1);
        assert!(!lonely.is_acknowledged());
    }
    let (again, _) = start(rooms[1].path(), Role::Agent, None, &[at]);
    wait(|| again.is_acknowledged());
    // What others may know of a node is renewed ten times a second.
    wait(|| station.snapshots().iter().all(|snapshot| snapshot.missing == 0));
    let snapshot = station.snapshots();
    assert_eq!((snapshot.len(), snapshot[0].missing, snapshot[0].finished), (1, 0, true));
    let mut assembler = crate::assembling::Assembler::default();
    let made = assembler.assemble(agent(7), &snapshot[0].entries, &*station.store(), None).unwrap().unwrap();
    assert!(made.whole && made.map == map);
}

/// Keys of one fleet, by the peers' names.
fn keys<const N: usize>(names: [&str; N]) -> [Keys; N] {
    let room = tempfile::tempdir().unwrap();
    let authority = Authority::init(room.path()).unwrap();
    names.map(|name| {
        authority.issue(name, Validity::days(1).unwrap(), &room.path().join(name)).unwrap();
        Keys::open(&room.path().join(name)).unwrap()
    })
}

#[test]
fn a_map_is_sent_from_peer_to_peer_by_tls() {
    let rooms: Vec<_> = (0..2).map(|_| tempfile::tempdir().unwrap()).collect();
    let [station, car] = keys(["Station", "car"]).map(Some);
    let (station, _) = start_with(rooms[0].path(), Role::Station, Some("tls/127.0.0.1:0"), &[], station);
    let at = Endpoint { host: "localhost".into(), ..station.listening().unwrap().clone() };
    let map = map(agent(7), 6);
    let (agent_there, _) = start_with(rooms[1].path(), Role::Agent, None, &[&at], car);
    agent_there.publish(Publisher::new(agent(7), 5).publish(&map, true).unwrap().unwrap());
    wait(|| agent_there.is_acknowledged());
    wait(|| station.snapshots().iter().any(|snapshot| snapshot.missing == 0));
    let mut assembler = crate::assembling::Assembler::default();
    let snapshot = station.snapshots();
    let made = assembler.assemble(agent(7), &snapshot[0].entries, &*station.store(), None).unwrap().unwrap();
    assert!(made.whole && made.map == map);
    assert_eq!(station.status().neighbours[0].name, "Agent of car");
    assert_eq!(agent_there.status().neighbours[0].name, "Station");
}

/// Links of their own with their events, and the number of the one that was dialled.
type Dialled = (Tcp, Receiver<Event>, u64);

/// Links of their own, dialled to a node.
fn dialled(at: &Endpoint, keys: Option<&Keys>) -> Dialled {
    let (events, happened) = channel();
    let tcp = Tcp::start(None, std::slice::from_ref(at), keys, events).unwrap();
    let Ok(Event::Up { link, .. }) = happened.recv_timeout(Duration::from_secs(20)) else {
        panic!("no link")
    };
    (tcp, happened, link)
}

/// One that listens, and one that has dialled it; with keys where the link is to be secure.
fn both_ends(secure: bool) -> ((Tcp, Receiver<Event>), Dialled) {
    let keys = secure.then(|| keys(["a", "b"]));
    let [a, b] = [0, 1].map(|number| keys.as_ref().map(|keys| &keys[number]));
    let at: Endpoint = if secure { "tls/127.0.0.1:0" } else { "tcp/127.0.0.1:0" }.parse().unwrap();
    let (events, happened) = channel();
    let there = Tcp::start(Some(&at), &[], a, events).unwrap();
    let here = dialled(there.listening().unwrap(), b);
    ((there, happened), here)
}

#[test]
#[cfg(target_os = "linux")]
fn both_ends_of_a_link_have_the_congestion_control_that_is_asked_for() {
    for secure in [false, true] {
        let ((there, _happened), (here, _news, _link)) = both_ends(secure);
        wait(|| !there.congestion().is_empty());
        let expected = crate::transport::congestion::tests::expected();
        assert_eq!([here.congestion(), there.congestion()], [[&*expected], [&*expected]], "secure: {secure}");
    }
}

#[test]
fn who_sends_more_than_is_looked_at_waits() {
    for secure in [false, true] {
        let ((there, happened), (flooding, _news, link)) = both_ends(secure);
        let mut came = 0;
        // Nobody looks at what comes.
        let end = Instant::now() + Duration::from_secs(2);
        while Instant::now() < end {
            flooding.send(link, Priority::Object, vec![4; MAX_MESSAGE]);
            std::thread::sleep(Duration::from_micros(100));
        }
        let mut first = None;
        for event in happened.try_iter() {
            if let Event::Received { link, bytes } = event {
                first.get_or_insert(link);
                came += bytes.len();
            }
        }
        assert!((500_000..2_000_000).contains(&came), "{came} bytes came");
        // What is looked at makes room.
        there.looked_at(first.unwrap(), came);
        wait(|| matches!(happened.recv_timeout(Duration::from_secs(9)), Ok(Event::Received { .. })));
    }
}

#[test]
fn hostile_lengths_and_floods_cost_their_own_link_only() {
    let rooms: Vec<_> = (0..2).map(|_| tempfile::tempdir().unwrap()).collect();
    let [station_keys, car, mallory] = keys(["station", "car", "mallory"]);
    let (station, notices) =
        start_with(rooms[0].path(), Role::Station, Some("tls/127.0.0.1:0"), &[], Some(station_keys));
    let at = station.listening().unwrap().clone();
    let (hostile, _news, link) = dialled(&at, Some(&mallory));
    // As many bytes as the largest message has, and more; then the same thing said for ever.
    hostile.send(link, Priority::State, vec![4; MAX_MESSAGE + 1]);
    let reported = |words: &str| {
        wait(|| {
            notices.try_iter().any(|notice| matches!(&notice, Notice::Trouble(text) if text.contains(words)))
        })
    };
    reported("no message");
    drop(hostile);
    let (hostile, _news, link) = dialled(&at, Some(&mallory));
    let stored =
        crate::wire::Message::Stored { agent: agent(3), begun: 1, revision: 1, missing: 1 }.to_bytes();
    (0..2000).for_each(|_| hostile.send(link, Priority::State, stored.clone()));
    reported("mallory is refused: it says more than");
    let (car, _) = start_with(rooms[1].path(), Role::Agent, None, &[&at], Some(car));
    car.publish(Publisher::new(agent(7), 5).publish(&map(agent(7), 3), true).unwrap().unwrap());
    wait(|| car.is_acknowledged());
    drop(hostile);
}

#[test]
fn rubbish_on_a_connection_ends_it_and_no_other() {
    let room = tempfile::tempdir().unwrap();
    let (station, notices) = start(room.path(), Role::Station, Some("tcp/127.0.0.1:0"), &[]);
    let at = station.listening().unwrap();
    for rubbish in [&[0xff; 4][..], &[3, 0, 0, 0, 99, 99, 99], b"GET / HTTP/1.1\r\n\r\n"] {
        let mut stream = TcpStream::connect((&at.host[..], at.port)).unwrap();
        stream.write_all(rubbish).unwrap();
        let reported =
            |notice: Notice| matches!(&notice, Notice::Trouble(text) if text.contains("no message"));
        wait(|| notices.try_iter().any(reported));
    }
    let other = tempfile::tempdir().unwrap();
    let (agent, _) = start(other.path(), Role::Agent, None, &[at]);
    wait(|| agent.status().neighbours.iter().any(|n| n.is_station && n.address.is_some()));
}

#[test]
fn nothing_leaves_this_machine() {
    let room = tempfile::tempdir().unwrap();
    let cases = [
        (Some("tcp/0.0.0.0:0"), None, "not of this machine alone"),
        (None, Some("tcp/192.0.2.1:7447"), "not of this machine alone"),
        (None, Some("tcp/nowhere.invalid:1"), "not found"),
        (Some("tls/0.0.0.0:0"), None, "needs keys"),
        (None, Some("tls/127.0.0.1:7447"), "needs keys"),
    ];
    for (listen, dial, words) in cases {
        let options = ServiceOptions {
            folder: room.path().to_owned(),
            name: "x".into(),
            role: Role::Agent,
            listen: listen.map(|text| text.parse().unwrap()),
            dial: dial.iter().map(|text| text.parse().unwrap()).collect(),
            quota: Quota::default(),
            waits: false,
            keys: None,
        };
        let refused = Service::start(options, |_| {}).err().expect("it is refused").to_string();
        assert!(refused.contains(words), "{refused}");
    }
}
