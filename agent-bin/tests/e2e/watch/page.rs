//! The page's server, asked without a browser.

use super::long_case;
use super::served::Served;
use super::socket::{Client, UPGRADE, host, request};
use crate::support::{Case, Outcome, drive, hand_held, loopbox};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The only folder beside `path` whose name begins with `prefix`.
fn folder_within(path: &Path, prefix: &str) -> PathBuf {
    let entries = std::fs::read_dir(path).expect("a folder").map(|entry| entry.expect("an entry").path());
    let named =
        |path: &PathBuf| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(prefix));
    let found: Vec<PathBuf> = entries.filter(named).collect();
    assert_eq!(found.len(), 1, "{found:?}");
    found[0].clone()
}

#[test]
fn a_run_is_watched_paused_saved_and_restarted() {
    let case = long_case();
    let mut run = Served::start(case.command(&["--view=0"]));
    let (first_line, page) = request(host(&run.url), "/", &[("Host", host(&run.url))]);
    assert_eq!(first_line, "HTTP/1.1 200 OK");
    assert!(page.contains("connect-src 'self'") && page.contains("recording"), "{}", &page[..600]);

    let mut client = Client::connect(&run.url);
    client.until("a keyframe with points and an image", |c| {
        c.counts[1] > 0 && c.counts[3] > 0 && c.counts[4] > 0
    });
    let before = client.number("frame");
    client.until("frames", |c| c.number("frame") > before + 5 && c.text("state") == "tracking");
    assert!(client.number("memory_bytes") > 1 << 20 && client.number("points") > 0, "{}", client.status);

    client.record(true);
    client
        .until("recording", |c| c.status["recording"] == true && c.text("note").contains("recording-1.mcap"));
    let since = client.number("frame");
    client.until("frames recorded", |c| c.number("frame") > since + 5);
    client.record(false);
    client.until("the end of recording", |c| c.status["recording"] == false);
    let mut info = loopbox();
    info.arg("info").arg(case.out().join("recording-1.mcap"));
    Outcome::of(info).assert_success();

    client.command("pause");
    client.until("the pause", |c| c.status["paused"] == true);
    let paused_at = client.number("frame");
    client.during(Duration::from_millis(500));
    assert_eq!(client.number("frame"), paused_at, "a paused run takes no frames");

    client.command("save");
    client.until("the results", |c| c.text("note").contains("saved to"));
    let saved =
        map::load_map(folder_within(&case.out(), "saved-").join("map.mcap")).expect("it is whole").map;
    assert_eq!(saved.frames.last().map(|frame| frame.frame_index), Some(paused_at));
    assert!(run.runs(), "saving does not end the run");

    let resets = client.resets;
    client.command("restart");
    client.until("a new map", |c| c.resets > resets && c.text("folder").ends_with("out-2"));
    assert_eq!(case.map().frames.len(), saved.frames.len(), "the map before is whole and in its place");
    assert_eq!(client.number("keyframes"), 0);
    client.command("resume");
    client.until("the new map", |c| c.number("frame") > paused_at && c.number("keyframes") > 1);
    run.interrupt();
    client.until("the end", |c| c.text("state") == "done");
    assert!(run.wait().success());
    let second = map::load_map(case.out().with_file_name("out-2").join("map.mcap")).expect("it is whole").map;
    assert!(second.frames.iter().all(|frame| frame.frame_index > paused_at));
}

#[test]
fn a_page_that_does_not_answer_receives_nothing_more_but_the_end() {
    let case = long_case();
    let mut run = Served::start(case.command(&["--view=0"]));
    let mut slow = Client::connect(&run.url);
    slow.answers = false;
    let mut quick = Client::connect(&run.url);
    quick.until("many rounds", |c| c.rounds > 10);
    quick.command("pause");
    quick.until("the pause", |c| c.status["paused"] == true);
    slow.until("a round", |c| c.rounds > 0);
    slow.during(Duration::from_millis(300));
    assert_eq!(slow.rounds, 1, "nothing is queued for a page that is busy");
    drop(quick);
    run.interrupt();
    slow.until("the end", |c| c.text("state") == "done");
    assert!(run.wait().success());
}

#[test]
fn a_run_that_waits_for_its_next_image_can_be_steered() {
    let case = long_case();
    // The second image is due in minutes, as that of an unplugged camera may be.
    let run = Served::start(case.command(&["--view=0", "--realtime", "--speed", "0.0001"]));
    let mut client = Client::connect(&run.url);
    client.command("pause");
    client.until("the pause", |c| c.status["paused"] == true);
    client.command("resume");
    client.until("the end of the pause", |c| c.status["paused"] == false);
}

#[test]
fn the_page_is_there_while_the_lens_is_found_and_after_the_run() {
    let case = Case::new(&hand_held(120));
    std::fs::remove_file(case.source().join("camera.yaml")).expect("it is there");
    let mut run = Served::start(case.command(&["--view=0"]));
    let mut client = Client::connect(&run.url);
    client.until("what is done before the run", |c| {
        c.text("state") == "preparing" && c.text("note").contains("finding the lens, round 1")
    });
    client.until("what is looked at", |c| c.counts[4] > 0 && c.number("frame") > 0);
    let report = |client: &Client| client.status["report"] == true;
    assert!(
        !report(&client)
            && request(host(&run.url), "/report.html", &[("Host", host(&run.url))]).0.contains("404")
    );
    let resets = client.resets;
    client.until("the run", |c| c.text("state") == "tracking" && c.resets > resets && c.counts[3] > 0);
    client.until("its end", |c| c.text("state") == "done");
    assert!(report(&client) && client.text("note").contains("Its results are in"), "{}", client.status);
    let (first_line, page) = request(host(&run.url), "/report.html", &[("Host", host(&run.url))]);
    assert!(first_line.contains("200 OK") && page.contains("id=\"keyframe-title\""), "{first_line}");
    // Whoever comes now sees it too.
    Client::connect(&run.url).until("the map", |c| c.counts[3] > 1 && c.text("state") == "done");
    assert!(run.runs(), "the user may look at the result");
    run.interrupt();
    assert!(run.wait().success());
}

#[test]
fn the_page_says_why_there_is_no_result() {
    let mut recording = hand_held(20);
    let first = std::sync::Arc::clone(&recording.shots[0].image);
    recording.shots.iter_mut().for_each(|shot| shot.image = std::sync::Arc::clone(&first));
    let case = Case::new(&recording);
    let mut run = Served::start(case.command(&["--view=0"]));
    let mut client = Client::connect(&run.url);
    client.until("the end", |c| c.text("state") == "done");
    assert!(client.text("note").contains("no frame could be tracked"), "{}", client.status);
    assert!(!run.wait().success());
}

#[test]
fn only_who_may_look_does() {
    let case = Case::new(&drive());
    case.run(&["--quiet", "--end", "1.5"]).assert_success();
    let view = |more: &[&str]| {
        let mut command = loopbox();
        command.arg("view").arg(case.out()).args(["--port", "0"]).args(more);
        Served::start(command)
    };
    let own = view(&[]);
    let host_name = host(&own.url);
    let ask = |path: &str, headers: &[(&str, &str)]| request(host_name, path, headers).0;
    assert_eq!(ask("/", &[("Host", host_name)]), "HTTP/1.1 200 OK");
    assert_eq!(ask("/other", &[("Host", host_name)]), "HTTP/1.1 404 Not Found");
    assert_eq!(ask("/", &[("Host", "evil.example")]), "HTTP/1.1 403 Forbidden");
    let with = |more: &[(&'static str, &'static str)]| [&UPGRADE[..], more].concat();
    assert!(ask("/ws", &with(&[("Host", "localhost")])).contains("101"));
    let foreign = with(&[("Host", "localhost"), ("Origin", "http://evil.example")]);
    assert_eq!(ask("/ws", &foreign), "HTTP/1.1 403 Forbidden");
    let mut client = Client::connect(&own.url);
    client.until("the map", |c| c.counts[3] > 1 && c.text("state") == "saved");
    drop(own);

    let guarded = view(&["--token", "open-sesame"]);
    assert!(guarded.url.ends_with("/?token=open-sesame"), "{}", guarded.url);
    let host_name = host(&guarded.url);
    let ask = |path: &str, headers: &[(&str, &str)]| request(host_name, path, headers).0;
    for path in ["/", "/?token=open-sesam", "/?token="] {
        assert_eq!(ask(path, &[("Host", host_name)]), "HTTP/1.1 403 Forbidden", "{path}");
    }
    assert_eq!(ask("/ws?token=wrong-token", &with(&[("Host", "localhost")])), "HTTP/1.1 403 Forbidden");
    assert_eq!(ask("/?token=open-sesame", &[("Host", host_name)]), "HTTP/1.1 200 OK");
    Client::connect(&guarded.url).until("the map", |c| c.counts[3] > 1);
}

#[test]
fn what_cannot_be_served_is_reported() {
    let case = Case::empty();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let port = taken.local_addr().expect("it has an address").port().to_string();
    let refuse = |arguments: &[&str], words: &[&str]| {
        let mut command = loopbox();
        command.args(arguments);
        Outcome::of(command).assert_refused(words);
    };
    let nothing = case.source();
    let nothing = nothing.to_str().expect("a path");
    refuse(&["view", nothing], &["there is no map", "hint"]);
    refuse(&["view", nothing, "--token", "short"], &["--token", "hint"]);
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("../demo/parking_a");
    let out = case.out();
    let run = ["run", demo.to_str().expect("a path"), "--out", out.to_str().expect("a path")];
    refuse(&[&run[..], &[&format!("--view={port}")]].concat(), &["cannot serve", &port, "hint"]);
}
