//! `loopbox info` and `loopbox export` on a map of several agents.

mod common;

use common::{arg, assert_refused, loopbox, stderr, stdout};
use geometry::{GrayImage, Pinhole, Se3, Sim3};
use map::{AgentId, AgentInfo, FramePose, Keyframe, KeyframeId, Map, SemiDense};
use std::sync::Arc;

/// A map of two keyframes with a depth and a frame each, of images `width` pixels wide.
fn small_map(name: &str, width: usize) -> Map {
    let camera = Pinhole { width, height: 8, fx: 9.0, fy: 9.0, cx: 4.0, cy: 3.5 };
    let mut map = Map::of(AgentInfo::new(name, camera));
    for id in (0..2).map(KeyframeId) {
        let x = f64::from(id.0);
        let keyframe = Keyframe {
            id,
            agent: AgentId::default(),
            timestamp: x,
            frame_index: id.0.into(),
            world_from_keyframe: Sim3::new(Default::default(), [x, 0.0, 0.0].into(), 1.0),
            image: Arc::new(GrayImage::filled(width, 8, width as u8)),
            color: None,
            scan: None,
            semi_dense: SemiDense {
                pixel: vec![7].into(),
                inverse_depth: vec![0.5].into(),
                variance: vec![1e-6].into(),
            }
            .into(),
            points: Vec::new(),
            features: None,
            words: None,
        };
        map.keyframes.insert(id, keyframe);
        map.frames.push(FramePose {
            timestamp: x,
            frame_index: id.0.into(),
            reference: id,
            keyframe_from_frame: Se3::identity(),
        });
    }
    map
}

#[test]
fn info_and_exports_tell_agents_apart() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let file = path("map.mcap");
    let map = Map::unite(vec![small_map("yard", 10), small_map("the street", 12)]).unwrap();
    map::save_map(&file, &map).unwrap();

    let json = loopbox(&["info", arg(&file), "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!((&json["agents"][1]["name"], &json["keyframes"]), (&"the street".into(), &4.into()));
    let reported = stdout(&loopbox(&["info", arg(&file)]));
    let (_, street) = reported.split_once("agent        the street\n").expect("the second agent is named");
    let (identity, rest) = street.split_once('\n').expect("more is told of it");
    assert!(identity.starts_with("identity     ") && rest.starts_with("images       12×8"), "{reported}");

    let (tum, ply, again) = (path("track.txt"), path("cloud.ply"), path("again.mcap"));
    let output =
        loopbox(&["export", arg(&file), "--tum", arg(&tum), "--ply", arg(&ply), "--mcap", arg(&again)]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(!tum.exists());
    for name in ["track-yard.txt", "track-the_street.txt"] {
        let text = std::fs::read_to_string(path(name)).unwrap();
        assert_eq!(text.lines().filter(|line| !line.starts_with('#')).count(), 2, "{name}");
    }
    let cloud = std::fs::read(&ply).unwrap();
    assert!(String::from_utf8_lossy(&cloud).contains("element vertex 4\n"));
    assert!(String::from_utf8_lossy(&cloud).contains("property ushort agent\n"));
    assert_eq!(std::fs::read(&again).unwrap(), std::fs::read(&file).unwrap());
}

#[test]
fn depth_is_measured_of_one_agent() {
    let folder = tempfile::tempdir().unwrap();
    let (file, tum) = (folder.path().join("map.mcap"), folder.path().join("track.txt"));
    map::save_map(&file, &Map::unite(vec![small_map("a", 10), small_map("b", 12)]).unwrap()).unwrap();
    std::fs::write(&tum, "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n2 1 1 0 0 0 0 1\n").unwrap();
    let of_tum = ["eval", arg(&tum), "--gt", arg(&tum), "--frames", arg(&tum)];
    let depth = ["--map", arg(&file), "--depth", arg(folder.path())];
    assert_refused(&[&of_tum[..], &depth].concat(), &["holds 2 agents"]);
}
