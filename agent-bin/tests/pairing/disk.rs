//! A station whose disk is full.

use super::common::{arg, command};
use super::{Process, bytes, collected, kept, status};
use std::fs;
use std::net::TcpListener;
use std::process::{Command, Stdio};

/// Runs what follows it in a name space of its own, where it may mount, and takes all of it along when it is ended.
const APART: [&str; 5] = ["-rm", "--pid", "--fork", "--kill-child", "sh"];

/// In a name space of its own the station's folder is a disk, too small for both maps, and of any largest object there is
/// no room for 48 pages of 4 KiB. Once it has been full for longer than it takes to notice, it grows.
const FULL: &str = r#"
    mount -t tmpfs -o size=4m tmpfs "$0/station" || exit 9
    "$@" & station=$!
    while [ "$(stat -fc %a "$0/station")" -gt 48 ]; do kill -0 $station || exit 8; sleep 0.05; done
    sleep 3
    kill -0 $station || exit 7
    touch "$0/filled"
    mount -o remount,size=256m "$0/station" || exit 6
    wait $station; code=$?
    cp -r "$0/station" "$0/result"
    exit $code"#;

/// A station's disk is full while maps come, and then it is not any more.
#[test]
fn a_station_waits_until_there_is_room_on_its_disk() {
    let mount = "mount -t tmpfs tmpfs /mnt && mount -o remount,size=2m /mnt";
    let allowed = Command::new("unshare").args(APART).args(["-c", mount]).output();
    if !allowed.is_ok_and(|output| output.status.success()) {
        eprintln!("NOT TESTED: no name spaces here, and so no disk that can be filled");
        return;
    }
    let room = tempfile::tempdir().expect("a folder");
    let [a, b] = kept(room.path());
    let station = room.path().join("station");
    fs::create_dir(&station).expect("there is room");
    // A port that is free: from outside nobody sees what the station writes on its disk.
    let at = TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr()).expect("a port");
    let at = format!("tcp/{at}");
    let listen = ["station", "--quiet", "--listen", &at, "--agents", "2", "--out", arg(&station)];
    let mut mounted = Command::new("unshare");
    mounted.args(APART).args(["-c", FULL]).arg(room.path()).arg(command().get_program()).args(listen);
    let there = Process(mounted.stdout(Stdio::null()).spawn().expect("it starts"));
    let _agents = [&a, &b].map(|out| Process::start(&["fleet", arg(out), "--connect", &at]));
    assert!(there.succeeded());
    assert!(room.path().join("filled").exists());
    let result = room.path().join("result");
    for (own, name) in [(&a, "a"), (&b, "b")] {
        let there = collected(&result, name).join("map.mcap");
        assert!(bytes(&there) == bytes(&own.join("map.mcap")), "{name}'s map is another one at the station");
    }
    let found = status(&result, |_| true);
    assert_eq!(found["found"]["meetings"][0]["verdict"], "accepted", "{found:#}");
    // It said what it lacked, and nobody is refused for it.
    let trouble = found["trouble"].to_string();
    assert!(trouble.contains("os error 28") && !trouble.contains("cannot be used"), "{trouble}");
}
