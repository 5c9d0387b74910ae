use super::*;
use geometry::{Distortion, Fov, KannalaBrandt, Pinhole, RadTan};
use proptest::prelude::*;

const OURS: &str = "model: radtan
width: 640
height: 480
fx: 517.306408
fy: 516.469215
cx: 318.64304
cy: 255.313989
distortion: [0.262383, -0.953104, -0.005358, 0.002628, 1.163314]
fps: 30
depth_scale: 0.001   # for other readers
";

const KALIBR: &str = "cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.0034, 0.0007, -0.0021, 0.0002]
  distortion_model: equidistant
  intrinsics: [190.978, 190.973, 254.93, 256.9]
  resolution: [512, 512]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [0.99, 0.0, 0.0, -0.1]
  camera_model: pinhole
";

const EUROC: &str = "# General sensor definitions.
sensor_type: camera
comment: VI-Sensor cam0 (MT9M034)
T_BS:
  cols: 4
  rows: 4
  data: [0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975,
         0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768,
        -0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949,
         0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
";

const ROS: &str = "image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [520.9, 0, 325.1, 0, 521.0, 249.7, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.2312, -0.7849, -0.0033, -0.0001, 0.9172]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
";

const ROS_MESSAGE: &str = "header:
  stamp: {sec: 1, nanosec: 2}
  frame_id: camera
height: 480
width: 640
distortion_model: rational_polynomial
d: [16.1, 17.6, 0.0001, -0.00004, 0.94, 16.5, 23.6, 5.6]
k:
- 520.9
- 0.0
- 325.1
- 0.0
- 521.0
- 249.7
- 0.0
- 0.0
- 1.0
---
";

const OPENCV: &str = "%YAML:1.0
---
calibration_time: \"Sat Nov 21 08:00:00 2020\"
nframes: 13
image_width: 640
image_height: 480
flags: 2
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.3591573396163199e+02, 0., 3.4228315473308373e+02, 0.,
       5.3591573396163199e+02, 2.3557082909788173e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -2.6637260909660682e-01, -3.8588898922304653e-02,
       1.7831947042852964e-03, -2.8122100441115472e-04,
       2.3839153080878486e-01 ]
avg_reprojection_error: 3.9259098975581364e-01
";

fn parsed(text: &str) -> CalibrationFile {
    parse_camera(text, "sample").unwrap()
}

fn camera(size: (usize, usize), [fx, fy, cx, cy]: [f64; 4], distortion: Distortion) -> Camera {
    Camera::new(Pinhole { width: size.0, height: size.1, fx, fy, cx, cy }, distortion).unwrap()
}

fn radtan(terms: &[f64]) -> Distortion {
    Distortion::RadTan(RadTan::new(terms).unwrap())
}

/// The message of a refusal; it must name the file.
fn refusal(text: &str) -> String {
    let message = parse_camera(text, "folder/bad.yaml").unwrap_err().to_string();
    assert!(message.starts_with("folder/bad.yaml: "), "{message}");
    message
}

/// Asserts that a text with one replacement is refused with all these words.
fn refused(text: &str, from: &str, to: &str, words: &[&str]) {
    assert!(text.contains(from), "the sample lacks {from}");
    let message = refusal(&text.replacen(from, to, 1));
    for word in words {
        assert!(message.contains(word), "`{word}` is not in: {message}");
    }
}

#[test]
fn reads_our_own_form() {
    let file = parsed(OURS);
    let lens = radtan(&[0.262383, -0.953104, -0.005358, 0.002628, 1.163314]);
    let expected = camera((640, 480), [517.306408, 516.469215, 318.64304, 255.313989], lens);
    assert_eq!(
        file,
        CalibrationFile { camera: expected, crop: None, fps: Some(30.0), format: CameraFormat::Loopbox }
    );
    let pinhole =
        parsed("model: pinhole\nwidth: 640\nheight: 480\nfx: 420.0\nfy: 420\ncx: 319.5\ncy: 239.5\n");
    assert_eq!(*pinhole.camera.distortion(), Distortion::None);
    assert_eq!(pinhole.fps, None);
}

#[test]
fn reads_kalibr_camchains() {
    let file = parsed(KALIBR);
    let lens = Distortion::KannalaBrandt(KannalaBrandt::new(&[-0.0034, 0.0007, -0.0021, 0.0002]).unwrap());
    assert_eq!(file.camera, camera((512, 512), [190.978, 190.973, 254.93, 256.9], lens));
    assert_eq!(file.format, CameraFormat::Kalibr);
    let none = KALIBR.replace("equidistant", "none").replace("[-0.0034, 0.0007, -0.0021, 0.0002]", "[]");
    assert_eq!(*parsed(&none).camera.distortion(), Distortion::None);
    let fov = KALIBR.replace("equidistant", "fov").replace("[-0.0034, 0.0007, -0.0021, 0.0002]", "[0.93]");
    assert_eq!(*parsed(&fov).camera.distortion(), Distortion::Fov(Fov::new(&[0.93]).unwrap()));
}

#[test]
fn reads_euroc_sensors() {
    let file = parsed(EUROC);
    let lens = radtan(&[-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]);
    assert_eq!(file.camera, camera((752, 480), [458.654, 457.296, 367.215, 248.375], lens));
    assert_eq!((file.fps, file.format), (Some(20.0), CameraFormat::Euroc));
}

#[test]
fn reads_ros_camera_info() {
    let file = parsed(ROS);
    let lens = radtan(&[0.2312, -0.7849, -0.0033, -0.0001, 0.9172]);
    assert_eq!(file.camera, camera((640, 480), [520.9, 521.0, 325.1, 249.7], lens));
    assert_eq!(file.format, CameraFormat::RosCameraInfo);

    let message = parsed(ROS_MESSAGE);
    let lens = radtan(&[16.1, 17.6, 0.0001, -0.00004, 0.94, 16.5, 23.6, 5.6]);
    assert_eq!(message.camera, camera((640, 480), [520.9, 521.0, 325.1, 249.7], lens));
    assert_eq!(message.format, CameraFormat::RosCameraInfo);

    let upper = ROS_MESSAGE.replace("d: [16.1", "D: [16.1").replace("k:\n", "K:\n");
    assert_eq!(parsed(&upper).camera, message.camera);
    let bare = ROS.replace("[0.2312, -0.7849, -0.0033, -0.0001, 0.9172]", "[]");
    assert!(parsed(&bare).camera.distortion().is_identity());
}

#[test]
#[expect(clippy::excessive_precision, reason = "digits as OpenCV prints them")]
fn reads_opencv_storage() {
    let file = parsed(OPENCV);
    let f = 5.3591573396163199e+02;
    let lens = radtan(&[
        -2.6637260909660682e-01,
        -3.8588898922304653e-02,
        1.7831947042852964e-03,
        -2.8122100441115472e-04,
        2.3839153080878486e-01,
    ]);
    assert_eq!(file.camera, camera((640, 480), [f, f, 3.4228315473308373e+02, 2.3557082909788173e+02], lens));
    assert_eq!(file.format, CameraFormat::OpenCv);
    for (matrix, terms) in [("Camera_Matrix", "Distortion_Coefficients"), ("K", "D"), ("M1", "D1")] {
        let renamed = OPENCV.replace("camera_matrix", matrix).replace("distortion_coefficients", terms);
        assert_eq!(parsed(&renamed), file);
    }
    assert_eq!(parsed(&OPENCV.replace('\n', "\r\n")), file);
    // Fourteen terms of which the last are zero, as a full calibration writes them.
    let padded = OPENCV
        .replace("2.3839153080878486e-01 ]", "2.3839153080878486e-01, 0., 0., 0., 0., 0., 0., 0., 0., 0. ]");
    assert_eq!(parsed(&padded), file);
    let fisheye =
        OPENCV.replace("flags: 2", "fisheye_model: 1").replace(",\n       2.3839153080878486e-01 ]", " ]");
    assert!(matches!(parsed(&fisheye).camera.distortion(), Distortion::KannalaBrandt(_)));
}

#[test]
fn reads_the_text_form() {
    let radial =
        parsed("RadTan 458.654 457.296 367.215 248.375 -0.28 0.07 0.0002 1.76e-05\n752 480\ncrop\n640 480\n");
    let lens = radtan(&[-0.28, 0.07, 0.0002, 1.76e-05]);
    assert_eq!(radial.camera, camera((752, 480), [458.654, 457.296, 367.215, 248.375], lens));
    assert_eq!((radial.crop, radial.format), (Some(Crop::Valid), CameraFormat::LsdDso));

    // Relative numbers measure from the corner of the first pixel: 0.5 of 640 is 319.5.
    let atan = parsed("0.5 0.75 0.5 0.5 0.93\n1280 1024\n0.4 0.53 0.5 0.5 0\n640 480\n");
    let lens = Distortion::Fov(Fov::new(&[0.93]).unwrap());
    assert_eq!(atan.camera, camera((1280, 1024), [640.0, 768.0, 639.5, 511.5], lens));
    let output = Pinhole { width: 640, height: 480, fx: 256.0, fy: 254.4, cx: 319.5, cy: 239.5 };
    let Some(Crop::Explicit(found)) = atan.crop else { panic!("{:?}", atan.crop) };
    assert!((found.fy - output.fy).abs() < 1e-9);
    assert_eq!(Pinhole { fy: output.fy, ..found }, output);

    let pinhole = parsed("Pinhole 420 420 319.5 239.5 0\r\n640 480\r\nnone\r\n640 480\r\n");
    assert_eq!(pinhole.camera, camera((640, 480), [420.0, 420.0, 319.5, 239.5], Distortion::None));
    assert_eq!(pinhole.crop, Some(Crop::KeepFocal));
    let fov = parsed("FOV 640 768 639.5 511.5 0.93\n1280 1024\n");
    assert_eq!(fov.camera, atan.camera);
    for name in ["KannalaBrandt", "EquiDistant"] {
        let fisheye = parsed(&format!("{name} 190 190 255 256 0.1 0 0 0\n512 512\nfull\n"));
        assert!(matches!(fisheye.camera.distortion(), Distortion::KannalaBrandt(_)));
    }
    let bare = parsed("517.3 516.5 318.6 255.3 0.2624 -0.9531 -0.0054 0.0026 1.1633\n640 480\ncrop\n640 480");
    assert_eq!(*bare.camera.distortion(), radtan(&[0.2624, -0.9531, -0.0054, 0.0026, 1.1633]));
}

#[test]
fn missing_keys_are_named() {
    for key in ["model", "width", "height", "fx", "fy", "cx", "cy", "distortion"] {
        let line = OURS.lines().find(|line| line.starts_with(key)).unwrap();
        refused(OURS, line, "", &[&format!("key `{key}` is missing; give")]);
    }
    refused(OURS, "fx: 517.306408", "fx:", &["key `fx` is missing"]);
    refused(KALIBR, "resolution", "size", &["`cam0.resolution` is missing"]);
    refused(KALIBR, "distortion_coeffs", "x", &["`cam0.distortion_coeffs` is missing"]);
    refused(EUROC, "intrinsics", "x", &["`intrinsics` is missing"]);
    refused(ROS, "camera_matrix", "x", &["`camera_matrix` is missing"]);
    refused(ROS, "image_width", "x", &["`image_width` is missing"]);
    refused(OPENCV, "image_width", "x", &["`image_width` is missing", "add `image_width`"]);
    refused(OPENCV, "distortion_coefficients", "x", &["`distortion_coefficients` is missing"]);
    assert!(refusal("Pinhole 420 420 319.5 239.5 0\n").contains("`line 2` is missing"));
}

#[test]
fn numbers_without_sense_are_named() {
    refused(OURS, "fx: 517.306408", "fx: .nan", &["`fx`: NaN is not a finite number; calibrate"]);
    refused(OURS, "fx: 517.306408", "fx: nan", &["`fx`: NaN is not a finite number"]);
    refused(OURS, "fy: 516.469215", "fy: -516.4", &["`fy`", "fy = -516.4 must be a positive"]);
    refused(OURS, "fx: 517.306408", "fx: abc", &["`fx`: \"abc\" is not a number"]);
    refused(OURS, "cx: 318.64304", "cx: 900", &["`cx`", "cx = 900 lies outside the image (0 to 639)"]);
    refused(OURS, "width: 640", "width: 0", &["`width`: 0 is no image size"]);
    refused(OURS, "width: 640", "width: 640.5", &["`width`: 640.5 is no image size"]);
    refused(OURS, "width: 640", "width: 1", &["`width`", "at least 2 pixels"]);
}

#[test]
fn wrong_distortions_are_named() {
    refused(
        OURS,
        "-0.953104, ",
        "-0.953104, 0, 0, ",
        &["`distortion`", "4, 5 or 8 distortion terms, not 7", "give k1"],
    );
    refused(OURS, "-0.953104", ".inf", &["`distortion[1]`: inf is not a finite number"]);
    refused(OURS, "model: radtan", "model: pinhole", &["`distortion`", "pinhole takes 0"]);
    refused(OURS, "model: radtan", "model: mei", &["`model`: unknown model \"mei\"; give pinhole"]);
    refused(OURS, "model: radtan", "model: fov", &["`distortion`", "fov takes 1 distortion terms, not 5"]);
    refused(
        KALIBR,
        "camera_model: pinhole",
        "camera_model: omni",
        &["`cam0.camera_model`", "omni", "pinhole-equi"],
    );
    refused(KALIBR, "0.0002]", "0.0002, 0.1]", &["`cam0.distortion_coeffs`", "4 distortion terms, not 5"]);
    refused(KALIBR, "254.93", "-3", &["`cam0.intrinsics[2]`", "outside the image"]);
    refused(KALIBR, "254.93, ", "", &["`cam0.intrinsics`: 3 numbers where 4 belong"]);
    refused(EUROC, "radial-tangential", "thin-prism", &["`distortion_model`", "thin-prism"]);
    refused(ROS, "520.9, 0, 325.1", "520.9, 0.4, 325.1", &["`camera_matrix`", "rectangular pixels"]);
    refused(ROS, "520.9", "-520.9", &["`camera_matrix (fx)`", "positive"]);
    refused(OPENCV, "2.3839153080878486e-01 ]", ".Nan ]", &["`distortion_coefficients.data[4]`", "NaN"]);
}

#[test]
fn bad_text_forms_are_named() {
    assert!(refusal("RadTan 420 420 319.5 239.5 0.1 nan 0 0\n640 480\n").contains("`line 1`: NaN"));
    assert!(refusal("RadTan 420 420 319.5 239.5 0.1 0.1\n640 480\n").contains("not 2"));
    assert!(refusal("420 420 319.5\n640 480\n").contains("3 numbers are not a camera"));
    assert!(refusal("Pinhole 420 420 319.5 239.5 0\n640\n").contains("`line 2`: \"640\" is no image size"));
    assert!(refusal("Pinhole -420 420 319.5 239.5 0\n640 480\n").contains("`line 1 (fx)`"));
    assert!(refusal("Pinhole 420 420 319.5 239.5 0\n640 480\nsquare\n").contains("`line 3`: \"square\""));
    assert!(refusal("Pinhole 420 420 319.5 239.5 0\n640 480\n0 1 2 3 0\n640 480").contains("`line 3 (fx)`"));
    assert!(
        refusal("Pinhole 420 420 319.5 239.5 0\n640 480\n1 1 2 3 0.4\n640 480").contains("with distortion")
    );
}

#[test]
fn other_files_are_no_calibration() {
    for text in ["", "hello", "- 1\n- 2\n", "a: b\n", "{}", "# nothing\n"] {
        assert!(refusal(text).contains("not a camera calibration"), "{text:?}");
    }
    assert!(refusal("model: [unclosed\nfx: 3\n").contains("not valid YAML"));
    assert!(refusal("fx: 1\nfx: 2\n").contains("duplicated key"));
}

#[test]
fn files_are_read_and_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("camera.yaml");
    let missing = read_camera(&path).unwrap_err().to_string();
    assert!(missing.contains("camera.yaml: cannot be read"), "{missing}");
    let file = parsed(OURS);
    write_camera(&path, &file.camera, file.fps).unwrap();
    assert_eq!(read_camera(&path).unwrap(), file);
    std::fs::write(&path, [0xff, 0xfe, 0x00]).unwrap();
    assert!(matches!(read_camera(&path), Err(CalibError::UnknownForm { .. })));
    let nowhere = folder.path().join("none").join("camera.yaml");
    assert!(matches!(write_camera(&nowhere, &file.camera, None), Err(CalibError::Write { .. })));
}

proptest! {
    #[test]
    fn our_own_form_comes_back_exactly(
        (width, height) in (2usize..5000, 2usize..5000),
        (fx, fy) in (1e-3..1e5f64, 1e-3..1e5f64),
        (x, y) in (0.0..1.0f64, 0.0..1.0f64),
        terms in proptest::collection::vec(-1e2..1e2f64, 8),
        model in 0..6,
        fps in proptest::option::of(1e-3..1e4f64),
    ) {
        let lens = match model {
            0 => Distortion::None,
            1 => radtan(&terms[..4]),
            2 => radtan(&terms[..5]),
            3 => radtan(&terms),
            4 => Distortion::KannalaBrandt(KannalaBrandt::new(&terms[..4]).unwrap()),
            _ => Distortion::Fov(Fov::new(&[(terms[0].abs() + 1e-9) / 40.0]).unwrap()),
        };
        let principal = (x * (width as f64 - 1.0), y * (height as f64 - 1.0));
        let camera = camera((width, height), [fx, fy, principal.0, principal.1], lens);
        let file = parse_camera(&format_camera(&camera, fps), "own").unwrap();
        prop_assert_eq!(file, CalibrationFile { camera, crop: None, fps, format: CameraFormat::Loopbox });
    }

    #[test]
    fn no_text_panics(text in "\\PC{0,200}", cut in 0usize..700) {
        let _ = parse_camera(&text, "noise");
        for sample in [OURS, KALIBR, EUROC, ROS, ROS_MESSAGE, OPENCV] {
            let cut = cut.min(sample.len());
            let _ = parse_camera(&sample[..cut], "cut");
            let _ = parse_camera(&format!("{}{text}", &sample[..cut]), "mixed");
        }
    }
}

#[test]
fn euroc_says_where_the_camera_is_on_the_body() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sensor.yaml");
    std::fs::write(&path, EUROC).unwrap();
    let body_from_camera = read_body_from_camera(&path).unwrap().unwrap();
    assert!(
        (body_from_camera.translation
            - nalgebra::Vector3::new(-0.0216401454975, -0.064676986768, 0.00981073058949))
        .norm()
            < 1e-12
    );
    assert!((body_from_camera.rotation_matrix()[(0, 1)] + 0.999880929698).abs() < 1e-6);
    std::fs::write(&path, ROS).unwrap();
    assert!(read_body_from_camera(&path).unwrap().is_none());
    std::fs::write(&path, EUROC.replace("-0.999880929698", "0.5")).unwrap();
    assert!(read_body_from_camera(&path).unwrap_err().to_string().contains("not a rotation"));
}
