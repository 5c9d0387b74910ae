//! The page of a calibration: what it is told, and what it shows in a browser.

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

use crate::common::{arg, assert_misused, assert_refused, command};
use crate::support::{Artist, BOARD, poses};
use browser::Browser;
use served::Served;
use socket::{Client, host, request};
use std::io::Cursor;
use std::path::Path;
use std::process::Command;
use std::sync::mpsc::{Sender, channel};
use tempfile::tempdir;

/// Images that are looked at before the page is told.
const BATCH: usize = 4;

/// Makes a recording whose images are there once they are let go, [`BATCH`] for each message: each view twice.
fn held_back(folder: &Path) -> Sender<()> {
    let artist = Artist::new();
    let drawn = poses().into_iter().flat_map(|(position, tilt)| {
        let mut png = Cursor::new(Vec::new());
        artist.draw(position, tilt).write_to(&mut png, image::ImageFormat::Png).unwrap();
        [png.get_ref().clone(), png.into_inner()]
    });
    let drawn: Vec<Vec<u8>> = drawn.collect();
    let names: Vec<_> = (0..drawn.len()).map(|i| folder.join(format!("{i:02}.png"))).collect();
    let made = Command::new("mkfifo").args(&names).status().expect("mkfifo can be run");
    assert!(made.success());
    let line = |i: usize| format!("{i}.0 {i:02}.png\n");
    std::fs::write(folder.join("times.txt"), (0..names.len()).map(line).collect::<String>()).unwrap();
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        let all: Vec<_> = names.iter().zip(drawn).collect();
        for batch in all.chunks(BATCH) {
            // The test may have seen enough.
            let Ok(()) = receiver.recv() else { return };
            batch.iter().for_each(|(name, png)| std::fs::write(name, png).expect("someone reads it"));
        }
    });
    sender
}

#[test]
fn the_page_shows_what_is_missing_until_the_user_has_enough() {
    let (folder, out) = (tempdir().unwrap(), tempdir().unwrap());
    let more = held_back(folder.path());
    let file = out.path().join("camera.yaml");
    let mut calib = command();
    calib.args(["calib", arg(folder.path()), "--board", BOARD, "--out", arg(&file), "--view=0"]);
    let mut calib = Served::start(calib);
    let (first_line, page) = request(host(&calib.url), "/", &[("Host", host(&calib.url))]);
    assert_eq!(first_line, "HTTP/1.1 200 OK");
    assert!(page.contains("connect-src 'self'") && page.contains(BOARD), "{}", &page[..600]);
    assert_eq!(request(host(&calib.url), "/", &[("Host", "evil.example")]).0, "HTTP/1.1 403 Forbidden");

    let mut client = Client::connect(&calib.url);
    client.until("the beginning", |c| c.text("state") == "collecting");
    let missing = |c: &Client| c.status["missing"].as_array().map_or(0, Vec::len);
    let at_first = missing(&client);
    assert_eq!(at_first, 11);
    for batch in 1..=5 {
        let (before, views, images) = (missing(&client), client.number("views"), client.counts[4]);
        more.send(()).unwrap();
        client.until("the views of this batch", |c| {
            c.number("images") == (BATCH * batch) as u64 && c.counts[4] > images
        });
        let grown = client.number("views") - views;
        assert!(grown <= 2, "at most every second image is new: {}", client.status);
        assert!(missing(&client) <= before, "{}", client.status);
        assert!(client.text("verdict").contains("like one"), "{}", client.status);
    }
    assert!(client.number("views") > 4 && missing(&client) < at_first - 4, "{}", client.status);
    client.command("finish");
    more.send(()).unwrap();
    client.until("the result", |c| c.text("state") == "done");
    assert_eq!(client.number("images"), 24);
    assert!(client.text("result").contains("fx "), "{}", client.status);
    assert!(calib.runs(), "the user may look at the result");
    client.command("finish");
    assert!(calib.wait().success());
    assert!(calib::read_camera(&file).is_ok());
}

#[test]
fn the_page_shows_views_and_result_in_a_browser() {
    let (folder, out) = (tempdir().unwrap(), tempdir().unwrap());
    let more = held_back(folder.path());
    let (file, report) = (out.path().join("camera.yaml"), out.path().join("report.html"));
    let mut calib = command();
    calib.args(["calib", arg(folder.path()), "--board", BOARD, "--view=0", "--out", arg(&file)]);
    calib.args(["--report", arg(&report)]);
    let mut calib = Served::start(calib);
    let Some(mut page) = Browser::open(&calib.url, [1200, 1000]) else { return };
    page.until("the beginning", |p| p.text("state") == "collecting views");
    for batch in 1..=5 {
        more.send(()).unwrap();
        page.until("the images of this batch", |p| p.text("number-images") == (BATCH * batch).to_string());
    }
    page.until("corners in the image", |p| p.number("marked") == 54.0);
    assert!(page.text("missing-title").starts_with("Still missing: "));
    let seen = page.value("document.querySelectorAll('#missing .seen').length").as_u64();
    assert!(seen.is_some_and(|count| count > 4), "{seen:?} wishes are ticked off");
    for id in ["picture", "coverage"] {
        let colours = page.colours(id);
        assert!(colours > 20, "{id} shows {colours} colours");
    }
    page.screenshot(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("calib.png"));
    page.click("finish");
    more.send(()).unwrap();
    page.until("the result", |p| p.text("state") == "calibrated" && p.text("result").contains("fx "));
    page.click("finish");
    assert!(calib.wait().success());
    assert_eq!(page.text("state"), "calibrated", "the result stays");
    page.go(&format!("file://{}", report.display()));
    page.until("the report", |p| p.value("document.documentElement.dataset.report") == "complete");
    page.screenshot(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("calib-report.png"));
    assert!(page.errors.is_empty(), "{:?}", page.errors);
}

#[test]
fn what_has_no_page_is_reported() {
    let out = tempdir().unwrap();
    let (folder, file) = (arg(out.path()), out.path().join("vignette.png"));
    assert_misused(&["calib", "--vignette", folder, "--view=0", "--out", arg(&file)], &["--view", "hint"]);
    assert_refused(
        &["calib", "--board", BOARD, folder, "--view=0", "--token", "short", "--out", arg(&file)],
        &["--token", "hint"],
    );
}
