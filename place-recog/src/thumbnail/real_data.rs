//! Recall on real sequences. Run with
//! `LOOPBOX_DATA=… cargo test -p loopbox-place-recog --release -- --ignored recall --nocapture`.

use super::*;
use std::path::{Path, PathBuf};
use std::time::Instant;

type Pose = ([f64; 3], [f64; 4]);

/// `(image, pose)` of every frame that has ground truth within 20 ms.
fn frames(sequence: &Path) -> Vec<(PathBuf, Pose)> {
    let read = |name: &str| std::fs::read_to_string(sequence.join(name)).unwrap();
    let truth: Vec<Vec<f64>> = read("groundtruth.txt")
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| line.split_whitespace().map(|v| v.parse().unwrap()).collect())
        .collect();
    let nearest = |t: f64| truth.iter().min_by(|a, b| (a[0] - t).abs().total_cmp(&(b[0] - t).abs())).unwrap();
    read("times.txt")
        .lines()
        .filter(|line| !line.starts_with('#'))
        .filter_map(|line| {
            let (time, name) = line.split_once(' ')?;
            let t: f64 = time.parse().ok()?;
            let p = nearest(t);
            let pose = ([p[1], p[2], p[3]], [p[4], p[5], p[6], p[7]]);
            ((p[0] - t).abs() < 0.02).then(|| (sequence.join(name.trim()), pose))
        })
        .collect()
}

/// Distance of the centres and angle between two views.
fn apart(a: &Pose, b: &Pose) -> (f64, f64) {
    let distance = (0..3).map(|i| (a.0[i] - b.0[i]).powi(2)).sum::<f64>().sqrt();
    let cosine: f64 = (0..4).map(|i| a.1[i] * b.1[i]).sum();
    (distance, 2.0 * cosine.abs().min(1.0).acos().to_degrees())
}

fn open(path: &Path) -> GrayImage {
    let gray = image::open(path).unwrap().into_luma8();
    GrayImage::from_vec(gray.width() as usize, gray.height() as usize, gray.into_raw()).unwrap()
}

#[test]
#[ignore = "needs the sequences with ground truth"]
fn recall_on_real_sequences() {
    let data =
        PathBuf::from(std::env::var_os("LOOPBOX_DATA").expect("set LOOPBOX_DATA to the folder of sequences"));
    for (stored, asked, near) in [
        ("tum_fr1_xyz", "tum_fr1_xyz", (0.15, 10.0)),
        ("tum_fr1_desk", "tum_fr1_desk", (0.3, 20.0)),
        ("tum_fr1_xyz", "tum_fr1_desk", (0.3, 20.0)),
        ("parking_a", "parking_b", (1.0, 10.0)),
        ("kitti00_first201", "kitti00_first201", (6.0, 10.0)),
    ] {
        let stored_frames: Vec<_> = frames(&data.join(stored)).into_iter().step_by(10).collect();
        let mut index = ThumbnailIndex::default();
        for (i, (path, _)) in stored_frames.iter().enumerate() {
            index.add(KeyframeId(i as u32), &open(path));
        }
        let offset = if stored == asked { 5 } else { 0 };
        let (mut possible, mut at_1, mut at_5, mut milliseconds, mut total) = (0, 0, 0, 0.0, 0);
        for (path, pose) in frames(&data.join(asked)).into_iter().skip(offset).step_by(10) {
            let image = open(&path);
            let start = Instant::now();
            let found = index.query(&image, 5);
            milliseconds += start.elapsed().as_secs_f64() * 1e3;
            total += 1;
            let is_near = |other: &Pose| {
                let (distance, angle) = apart(&pose, other);
                distance < near.0 && angle < near.1
            };
            if !stored_frames.iter().any(|(_, other)| is_near(other)) {
                continue;
            }
            possible += 1;
            let hit = |c: &PlaceCandidate| is_near(&stored_frames[c.keyframe.0 as usize].1);
            at_1 += found.first().is_some_and(hit) as usize;
            at_5 += found.iter().any(hit) as usize;
        }
        println!(
            "{asked} in {stored} ({} keyframes), near = {near:?} m °: {possible} of {total} queries possible, recall@1 {:.3} @5 {:.3}, {:.2} ms a query",
            index.len(),
            at_1 as f64 / possible as f64,
            at_5 as f64 / possible as f64,
            milliseconds / total as f64
        );
        assert!(at_5 as f64 >= 0.5 * possible as f64);
    }
}

#[test]
#[ignore = "a measurement of time"]
fn time_of_a_query_over_thousands() {
    let mut index = ThumbnailIndex::default();
    let base =
        GrayImage::from_vec(640, 480, (0..640 * 480u32).map(|i| (i % 640 / 3) as u8).collect()).unwrap();
    for count in [200u32, 1000, 5000] {
        while index.len() < count as usize {
            index.add(KeyframeId(index.len() as u32), &base);
        }
        let start = Instant::now();
        for _ in 0..20 {
            assert_eq!(index.query(&base, 5).len(), 5);
        }
        println!("{count} keyframes: {:.3} ms", start.elapsed().as_secs_f64() * 50.0);
    }
}
