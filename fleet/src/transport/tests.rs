//! Nodes in one process over real connections.

use crate::node::{News, Quota};
use crate::publishing::Publisher;
use crate::service::{Endpoint, Service, ServiceOptions};
use crate::store::Store;
use crate::test_support::{agent, map};
use crate::wire::Role;
use std::io::Write;
use std::net::TcpStream;
use std::path::Path;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

fn start(folder: &Path, role: Role, listen: Option<&str>, dial: &[Endpoint]) -> (Service, Receiver<News>) {
    let (tell, news) = channel();
    let options = ServiceOptions {
        folder: folder.to_owned(),
        name: format!("{role:?}"),
        role,
        listen: listen.map(|text| text.parse().unwrap()),
        dial: dial.to_vec(),
        quota: Quota::default(),
        waits: false,
    };
    let service = Service::start(options, move |news| drop(tell.send(news))).unwrap();
    (service, news)
}

fn wait(mut done: impl FnMut() -> bool) {
    let end = Instant::now() + Duration::from_secs(60);
    while !done() {
        assert!(Instant::now() < end, "it takes too long");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_map_goes_over_a_connection_and_what_was_told_is_told_again_after_a_restart() {
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
        assert!(!lonely.is_held());
    }
    let (again, _) = start(rooms[1].path(), Role::Agent, None, &[at]);
    wait(|| again.is_held());
    // What others may know of a node is renewed ten times a second.
    wait(|| station.heard().iter().all(|heard| heard.missing == 0));
    let heard = station.heard();
    assert_eq!((heard.len(), heard[0].missing, heard[0].finished), (1, 0, true));
    let mut assembler = crate::assembling::Assembler::default();
    let made = assembler.assemble(agent(7), &heard[0].entries, &*station.store(), None).unwrap().unwrap();
    assert!(made.whole && made.map == map);
}

#[test]
fn rubbish_on_a_connection_ends_it_and_no_other() {
    let room = tempfile::tempdir().unwrap();
    let (station, news) = start(room.path(), Role::Station, Some("tcp/127.0.0.1:0"), &[]);
    let at = station.listening().unwrap();
    for rubbish in [&[0xff; 4][..], &[3, 0, 0, 0, 99, 99, 99], b"GET / HTTP/1.1\r\n\r\n"] {
        let mut stream = TcpStream::connect(at.0).unwrap();
        stream.write_all(rubbish).unwrap();
        let told = |news: News| matches!(&news, News::Trouble(text) if text.contains("no message"));
        wait(|| news.try_iter().any(told));
    }
    let other = tempfile::tempdir().unwrap();
    let (agent, _) = start(other.path(), Role::Agent, None, &[at]);
    wait(|| agent.status().neighbours.iter().any(|n| n.is_station && n.address.is_some()));
}

#[test]
fn nothing_goes_beyond_this_machine() {
    let room = tempfile::tempdir().unwrap();
    for (listen, dial) in [(Some("tcp/0.0.0.0:0"), None), (None, Some("tcp/192.0.2.1:7447"))] {
        let options = ServiceOptions {
            folder: room.path().to_owned(),
            name: "x".into(),
            role: Role::Agent,
            listen: listen.map(|text| text.parse().unwrap()),
            dial: dial.iter().map(|text| text.parse().unwrap()).collect(),
            quota: Quota::default(),
            waits: false,
        };
        let refused = Service::start(options, |_| {}).err().expect("it is refused").to_string();
        assert!(refused.contains("not of this machine alone"), "{refused}");
    }
    for text in ["7447", "tls/127.0.0.1:7447", "tcp/127.0.0.1", "tcp/nowhere.invalid:1"] {
        assert!(text.parse::<Endpoint>().is_err(), "{text}");
    }
}
