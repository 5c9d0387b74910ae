//! Files that grow while a run goes on.

use super::*;

#[test]
fn a_killed_run_leaves_what_was_flushed() {
    let folder = Folder::new();
    let path = folder.file("map.mcap");
    let whole = sample_map(4);
    let mut map = Map { keyframes: Default::default(), edges: vec![], frames: vec![], ..whole.clone() };
    let mut writer = MapWriter::create(&path, &sole_agent(&map)).unwrap();
    assert_eq!(load_map(&path).unwrap().map, map, "a file without keyframes loads");
    for (count, (id, keyframe)) in whole.keyframes.iter().enumerate() {
        writer.append_keyframe(keyframe).unwrap();
        map.keyframes.insert(*id, keyframe.clone());
        // The optimiser moves all keyframes and rewrites the latest edge and frames.
        map.keyframes.values_mut().for_each(|keyframe| keyframe.world_from_keyframe.scale *= 1.1);
        map.edges = whole.edges[..count].to_vec();
        map.frames = whole.frames[..5 * count + 2].to_vec();
        map.frames.iter_mut().rev().take(3).for_each(|frame| frame.keyframe_from_frame.translation.x += 0.1);
        let known = map.keyframes.clone();
        for point in map.keyframes.values_mut().flat_map(|keyframe| &mut keyframe.points) {
            point.observations.retain(|observation| known.contains_key(&observation.keyframe));
        }
        map.keyframes.values().for_each(|keyframe| writer.append_keyframe(keyframe).unwrap());
        writer.append_poses(&map).unwrap();
        writer.flush().unwrap();
        let loaded = load_map(&path).unwrap();
        assert!(!loaded.complete);
        assert_eq!(loaded.map, map);
    }
    // The process ends without any destructor.
    std::mem::forget(writer);
    assert_eq!(load_map(&path).unwrap().map, map);
}

/// What is told in deltas, the way an agent does: keyframes first without depth, then moved, then settled and described.
#[test]
fn a_file_that_deltas_are_appended_to_is_the_map_they_make() {
    let folder = Folder::new();
    let path = folder.file("map.mcap");
    let mut whole = sample_map(4);
    first(&mut whole).features = Some(vec![9; 300].into());
    let mut map = Map { keyframes: Default::default(), edges: vec![], frames: vec![], ..whole.clone() };
    let mut writer = MapWriter::create(&path, &sole_agent(&map)).unwrap();
    let mut sequence = 0;
    let mut tell = |map: &mut Map, delta: MapDelta, frames: &[FramePose]| {
        let delta = MapDelta { sequence, ..delta };
        sequence += 1;
        writer.append(&delta, frames).unwrap();
        writer.flush().unwrap();
        map.take_in(delta);
        map.frames.extend_from_slice(frames);
        let (loaded, mut known) = (load_map(&path).unwrap(), map.clone());
        assert!(!loaded.complete);
        // The reader of an unfinished file leaves out what refers to keyframes that are not there.
        let has = |id: &KeyframeId| map.keyframes.contains_key(id);
        known.edges.retain(|edge| has(&edge.from) && has(&edge.to));
        known.frames.retain(|frame| has(&frame.reference));
        for point in known.keyframes.values_mut().flat_map(|keyframe| &mut keyframe.points) {
            point.observations.retain(|observation| has(&observation.keyframe));
        }
        assert!(loaded.map == known);
    };
    let per_keyframe = whole.frames.len() / whole.keyframes.len();
    for (count, keyframe) in whole.keyframes.values().enumerate() {
        let mut bare = keyframe.clone();
        (bare.semi_dense, bare.points, bare.features) = Default::default();
        bare.world_from_keyframe.scale *= 2.0;
        let frames = &whole.frames[per_keyframe * count..per_keyframe * (count + 1)];
        tell(&mut map, MapDelta { added: vec![bare], ..MapDelta::default() }, frames);
    }
    tell(&mut map, MapDelta { edges: Some(whole.edges[1..].to_vec()), ..MapDelta::default() }, &[]);
    for keyframe in whole.keyframes.values() {
        let (id, world_from_keyframe) = (keyframe.id, keyframe.world_from_keyframe);
        let (semi_dense, points) = (keyframe.semi_dense.clone(), keyframe.points.clone());
        let features = keyframe.features.clone();
        let delta = MapDelta {
            moved: vec![Moved { keyframe: id, world_from_keyframe }],
            settled: vec![Settled { keyframe: id, semi_dense, points }],
            described: features.into_iter().map(|features| Described { keyframe: id, features }).collect(),
            ..MapDelta::default()
        };
        tell(&mut map, delta, &[]);
    }
    let size = fs::metadata(&path).unwrap().len();
    let again =
        map.keyframes.values().map(|k| Moved { keyframe: k.id, world_from_keyframe: k.world_from_keyframe });
    tell(&mut map.clone(), MapDelta { moved: again.collect(), ..MapDelta::default() }, &[]);
    assert_eq!(fs::metadata(&path).unwrap().len(), size, "poses that are what they were cost nothing");
    tell(&mut map, MapDelta { edges: Some(whole.edges.clone()), ..MapDelta::default() }, &[]);
    assert!(map == whole);
    for value in ["0.25", "-0.5"] {
        let provenance = [("lens".to_owned(), value.to_owned())].into();
        tell(&mut map, MapDelta { provenance, ..MapDelta::default() }, &[]);
    }
    assert_eq!(sole_agent(&map).provenance["lens"], "-0.5");
    let removed = map.keyframes.keys().next_back().copied().into_iter().collect();
    tell(&mut map, MapDelta { removed, ..MapDelta::default() }, &[]);
    assert_eq!(map.keyframes.len() + 1, whole.keyframes.len());
}

#[test]
fn keyframes_taken_out_of_the_map_are_taken_out_of_the_file() {
    let folder = Folder::new();
    let path = folder.file("map.mcap");
    let mut map = sample_map(4);
    let mut writer = MapWriter::create(&path, &sole_agent(&map)).unwrap();
    map.keyframes.values().for_each(|keyframe| writer.append_keyframe(keyframe).unwrap());
    writer.append_poses(&map).unwrap();
    map.keyframes.remove(&KeyframeId(4));
    map.edges.truncate(1);
    map.frames.truncate(7);
    writer.append_poses(&map).unwrap();
    writer.finish().unwrap();
    let loaded = load_map(&path).unwrap();
    assert!(loaded.complete);
    assert_eq!(loaded.map, map);
}

#[test]
fn a_writer_may_live_in_its_own_thread() {
    fn assert_send<T: Send>() {}
    assert_send::<MapWriter>();
}

#[test]
fn unchanged_poses_cost_nothing() {
    let folder = Folder::new();
    let path = folder.file("map.mcap");
    let map = sample_map(3);
    let mut writer = MapWriter::create(&path, &sole_agent(&map)).unwrap();
    map.keyframes.values().for_each(|keyframe| writer.append_keyframe(keyframe).unwrap());
    writer.append_poses(&map).unwrap();
    writer.flush().unwrap();
    let size = fs::metadata(&path).unwrap().len();
    writer.append_poses(&map).unwrap();
    writer.flush().unwrap();
    assert_eq!(fs::metadata(&path).unwrap().len(), size);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_named() {
    let map = sample_map(2);
    let full = std::path::Path::new("/dev/full");
    let error = save_map(full, &map).unwrap_err();
    assert!(matches!(error, MapError::Write { .. }) && error.to_string().contains("/dev/full"), "{error}");
    let error = MapWriter::create(full, &sole_agent(&map)).err().unwrap();
    assert!(error.to_string().contains("/dev/full"), "{error}");
}
