//! `loopbox import`: maps of posed images from elsewhere, and what becomes of them.

use crate::support::{Case, Runs, arg, loopbox};
use geometry::{Pinhole, Se3};
use image::{ImageBuffer, Luma};
use loopbox_tests::{Recording, World, render, trajectory};
use map::{KeyframeId, load_map};
use nalgebra::Vector3;
use serde_json::Value;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

const CAMERA: Pinhole = Recording::SMALL_CAMERA;

/// Poses in the yard of the runs, aside of their ways, where both were.
fn path() -> Vec<Se3> {
    let aside = Vector3::new(0.0, 0.05, 0.15);
    let all = trajectory::sideways(180, 8.1);
    all[66..120].iter().step_by(6).map(|pose| Se3::new(pose.rotation, pose.translation + aside)).collect()
}

/// Writes image and depth image of a pose; a metre is `per_metre` there.
fn write_pair(image: &Path, depth: &Path, pose: &Se3, per_metre: f32) {
    let (grey, depths) = render(&World::yard(1), &CAMERA, pose);
    let (width, height) = (CAMERA.width as u32, CAMERA.height as u32);
    let grey = ImageBuffer::<Luma<u8>, _>::from_raw(width, height, grey.data().to_vec()).unwrap();
    grey.save(image).unwrap();
    let step =
        |&inverse: &f32| if inverse > 0.0 { (per_metre / inverse).round().min(65535.0) as u16 } else { 0 };
    let values: Vec<u16> = depths.data().iter().map(step).collect();
    ImageBuffer::<Luma<u16>, _>::from_raw(width, height, values).unwrap().save(depth).unwrap();
}

/// A folder in the layout of TUM RGB-D.
fn tum(case: &Case) -> PathBuf {
    let folder = case.path("tum");
    let (mut rgb, mut depth, mut poses) = (String::from("# color\n"), String::new(), String::new());
    for name in ["rgb", "depth"] {
        fs::create_dir_all(folder.join(name)).unwrap();
    }
    for (i, pose) in path().iter().enumerate() {
        let time = 100.0 + 0.2 * i as f64;
        writeln!(rgb, "{time:.3} rgb/{i}.png").unwrap();
        writeln!(depth, "{:.3} depth/{i}.png", time + 0.01).unwrap();
        let numbers: Vec<String> = pose.to_tum().iter().map(f64::to_string).collect();
        writeln!(poses, "{:.3} {}", time - 0.01, numbers.join(" ")).unwrap();
        write_pair(
            &folder.join(format!("rgb/{i}.png")),
            &folder.join(format!("depth/{i}.png")),
            pose,
            5000.0,
        );
    }
    let yaml = Recording { camera: CAMERA, shots: Vec::new() }.camera_yaml();
    for (name, text) in
        [("rgb.txt", rgb), ("depth.txt", depth), ("groundtruth.txt", poses), ("camera.yaml", yaml)]
    {
        fs::write(folder.join(name), text).unwrap();
    }
    folder
}

/// A folder in the layout of 7-Scenes, without a calibration.
fn seven_scenes(case: &Case) -> PathBuf {
    let folder = case.path("scene");
    fs::create_dir_all(&folder).unwrap();
    for (i, pose) in path().iter().take(3).enumerate() {
        let name = |end: &str| folder.join(format!("frame-{i:06}.{end}"));
        write_pair(&name("color.png"), &name("depth.png"), pose, 1000.0);
        let matrix = pose.to_matrix();
        let row = |r: usize| (0..4).map(|c| matrix[(r, c)].to_string()).collect::<Vec<_>>().join("\t ");
        fs::write(name("pose.txt"), (0..4).map(|r| row(r) + "\n").collect::<String>()).unwrap();
    }
    folder
}

fn import(folder: &Path, map: &Path, more: &[&str]) -> crate::support::Outcome {
    loopbox(&[&["import", arg(folder), "--out", arg(map)], more].concat())
}

/// Poses of an RGB-D camera are a map in metres; an agent of ours that was there gets its place and its unit from it.
#[test]
fn an_imported_map_is_merged_with_one_of_ours() {
    let (runs, case) = (Runs::get(), Case::new());
    let (folder, map) = (tum(&case), case.path("tum.mcap"));
    import(&folder, &map, &[]).assert_success();
    let made = load_map(&map).unwrap().map;
    assert!(made.is_metric() && made.keyframes.len() == path().len());
    for (keyframe, pose) in made.keyframes.values().zip(path()) {
        let off = keyframe.world_from_keyframe.rigid() * pose.inverse();
        assert!(off.log().norm() < 1e-6 && keyframe.features.is_some());
        assert!(keyframe.semi_dense.len() > 1000, "{}", keyframe.semi_dense.len());
    }
    case.merge(&[&runs.run("right"), &map]).assert_success();
    let united = load_map(case.out().join("map.mcap")).unwrap().map;
    assert!(united.is_metric());
    let truth = runs.truth("right");
    let right = case.out().join("trajectory-right.txt");
    let outcome = loopbox(&["eval", arg(&right), "--gt", arg(&truth), "--align", "none", "--json"]);
    let found: Value = serde_json::from_str(&outcome.stdout).unwrap();
    assert!(found["ate"]["rmse"].as_f64().unwrap() < 0.1, "{found:#}");
}

#[test]
fn features_can_be_left_for_the_merge_and_images_left_out() {
    let case = Case::new();
    let (folder, map) = (tum(&case), case.path("some.mcap"));
    import(&folder, &map, &["--features", "later", "--every", "3"]).assert_success();
    let made = load_map(&map).unwrap().map;
    assert_eq!(made.keyframes.len(), path().len().div_ceil(3));
    assert!(made.keyframes.values().all(|keyframe| keyframe.features.is_none()));
    assert_eq!(made.keyframes[&KeyframeId(1)].frame_index, 3);
    assert_eq!(made.edges.len(), made.keyframes.len() - 1);
    // What is there is not lost, but where one wants so.
    import(&folder, &map, &[]).assert_refused(&["some.mcap", "--force"]);
    import(&folder, &map, &["--force"]).assert_success();
}

#[test]
fn scenes_need_a_calibration_and_all_three_files() {
    let case = Case::new();
    let (folder, map) = (seven_scenes(&case), case.path("scene.mcap"));
    import(&folder, &map, &[]).assert_refused(&["scene", "--calib"]);
    let yaml = Recording { camera: CAMERA, shots: Vec::new() }.camera_yaml();
    let calib = case.file("camera.yaml", yaml.as_bytes());
    import(&folder, &map, &["--calib", arg(&calib)]).assert_success();
    let made = load_map(&map).unwrap().map;
    assert_eq!(made.keyframes.len(), 3);
    let pose = made.keyframes[&KeyframeId(2)].world_from_keyframe.rigid();
    assert!((pose * path()[2].inverse()).log().norm() < 1e-6);
    // Where tracking was lost, 7-Scenes' poses are no numbers.
    let lost = folder.join("frame-000001.pose.txt");
    fs::write(&lost, "nan nan nan nan\n".repeat(4)).unwrap();
    let outcome = import(&folder, &map, &["--calib", arg(&calib), "--force"]);
    outcome.assert_success();
    assert!(outcome.stderr.contains("1 of 3 images"), "{outcome:#?}");
    let before = fs::read(&map).unwrap();
    fs::write(&lost, "1 0 0 0 0 1 0\n").unwrap();
    import(&folder, &map, &["--calib", arg(&calib), "--force"])
        .assert_refused(&["frame-000001.pose.txt", "4×4"]);
    fs::remove_file(&lost).unwrap();
    let outcome = import(&folder, &map, &["--calib", arg(&calib), "--force"]);
    outcome.assert_refused(&["frame-000001.pose.txt", "pose", "missing"]);
    assert_eq!(fs::read(&map).unwrap(), before, "the map that was there stays");
}

#[test]
fn what_does_not_fit_is_named() {
    let case = Case::new();
    let (folder, map) = (tum(&case), case.path("map.mcap"));
    let depth = folder.join("depth/4.png");
    let whole = fs::read(&depth).unwrap();
    fs::write(&depth, &whole[..whole.len() / 2]).unwrap();
    import(&folder, &map, &[]).assert_refused(&["depth/4.png"]);
    ImageBuffer::<Luma<u16>, _>::new(160, 120).save(&depth).unwrap();
    import(&folder, &map, &[]).assert_refused(&["depth/4.png", "160×120", "320×240"]);
    ImageBuffer::<Luma<u8>, _>::new(320, 240).save(&depth).unwrap();
    import(&folder, &map, &[]).assert_refused(&["depth/4.png", "16-bit"]);
    fs::write(&depth, &whole).unwrap();
    // Poses of another clock.
    fs::write(folder.join("groundtruth.txt"), "5 0 0 0 0 0 0 1\n6 0 0 0 0 0 0 1\n").unwrap();
    import(&folder, &map, &[]).assert_refused(&["tum", "without pose: 9", "one clock"]);
    fs::remove_file(folder.join("rgb.txt")).unwrap();
    import(&folder, &map, &[]).assert_refused(&["tum", "no known layout", "hint"]);
    assert!(!map.exists());
}

/// A map of ours, exported as a COLMAP project and read again: its images, as an ideal camera would have taken them, at the same places, and
/// their points.
#[test]
fn a_colmap_model_comes_back() {
    let (runs, case) = (Runs::get(), Case::new());
    let (folder, map) = (case.path("colmap"), case.path("back.mcap"));
    loopbox(&["export", arg(&runs.run("left")), "--colmap", arg(&folder)]).assert_success();
    import(&folder, &map, &[]).assert_success();
    let (own, back) = (runs.map("left"), load_map(&map).unwrap().map);
    assert!(!back.is_metric());
    assert_eq!(back.keyframes.len(), own.keyframes.len());
    for (keyframe, back) in own.keyframes.values().zip(back.keyframes.values()) {
        let off = keyframe.world_from_keyframe.rigid() * back.world_from_keyframe.rigid().inverse();
        // What takes a model in knows pinhole cameras.
        let image = own.rectified(keyframe).map_or(keyframe.image.clone(), |ideal| ideal.keyframe.image);
        assert!(off.log().norm() < 1e-6 && image == back.image);
    }
    let seen = |map: &map::Map| -> usize {
        let points = map.keyframes.values().flat_map(|keyframe| &keyframe.points);
        points.filter(|point| !point.observations.is_empty()).count()
    };
    assert!(
        seen(&back) > 100 && seen(&back) as f64 > 0.9 * seen(&own) as f64,
        "{} of {}",
        seen(&back),
        seen(&own)
    );
    let images = folder.join("sparse/0/images.txt");
    let text = fs::read_to_string(&images).unwrap();
    let first = text.lines().nth(1).unwrap();
    let without: String = text.replacen(first, &first.split(' ').take(5).collect::<Vec<_>>().join(" "), 1);
    fs::write(&images, without).unwrap();
    import(&folder, &map, &["--force"]).assert_refused(&["images.txt", "line 2", "pose"]);
    fs::write(&images, &text).unwrap();
    let picture = folder.join("images").join(first.split(' ').next_back().unwrap());
    fs::remove_file(&picture).unwrap();
    import(&folder, &map, &["--force"])
        .assert_refused(&[picture.file_name().unwrap().to_str().unwrap(), "missing"]);
}
