//! The page of a run in a browser: what it shows, and its buttons.

use super::browser::Browser;
use super::served::Served;
use super::socket::Client;
use crate::support::{Case, RATE, hand_held};
use std::path::Path;
use std::time::Duration;

/// A run that is paused as soon as there is something to see, over a recording too long to end meanwhile: Chromium takes
/// longer to start than a short run to end, and both want all cores.
fn paused_run() -> (Case, Served) {
    const ROUNDS: usize = 50;
    let recording = hand_held(60);
    let case = Case::new(&recording);
    let shots = recording.shots.len();
    let line = |i: usize| format!("{:.6} images/{:06}.png\n", i as f64 / RATE, i % shots);
    let times: String = (0..ROUNDS * shots).map(line).collect();
    std::fs::write(case.source().join("times.txt"), times).expect("the recording's folder takes a file");
    let run = Served::start(case.command(&["--view=0"]));
    let mut client = Client::connect(&run.url);
    client.until("points", |c| c.counts[3] > 1);
    client.until("an image with depth", |c| c.depths > 200);
    client.command("pause");
    client.until("the pause", |c| c.status["paused"] == true);
    (case, run)
}

#[test]
fn the_page_shows_a_run_and_its_buttons_work() {
    let (_case, mut run) = paused_run();
    let Some(mut page) = Browser::open(&run.url, [1000, 600]) else { return };
    page.until("the page", |p| p.value("document.documentElement.dataset.page") == "complete");
    page.until("points drawn", |p| p.number("drawn") > 0.0 && p.number("points") > 1000.0);
    page.until("depth over the image", |p| p.number("overlaid") > 50.0);
    page.until("that it is paused", |p| p.text("pause") == "Resume" && p.text("state") == "paused");
    assert!(page.text("number-memory").ends_with("MiB"));
    let frame = page.text("number-frame");
    std::thread::sleep(Duration::from_millis(400));
    assert_eq!(page.text("number-frame"), frame, "a paused run takes no frames");

    page.click("record");
    page.until("recording", |p| p.text("record") == "Stop recording");
    page.click("pause");
    page.until("its numbers to move", |p| p.text("number-frame") != frame && p.text("pause") == "Pause");
    page.click("pause");
    page.until("the second pause", |p| p.text("pause") == "Resume");
    page.click("record");
    page.until("the end of recording", |p| p.text("record") == "Record");
    let frame = page.text("number-frame");
    page.click("save");
    page.until("the results", |p| p.text("note").contains("saved to"));
    for id in ["scene", "picture"] {
        let colours = page.colours(id);
        assert!(colours > 100, "{id} shows {colours} colours");
    }
    page.screenshot(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("view.png"));

    use_tools(&mut page);
    // It asks first, and a letter typed elsewhere stops nothing.
    page.value("document.body.dispatchEvent(new KeyboardEvent('keydown', { key: 'p', bubbles: true }))");
    page.click("restart");
    assert_eq!(page.value("document.getElementById('ask-restart').open"), true);
    assert_eq!(page.text("pause"), "Resume");
    page.click("restart-yes");
    page.until("a new map", |p| p.number("points") == 0.0 || p.text("number-keyframes") == "0");
    page.click("pause");
    page.until("frames again", |p| p.text("pause") == "Pause" && p.text("number-frame") != frame);
    page.until("points of the new map", |p| p.text("number-keyframes") != "0" && p.number("points") > 0.0);
    run.interrupt();
    page.until("the end", |p| p.text("state") == "finished");
    assert!(page.text("banner").contains("out-2"), "{}", page.text("banner"));
    assert!(run.wait().success());
    assert!(page.errors.is_empty(), "{:?}", page.errors);
}

/// The page of a recording without a calibration, from its first second to the report.
#[test]
fn the_token_leaves_the_address_and_the_page_leads_to_the_report() {
    let case = Case::new(&hand_held(90));
    std::fs::remove_file(case.source().join("camera.yaml")).expect("it is there");
    let mut run = Served::start(case.command(&["--view=0", "--token", "open-sesame"]));
    let Some(mut page) = Browser::open(&run.url, [1000, 600]) else { return };
    page.until("the page", |p| p.value("document.documentElement.dataset.page") == "complete");
    assert_eq!(page.value("location.search"), "");
    page.until("the end", |p| p.text("state") == "finished" && p.number("points") > 1000.0);
    // What it has by its cookie it gets again.
    page.call("Page.reload", serde_json::json!({}));
    page.until("the map again", |p| p.text("state") == "finished" && p.number("points") > 1000.0);
    page.screenshot(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("view-ended.png"));
    assert_eq!(page.text("report"), "Open the report");
    page.click("report");
    page.until("the report", |p| p.value("document.documentElement.dataset.report") == "complete");
    run.interrupt();
    assert!(run.wait().success());
    assert!(page.errors.is_empty(), "{:?}", page.errors);
}

/// Measures between two points, cuts, writes the points and plays the frames, as in the report.
fn use_tools(page: &mut Browser) {
    page.click("measure");
    page.value(
        "const canvas = document.getElementById('scene'), box = canvas.getBoundingClientRect();
         canvas.setPointerCapture = () => {};
         for (let y = 0.1; y < 0.95; y += 0.05) for (let x = 0.4; x < 0.95; x += 0.1)
           ['pointerdown', 'pointerup'].forEach((kind) => canvas.dispatchEvent(new PointerEvent(kind, { pointerId: 1,
             button: 0, clientX: box.left + x * box.width, clientY: box.top + y * box.height })));",
    );
    page.until("a length", |p| p.number("measured") > 0.0);
    page.click("measure");
    // Points may still come, and the first map lies at any distance: both counts are taken at once, and the cut goes
    // through the middle of the width, which cameras and points share.
    page.value(
        "globalThis.cutInTheMiddle = () => {
           const from = document.querySelectorAll('#cut-sides input')[2];
           const saved = (value) => {
             from.value = value;
             from.dispatchEvent(new Event('input', { bubbles: true }));
             document.getElementById('save-cloud').click();
             return Number(document.documentElement.dataset.saved);
           };
           const whole = saved(0), cut = saved(100);
           return whole > 0 ? cut / whole : -1;
         }",
    );
    page.until("a cut", |p| {
        let share = p.value("cutInTheMiddle()").as_f64().unwrap_or(f64::NAN);
        share > 0.0 && share < 1.0
    });
    page.click("play");
    page.until("frames played", |p| p.number("played") >= 0.0);
    page.click("play");
}
