//! Common maps of LiDARs as manifests, which grow.

use crate::Hall;
use loopbox_tests::lidar::{HALL, walk, write_recording};
use std::fs;

/// Only pairs with the new map are compared, and what comes of it is what comes of all at once.
#[test]
fn a_manifest_of_lidars_grows_by_what_is_new() {
    let hall = Hall::new();
    let (pose, duration) = walk(&[[-8.0, 5.0], [1.0, 4.5], [5.0, 5.5]]);
    write_recording(&hall.at("c"), &HALL, pose, duration).unwrap();
    for name in ["a", "b", "c"] {
        hall.run(0, &format!("run @{name} --out @out/{name} --quiet"));
    }
    let names = |folder: &str| {
        let files = fs::read_dir(hall.at(folder)).unwrap();
        let mut names: Vec<_> = files.map(|file| file.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    };
    let content = |folder: &str| {
        let mut content = hall.json(&format!("out/{folder}/manifest.json"));
        assert!(content.as_object_mut().unwrap().remove("verdicts").is_some());
        content
    };
    let exported = |map: &str| {
        hall.run(0, &format!("export @{map} --mcap @exported.mcap"));
        fs::read(hall.at("exported.mcap")).unwrap()
    };
    let (printed, _) = hall.run(0, "merge @out/a @out/b --out @out/two --no-map");
    assert!(printed.contains("manifest.json: a, b\n"), "{printed}");
    assert_eq!(
        (names("out/two").join(" "), names("out/two/verdicts").len()),
        ("manifest.json verdicts".into(), 1)
    );
    let (_, told) = hall.run(0, "merge @out/two @out/c --out @out/three --no-map");
    let compared: Vec<_> = told.lines().filter(|line| line.starts_with("comparing")).collect();
    assert_eq!(compared, ["comparing a and c", "comparing b and c"], "{told}");
    assert_eq!(names("out/two/verdicts").len(), 3);
    hall.run(0, "merge @out/a @out/b @out/c --out @out/all --quiet");
    let whole = fs::read(hall.at("out/all/map.mcap")).unwrap();
    assert_eq!(content("three"), content("all"));
    assert!(exported("out/three") == whole && exported("out/all/manifest.json") == whole);
    // All that a merge writes is made of it.
    let (_, told) = hall.run(0, "merge @out/three --out @out/made");
    assert!(!told.contains("comparing"), "{told}");
    for file in names("out/all").iter().filter(|name| name.contains('.') && !name.ends_with("json")) {
        let [made, all] =
            ["made", "all"].map(|folder| fs::read(hall.at("out").join(folder).join(file)).unwrap());
        assert!(made == all || file == "report.html", "{file}");
    }
    let (printed, _) = hall.run(0, "info @out/three");
    assert!(printed.contains("agents       3") && printed.contains("sensor       LiDAR"), "{printed}");
    hall.run(0, "unmerge @out/three --out @out/apart");
    assert!(
        fs::read(hall.at("out/apart/c/map.mcap")).unwrap() == fs::read(hall.at("out/c/map.mcap")).unwrap()
    );
    hall.run(0, "merge @out/three --without c --no-map --out @out/rest");
    assert_eq!(content("rest"), content("two"));
    // A common map of LiDARs among the maps is one file of several agents.
    hall.run(0, "merge @out/a @out/b --out @out/ab --quiet");
    hall.run(0, "merge @out/ab @out/c --out @out/abc --quiet");
    assert_eq!(content("abc")["maps"][0]["name"], "a+b");
    assert!(exported("out/abc/manifest.json") == fs::read(hall.at("out/abc/map.mcap")).unwrap());
}
