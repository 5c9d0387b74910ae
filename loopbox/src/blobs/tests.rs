use super::*;
use std::fs;

/// What holds of every kind of them.
pub(super) fn keeps_what_is_put_first(blobs: &dyn Blobs) {
    assert!(blobs.get("a.x").unwrap().is_none() && !blobs.has("a.x").unwrap());
    assert!(blobs.list("").unwrap().is_empty());
    for (name, bytes) in
        [("b/one.x", &b"one"[..]), ("a.x", b""), ("b/two.x", b"two"), ("b/one.x", b"another")]
    {
        blobs.put(name, bytes).unwrap();
    }
    assert_eq!(blobs.get("b/one.x").unwrap().unwrap(), b"one");
    assert!(blobs.has("a.x").unwrap() && blobs.get("a.x").unwrap().unwrap().is_empty());
    assert_eq!(blobs.list("").unwrap(), ["a.x", "b/one.x", "b/two.x"]);
    assert_eq!(blobs.list("b/o").unwrap(), ["b/one.x"]);
    assert_eq!(blobs.list("b/").unwrap(), ["b/one.x", "b/two.x"]);
    assert!(blobs.list("none/").unwrap().is_empty());
    assert!(blobs.list("c").unwrap().is_empty() && blobs.address("b/two.x").contains("b/two.x"));
}

#[test]
fn of_two_objects_of_one_name_the_first_stays() {
    let room = tempfile::tempdir().unwrap();
    keeps_what_is_put_first(&FolderBlobs::at(&room.path().join("folder")).unwrap());
    keeps_what_is_put_first(&MemoryBlobs::default());
}

#[test]
fn what_a_killed_writer_left_is_no_object() {
    let room = tempfile::tempdir().unwrap();
    let blobs = FolderBlobs::at(room.path()).unwrap();
    fs::write(room.path().join(".tmpKilled"), "ha").unwrap();
    blobs.put("a", b"whole").unwrap();
    assert_eq!(blobs.list("").unwrap(), ["a"]);
}

#[test]
fn what_cannot_be_read_or_written_is_named() {
    let room = tempfile::tempdir().unwrap();
    let file = room.path().join("file");
    fs::write(&file, "in the way").unwrap();
    let refused = FolderBlobs::at(&file).unwrap_err().to_string();
    assert!(refused.contains("file: the folder cannot be made") && refused.contains("hint: "), "{refused}");
    let blobs = FolderBlobs::at(room.path()).unwrap();
    fs::create_dir(room.path().join("folder")).unwrap();
    assert!(blobs.get("folder").unwrap_err().to_string().contains("folder: cannot be read"));
    assert!(blobs.put("file/a", b"").unwrap_err().to_string().contains("file/a: cannot be written"));
}

#[test]
fn what_is_in_memory_is_forgotten_where_it_is_not_wanted() {
    let blobs = MemoryBlobs::default();
    ["a", "b"].iter().for_each(|name| blobs.put(name, b"1").unwrap());
    blobs.retain(|name| name == "b");
    assert_eq!(blobs.list("").unwrap(), ["b"]);
}

#[test]
fn maps_under_a_prefix_are_files_there_and_maps_of_folders() {
    let names = [
        "out/a.mcap",
        "out/b/map.mcap",
        "out/b/other.mcap",
        "out/c/d/map.mcap",
        "out/e.ply",
        "outer/map.mcap",
    ];
    let names = names.map(str::to_owned);
    assert_eq!(maps_among(&names, "out/"), ["out/a.mcap", "out/b/map.mcap"]);
    assert_eq!(maps_among(&names[5..], ""), ["outer/map.mcap"]);
}
