//! Disk and memory within their limits.

use crate::support::{Case, map_in};
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

fn fill(path: &Path, mebibytes: usize) {
    fs::create_dir_all(path.parent().expect("not the root")).expect("there is room");
    fs::write(path, vec![7; mebibytes << 20]).expect("there is room");
}

fn bytes_in(folder: &Path) -> u64 {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let bytes = |entry: fs::DirEntry| match entry.metadata() {
        Ok(about) if about.is_dir() => bytes_in(&entry.path()),
        Ok(about) => about.len(),
        Err(_) => 0,
    };
    entries.map(bytes).sum()
}

#[test]
fn the_oldest_is_deleted_first_and_the_map_in_use_stays() {
    let case = Case::new("short", "");
    assert!(case.start().wait().success(), "{}", case.log());
    let (_, identity) = map_in(&case.session(1));
    // Recordings of sessions without a map, younger than the map that is in use.
    for session in 2..5 {
        fill(&case.session(session).join("recording-1.mcap"), 6);
    }
    let limit = bytes_in(&case.session(1)) / (1 << 20) + 8;
    let source = fs::read_to_string(case.file()).expect("it is there");
    case.configure(&format!(
        "{}\n[limits]\ndisk_mib = {limit}\nfree_mib = 1\n",
        source.split_once("json\"\n").expect("our own text").1
    ));
    assert!(case.start().wait().success(), "{}", case.log());
    let left = [1, 2, 3, 4, 5].map(|session| case.session(session).exists());
    assert_eq!(left[1..3], [false, false], "{}", case.log());
    assert!(left[4], "{}", case.log());
    assert_eq!(map_in(&case.session(5)).1, identity, "the map in use was gone on with\n{}", case.log());
    assert!(bytes_in(&case.at("kept")) <= limit << 20, "{}", case.log());
}

#[test]
fn recordings_come_in_files_and_within_the_budget() {
    let case =
        Case::new("yard", "[record]\nenabled = true\nfile_mib = 2\n[limits]\ndisk_mib = 14\nfree_mib = 1\n");
    let mut agent = case.start();
    let began = Instant::now();
    let recordings = || {
        let names = fs::read_dir(case.session(1)).into_iter().flatten().flatten();
        let names = names.map(|entry| entry.file_name().to_string_lossy().into_owned());
        names.filter_map(|name| name.strip_prefix("recording-")?.strip_suffix(".mcap")?.parse::<u32>().ok())
    };
    let mut most = 0;
    while began.elapsed() < Duration::from_secs(12) {
        agent.until("alive", |_| true);
        most = most.max(bytes_in(&case.at("kept")));
        std::thread::sleep(Duration::from_millis(200));
    }
    assert!(recordings().max() > Some(2), "{:?}\n{}", recordings().collect::<Vec<_>>(), case.log());
    // What comes in two seconds, between two looks, is beyond it.
    assert!(most < 20 << 20, "{most} bytes\n{}", case.log());
    let (status, _) = agent.terminate();
    assert!(status.success(), "{}", case.log());
    assert!(!map_in(&case.session(1)).0.keyframes.is_empty());
    // The newest may have no frame yet.
    let oldest = recordings().min().expect("there is one");
    let oldest = case.session(1).join(format!("recording-{oldest}.mcap"));
    let info = Command::new(env!("CARGO_BIN_EXE_loopbox")).arg("info").arg(oldest).output();
    assert!(info.expect("it starts").status.success());
}

/// A process that has too little memory for any map saves, begins anew and says so; it does not spin.
#[test]
fn a_session_ends_where_memory_does() {
    let case = Case::new("yard", "[limits]\nmemory_mib = 40\n");
    let mut agent = case.start();
    let process = agent.id();
    agent
        .until("out of memory", |beat| beat["last_error"].as_str().is_some_and(|e| e.contains("memory_mib")));
    // In its place another program has begun, with its number.
    let first = agent.until("begun anew", |beat| beat["up_s"].as_f64() < Some(3.0) && beat["session"] != 1);
    assert_eq!(first["process"], process);
    let (status, _) = agent.terminate();
    assert!(status.success(), "{status}\n{}", case.log());
}

/// The disk is full while the agent maps, and then no more.
#[test]
fn a_full_disk_is_waited_out() {
    let case = Case::new("yard", "[limits]\nfree_mib = 1\n");
    let allowed = Command::new("unshare").args(["-rm", "sh", "-c", "mount -t tmpfs tmpfs /mnt"]).output();
    if !allowed.is_ok_and(|output| output.status.success()) {
        eprintln!("NOT TESTED: no name spaces here, and so no disk that can be filled");
        return;
    }
    fs::create_dir(case.at("kept")).expect("there is room");
    // In a name space of its own, the folder is a disk of 16 MB, of which others leave 3.
    let script = r#"
        mount -t tmpfs -o size=16m tmpfs "$0/kept" && head -c 13m /dev/zero > "$0/kept/others" || exit 9
        "$@" & agent=$!
        while [ ! -e "$0/release" ]; do sleep 0.05; done
        rm "$0/kept/others"
        while [ ! -e "$0/finish" ]; do sleep 0.05; done
        kill -TERM $agent; wait $agent; code=$?
        cp -r "$0/kept" "$0/result"
        exit $code"#;
    let agent = case.command();
    let mut mounted = Command::new("unshare");
    mounted
        .args(["-rm", "sh", "-c", script])
        .arg(case.at(""))
        .arg(agent.get_program())
        .args(agent.get_args());
    mounted.stderr(fs::File::create(case.at("log")).expect("there is room"));
    let mut agent = case.start_as(mounted);
    let full = agent.until("a full disk", |beat| {
        beat["trouble"]
            .as_array()
            .is_some_and(|all| all.iter().any(|t| t.as_str().is_some_and(|t| t.contains("the disk is full"))))
    });
    assert_eq!(full["healthy"], false);
    let mapped = agent
        .until("mapping on", |beat| beat["keyframes"].as_u64() >= Some(4) && beat["state"] == "tracking");
    fs::write(case.at("release"), "").expect("there is room");
    agent.until("room again", |beat| beat["healthy"] == true);
    fs::write(case.at("finish"), "").expect("there is room");
    assert!(agent.wait().success(), "{}", case.log());
    let (map, _) = map_in(&case.at("result/000001"));
    assert!(map.keyframes.len() as u64 >= mapped["keyframes"].as_u64().expect("a number"), "{}", case.log());
}
