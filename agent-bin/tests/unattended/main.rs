//! `loopbox agent` and `loopbox status`, through the binary: kills, limits, damaged maps, full disks, cameras that are not
//! there. Recordings stand for the camera; `script/vivid` has one that can be unplugged.
#![cfg(target_os = "linux")]

#[path = "../common/documented.rs"]
mod documented;
mod limits;
mod support;

use documented::assert_documented;
use geometry::Pinhole;
use loopbox_tests::Recording;
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::net::UnixDatagram;
use std::process::Command;
use std::time::Duration;
use support::{Case, holds, map_in};

/// What `SIGTERM` may take.
const FIVE_SECONDS: Duration = Duration::from_secs(5);

#[test]
fn an_agent_that_is_killed_continues_from_its_map() {
    let case = Case::new("yard", "");
    let mut before = None;
    for start in 1..=4 {
        let mut agent = case.start();
        let beat = agent.until_tracking();
        assert_eq!(beat["session"], start, "{beat:#}");
        let continues = beat["continues"].as_str();
        assert_eq!(continues.is_some(), start > 1, "{beat:#}\n{}", case.log());
        agent.kill();
        let (map, identity) = map_in(&case.session(start));
        if let Some((earlier, known)) = &before {
            assert_eq!(known, &identity, "start {start} began another map\n{}", case.log());
            assert!(holds(&map, earlier), "start {start} lost keyframes");
        }
        before = Some((map, identity));
    }
    let frames = |map: &map::Map| map.frames.len();
    assert!(before.is_some_and(|(map, _)| frames(&map) > 60), "the frames of all starts are there");
}

#[test]
fn sigterm_saves_within_five_seconds() {
    let case = Case::new("yard", "");
    let mut agent = case.start();
    let keyframes = agent.until_tracking()["keyframes"].as_u64().expect("a number");
    let (status, took) = agent.terminate();
    assert!(status.success() && took < FIVE_SECONDS, "{status}, {took:?}\n{}", case.log());
    let (map, _) = map_in(&case.session(1));
    assert!(map.keyframes.len() as u64 >= keyframes && map.frames.len() > 20);
    let names: Vec<_> = fs::read_dir(case.session(1)).expect("it is there").flatten().collect();
    assert_eq!(names.len(), 1, "the map is all that is left, and no part of anything: {names:?}");
    let beat = case.beat().expect("the last one stays");
    assert_eq!((&beat["state"], &beat["healthy"]), (&"ended".into(), &false.into()));
}

#[test]
fn the_end_of_a_recording_is_that_of_the_agent() {
    let case = Case::new("short", "");
    assert!(case.start().wait().success(), "{}", case.log());
    for name in ["map.mcap", "trajectory.txt", "cloud.ply", "report.html", "run.json"] {
        assert!(case.session(1).join(name).exists(), "{name} is missing\n{}", case.log());
    }
    // The next one goes on in it, and holds all of it.
    assert!(case.start().wait().success(), "{}", case.log());
    let ((first, one), (second, other)) = (map_in(&case.session(1)), map_in(&case.session(2)));
    assert!(one == other && holds(&second, &first), "{}", case.log());
}

#[test]
fn a_map_that_cannot_be_read_is_set_aside_and_a_torn_one_is_gone_on_with() {
    let case = Case::new("short", "");
    assert!(case.start().wait().success(), "{}", case.log());
    let (_, first) = map_in(&case.session(1));
    // What a power cut leaves on some file systems: zeros.
    fs::create_dir(case.session(2)).expect("there is room");
    fs::write(case.session(2).join("map.mcap"), vec![0; 70_000]).expect("there is room");
    assert!(case.start().wait().success(), "{}", case.log());
    let aside = case.session(2).join("map.mcap.unreadable");
    assert!(aside.exists() && !case.session(2).join("map.mcap").exists(), "{}", case.log());
    let reason = fs::read_to_string(case.session(2).join("map.mcap.unreadable.txt")).expect("a reason");
    assert!(reason.contains("map.mcap"), "{reason}");
    assert!(case.log().contains("set aside"), "{}", case.log());
    assert_eq!(map_in(&case.session(3)).1, first, "the one before is gone on with");
    // A map whose end is torn, with zeros where the disk had no time.
    let whole = fs::read(case.session(3).join("map.mcap")).expect("it is there");
    let torn = [&whole[..whole.len() / 2], &[0; 5000]].concat();
    fs::create_dir(case.session(4)).expect("there is room");
    fs::write(case.session(4).join("map.mcap"), torn).expect("there is room");
    assert!(case.start().wait().success(), "{}", case.log());
    assert!(case.session(5).join("map.mcap").exists(), "{}", case.log());
}

#[test]
fn the_map_of_another_camera_stays_and_a_new_one_is_begun() {
    let case = Case::new("short", "");
    assert!(case.start().wait().success(), "{}", case.log());
    let (_, first) = map_in(&case.session(1));
    let text = fs::read_to_string(case.file()).expect("it is there");
    let source = text.split_once("json\"\n").expect("our own text").1;
    case.configure(&source.replace("realtime", "calibration = \"other.yaml\"\nrealtime"));
    let Pinhole { width, height, fx, fy, cx, cy } = Recording::SMALL_CAMERA;
    let (fx, fy) = (1.01 * fx, 1.01 * fy);
    let size = format!("model: pinhole\nwidth: {width}\nheight: {height}\n");
    let other = format!("{size}fx: {fx}\nfy: {fy}\ncx: {cx}\ncy: {cy}\ndistortion: []\n");
    fs::write(case.at("other.yaml"), other).expect("there is room");
    assert!(case.start().wait().success(), "{}", case.log());
    assert!(case.log().contains("was made with a camera of"), "{}", case.log());
    assert_ne!(map_in(&case.session(2)).1, first, "{}", case.log());
    assert_eq!(map_in(&case.session(1)).1, first, "it is kept");
}

#[test]
fn status_and_health_say_how_it_is() {
    let case = Case::new("yard", "[page]\nport = 0\n");
    assert_eq!(case.status(&[]).0, Some(5), "it is not there yet");
    let mut agent = case.start();
    agent.until_tracking();
    let (code, output) = case.status(&[]);
    assert_eq!(code, Some(0), "{output}");
    assert!(
        ["tester: tracking", "a new map", "keyframes", "MiB"].iter().all(|w| output.contains(w)),
        "{output}"
    );
    let (code, json) = case.status(&["--json"]);
    let json: serde_json::Value = serde_json::from_str(&json).expect("it is JSON");
    assert_eq!((code, &json["stale"], &json["healthy"]), (Some(0), &false.into(), &true.into()));
    assert_documented(&json);
    let address = page_of(&case);
    let (head, body) = ask(&address, &address, "/health");
    assert!(head.starts_with("HTTP/1.1 200"), "{head}");
    let health: serde_json::Value = serde_json::from_str(&body).expect("it is JSON");
    assert_eq!((&health["state"], &health["name"]), (&"tracking".into(), &"tester".into()));
    let (_, page) = ask(&address, &address, "/");
    assert!(page.contains("</html>") && page.contains("\"mode\":\"service\""), "the page is there as well");
    assert!(ask(&address, "evil.example", "/health").0.starts_with("HTTP/1.1 403"));
    agent.kill();
    std::thread::sleep(Duration::from_secs(6));
    let (code, _) = case.status(&[]);
    assert_eq!(code, Some(5), "a dead agent is not well");
}

/// Where the agent says that its page is.
fn page_of(case: &Case) -> String {
    let log = case.log();
    let url = log.lines().find_map(|line| line.split_once("watch at http://")).map(|(_, at)| at);
    url.expect("the page's address").trim_end_matches('/').to_owned()
}

/// The head and the body of an answer.
fn ask(address: &str, host: &str, path: &str) -> (String, String) {
    let mut stream = TcpStream::connect(address).expect("it listens");
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n").expect("it hears");
    let mut text = String::new();
    stream.read_to_string(&mut text).expect("it answers");
    let (head, body) = text.split_once("\r\n\r\n").expect("a head");
    (head.to_owned(), body.to_owned())
}

#[test]
fn the_service_manager_is_notified() {
    let case = Case::new("yard", "");
    let socket = UnixDatagram::bind(case.at("notify")).expect("a socket");
    socket.set_read_timeout(Some(Duration::from_secs(60))).expect("it can wait");
    let received = |wanted: &str| {
        let mut bytes = [0; 512];
        loop {
            let count = socket.recv(&mut bytes).unwrap_or_else(|error| panic!("no {wanted}: {error}"));
            if String::from_utf8_lossy(&bytes[..count]).contains(wanted) {
                return;
            }
        }
    };
    let mut command = case.command();
    command.env("NOTIFY_SOCKET", case.at("notify"));
    let mut agent = case.start_as(command);
    ["READY=1", "WATCHDOG=1", "STATUS=tracking"].iter().for_each(|words| received(words));
    agent.until_tracking();
    // Who hangs is not fed.
    let id = agent.id().to_string();
    let stopped = Command::new("kill").args(["-STOP", &id]).status();
    assert!(stopped.expect("kill can be run").success());
    socket.set_nonblocking(true).expect("it can");
    let mut rest = [0; 512];
    while socket.recv(&mut rest).is_ok() {}
    std::thread::sleep(Duration::from_secs(2));
    assert!(socket.recv(&mut rest).is_err(), "a stopped process feeds nobody");
    socket.set_nonblocking(false).expect("it can");
    assert!(Command::new("kill").args(["-CONT", &id]).status().expect("kill can be run").success());
    received("WATCHDOG=1");
    let (status, _) = agent.terminate();
    assert!(status.success());
    received("STOPPING=1");
}

#[cfg(feature = "camera")]
#[test]
fn a_camera_that_is_not_there_is_waited_for() {
    let case =
        Case::of("[camera]\ndevice = \"/dev/video177\"\ncalibration = \"camera.yaml\"\n[page]\nport = 0\n");
    let camera = "model: pinhole\nwidth: 640\nheight: 480\nfx: 500.0\nfy: 500.0\ncx: 319.5\ncy: 239.5\ndistortion: []\n";
    fs::write(case.at("camera.yaml"), camera).expect("there is room");
    let mut agent = case.start();
    let beat = agent.until("waiting", |beat| beat["state"] == "waiting");
    assert_eq!(beat["healthy"], false);
    assert!(beat["trouble"][0].as_str().is_some_and(|text| text.contains("/dev/video177")), "{beat:#}");
    let (code, printed) = case.status(&[]);
    assert!(code == Some(5) && printed.contains("no session yet"), "{printed}");
    let address = page_of(&case);
    let (head, page) = ask(&address, &address, "/");
    assert!(head.starts_with("HTTP/1.1 503") && head.contains("text/html"), "{head}");
    assert!(page.contains("waiting") && page.contains("/dev/video177"), "{page}");
    let (status, took) = agent.terminate();
    assert!(status.success() && took < FIVE_SECONDS, "{status}, {took:?}");
    assert!(!case.session(1).exists(), "nothing was mapped");
}

#[test]
fn what_is_wrong_in_the_file_is_refused_with_its_line() {
    let case = Case::new("short", "");
    let text = fs::read_to_string(case.file()).expect("it is there");
    fs::write(case.file(), text + "[limits]\nmemory = 3\n").expect("there is room");
    let status = case.start().wait();
    assert_eq!(status.code(), Some(1));
    let log = case.log();
    for words in ["agent.toml", "line 8", "unknown field `memory`", "memory_mib", "agent-file.md"] {
        assert!(log.contains(words), "no '{words}' in: {log}");
    }
    fs::write(case.file(), "out = \"kept\"\n[recording]\npath = \"nowhere\"\n").expect("there is room");
    assert_eq!(case.start().wait().code(), Some(1));
    assert!(case.log().contains("nowhere: there is no such file"), "{}", case.log());
}
