//! Files of other programs, as these have them.

use super::*;
use geometry::{Distortion, Fov, KannalaBrandt, RadTan};

fn read(text: &str) -> CalibrationFile {
    parse_camera(text, "sample").unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn refusal(text: &str) -> String {
    parse_camera(text, "sample").unwrap_err().to_string()
}

fn of(folder: &str) -> CameraHint {
    CameraHint { folder: Some(folder.into()), ..CameraHint::default() }
}

fn camera(size: (usize, usize), [fx, fy, cx, cy]: [f64; 4], distortion: Distortion) -> Camera {
    Camera::new(Pinhole { width: size.0, height: size.1, fx, fy, cx, cy }, distortion).unwrap()
}

fn radtan(terms: &[f64]) -> Distortion {
    Distortion::RadTan(RadTan::new(terms).unwrap())
}

fn kb4(terms: [f64; 4]) -> Distortion {
    Distortion::KannalaBrandt(KannalaBrandt::new(&terms).unwrap())
}

#[test]
fn kitti_of_odometry_and_raw() {
    let odometry = "P0: 718.856 0 607.1928 0 0 718.856 185.2157 0 0 0 1 0\nP1: 718.856 0 607.1928 -386.1 0 718.856 185.2157 0 0 0 1 0\n\
        P2: 700 0 600 45.4 0 701 180 -0.1 0 0 1 0\nTr: 1 0 0 0 0 1 0 0 0 0 1 0\n";
    let size = Some((1241, 376));
    let hint = |folder: &str| CameraHint { size, ..of(folder) };
    let found = parse_camera_of(odometry, "calib.txt", &hint("seq/image_1")).unwrap();
    assert_eq!(
        (found.camera, found.format),
        (camera((1241, 376), [718.856, 718.856, 607.1928, 185.2157], Distortion::None), CameraFormat::Kitti)
    );
    let named = CameraHint { name: Some("image_02".into()), ..hint("images") };
    assert_eq!(parse_camera_of(odometry, "calib.txt", &named).unwrap().camera.intrinsics().fy, 701.0);
    assert!(
        parse_camera_of(odometry, "c", &hint("images")).unwrap_err().to_string().contains("several cameras")
    );
    let sizeless = parse_camera_of(odometry, "c", &of("image_0")).unwrap_err().to_string();
    assert!(sizeless.contains("does not tell the image size"), "{sizeless}");

    let one = |i: usize| {
        format!(
            "S_0{i}: 1.392000e+03 5.120000e+02\nK_0{i}: 984.2 0 690 0 980.8 233.2 0 0 1\nD_0{i}: -0.37 0.2 0.001 0.002 -0.07\n\
             S_rect_0{i}: 1.242000e+03 3.750000e+02\nP_rect_0{i}: 721.5 0 609.6 {i} 0 721.5 172.9 0 0 0 1 0\n"
        )
    };
    let raw: String =
        std::iter::once("calib_time: 09-Jan-2012 13:57:47\n".to_owned()).chain((0..4).map(one)).collect();
    let rectified = camera((1242, 375), [721.5, 721.5, 609.6, 172.9], Distortion::None);
    let of_drive = |size| CameraHint { size, ..of("drive_0001/image_02/data") };
    for size in [None, Some((1242, 375))] {
        assert_eq!(parse_camera_of(&raw, "c", &of_drive(size)).unwrap().camera, rectified);
    }
    let as_taken = parse_camera_of(&raw, "c", &of_drive(Some((1392, 512)))).unwrap().camera;
    assert_eq!(
        as_taken,
        camera((1392, 512), [984.2, 980.8, 690.0, 233.2], radtan(&[-0.37, 0.2, 0.001, 0.002, -0.07]))
    );
    let torn = raw.replace("S_rect_02: 1.242000e+03 3.750000e+02\n", "");
    assert!(parse_camera_of(&torn, "c", &of_drive(None)).unwrap_err().to_string().contains("S_rect_02"));
}

#[test]
fn orb_slam_2_and_3() {
    let tum = "%YAML:1.0\n\n#---- Camera Parameters\nCamera.fx: 517.306408\nCamera.fy: 516.469215\nCamera.cx: 318.643040\n\
        Camera.cy: 255.313989\n\nCamera.k1: 0.262383\nCamera.k2: -0.953104\nCamera.p1: -0.005358\nCamera.p2: 0.002628\n\
        Camera.k3: 1.163314\n\nCamera.width: 640\nCamera.height: 480\n\nCamera.fps: 30.0\nCamera.RGB: 1\n\
        ORBextractor.nFeatures: 1000\n";
    let expected = camera(
        (640, 480),
        [517.306408, 516.469215, 318.64304, 255.313989],
        radtan(&[0.262383, -0.953104, -0.005358, 0.002628, 1.163314]),
    );
    let found = read(tum);
    assert_eq!((found.camera, found.fps, found.format), (expected, Some(30.0), CameraFormat::OrbSlam));
    // ORB-SLAM2's own files often leave the size out.
    let without = refusal(&tum.replace("Camera.width: 640\n", ""));
    assert!(without.contains("`Camera.width` is missing") && without.contains("add the key"), "{without}");
    // Then it is that of the images, where these are known.
    let neither = tum.replace("Camera.width: 640\nCamera.height: 480\n", "");
    let of_images = CameraHint { size: Some((640, 480)), ..CameraHint::default() };
    assert_eq!(parse_camera_of(&neither, "s", &of_images).unwrap().camera, expected);

    let tum_vi = "%YAML:1.0\nFile.version: \"1.0\"\nCamera.type: \"KannalaBrandt8\"\nCamera1.fx: 190.97\nCamera1.fy: 190.96\n\
        Camera1.cx: 254.93\nCamera1.cy: 256.89\nCamera1.k1: 0.0034\nCamera1.k2: 0.0007\nCamera1.k3: -0.002\nCamera1.k4: 0.0002\n\
        Camera.width: 512\nCamera.height: 512\nCamera.fps: 20\n";
    let fisheye = camera((512, 512), [190.97, 190.96, 254.93, 256.89], kb4([0.0034, 0.0007, -0.002, 0.0002]));
    assert_eq!(read(tum_vi).camera, fisheye);
    let stereo =
        format!("{tum_vi}{}", "Camera2.fx: 180\nCamera2.fy: 180\nCamera2.cx: 252\nCamera2.cy: 255\n");
    assert!(refusal(&stereo).contains("several cameras (Camera1, Camera2)"), "{}", refusal(&stereo));
    assert_eq!(parse_camera_of(&stereo, "s", &of("mav0/cam0/data")).unwrap().camera, fisheye);
    let right = parse_camera_of(&stereo, "s", &of("mav0/cam1/data")).unwrap().camera;
    assert_eq!(right.intrinsics().fx, 180.0);
    let rectified = tum_vi.replace("KannalaBrandt8", "Rectified");
    assert!(read(&rectified).camera.distortion().is_identity());
    assert!(refusal(&tum_vi.replace("KannalaBrandt8", "Mei")).contains("\"Mei\" is not supported"));

    // ORB-SLAM2's stereo files: Camera.fx is that of the rectified images, the recording's are as LEFT.K says.
    let euroc = "%YAML:1.0\nCamera.fx: 435.2\nCamera.fy: 435.2\nCamera.cx: 367.4\nCamera.cy: 252.2\nCamera.k1: 0.0\n\
        Camera.width: 752\nCamera.height: 480\nLEFT.height: 480\nLEFT.width: 752\nLEFT.D: !!opencv-matrix\n   rows: 1\n   cols: 5\n\
        \x20  dt: d\n   data:[-0.28, 0.07, 0.0002, 1.7e-05, 0.0]\nLEFT.K: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   \
        data: [458.6, 0.0, 367.2, 0.0, 457.3, 248.4, 0.0, 0.0, 1.0]\nRIGHT.height: 480\nRIGHT.width: 752\n"
        .replace("data:[", "data: [");
    let left = parse_camera_of(&euroc, "s", &of("EuRoC/MH01/mav0/cam0/data")).unwrap().camera;
    assert_eq!(
        left,
        camera((752, 480), [458.6, 457.3, 367.2, 248.4], radtan(&[-0.28, 0.07, 0.0002, 1.7e-5, 0.0]))
    );
}

#[test]
fn stella_vslam_and_openvslam() {
    let stella = "# EuRoC monocular model\nCamera:\n  name: \"EuRoC monocular\"\n  setup: \"monocular\"\n  model: \"perspective\"\n\n  \
        fx: 458.654\n  fy: 457.296\n  cx: 367.215\n  cy: 248.375\n\n  k1: -0.28340811\n  k2: 0.07395907\n  p1: 0.00019359\n  \
        p2: 1.76187114e-05\n  k3: 0.0\n\n  fps: 20.0\n  cols: 752\n  rows: 480\n\n  color_order: \"Gray\"\n\nFeature:\n  name: \"x\"\n";
    let lens = radtan(&[-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]);
    let expected = camera((752, 480), [458.654, 457.296, 367.215, 248.375], lens);
    assert_eq!((read(stella).camera.intrinsics(), read(stella).fps), (expected.intrinsics(), Some(20.0)));
    assert_eq!(read(stella).camera.distortion(), expected.distortion());
    let open = "Camera.name: \"x\"\nCamera.setup: \"monocular\"\nCamera.model: \"fisheye\"\nCamera.fx: 300\nCamera.fy: 301\n\
        Camera.cx: 320\nCamera.cy: 240\nCamera.k1: 0.1\nCamera.k2: 0.01\nCamera.k3: 0\nCamera.k4: 0\nCamera.fps: 30\n\
        Camera.cols: 640\nCamera.rows: 480\n";
    assert_eq!(
        read(open).camera,
        camera((640, 480), [300.0, 301.0, 320.0, 240.0], kb4([0.1, 0.01, 0.0, 0.0]))
    );
    let round = "Camera:\n  setup: monocular\n  model: equirectangular\n  cols: 1920\n  rows: 960\n  fx: 1\n  fy: 1\n  cx: 1\n  cy: 1\n";
    assert!(refusal(round).contains("`Camera.model`: the camera model \"equirectangular\" is not supported"));
}

#[test]
fn vins() {
    let pinhole = "%YAML:1.0\n---\nmodel_type: PINHOLE\ncamera_name: camera\nimage_width: 752\nimage_height: 480\n\
        distortion_parameters:\n   k1: -0.2917\n   k2: 8.228e-02\n   p1: 5.333e-05\n   p2: -1.578e-04\nprojection_parameters:\n   \
        fx: 461.6\n   fy: 460.3\n   cx: 363.0\n   cy: 248.1\n";
    let lens = radtan(&[-0.2917, 8.228e-02, 5.333e-05, -1.578e-04]);
    assert_eq!(read(pinhole).camera, camera((752, 480), [461.6, 460.3, 363.0, 248.1], lens));
    let fisheye = "%YAML:1.0\n---\nmodel_type: KANNALA_BRANDT\ncamera_name: c\nimage_width: 512\nimage_height: 512\n\
        projection_parameters:\n   k2: 0.003\n   k3: 0.0007\n   k4: -0.002\n   k5: 0.0002\n   mu: 190.9\n   mv: 190.8\n   \
        u0: 254.9\n   v0: 256.8\n";
    let expected = camera((512, 512), [190.9, 190.8, 254.9, 256.8], kb4([0.003, 0.0007, -0.002, 0.0002]));
    assert_eq!((read(fisheye).camera, read(fisheye).format), (expected, CameraFormat::Vins));
    let mei = fisheye.replace("KANNALA_BRANDT", "MEI");
    assert!(refusal(&mei).contains("camodocal's camera model \"MEI\" is not supported"));
    let main = "%YAML:1.0\nimu: 1\nnum_of_cam: 2\nimage0_topic: \"/cam0/image_raw\"\ncam0_calib: \"cam0_mei.yaml\"\n";
    assert!(refusal(main).contains("in other files, \"cam0_mei.yaml\""), "{}", refusal(main));
}

#[test]
fn svo_and_maplab() {
    let vikit = "cam_model: Pinhole\ncam_width: 752\ncam_height: 480\ncam_fx: 414.5\ncam_fy: 414.3\ncam_cx: 348.8\ncam_cy: 240.0\n\
        cam_d0: -0.283\ncam_d1: 0.1326\ncam_d2: 0.00074\ncam_d3: -0.0004\n";
    let lens = radtan(&[-0.283, 0.1326, 0.00074, -0.0004]);
    assert_eq!(read(vikit).camera, camera((752, 480), [414.5, 414.3, 348.8, 240.0], lens));
    let atan = "cam_model: ATAN\ncam_width: 752\ncam_height: 480\ncam_fx: 0.5\ncam_fy: 0.8\ncam_cx: 0.5\ncam_cy: 0.5\ncam_d0: 0.93\n";
    let lens = Distortion::Fov(Fov::new(&[0.93]).unwrap());
    assert_eq!(read(atan).camera, camera((752, 480), [376.0, 384.0, 375.5, 239.5], lens));
    assert!(refusal(&atan.replace("ATAN", "Ocam")).contains("vikit's camera model \"Ocam\""));

    let camera_in = |label: &str, fx: f64| {
        format!(
            "- camera:\n    label: {label}\n    line-delay-nanoseconds: 0\n    image_height: 480\n    image_width: 752\n    \
             type: pinhole\n    intrinsics:\n      cols: 1\n      rows: 4\n      data: [{fx}, 457.5, 366.6, 249.3]\n    \
             distortion:\n      type: radial-tangential\n      parameters:\n        cols: 1\n        rows: 4\n        \
             data: [-0.28, 0.07, 0.0003, -2.6e-06]\n  T_B_C:\n    cols: 4\n"
        )
    };
    let one = format!(
        "label: \"Euroc\"\nid: 412eab8e4058621f7036b5e765dfe812\ncameras:\n{}",
        camera_in("cam0", 458.7)
    );
    let lens = radtan(&[-0.28, 0.07, 0.0003, -2.6e-06]);
    assert_eq!(read(&one).camera, camera((752, 480), [458.7, 457.5, 366.6, 249.3], lens));
    let two = format!("{one}{}", camera_in("cam1", 460.0));
    assert!(refusal(&two).contains("several cameras (cam0, cam1)"));
    assert_eq!(parse_camera_of(&two, "s", &of("x/cam1")).unwrap().camera.intrinsics().fx, 460.0);
}

#[test]
fn basalt() {
    let double = "{\n\t\"value0\": {\n\t\t\"T_imu_cam\": [{\"px\": 0.1}],\n\t\t\"intrinsics\": [{\"camera_type\": \"kb4\",\n\t\t\t\"intrinsics\": \
        {\"fx\": 190.9, \"fy\": 190.8, \"cx\": 254.9, \"cy\": 256.8, \"k1\": 0.003, \"k2\": 0.0007, \"k3\": -0.002, \"k4\": 0.0002}},\n\
        {\"camera_type\": \"ds\", \"intrinsics\": {\"fx\": 158.2, \"fy\": 158.2, \"cx\": 254.9, \"cy\": 256.8, \"xi\": -0.17, \
        \"alpha\": 0.59}}],\n\"resolution\": [[512, 511], [512, 512]]}}\n";
    let found = parse_camera_of(double, "s", &of("mav0/cam0")).unwrap();
    let lens = kb4([0.003, 0.0007, -0.002, 0.0002]);
    assert_eq!(found.camera, camera((512, 511), [190.9, 190.8, 254.9, 256.8], lens));
    let other = parse_camera_of(double, "s", &of("mav0/cam1")).unwrap_err().to_string();
    assert!(other.contains("Basalt's camera model \"ds\" is not supported"), "{other}");
    assert!(refusal(double).contains("several cameras"));
}

#[test]
fn opencv_xml() {
    let xml = "<?xml version=\"1.0\"?>\n<opencv_storage>\n<calibration_time>\"Sat 21 Nov 2020\"</calibration_time>\n\
        <image_width>640</image_width>\n<image_height>480</image_height>\n<camera_matrix type_id=\"opencv-matrix\">\n  <rows>3</rows>\n  \
        <cols>3</cols>\n  <dt>d</dt>\n  <data>\n    5.3e+02 0. 3.2e+02 0. 5.31e+02\n    2.4e+02 0. 0. 1.</data></camera_matrix>\n\
        <distortion_coefficients type_id=\"opencv-matrix\">\n  <rows>5</rows>\n  <cols>1</cols>\n  <dt>d</dt>\n  <data>\n    \
        -2.6e-01 -3.8e-02 1.7e-03 -2.8e-04 2.3e-01</data></distortion_coefficients>\n</opencv_storage>\n";
    let lens = radtan(&[-0.26, -0.038, 0.0017, -0.00028, 0.23]);
    assert_eq!(read(xml).camera, camera((640, 480), [530.0, 531.0, 320.0, 240.0], lens));
    assert_eq!(read(xml).format, CameraFormat::OpenCv);
    assert!(refusal("<?xml version=\"1.0\"?>\n<calibration/>").contains("not a camera calibration"));
    assert!(refusal("<?xml version=\"1.0\"?>\n<opencv_storage>").contains("XML"));
    for end in 0..xml.len() {
        let _ = parse_camera(&xml[..end], "cut");
    }
}

#[test]
fn nerfstudio_and_colmap_measure_from_the_corner_of_the_first_pixel() {
    let transforms = "{\"w\": 1080, \"h\": 1920, \"fl_x\": 1000.0, \"fl_y\": 1001.0, \"cx\": 540.0, \"cy\": 960.5, \"k1\": 0.03, \
        \"k2\": -0.02, \"p1\": 0.0004, \"p2\": 0.0003, \"camera_model\": \"OPENCV\", \"frames\": [{\"file_path\": \"a.png\", \
        \"transform_matrix\": [[1,0,0,0]]}]}";
    let lens = radtan(&[0.03, -0.02, 0.0004, 0.0003]);
    assert_eq!(read(transforms).camera, camera((1080, 1920), [1000.0, 1001.0, 539.5, 960.0], lens));
    let each = "{\"camera_model\": \"PINHOLE\", \"frames\": [{\"w\": 640, \"h\": 480, \"fl_x\": 500, \"fl_y\": 500, \"cx\": 320, \"cy\": 240}, \
        {\"w\": 640, \"h\": 480, \"fl_x\": 500, \"fl_y\": 500, \"cx\": 320, \"cy\": 240}]}";
    assert_eq!(read(each).camera, camera((640, 480), [500.0, 500.0, 319.5, 239.5], Distortion::None));
    let other = each.replacen("\"fl_x\": 500", "\"fl_x\": 510", 1);
    assert!(refusal(&other).contains("another than that of the images before"), "{}", refusal(&other));
    let ngp = "{\"camera_angle_x\": 1.5707963267948966, \"w\": 800, \"h\": 600, \"frames\": []}";
    assert_eq!(read(ngp).camera.intrinsics().fx.round(), 400.0);

    let head = "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n# Number of cameras: 1\n";
    for (row, expected) in [
        (
            "1 SIMPLE_RADIAL 640 480 500 320 240 -0.02",
            camera((640, 480), [500.0, 500.0, 319.5, 239.5], radtan(&[-0.02, 0.0, 0.0, 0.0])),
        ),
        (
            "1 PINHOLE 640 480 500 501 320 240",
            camera((640, 480), [500.0, 501.0, 319.5, 239.5], Distortion::None),
        ),
        (
            "3 OPENCV_FISHEYE 640 480 300 301 320 240 0.1 0.01 0 0",
            camera((640, 480), [300.0, 301.0, 319.5, 239.5], kb4([0.1, 0.01, 0.0, 0.0])),
        ),
        (
            "1 FOV 640 480 300 301 320 240 0.9",
            camera((640, 480), [300.0, 301.0, 319.5, 239.5], Distortion::Fov(Fov::new(&[0.9]).unwrap())),
        ),
        (
            "1 FULL_OPENCV 640 480 500 501 320 240 1 2 3 4 5 6 7 8",
            camera(
                (640, 480),
                [500.0, 501.0, 319.5, 239.5],
                radtan(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]),
            ),
        ),
    ] {
        let found = read(&format!("{head}{row}\n"));
        assert_eq!((found.camera, found.format), (expected, CameraFormat::Colmap), "{row}");
    }
    let two = format!("{head}1 PINHOLE 640 480 500 501 320 240\n2 PINHOLE 640 480 600 601 320 240\n");
    assert!(refusal(&two).contains("several cameras (1, 2)"));
    let named = CameraHint { name: Some("2".into()), ..CameraHint::default() };
    assert_eq!(parse_camera_of(&two, "s", &named).unwrap().camera.intrinsics().fx, 600.0);
    let same = format!("{head}1 PINHOLE 640 480 500 501 320 240\n2 PINHOLE 640 480 500 501 320 240\n");
    assert_eq!(read(&same).camera.intrinsics().fx, 500.0);
    let thin = refusal("1 THIN_PRISM_FISHEYE 640 480 1 2 3 4 5 6 7 8 9 10 11 12\n");
    assert!(thin.contains("COLMAP's model THIN_PRISM_FISHEYE is not supported"), "{thin}");
    assert!(refusal("1 OPENCV 640 480 500 501 320\n").contains("not the 10 numbers of OPENCV"));
}

#[test]
fn the_second_camera_of_a_chain_gets_its_own_numbers() {
    let cam = |name: &str, fx: f64| {
        format!(
            "{name}:\n  camera_model: pinhole\n  distortion_coeffs: [0.1, 0.01, 0.001, 0.002]\n  distortion_model: radtan\n  \
             intrinsics: [{fx}, 460.0, 360.0, 240.0]\n  resolution: [752, 480]\n  rostopic: /{name}/image_raw\n"
        )
    };
    let chain = cam("cam0", 458.0) + &cam("cam1", 470.0);
    let fx = |hint: &CameraHint| {
        parse_camera_of(&chain, "chain.yaml", hint).map(|file| file.camera.intrinsics().fx)
    };
    assert_eq!(fx(&of("mav0/cam1/data")).unwrap(), 470.0);
    let topic = CameraHint { topic: Some("/cam1/image_raw/compressed".into()), ..CameraHint::default() };
    assert_eq!(fx(&topic).unwrap(), 470.0);
    let refused = fx(&CameraHint::default()).unwrap_err().to_string();
    assert!(refused.contains("cam0 of /cam0/image_raw, cam1 of /cam1/image_raw"), "{refused}");
    // OpenVINS marks its chains as OpenCV's.
    let openvins = format!("%YAML:1.0 # need to specify the file type at the top!\n\n{chain}");
    assert_eq!(parse_camera_of(&openvins, "s", &of("cam0")).unwrap().format, CameraFormat::Kalibr);

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("chain.yaml");
    std::fs::write(&path, &chain).unwrap();
    let named = format!("{}:cam1", path.display());
    assert_eq!(read_camera(Path::new(&named)).unwrap().camera.intrinsics().fx, 470.0);
    let unknown = read_camera(Path::new(&format!("{}:cam5", path.display()))).unwrap_err().to_string();
    assert!(unknown.contains("chain.yaml:cam0"), "{unknown}");
}

#[test]
fn a_camera_info_that_says_it_is_none_or_shows_a_part() {
    let info = "height: 960\nwidth: 1280\ndistortion_model: ''\nd: [-0.3, 0.1, 0.001, 0.002, 0.0]\n\
        k: [1000, 0, 640, 0, 1000, 480, 0, 0, 1]\nbinning_x: 2\nbinning_y: 2\nroi:\n  x_offset: 320\n  y_offset: 240\n  \
        height: 480\n  width: 640\n  do_rectify: false\n";
    let expected = camera((320, 240), [500.0, 500.0, 160.0, 120.0], radtan(&[-0.3, 0.1, 0.001, 0.002]));
    assert_eq!(read(info).camera.intrinsics(), expected.intrinsics());
    assert!(!read(info).camera.distortion().is_identity());
    let zero = info.replace("k: [1000, 0, 640, 0, 1000, 480, 0, 0, 1]", "k: [0, 0, 0, 0, 0, 0, 0, 0, 0]");
    assert!(refusal(&zero).contains("not calibrated"), "{}", refusal(&zero));
}
