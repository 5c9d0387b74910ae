use super::*;
use crate::lidar::{LidarMergeOptions, merge_maps};
use geometry::{GrayImage, Se3, Sim3};
use loopbox_tests::lidar::{HALL, sweep};
use map::{AgentInfo, Identity, Keyframe, KeyframeId, Map, Scan, Sensor, Uuid};
use nalgebra::Vector3;
use sources::Stop;
use std::collections::BTreeMap;

/// The map of a LiDAR with a keyframe a metre along a lane of the hall.
fn along(number: u8, from: f64) -> Map {
    let at = |x: f64, y: f64| Se3::new(Default::default(), Vector3::new(x, y, 0.0));
    let keyframe = |k: u32| {
        let (x, image) = (f64::from(k), Arc::new(GrayImage::filled(0, 0, 0)));
        let rays = sweep(&HALL, |_| at(from + x, 5.0), x);
        let scan = Some(Arc::new(Scan::new(rays.iter().map(|ray| ray.point))));
        let pose = Sim3::from(at(x, 0.0));
        Keyframe { scan, ..Keyframe::of_image(KeyframeId(k), x, 0, pose, image) }
    };
    let identity = Some(Identity { uuid: Uuid::from_u128(number.into()), epoch: 0 });
    let mut map = Map::of(AgentInfo { identity, ..AgentInfo::new(format!("m{number}"), Sensor::Lidar) });
    map.keyframes = (0..5).map(|k| (KeyframeId(k), keyframe(k))).collect();
    map
}

/// Three maps, of which every two share a part of the lane.
fn maps(folder: &Path) -> Vec<PathBuf> {
    let map = |number: u8| {
        let path = folder.join(format!("m{number}.mcap"));
        map::save_map(&path, &along(number, -8.0 + f64::from(number))).unwrap();
        path
    };
    (0..3).map(map).collect()
}

fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries
        .map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), fs::read(path).unwrap()))
        .collect()
}

#[test]
fn a_map_is_put_once_and_called_by_its_hash() {
    let room = tempfile::tempdir().unwrap();
    let store = Store::at(&room.path().join("store")).unwrap();
    let file = room.path().join("a.mcap");
    fs::write(&file, b"abc").unwrap();
    let digests = [store.put_map(&file).unwrap(), store.put_map(&file).unwrap()];
    assert_eq!(digests[0], digests[1]);
    let name = format!("maps/{}.mcap", MapDigest::of(&file).unwrap().as_str());
    assert_eq!(store.maps().unwrap(), std::slice::from_ref(&name));
    assert_eq!(fs::read(store.file(&name, &|_| {}).unwrap()).unwrap(), b"abc");
    let missing = store.put_map(&room.path().join("none.mcap")).unwrap_err().to_string();
    assert!(missing.contains("none.mcap: cannot be read"), "{missing}");
}

#[test]
fn workers_find_what_a_merge_of_lidars_keeps_and_nothing_is_left_for_it() {
    let room = tempfile::tempdir().unwrap();
    let (paths, place) = (maps(room.path()), room.path().join("store"));
    let store = Store::at(&place).unwrap();
    paths.iter().for_each(|path| drop(store.put_map(path).unwrap()));
    let options = WorkOptions { store: place.clone(), once: true, ..WorkOptions::default() };
    let both: Vec<Work> = std::thread::scope(|scope| {
        let workers = [0, 1].map(|_| scope.spawn(|| work(&options, &Stop::default(), &()).unwrap()));
        workers.into_iter().map(|worker| worker.join().unwrap()).collect()
    });
    // A pair that both took at once is there once.
    let asked: usize = both.iter().map(|work| work.asked).sum();
    assert!(asked >= 3 && both.iter().all(|work| work.left_out.is_empty()), "{both:?}");
    let reference = room.path().join("reference");
    let verdicts = Some(reference.clone());
    let merge = LidarMergeOptions { verdicts, ..LidarMergeOptions::to(room.path().join("out")) };
    merge_maps(&paths, &merge, &Stop::default(), &mut |_| {}).unwrap();
    assert!(files(&reference).len() == 3 && files(&place.join("verdicts")) == files(&reference));
    assert_eq!(work(&options, &Stop::default(), &()).unwrap(), Work::default());
}

#[test]
fn maps_that_cannot_be_asked_are_left_out_and_named_and_the_others_are_asked() {
    let room = tempfile::tempdir().unwrap();
    let (paths, place) = (maps(room.path()), room.path().join("store"));
    let store = Store::at(&place).unwrap();
    store.put_map(&paths[0]).unwrap();
    // Copied by hand, one of another name and one in a folder.
    fs::copy(&paths[1], place.join("maps/other.mcap")).unwrap();
    fs::create_dir(place.join("maps/third")).unwrap();
    fs::copy(&paths[2], place.join("maps/third/map.mcap")).unwrap();
    fs::write(place.join("maps/text.mcap"), "no map").unwrap();
    let rotten = format!("{}.mcap", "a".repeat(64));
    fs::copy(&paths[1], place.join("maps").join(&rotten)).unwrap();
    let options = WorkOptions { store: place.clone(), once: true, ..WorkOptions::default() };
    let done = work(&options, &Stop::default(), &()).unwrap();
    assert_eq!((done.asked, done.left_out.len()), (3, 2), "{done:?}");
    let all = done.left_out.join("\n");
    assert!(all.contains("text.mcap") && all.contains(&rotten) && all.contains("delete it"), "{all}");
    assert_eq!(files(&place.join("verdicts")).len(), 3);
}

#[test]
fn a_store_that_cannot_be_written_ends_it_and_is_named() {
    let room = tempfile::tempdir().unwrap();
    let (paths, place) = (maps(room.path()), room.path().join("store"));
    let store = Store::at(&place).unwrap();
    paths.iter().for_each(|path| drop(store.put_map(path).unwrap()));
    fs::write(place.join("verdicts"), "in the way").unwrap();
    let options = WorkOptions { store: place.clone(), once: true, ..WorkOptions::default() };
    let refused = work(&options, &Stop::default(), &()).unwrap_err().to_string();
    assert!(refused.contains("verdicts"), "{refused}");
}
