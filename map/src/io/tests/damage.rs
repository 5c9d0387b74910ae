//! Files that are cut, changed, or none.

use super::*;

#[test]
fn a_file_cut_anywhere_gives_its_whole_keyframes() {
    for map in [sample_map(4), united()] {
        assert_survives_cuts(&map);
    }
}

/// Asserts that the file of `map`, cut anywhere, gives what is whole.
#[track_caller]
fn assert_survives_cuts(map: &Map) {
    let folder = Folder::new();
    let bytes = folder.bytes(map);
    let (mut loaded, mut most) = (0, 0);
    for length in (0..bytes.len()).step_by(97).chain([bytes.len() - 1]) {
        match folder.load(&bytes[..length]) {
            Ok(part) => {
                assert!(!part.complete && !part.warnings.is_empty(), "cut at {length}");
                assert!(part.map.keyframes.len() >= most, "a longer file has no less");
                most = part.map.keyframes.len();
                loaded += 1;
                for (id, keyframe) in &part.map.keyframes {
                    assert_eq!(keyframe.semi_dense, map.keyframes[id].semi_dense);
                    assert_eq!(keyframe.image, map.keyframes[id].image);
                }
                assert_eq!(part.map.frames.len(), 5 * part.map.keyframes.len());
                let known = |id: &KeyframeId| part.map.keyframes.contains_key(id);
                assert!(part.map.edges.iter().all(|edge| known(&edge.from) && known(&edge.to)));
                assert!(part.map.frames.iter().all(|frame| known(&frame.reference)));
                let kept: usize = part.map.split().iter().map(|own| own.keyframes.len()).sum();
                assert_eq!(kept, part.map.keyframes.len());
            }
            Err(error) => assert!(length < 1500, "cut at {length}: {error}"),
        }
    }
    assert_eq!(most, map.keyframes.len());
    assert!(loaded > 50);
}

#[test]
fn a_changed_byte_never_panics_and_is_always_noticed() {
    assert_notices_changes(&sample_map(3), 1);
    assert_notices_changes(&united(), 5);
}

/// Asserts that any changed byte in the file of `map`, every `step`-th tried, is refused or said to be damage.
#[track_caller]
fn assert_notices_changes(map: &Map, step: usize) {
    let folder = Folder::new();
    let bytes = folder.bytes(map);
    let mut numbers = Numbers::new(3);
    let (mut partial, mut refused) = (0, 0);
    // All of the first bytes (header, version, agents), then samples.
    let positions = (0..1000).step_by(step).chain((1000..bytes.len()).step_by(61 * step));
    for position in positions {
        let mut changed = bytes.clone();
        changed[position] ^= 1 + (numbers.next() * 255.0) as u8;
        match folder.load(&changed) {
            // The index at the end repeats what the data say and is not needed.
            Ok(loaded) if loaded.complete => assert_eq!(loaded.map, *map, "byte {position}"),
            Ok(_) => partial += 1,
            Err(error) => {
                assert!(error.to_string().contains("bytes.mcap"), "{error}");
                refused += 1;
            }
        }
    }
    assert!(partial > 30 && refused > 20, "{partial} partial, {refused} refused");
}

#[test]
fn bytes_between_records_never_panic() {
    let folder = Folder::new();
    let bytes = folder.bytes(&sample_map(2));
    let mut numbers = Numbers::new(11);
    for _ in 0..300 {
        let mut changed = bytes.clone();
        let at = (numbers.next() * changed.len() as f64) as usize;
        let count = (numbers.next() * 40.0) as usize;
        let end = (at + count).min(changed.len());
        if numbers.next() < 0.5 {
            changed.drain(at..end);
        } else {
            changed.splice(at..at, vec![0xff; count]);
        }
        // Either outcome is fine; a panic is not.
        let _ = folder.load(&changed);
    }
}

#[test]
fn what_is_no_map_is_recognised() {
    let folder = Folder::new();
    assert!(matches!(folder.load(b""), Err(MapError::Empty { .. })));
    assert!(matches!(folder.load(b"ply\nformat"), Err(MapError::NotMcap { .. })));
    assert!(matches!(load_map(folder.file("none.mcap")), Err(MapError::Read { .. })));
    assert!(matches!(load_map(folder.0.path()), Err(MapError::Read { .. })));
    let recording = folder.file("recording.mcap");
    mcap::Writer::new(fs::File::create(&recording).unwrap()).unwrap().finish().unwrap();
    assert!(matches!(load_map(&recording), Err(MapError::NotAMap { .. })));
    assert!(!is_map_file(&recording) && !is_map_file(folder.file("none.mcap")));
    folder.bytes(&sample_map(1));
    assert!(is_map_file(folder.file("map.mcap")));
}

#[test]
fn another_version_is_refused_by_name() {
    let folder = Folder::new();
    let mut bytes = folder.bytes(&sample_map(1));
    let key = bytes.windows(6).position(|window| window == b"format").unwrap();
    // The value follows the key: a length of four bytes, then the text.
    assert_eq!(&bytes[key + 6..key + 11], b"\x01\x00\x00\x003");
    bytes[key + 10] = b'7';
    let error = folder.load(&bytes).unwrap_err();
    assert!(matches!(&error, MapError::Version { found, .. } if found == "7"), "{error}");
    assert!(error.to_string().contains("format 7"), "{error}");
}
