use super::*;
use crate::lidar::merging::LidarMergeParams;
use crate::lidar::merging::verdicts::lidar_key;
use crate::merging::MergingParams;
use crate::merging::verdicts::camera_key;
use std::fs;

struct Room {
    folder: tempfile::TempDir,
}

impl Room {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    fn map(&self, name: &str, content: &[u8]) -> MapDigest {
        let file = self.folder.path().join(name);
        fs::write(&file, content).unwrap();
        MapDigest::of(&file).unwrap()
    }

    fn verdicts(&self) -> Verdicts {
        Verdicts::at(&self.folder.path().join("verdicts")).unwrap()
    }

    /// The file of a verdict among these.
    fn file(&self, key: &VerdictKey) -> PathBuf {
        self.folder.path().join("verdicts").join(key.object())
    }
}

#[test]
fn a_map_is_called_by_what_its_file_holds() {
    let room = Room::new();
    // Of FIPS 180-2, appendix B.1.
    let abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
    assert_eq!(room.map("a.mcap", b"abc").as_str(), abc);
    assert_eq!(room.map("b.mcap", b"abc").as_str(), abc);
    assert_ne!(room.map("c.mcap", b"abd").as_str(), abc);
    assert!(MapDigest::of(&room.folder.path().join("none")).unwrap_err().to_string().contains("none"));
}

#[test]
fn a_key_depends_on_maps_and_parameters_and_not_on_the_order() {
    let room = Room::new();
    let [a, b, c] = ["a", "b", "c"].map(|name| room.map(name, name.as_bytes()));
    let usual = MergingParams::default();
    let key = |x: &MapDigest, y: &MapDigest, params: &MergingParams| camera_key([x, y], params);
    assert_eq!(key(&a, &b, &usual), key(&b, &a, &usual));
    let mut longer = usual.clone();
    longer.further.place.prior.days_apart = 3.0;
    let of_lidars = lidar_key([&a, &b], &LidarMergeParams::default());
    let keys = [key(&a, &b, &usual), key(&a, &c, &usual), key(&a, &b, &longer), of_lidars];
    for (number, one) in keys.iter().enumerate() {
        assert!(keys[..number].iter().all(|other| other != one), "{keys:?}");
    }
    // What becomes of many pairs together is no part of a verdict.
    assert_eq!(key(&a, &b, &usual), key(&a, &b, &MergingParams { joint: !usual.joint, ..usual }));
}

#[test]
fn the_first_verdict_stays_and_comes_back_with_every_bit() {
    let room = Room::new();
    let [a, b] = ["a", "b"].map(|name| room.map(name, name.as_bytes()));
    let key = camera_key([&a, &b], &MergingParams::default());
    let verdicts = room.verdicts();
    assert!(verdicts.get::<Vec<f64>>(&key).unwrap().is_none());
    let numbers = [0.1, -0.0, f64::NAN, f64::INFINITY, f64::MIN_POSITIVE / 3.0];
    verdicts.put(&key, [&b, &a], &numbers.to_vec()).unwrap();
    verdicts.put(&key, [&a, &b], &vec![1.0]).unwrap();
    let found = verdicts.get::<Vec<f64>>(&key).unwrap().unwrap();
    assert_eq!(found.maps, [b, a]);
    assert_eq!(found.verdict.iter().map(|v| v.to_bits()).collect::<Vec<_>>(), numbers.map(f64::to_bits));
    assert_eq!(fs::read_dir(room.file(&key).parent().unwrap()).unwrap().count(), 1);
}

#[test]
fn a_file_that_is_no_verdict_on_the_maps_is_named() {
    let room = Room::new();
    let [a, b, c] = ["a", "b", "c"].map(|name| room.map(name, name.as_bytes()));
    let of = |x: &MapDigest, y: &MapDigest| camera_key([x, y], &MergingParams::default());
    let verdicts = room.verdicts();
    verdicts.put(&of(&a, &b), [&a, &b], &vec![1.0]).unwrap();
    let whole = fs::read(room.file(&of(&a, &b))).unwrap();
    for wrong in [&whole[..], &whole[..whole.len() - 1], b"text"] {
        fs::write(room.file(&of(&a, &c)), wrong).unwrap();
        let refused = verdicts.get::<Vec<f64>>(&of(&a, &c)).unwrap_err().to_string();
        let name = room.file(&of(&a, &c)).display().to_string();
        assert!(refused.contains(&name) && refused.contains("delete it"), "{refused}");
    }
}
