use super::*;

fn run() -> Owner {
    Owner::Run("video.mp4".into())
}

/// Writes results as a run does.
fn write(folder: &Path, owner: &Owner, names: &[&str], text: &str) {
    let mut results = Results::create(folder, owner, false).expect("it is free");
    for name in names {
        let path = results.file(name).expect("there is room");
        fs::write(path, text).expect("there is room");
    }
    results.commit().expect("there is room");
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        within(folder).expect("it is there").iter().map(|name| name.display().to_string()).collect();
    names.sort();
    names
}

#[test]
fn earlier_results_go_when_the_new_ones_are_complete_and_not_before() {
    let room = tempfile::tempdir().expect("a folder");
    let folder = room.path().join("out");
    write(&folder, &run(), &["map.mcap", "cloud.ply"], "old");
    fs::write(folder.join("notes.txt"), "mine").expect("there is room");
    let mut results = Results::create(&folder, &run(), false).expect("it is free");
    fs::write(results.file("map.mcap").expect("there is room"), "new").expect("there is room");
    drop(results);
    assert_eq!(names(&folder), ["cloud.ply", "map.mcap", "notes.txt"]);
    assert_eq!(fs::read(folder.join("map.mcap")).expect("it stays"), b"old");
    write(&folder, &run(), &["map.mcap"], "new");
    assert_eq!(names(&folder), ["map.mcap", "notes.txt"]);
    assert_eq!(fs::read(folder.join("map.mcap")).expect("it is there"), b"new");
}

#[test]
fn listed_results_go_and_what_others_list_elsewhere_stays() {
    let room = tempfile::tempdir().expect("a folder");
    let folder = room.path().join("out");
    fs::write(room.path().join("precious"), "").expect("there is room");
    write(&folder, &Owner::Unmerge, &["left/map.mcap", "map-right.mcap"], "old");
    let list =
        r#"{"files": ["left/map.mcap", "map-right.mcap", "../precious", "a/b/map.mcap", "notes/mine.txt"]}"#;
    fs::write(folder.join("unmerge.json"), list).expect("there is room");
    fs::create_dir(folder.join("notes")).expect("there is room");
    fs::write(folder.join("notes/mine.txt"), "").expect("there is room");
    write(&folder, &Owner::Unmerge, &["right/map.mcap"], "new");
    assert_eq!(names(&folder), ["notes/mine.txt", "right/map.mcap"]);
    assert!(room.path().join("precious").is_file());
}

#[test]
fn results_of_something_else_need_force() {
    let room = tempfile::tempdir().expect("a folder");
    let folder = room.path().join("out");
    write(&folder, &run(), &["map.mcap"], "old");
    fs::write(folder.join("run.json"), r#"{"source": {"path": "video.mp4"}}"#).expect("there is room");
    assert!(Results::create(&folder, &run(), false).is_ok());
    let other = Owner::Run("other.mp4".into());
    let refusal = |owner| Results::create(&folder, owner, false).err().map(|error| format!("{error:#}"));
    assert!(
        refusal(&other).is_some_and(|text| text.contains("a run over video.mp4") && text.contains("--force"))
    );
    assert!(refusal(&Owner::Merge).is_some());
    assert!(Results::create(&folder, &Owner::Merge, true).is_ok());
    assert_eq!(names(&folder), ["map.mcap", "run.json"]);
}

#[test]
fn two_programs_never_write_one_folder() {
    let room = tempfile::tempdir().expect("a folder");
    let first = Results::create(room.path(), &run(), false).expect("it is free");
    let second = Results::create(room.path(), &run(), false).err().map(|error| error.to_string());
    assert!(second.is_some_and(|text| text.contains("another loopbox")));
    drop(first);
    assert!(Results::create(room.path(), &run(), false).is_ok());
}

/// A program that is killed while it moves complete results: a reader finds the new map, the next writer ends the move.
#[test]
fn a_move_that_was_cut_is_ended_by_who_comes_next() {
    let room = tempfile::tempdir().expect("a folder");
    let folder = room.path();
    fs::write(folder.join("cloud.ply"), "old").expect("there is room");
    fs::write(folder.join("map.mcap"), "old").expect("there is room");
    fs::create_dir(folder.join(COMPLETE)).expect("there is room");
    fs::write(folder.join(COMPLETE).join("map.mcap"), "new").expect("there is room");
    assert_eq!(map_in(folder).map(|(path, _)| path), Some(folder.join(COMPLETE).join("map.mcap")));
    drop(Results::create(folder, &run(), false).expect("it is free"));
    assert_eq!(names(folder), ["map.mcap"]);
    assert_eq!(fs::read(folder.join("map.mcap")).expect("it is there"), b"new");
}

#[test]
fn the_live_map_is_stored_where_nothing_conflicts() {
    let room = tempfile::tempdir().expect("a folder");
    let grow = |folder: &Path| {
        let mut results = Results::create(folder, &run(), false).expect("it is free");
        let path = results.live_map().expect("there is room").to_owned();
        fs::write(&path, "growing").expect("there is room");
        (results, path)
    };
    let (killed, path) = grow(room.path());
    assert_eq!(path, room.path().join("map.mcap"));
    drop(killed);
    let (killed, path) = grow(room.path());
    assert_eq!(path, room.path().join("unfinished/map.mcap"));
    drop(killed);
    let (path, note) = map_in(room.path()).expect("there is a map");
    assert_eq!(path, room.path().join("map.mcap"));
    assert!(note.is_some_and(|note| note.contains("unfinished/map.mcap")));
    let second = room.path().join("unfinished/map.mcap");
    fs::write(&second, "killed second").expect("there is room");
    let (mut third, _) = grow(room.path());
    assert_eq!(names(room.path()), ["map.mcap", "unfinished-before/map.mcap", "unfinished/map.mcap"]);
    third.discard_live_map();
    assert_eq!(fs::read(second).expect("nothing newer is there"), b"killed second");
    drop(third);
    for _ in 0..3 {
        drop(grow(room.path()));
    }
    let (mut third, _) = grow(room.path());
    assert_eq!(names(room.path()), ["map.mcap", "unfinished-before/map.mcap", "unfinished/map.mcap"]);
    fs::write(third.file("map.mcap").expect("there is room"), "new").expect("there is room");
    third.commit().expect("there is room");
    assert_eq!(names(room.path()), ["map.mcap"]);
}

#[test]
fn a_full_disk_is_not_the_fault_of_the_map() {
    let full = std::io::Error::from(std::io::ErrorKind::StorageFull);
    assert!(is_of_the_disk(&anyhow::Error::new(full).context("map.mcap: cannot be written")));
    assert!(!is_of_the_disk(&anyhow::Error::msg("was made with another camera")));
    let of_map =
        |kind: std::io::ErrorKind| map::MapError::Write { path: "map.mcap".into(), reason: kind.into() };
    assert!(is_of_the_disk(&of_map(std::io::ErrorKind::StorageFull).into()));
    assert!(!is_of_the_disk(&of_map(std::io::ErrorKind::PermissionDenied).into()));
}

#[cfg(feature = "fleet")]
#[test]
fn of_an_attempt_that_failed_nothing_is_among_the_next_results() {
    let room = tempfile::tempdir().expect("a folder");
    let mut results = Results::create(room.path(), &Owner::Merge, false).expect("it is free");
    for name in ["map.mcap", "map-c.mcap"] {
        fs::write(results.file(name).expect("there is room"), "half of it").expect("there is room");
    }
    results.start_over().expect("there is room");
    fs::write(results.file("map.mcap").expect("there is room"), "all of it").expect("there is room");
    assert_eq!(results.names(), ["map.mcap"]);
    results.commit().expect("there is room");
    assert_eq!(names(room.path()), ["map.mcap"]);
    assert_eq!(fs::read(room.path().join("map.mcap")).expect("it is there"), b"all of it");
}
