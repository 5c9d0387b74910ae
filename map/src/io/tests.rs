//! What a map file survives.

mod damage;
mod growing;

use super::*;
use crate::test_support::{Numbers, lidar_map, sample_map, united};
use crate::{
    AgentId, AgentInfo, Described, FramePose, Identity, Keyframe, KeyframeId, Map, MapDelta, MapError, Moved,
    Sensor, Settled,
};
use geometry::{Swap, Swapped};
use std::fs;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A folder that goes away with the test.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn file(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Loads a file of these bytes.
    fn load(&self, bytes: &[u8]) -> Result<LoadedMap, MapError> {
        let path = self.file("bytes.mcap");
        fs::write(&path, bytes).unwrap();
        load_map(&path)
    }

    /// The bytes of a map's file.
    fn bytes(&self, map: &Map) -> Vec<u8> {
        let path = self.file("map.mcap");
        save_map(&path, map).unwrap();
        fs::read(&path).unwrap()
    }
}

/// The map's first keyframe.
fn first(map: &mut Map) -> &mut Keyframe {
    map.keyframes.values_mut().next().unwrap()
}

/// The map's first agent.
fn agent(map: &mut Map) -> &mut AgentInfo {
    map.agents.values_mut().next().unwrap()
}

/// What a map's only agent is.
fn sole_agent(map: &Map) -> AgentInfo {
    map.agents[&AgentId::default()].clone()
}

/// Counts the bytes that it is offered and has no room for any.
#[derive(Default)]
struct Full {
    offered: AtomicUsize,
}

impl Swap for Full {
    fn keep(&self, bytes: &[u8]) -> Option<Arc<dyn Swapped>> {
        self.offered.fetch_add(bytes.len(), Ordering::Relaxed);
        None
    }
}

#[test]
fn a_map_beyond_memory_is_offered_to_what_keeps_it_while_it_is_read() {
    let folder = Folder::new();
    // More than are decoded together.
    let (mut map, path) = (sample_map(80), folder.file("map.mcap"));
    let described = map.keyframes.values_mut().filter(|keyframe| keyframe.features.is_some());
    described.for_each(|keyframe| keyframe.words = Some(vec![3, 1, 4, 1].into()));
    save_map(&path, &map).unwrap();
    let full = Full::default();
    assert_eq!(load_map_swapped(&path, &full).unwrap().map, map);
    let bytes = |keyframe: &Keyframe| {
        let described = [&keyframe.features, &keyframe.words].into_iter().flatten();
        let described: usize = described.map(|bytes| bytes.len()).sum();
        keyframe.image.data().len() + 12 * keyframe.semi_dense.len() + described
    };
    assert_eq!(full.offered.into_inner(), map.keyframes.values().map(bytes).sum::<usize>());
}

#[test]
fn loads_back_equal_and_saves_the_same_bytes() {
    let folder = Folder::new();
    for keyframes in [0, 1, 6] {
        let map = sample_map(keyframes);
        let bytes = folder.bytes(&map);
        let loaded = folder.load(&bytes).unwrap();
        assert!(loaded.complete, "{:?}", loaded.warnings);
        assert_eq!(loaded.map, map);
        assert_eq!(folder.bytes(&loaded.map), bytes);
    }
}

#[test]
fn several_agents_load_back_equal_and_come_apart() {
    let folder = Folder::new();
    let map = united();
    let bytes = folder.bytes(&map);
    let loaded = folder.load(&bytes).unwrap();
    assert!(loaded.complete, "{:?}", loaded.warnings);
    assert_eq!(loaded.map, map);
    assert_eq!(folder.bytes(&loaded.map), bytes);
    for own in loaded.map.split() {
        let loaded = folder.load(&folder.bytes(&own)).unwrap();
        assert_eq!(loaded.map, own);
    }
    assert_eq!(folder.bytes(&loaded.map.split()[0]), folder.bytes(&sample_map(3)));
}

#[test]
fn a_lidars_map_loads_back_equal_alone_and_together_with_a_cameras() {
    let folder = Folder::new();
    let lidar = lidar_map(3);
    let bytes = folder.bytes(&lidar);
    let loaded = folder.load(&bytes).unwrap();
    assert!(loaded.complete, "{:?}", loaded.warnings);
    assert_eq!(loaded.map, lidar);
    assert_eq!(folder.bytes(&loaded.map), bytes);
    let both = Map::unite(vec![sample_map(2), lidar.clone()]).unwrap();
    let loaded = folder.load(&folder.bytes(&both)).unwrap().map;
    assert_eq!(loaded, both);
    assert_eq!(loaded.split(), [sample_map(2), lidar.clone()]);
    assert_eq!(sensors_of(folder.file("bytes.mcap")).unwrap().len(), 2);
    let twice = Map::can_unite(&[&lidar, &loaded]).unwrap_err();
    assert!(matches!(twice, MapError::SameMapTwice { .. }), "{twice}");
}

#[test]
fn a_lidars_run_that_is_killed_leaves_what_was_flushed() {
    let folder = Folder::new();
    let path = folder.file("map.mcap");
    let map = lidar_map(2);
    let mut writer = MapWriter::create(&path, &sole_agent(&map)).unwrap();
    map.keyframes.values().for_each(|keyframe| writer.append_keyframe(keyframe).unwrap());
    writer.append_poses(&map).unwrap();
    writer.flush().unwrap();
    std::mem::forget(writer);
    let loaded = load_map(&path).unwrap();
    assert!(!loaded.complete);
    assert_eq!(loaded.map, map);
}

#[test]
fn a_lidars_keyframe_without_a_scan_is_refused() {
    let mut map = lidar_map(2);
    first(&mut map).scan = None;
    let error = save_map(Folder::new().file("map.mcap"), &map).unwrap_err().to_string();
    assert!(error.contains("keyframe 1: it is a LiDAR's and has no scan"), "{error}");
    let error = load_unchecked(&map).unwrap_err().to_string();
    assert!(error.contains("keyframe 1 has no"), "{error}");
}

#[test]
fn viewers_find_each_agent_by_its_name() {
    let topics = |map: &Map| {
        let bytes = Folder::new().bytes(map);
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        let count = |id: u16| summary.stats.as_ref().unwrap().channel_message_counts[&id];
        let found = summary.channels.iter().map(|(id, channel)| (channel.topic.clone(), count(*id)));
        found.collect::<std::collections::BTreeMap<String, u64>>()
    };
    let united = topics(&united());
    assert_eq!([united["/sample/trajectory"], united["/sample-2/trajectory"]], [1, 1]);
    assert_eq!([united["/sample/keyframes/cloud"], united["/other/keyframes/cloud"]], [3, 1]);
    assert_eq!((united["/other/camera/calibration"], united["/tf"]), (1, 1 + 30));
    let own = topics(&sample_map(3));
    assert_eq!([own["/trajectory"], own["/camera/calibration"], own["/keyframes/cloud"]], [1, 1, 3]);
}

#[test]
fn every_bit_of_a_number_comes_back() {
    let folder = Folder::new();
    let mut map = sample_map(1);
    let keyframe = first(&mut map);
    let odd = [f32::MIN_POSITIVE / 3.0, f32::MAX, 1.0 + f32::EPSILON];
    keyframe.semi_dense.inverse_depth[..3].copy_from_slice(&odd);
    keyframe.semi_dense.variance[..3].copy_from_slice(&[0.0, f32::MAX, f32::MIN_POSITIVE]);
    keyframe.points[0].pixel = [-0.0, 1.0 / 3.0];
    // A rotation as it is after many products: not quite of unit length.
    let drifted = keyframe.world_from_keyframe.rotation.into_inner() * (1.0 + 1e-9);
    keyframe.world_from_keyframe.rotation = nalgebra::UnitQuaternion::new_unchecked(drifted);
    let loaded = folder.load(&folder.bytes(&map)).unwrap().map;
    assert_eq!(loaded, map);
    let (loaded, saved) = (&loaded.keyframes[&KeyframeId(1)], &map.keyframes[&KeyframeId(1)]);
    let bits = |keyframe: &Keyframe| {
        keyframe.semi_dense.inverse_depth.iter().map(|d| d.to_bits()).collect::<Vec<_>>()
    };
    assert_eq!(bits(loaded), bits(saved));
    assert_eq!(loaded.points[0].pixel[0].to_bits(), (-0.0f32).to_bits());
    let norm = |keyframe: &Keyframe| keyframe.world_from_keyframe.rotation.quaternion().norm().to_bits();
    assert_eq!(norm(loaded), norm(saved));
}

/// A file that an earlier version of this crate wrote; they are never written anew.
fn kept(name: &str) -> Map {
    let loaded = load_map(PathBuf::from("tests/data").join(name)).unwrap();
    assert!(loaded.complete, "{:?}", loaded.warnings);
    loaded.map
}

/// The map as versions 1 and 2 held it, with the identities that its agents are given when it is read.
fn without_names(mut map: Map) -> Map {
    map.keyframes.values_mut().for_each(|keyframe| keyframe.features = None);
    for (agent, info) in &mut map.agents {
        let first = map.keyframes.values().find(|keyframe| keyframe.agent == *agent).unwrap();
        info.identity = Some(Identity::of_recording(info.camera().unwrap(), first.timestamp, &first.image));
    }
    map
}

#[test]
fn maps_of_earlier_versions_load() {
    assert_eq!(kept("version-2.mcap"), without_names(sample_map(3)));
    assert_eq!(kept("version-2-united.mcap"), without_names(united()));
    let mut first = without_names(sample_map(3));
    agent(&mut first).name = "a folder with an ümlaut".into();
    assert_eq!(kept("version-1.mcap"), first);
}

#[test]
fn an_agent_without_identity_has_one_in_every_map_from_before_there_were() {
    let (own, united) = (kept("version-2.mcap"), kept("version-2-united.mcap"));
    assert_eq!(sole_agent(&own).identity, united.agents[&AgentId(0)].identity);
    let identities: std::collections::BTreeSet<_> =
        united.agents.values().map(|info| info.identity).collect();
    assert_eq!(identities.len(), 3);
    let folder = Folder::new();
    assert_eq!(folder.load(&folder.bytes(&united)).unwrap().map, united);
}

#[test]
fn features_come_back_and_are_written_once() {
    let folder = Folder::new();
    let mut map = sample_map(2);
    first(&mut map).features = Some(vec![9; 3000].into());
    let path = folder.file("growing.mcap");
    let mut writer = MapWriter::create(&path, &sole_agent(&map)).unwrap();
    let bare = Keyframe { features: None, words: None, ..map.keyframes[&KeyframeId(1)].clone() };
    let count = |path: &PathBuf| {
        let file = fs::read(path).unwrap();
        let messages = mcap::MessageStream::new(&file).unwrap().map_while(Result::ok);
        messages.filter(|message| message.channel.topic == FEATURES_TOPIC).count()
    };
    writer.append_keyframe(&bare).unwrap();
    writer.flush().unwrap();
    assert_eq!(
        (count(&path), load_map(&path).unwrap().map.keyframes[&KeyframeId(1)].features.clone()),
        (0, None)
    );
    for _ in 0..2 {
        map.keyframes.values().for_each(|keyframe| writer.append_keyframe(keyframe).unwrap());
    }
    writer.append_poses(&map).unwrap();
    writer.finish().unwrap();
    let loaded = load_map(&path).unwrap();
    assert!(loaded.complete, "{:?}", loaded.warnings);
    assert_eq!((loaded.map.keyframes, count(&path)), (map.keyframes, 1));
}

#[test]
fn the_words_of_features_come_back() {
    let folder = Folder::new();
    let mut map = sample_map(2);
    let keyframe = first(&mut map);
    (keyframe.features, keyframe.words) = (Some(vec![9; 30].into()), Some(vec![1, 2, 3].into()));
    assert_eq!(folder.load(&folder.bytes(&map)).unwrap().map, map);
}

/// Asserts that the map changed by `spoil` is refused with a text that holds `words`.
#[track_caller]
fn assert_refused(spoil: impl FnOnce(&mut Map), words: &str) {
    let folder = Folder::new();
    let mut map = sample_map(2);
    let path = folder.file("map.mcap");
    save_map(&path, &map).unwrap();
    let before = fs::read(&path).unwrap();
    spoil(&mut map);
    let error = save_map(&path, &map).unwrap_err().to_string();
    assert!(error.contains(words) && error.contains("map.mcap"), "{error}");
    assert_eq!(fs::read(&path).unwrap(), before);
}

#[test]
fn contradictions_are_refused_with_their_place() {
    assert_refused(|map| first(map).world_from_keyframe.translation.x = f64::NAN, "keyframe 1: its pose");
    assert_refused(|map| first(map).world_from_keyframe.scale = 0.0, "scale 0");
    assert_refused(|map| first(map).semi_dense.variance.truncate(2), "2 variances");
    assert_refused(|map| *first(map).semi_dense.pixel.last_mut().unwrap() = 24 * 18, "outside of the image");
    assert_refused(|map| first(map).semi_dense.pixel[1] = 0, "ascending");
    assert_refused(|map| first(map).semi_dense.inverse_depth[0] = -1.0, "inverse depth -1");
    assert_refused(|map| first(map).points[1].observations[0].pixel[0] = f32::NAN, "point 1");
    assert_refused(|map| first(map).image = Arc::new(geometry::GrayImage::filled(3, 3, 0)), "3×3");
    assert_refused(|map| map.frames[3].keyframe_from_frame.translation.z = f64::INFINITY, "frame 3");
    assert_refused(|map| map.edges[0].information[(2, 3)] = f64::NAN, "edge from keyframe 1 to 4");
    assert_refused(
        |map| match &mut agent(map).sensor {
            Sensor::Camera(camera) => camera.fx = f64::NAN,
            Sensor::Lidar => unreachable!("the sample has a camera"),
        },
        "camera",
    );
    assert_refused(|map| first(map).scan = Some(Arc::default()), "is a camera's and has a scan");
}

/// Loads what a sink writes without the checks of `save_map`.
fn load_unchecked(map: &Map) -> Result<LoadedMap, MapError> {
    let mut out = std::io::Cursor::new(Vec::new());
    let mut sink = sink::MapSink::create(&mut out, &about::About::of(map)).unwrap();
    map.keyframes.values().for_each(|keyframe| sink.keyframe(keyframe, None).unwrap());
    sink.graph(map).unwrap();
    sink.finish().unwrap();
    drop(sink);
    Folder::new().load(&out.into_inner())
}

#[test]
fn a_loaded_map_is_checked_too() {
    type Spoil = fn(&mut Map);
    let spoil: [(Spoil, &str); 5] = [
        (|map| first(map).world_from_keyframe.translation.x = f64::NAN, "not finite"),
        (|map| first(map).semi_dense.variance.truncate(2), "2 variances"),
        (|map| *first(map).semi_dense.pixel.last_mut().unwrap() = 24 * 18, "outside of the image"),
        (|map| map.frames[3].timestamp = f64::NAN, "time stamp"),
        (|map| first(map).image = Arc::new(geometry::GrayImage::filled(3, 3, 0)), "3×3"),
    ];
    for (spoil, words) in spoil {
        let mut map = sample_map(2);
        spoil(&mut map);
        let error = load_unchecked(&map).unwrap_err();
        assert!(matches!(error, MapError::Invalid { .. }) && error.to_string().contains(words), "{error}");
    }
}
