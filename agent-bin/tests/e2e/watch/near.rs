//! What the page of an agent that pairs says of its neighbours.

use super::long_case;
use super::served::Served;
use super::socket::Client;
use crate::support::loopbox;
use std::io::Write;
use std::net::TcpStream;
use std::process::{Child, Stdio};

/// A process that is ended with the test.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn the_page_of_an_agent_shows_who_is_near_and_who_is_refused() {
    let case = long_case();
    let run = Served::start(case.command(&["--view=0", "--fleet=car", "--listen", "tcp/127.0.0.1:0"]));
    let mut client = Client::connect(&run.url);
    // It does not end meanwhile.
    client.command("pause");
    client.until("the pause", |c| c.status["paused"] == true);
    client.until("where it listens", |c| c.status["neighbourhood"]["listening"].is_string());
    let at = client.status["neighbourhood"]["listening"].as_str().expect("a text").to_owned();
    assert_eq!(client.status["neighbourhood"]["links"].as_array().map(Vec::len), Some(0));

    let room = tempfile::tempdir().expect("a folder");
    let mut station = loopbox();
    station
        .args(["station", "--quiet", "--name", "base", "--connect", &at, "--out"])
        .arg(room.path().join("base"));
    let station = station.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("it starts");
    let station = Process(station);
    client.until("the station", |c| {
        let link = &c.status["neighbourhood"]["links"][0];
        link["name"] == "base" && link["address"].is_string() && link["lacks"].is_u64()
    });
    drop(station);
    client.until("its end", |c| c.status["neighbourhood"]["links"][0]["address"].is_null());

    // A peer that says a message of 4 GiB follows.
    let mut hostile = TcpStream::connect(at.trim_start_matches("tcp/")).expect("it listens");
    hostile.write_all(&[0xff; 64]).expect("it is taken");
    client.until("the refusal", |c| {
        c.status["neighbourhood"]["trouble"].as_array().is_some_and(|trouble| !trouble.is_empty())
    });
}
