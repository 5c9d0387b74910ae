use super::*;

/// A model of two cameras and two images as text: `cameras`, `images`, `points3D`.
const TEXT: [&str; 3] = [
    "# CAMERA_ID MODEL WIDTH HEIGHT PARAMS\n7 PINHOLE 320 240 210 211 160 120\n9 SIMPLE_RADIAL 320 240 200 160 120 0.01\n",
    "# two lines each\n3 1 0 0 0 0.5 0 0 7 a image.png\n10.5 20.5 5 30 40 -1\n4 0.8 0.6 0 0 0 1 0 9 b.png\n\n",
    "# points\n5 1 2 3 9 9 9 0.5 3 0\n",
];

fn written(folder: &Path, end: &str, files: [&[u8]; 3]) {
    for (name, content) in ["cameras", "images", "points3D"].iter().zip(files) {
        std::fs::write(folder.join(format!("{name}.{end}")), content).unwrap();
    }
}

/// The same model as bytes.
fn bytes() -> [Vec<u8>; 3] {
    let doubles = |numbers: &[f64]| numbers.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let camera = |id: u32, model: i32, params: &[f64]| {
        let sizes = [320u64, 240].map(u64::to_le_bytes).concat();
        [&id.to_le_bytes()[..], &model.to_le_bytes(), &sizes, &doubles(params)].concat()
    };
    let two = 2u64.to_le_bytes();
    let cameras =
        [&two[..], &camera(7, 1, &[210.0, 211.0, 160.0, 120.0]), &camera(9, 2, &[200.0, 160.0, 120.0, 0.01])];
    let image = |id: u32, pose: [f64; 7], camera: u32, name: &str, points: &[(f64, f64, u64)]| {
        let mut all =
            [&id.to_le_bytes()[..], &doubles(&pose), &camera.to_le_bytes(), name.as_bytes(), &[0]].concat();
        all.extend((points.len() as u64).to_le_bytes());
        for (x, y, point) in points {
            all.extend(doubles(&[*x, *y]));
            all.extend(point.to_le_bytes());
        }
        all
    };
    let seen = [(10.5, 20.5, 5), (30.0, 40.0, u64::MAX)];
    let images = [
        &two[..],
        &image(3, [1.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0], 7, "a image.png", &seen),
        &image(4, [0.8, 0.6, 0.0, 0.0, 0.0, 1.0, 0.0], 9, "b.png", &[]),
    ];
    let one = 1u64.to_le_bytes();
    let point =
        [&5u64.to_le_bytes()[..], &doubles(&[1.0, 2.0, 3.0]), &[9; 3], &doubles(&[0.5]), &one, &[0; 8]];
    [cameras.concat(), images.concat(), [&one[..], &point.concat()].concat()]
}

#[test]
fn text_and_bytes_are_one_model() {
    let folder = tempfile::tempdir().unwrap();
    written(folder.path(), "txt", TEXT.map(str::as_bytes));
    assert_eq!(model_in(folder.path()), Some((folder.path().join("."), false)));
    let model = text::read(folder.path()).unwrap();
    assert_eq!((model.cameras.len(), model.images.len(), model.points.len()), (2, 2, 1));
    assert_eq!(model.cameras[&7].intrinsics().cx, 159.5);
    assert_eq!((model.images[0].name.as_str(), model.images[0].seen.len()), ("a image.png", 1));
    let bytes = bytes();
    written(folder.path(), "bin", bytes.each_ref().map(Vec::as_slice));
    assert_eq!(model_in(folder.path()), Some((folder.path().join("."), true)));
    assert_eq!(binary::read(folder.path()).unwrap(), model);
}

#[test]
fn models_cut_short_anywhere_are_refused() {
    let (folder, whole) = (tempfile::tempdir().unwrap(), bytes());
    for file in 0..3 {
        for length in 0..whole[file].len() {
            let mut cut = whole.each_ref().map(Vec::as_slice);
            cut[file] = &whole[file][..length];
            written(folder.path(), "bin", cut);
            let error = format!("{:#}", binary::read(folder.path()).unwrap_err());
            assert!(error.contains("cut short"), "{file} {length}: {error}");
        }
    }
}

#[test]
fn what_a_text_gets_wrong_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let cases = [
        (0, "7 THIN_PRISM_FISHEYE 320 240 1 2 3\n", "THIN_PRISM_FISHEYE"),
        (0, "7 PINHOLE 320 240 210 211 160\n", "4 parameters"),
        (0, "7 PINHOLE 0 240 210 211 160 120\n", "no image"),
        (1, "3 1 0 0 0 0.5 0\n\n", "pose"),
        (1, "3 1 0 0 0 x 0 0 7 a.png\n\n", "x is no number"),
        (1, "3 0 0 0 0 0 0 0 7 a.png\n\n", "is none"),
        (1, "3 1 0 0 0 0 0 0 7 a.png\n1 2\n", "cut short"),
        (1, "3 1 0 0 0 0 0 0 7 a.png", "ends"),
        (2, "5 1 2\n", "POINT3D_ID"),
    ];
    for (file, text, word) in cases {
        let mut files = TEXT;
        files[file] = text;
        written(folder.path(), "txt", files.map(str::as_bytes));
        let error = format!("{:#}", text::read(folder.path()).unwrap_err());
        assert!(error.contains(word) && error.contains("line 1"), "{text}: {error}");
    }
}
