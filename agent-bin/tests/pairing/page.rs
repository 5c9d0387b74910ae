//! The page of a station: what it is told, and what it shows in a browser while two agents meet.

// What the page of a run needs beyond this is not used here.
#[allow(dead_code)]
#[path = "../e2e/watch/browser.rs"]
mod browser;
#[allow(dead_code)]
#[path = "../e2e/watch/served.rs"]
mod served;
#[allow(dead_code)]
#[path = "../e2e/watch/socket.rs"]
mod socket;

use super::common::{arg, command};
use super::{Process, address, bytes, recording};
use browser::Browser;
use serde_json::Value;
use served::Served;
use socket::Client;
use std::io::Write;
use std::net::TcpStream;
use std::path::Path;

/// Whether the page says so of agents near.
fn says(page: &mut Browser, words: &str) -> bool {
    page.text("near-list").contains(words)
}

#[test]
fn the_page_of_a_station_shows_who_is_near_and_the_common_map_as_it_grows() {
    let room = tempfile::tempdir().expect("a folder");
    let at = |name: &str| room.path().join(name);
    let (station, mut reported) = (at("station"), command());
    reported
        .args(["station", "--view=0", "--name", "base", "--listen", "tcp/127.0.0.1:0", "--out"])
        .arg(&station);
    let mut there = Served::start(reported);
    let mut client = Client::connect(&there.url);
    // It is there before anybody else is.
    client.until("where it listens", |c| c.status["neighbourhood"]["listening"].is_string());
    assert_eq!((client.status["state"].as_str(), client.number("keyframes")), (Some("collecting"), 0));
    let mut page = Browser::open(&there.url, [1200, 760]);
    if let Some(page) = &mut page {
        page.until("the page", |p| p.value("document.documentElement.dataset.page") == "complete");
        page.until("nobody", |p| says(p, "nobody is near") && p.text("state") == "collecting");
        page.value("window.sinceTheBeginning = true");
    }

    let dial = address(&station);
    let [a, b] = ["a", "b"].map(|name| {
        let words = ["--quiet", &format!("--fleet={name}"), "--connect", &dial];
        Process::start(&[&["run", arg(&recording(name)), "--out", arg(&at(name))], &words[..]].concat())
    });
    client.until("the neighbours", |c| {
        c.status["neighbourhood"]["links"].as_array().is_some_and(|l| l.len() == 2)
    });
    assert!(a.succeeded() && b.succeeded());
    client.until("both whole maps in the common one", |c| {
        let maps = c.status["neighbourhood"]["maps"].as_array().into_iter().flatten();
        let is_in = |map: &&Value| map["is_joined"] == true && map["finished"] == true && map["missing"] == 0;
        let near = &c.status["neighbourhood"]["meetings"][0];
        maps.filter(is_in).count() == 2 && near["verdict"] == "accepted" && near["is_told"] == false
    });
    let keyframes = |name: &str| {
        let text = bytes(&at(name).join("run.json"));
        let record: Value = serde_json::from_slice(&text).expect("numbers");
        record["map"]["keyframes"].as_u64().expect("a number")
    };
    let all = keyframes("a") + keyframes("b");
    client.until("all keyframes", |c| c.number("keyframes") == all);
    // They come in rounds, behind the number of all.
    client.until("each one's points", |c| c.counts[3] as u64 >= all);
    // A peer that says a message of 4 GiB follows.
    let mut hostile = TcpStream::connect(dial.trim_start_matches("tcp/")).expect("it listens");
    hostile.write_all(&[0xff; 64]).expect("it is taken");
    client.until("the refusal", |c| {
        c.status["neighbourhood"]["trouble"].as_array().is_some_and(|t| !t.is_empty())
    });
    if let Some(page) = &mut page {
        look(page, all);
    }

    there.interrupt();
    client.until("the end", |c| c.status["state"] == "done");
    assert!(there.wait().success());
}

/// What the page shows in the end, to somebody who opened it before the agents came.
fn look(page: &mut Browser, keyframes: u64) {
    page.until("both agents", |p| p.value("document.querySelectorAll('#agents label').length") == 2);
    assert_eq!(page.value("window.sinceTheBeginning"), true, "the page was not loaded anew when they came");
    page.until("all keyframes", |p| p.text("number-keyframes") == keyframes.to_string());
    page.until("points drawn", |p| p.number("drawn") > 1000.0);
    for words in ["map of a:", "in the common map"] {
        page.until(words, |p| says(p, words));
    }
    // The elder one comes first.
    page.until("the merge", |p| says(p, "a + b: accepted") || says(p, "b + a: accepted"));
    page.until("who is refused", |p| p.value("document.querySelectorAll('#near-list .trouble').length") == 1);
    let hidden =
        "['pause', 'picture', 'trend-ms'].every((id) => !document.getElementById(id).checkVisibility())";
    assert_eq!(page.value(hidden), true, "there is no run to be paused or looked at");
    let colours = page.colours("scene");
    assert!(colours > 100, "the map shows {colours} colours");
    page.screenshot(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("station.png"));
    assert!(page.errors.is_empty(), "{:?}", page.errors);
}
