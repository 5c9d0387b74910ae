//! What an agent's file may say, and that all of it is documented.

use super::*;

fn read(text: &str) -> Result<AgentConfig> {
    let room = tempfile::tempdir().expect("a folder");
    let path = room.path().join("agent.toml");
    fs::write(&path, text).expect("there is room");
    AgentConfig::read(&path)
}

fn refused(text: &str) -> String {
    crate::explained(&read(text).expect_err("it is refused"))
}

#[test]
fn little_is_needed_and_paths_are_those_of_the_file() {
    let config = read("out = \"kept\"\n[recording]\npath = \"yard\"\n").expect("it is enough");
    assert!(config.out.is_absolute() && config.heartbeat().ends_with("kept/heartbeat.json"));
    assert!(config.map.resumes && !config.record.enabled && config.page.is_none());
    assert_eq!((config.limits.disk_mib, config.limits.memory_mib), (4096, 1024));
    let absolute = read("out = \"/srv\"\n[recording]\npath = \"/data/yard\"\n").expect("it is enough");
    assert_eq!(absolute.out, PathBuf::from("/srv"));
}

#[test]
fn what_is_wrong_is_named_with_file_and_line() {
    let unknown = refused("out = \"kept\"\n[recording]\npath = \"yard\"\nrepeat = 3\n");
    for words in ["agent.toml", "line 4", "repeat", "realtime"] {
        assert!(unknown.contains(words), "no '{words}' in: {unknown}");
    }
    let camera = "out = \"o\"\n[camera]\ndevice = \"/dev/video0\"\ncalibration = \"c.yaml\"\n";
    let lock = refused(&format!("{camera}lock = [\"iris\"]\n"));
    assert!(lock.contains("line 5") && lock.contains("white-balance"), "{lock}");
    for (text, words) in [
        ("out = \"kept\"\n", "neither [camera] nor [recording]"),
        ("out = 3\n", "line 1"),
        ("out = \"o\"\n[recording]\npath = \"y\"\n[limits]\nmemory_mib = 1\n", "limits.memory_mib is 1"),
        ("out = \"o\"\n[recording]\npath = \"y\"\nmax_width = 8\n", "max_width 8"),
    ] {
        let refusal = refused(text);
        assert!(refusal.contains(words) && refusal.contains("agent.toml"), "no '{words}' in: {refusal}");
    }
    let missing = AgentConfig::read(Path::new("/nowhere/agent.toml")).expect_err("it is not there");
    assert!(crate::explained(&missing).contains("/nowhere/agent.toml"));
}

/// The file that is shipped, with all that is commented out in it as well.
fn shipped(uncommented: bool) -> String {
    let text = include_str!("../../../script/agent/agent.toml");
    let lines = text.lines().map(|line| match line.strip_prefix("# ") {
        Some(key) if uncommented && (key.contains(" = ") || key.starts_with('[')) => key,
        _ => line,
    });
    lines.collect::<Vec<_>>().join("\n")
}

#[cfg(all(feature = "camera", feature = "fleet", feature = "view"))]
#[test]
fn the_file_that_is_shipped_shows_every_key_with_its_default() {
    let (plain, whole) = (read(&shipped(false)), read(&shipped(true)));
    let (plain, mut whole) = (plain.expect("it is a file"), whole.expect("its keys are keys"));
    assert_eq!(format!("{:?}", plain.limits), format!("{:?}", whole.limits));
    assert_eq!(format!("{:?}{:?}", plain.map, plain.record), format!("{:?}{:?}", whole.map, whole.record));
    let usual = (PageConfig { token: None, ..whole.page.take().expect("a page") }, PageConfig::default());
    assert_eq!(format!("{:?}", usual.0), format!("{:?}", usual.1));
    let (one, other) = (plain.camera.expect("a camera"), whole.camera.expect("a camera"));
    assert_eq!((one.max_width, one.format, &one.lock), (other.max_width, other.format, &other.lock));
}

#[test]
fn every_key_is_documented_and_in_the_file_that_is_shipped() {
    let document = include_str!("../../../book/src/reference/agent-file.md");
    let keys = include_str!("config.rs").lines().filter_map(|line| {
        let field = line.strip_prefix("    pub ").filter(|line| !line.contains("fn "))?;
        Some(field.split_once(':')?.0)
    });
    let documented = |key: &str| if key == "resumes" { "continue".to_owned() } else { key.to_owned() };
    for key in keys.map(documented) {
        assert!(
            document.contains(&format!("`{key}`")) || document.contains(&format!("`[{key}]`")),
            "book/src/reference/agent-file.md says nothing of {key}"
        );
        let is_listed = shipped(true)
            .lines()
            .any(|line| line.starts_with(&format!("{key} =")) || line.starts_with(&format!("[{key}]")));
        let of_recordings = ["recording", "path", "realtime"].contains(&key.as_str());
        assert!(is_listed || of_recordings, "script/agent/agent.toml does not show {key}");
    }
}

#[cfg(feature = "fleet")]
#[test]
fn a_fleet_of_nobody_is_refused() {
    let refusal = refused("out = \"o\"\n[recording]\npath = \"y\"\n[fleet]\nname = \"a\"\n");
    assert!(refusal.contains("nobody could be reached"), "{refusal}");
}
