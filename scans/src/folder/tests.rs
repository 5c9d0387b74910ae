use super::*;

/// A sweep of a cube's inside, as KITTI stores it.
fn bytes(points: usize) -> Vec<u8> {
    let point = |i: usize| {
        let (azimuth, z) = (i as f32 * 0.01, (i % 7) as f32 * 0.3 - 1.0);
        [3.0 * azimuth.cos(), 3.0 * azimuth.sin(), z, 0.0]
    };
    (0..points).flat_map(point).flat_map(f32::to_le_bytes).collect()
}

fn folder(times: &str, scans: &[(&str, Vec<u8>)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in scans {
        std::fs::write(folder.path().join(name), bytes).unwrap();
    }
    if !times.is_empty() {
        std::fs::write(folder.path().join("times.txt"), times).unwrap();
    }
    folder
}

#[test]
fn scans_come_in_order_with_their_stamps() {
    let dir = folder("0.5 000001\n0.6 000002\n", &[("000002.bin", bytes(900)), ("000001.bin", bytes(800))]);
    let found = Folder::open(dir.path(), &FolderOptions::default()).unwrap();
    let scans: Vec<Scan> = found.files().iter().map(|f| found.read(f).unwrap()).collect();
    assert_eq!(scans.iter().map(|s| (s.stamp, s.points.len())).collect::<Vec<_>>(), [(0.5, 800), (0.6, 900)]);
    assert!(scans[0].times.is_empty());
}

#[test]
fn what_is_of_no_use_is_refused_with_the_reason() {
    let cut = bytes(900)[..1003].to_vec();
    let mut nan = bytes(900);
    nan.chunks_exact_mut(16).for_each(|p| p[..4].copy_from_slice(&f32::NAN.to_le_bytes()));
    let ring: Vec<u8> = (0..900)
        .flat_map(|i| [(i as f32 * 0.007).cos(), (i as f32 * 0.007).sin(), 0.0, 0.0])
        .flat_map(f32::to_le_bytes)
        .collect();
    let dir = folder("", &[("0.bin", cut), ("1.bin", nan), ("2.bin", ring), ("3.bin", vec![])]);
    let found = Folder::open(dir.path(), &FolderOptions::default()).unwrap();
    let reasons: Vec<String> = found.files().iter().map(|f| found.read(f).unwrap_err().to_string()).collect();
    for (reason, part) in reasons.iter().zip(["cut off", "0 of 900", "one ring", "0 of 0"]) {
        assert!(reason.contains(part), "{reason}");
    }
    let dir = folder("1.0\n", &[("0.bin", bytes(900)), ("1.bin", bytes(900))]);
    let refused = Folder::open(dir.path(), &FolderOptions::default()).unwrap_err();
    assert!(refused.to_string().contains("1 times for 2 scans"), "{refused}");
}

/// The names and stamps of a folder of scans so named, and what is said of them.
fn inferred(
    times: &str,
    names: &[&str],
    options: &FolderOptions,
) -> Result<(Vec<String>, Vec<f64>, String), ScanError> {
    let scans: Vec<_> = names.iter().map(|name| (*name, bytes(900))).collect();
    let dir = folder(times, &scans);
    let found = Folder::open(dir.path(), options)?;
    let name = |file: &ScanFile| file.path.file_name().unwrap().to_string_lossy().into_owned();
    let (names, stamps) = found.files().iter().map(|file| (name(file), file.stamp)).unzip();
    Ok((names, stamps, found.remarks().join("; ")))
}

#[test]
fn scans_named_by_their_times_have_them() {
    let half_seconds = ["1700000000.000000.bin", "1700000000.500000.bin", "1700000001.000000.bin"];
    let (_, stamps, _) = inferred("", &half_seconds, &FolderOptions::default()).unwrap();
    assert_eq!(stamps, [1_700_000_000.0, 1_700_000_000.5, 1_700_000_001.0]);
    let nanoseconds = ["1700000000000000000.bin", "1700000000050000000.bin"];
    let (_, stamps, output) = inferred("", &nanoseconds, &FolderOptions::default()).unwrap();
    assert!((stamps[1] - stamps[0] - 0.05).abs() < 1e-6, "{stamps:?}");
    assert!(output.contains("named by their times, in nanoseconds"), "{output}");
    let (_, stamps, _) =
        inferred("", &half_seconds, &FolderOptions { rate: Some(4.0), times: None }).unwrap();
    assert_eq!(stamps, [0.0, 0.25, 0.5]);
}

#[test]
fn scans_come_as_people_count() {
    let plain = FolderOptions::default();
    let (names, ..) = inferred("", &["0.bin", "1.bin", "10.bin", "100.bin", "2.bin"], &plain).unwrap();
    assert_eq!(names, ["0.bin", "1.bin", "2.bin", "10.bin", "100.bin"]);
    let (names, stamps, output) = inferred("", &["s9.bin", "s10.bin", "s14.bin", "s15.bin"], &plain).unwrap();
    assert_eq!((names[1].as_str(), stamps[3]), ("s10.bin", 0.3));
    assert!(output.contains("after 10 comes 14 (3 missing)"), "{output}");
    let (_, stamps, output) =
        inferred("0\n0.1\n0.2\n0.3\n0.4\n", &["000000.bin", "000003.bin"], &plain).unwrap();
    assert!(stamps == [0.0, 0.3] && output.contains("5 times for 2 scans"), "{stamps:?} {output}");
}

#[test]
fn times_of_scans_are_recognised_as_those_of_images() {
    let (plain, names) = (FolderOptions::default(), ["0.bin", "1.bin", "2.bin"]);
    for table in [
        "0\n100000000\n200000000\n",
        "1600000000000000000\n1600000000100000000\n1600000000200000000\n",
        "time;scan\n0;0\n0,1;1\n0,2;2\n",
        "\u{feff}0.0 0\r\n0.1 1\r\n0.2 2\r\n",
        "2011-09-26 13:02:25.9\n2011-09-26 13:02:26.0\n2011-09-26 13:02:26.1\n",
    ] {
        let stamps = inferred(table, &names, &plain).unwrap().1;
        assert!(stamps.windows(2).all(|w| (w[1] - w[0] - 0.1).abs() < 1e-6), "{table}: {stamps:?}");
    }
    let error = inferred("7\n7\n7\n", &names, &plain).unwrap_err().to_string();
    assert!(error.contains("all 3 scans have the time 7") && error.contains("--rate"), "{error}");
    let options = FolderOptions { rate: Some(20.0), ..plain.clone() };
    assert_eq!(inferred("7\n7\n7\n", &names, &options).unwrap().1[2], 0.1);
    let raw = tempfile::tempdir().unwrap();
    let data = raw.path().join("velodyne_points/data");
    std::fs::create_dir_all(&data).unwrap();
    (0..2).for_each(|i| std::fs::write(data.join(format!("000000000{i}.bin")), bytes(900)).unwrap());
    let dates = "2011-09-26 13:02:25.900000000\n2011-09-26 13:02:26.000000000\n";
    std::fs::write(raw.path().join("velodyne_points/timestamps.txt"), dates).unwrap();
    assert!(!folder_contents(raw.path()).unwrap().scans.is_empty());
    let found = Folder::open(raw.path(), &plain).unwrap();
    assert!((found.files()[1].stamp - found.files()[0].stamp - 0.1).abs() < 1e-6);
}

/// A hall's inside seen by 16 rings, with intensity and ring.
fn of_five() -> Vec<u8> {
    let point = |i: usize| {
        let (column, ring) = (i / 16, i % 16);
        let (azimuth, elevation) = (column as f32 * 0.016, (2.0 * ring as f32 - 15.0f32).to_radians());
        let range = 8.0 / azimuth.cos().abs().max(azimuth.sin().abs()).max(4.0 * elevation.sin().abs());
        let level = range * elevation.cos();
        let intensity = (i * 7919 % 251) as f32;
        [level * azimuth.cos(), level * azimuth.sin(), range * elevation.sin(), intensity, ring as f32]
    };
    (0..16 * 400).flat_map(point).flat_map(f32::to_le_bytes).collect()
}

#[test]
fn points_of_five_numbers_are_not_read_as_of_four() {
    let scans: Vec<(String, Vec<u8>)> = (0..4).map(|i| (format!("{i:06}.bin"), of_five())).collect();
    let scans: Vec<(&str, Vec<u8>)> = scans.iter().map(|(n, b)| (n.as_str(), b.clone())).collect();
    let dir = folder("", &scans);
    std::fs::write(dir.path().join("cloud.ply"), "ply\n").unwrap();
    let found = Folder::open(dir.path(), &FolderOptions::default()).unwrap();
    assert_eq!(found.kind(), "binary (x y z intensity ring)");
    assert!(found.facts().iter().any(|(label, text)| *label == "left out" && text.contains("cloud.ply")));
    let scan = found.read(&found.files()[1]).unwrap();
    assert_eq!((scan.points.len(), scan.rings[17]), (6400, 1));
    assert!(!found.is_kitti());
}

#[test]
fn kitti_is_recognised_by_its_layout() {
    let dir = tempfile::tempdir().unwrap();
    let scans = dir.path().join("velodyne");
    std::fs::create_dir(&scans).unwrap();
    (0..3).for_each(|i| std::fs::write(scans.join(format!("{i:06}.bin")), bytes(900)).unwrap());
    std::fs::write(scans.join("._000000.bin"), [0; 100]).unwrap();
    let found = Folder::open(dir.path(), &FolderOptions::default()).unwrap();
    assert_eq!((found.kind().as_str(), found.files().len(), found.is_kitti()), ("KITTI", 3, true));
    let plain = folder("", &[("000000.bin", bytes(900)), ("000001.bin", bytes(900))]);
    let found = Folder::open(plain.path(), &FolderOptions::default()).unwrap();
    assert_eq!((found.kind().as_str(), found.is_kitti()), ("binary (x y z intensity)", false));
}
