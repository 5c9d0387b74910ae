use super::*;
use nalgebra::Vector6;

const CAMERA: Pinhole = Pinhole { width: 640, height: 480, fx: 420.0, fy: 425.0, cx: 319.5, cy: 239.5 };
/// Metres of a map unit.
const METRES: f64 = 2.5;

fn board(text: &str) -> Board {
    text.parse().expect("a board")
}

/// Numbers between −1 and 1 that look drawn.
fn noise(seed: usize) -> f64 {
    let x = (seed as f64 * 12.9898).sin() * 43_758.547;
    2.0 * (x - x.floor()) - 1.0
}

/// What cameras along a way of `reach` metres see of a board about 1.2 m before them, in a world of map units that is turned
/// and moved; corners are off by up to `pixels`.
fn sightings(board: &Board, views: usize, reach: f64, pixels: f64) -> Vec<Sighting> {
    let camera_from_board = Se3::exp(&Vector6::new(-0.3, -0.2, 1.2, 0.3, -0.35, 0.1));
    let world = Se3::exp(&Vector6::new(0.4, 2.0, -1.0, 0.7, 0.1, -0.5));
    (0..views)
        .map(|i| {
            let s = i as f64 / (views - 1) as f64 - 0.5;
            let twist = Vector6::new(reach * s, 0.2 * reach * (5.0 * s).sin(), 0.0, 0.05 * s, 0.1 * s, 0.02);
            let first_from_camera = Se3::exp(&twist);
            let mut pose = world * first_from_camera;
            pose.translation /= METRES;
            let corner = |(index, point): (usize, &Vector3<f64>)| {
                let seen = CAMERA.project(&(first_from_camera.inverse() * camera_from_board * *point));
                let off = Vector2::new(noise(1000 * i + 2 * index), noise(1000 * i + 2 * index + 1)) * pixels;
                Corner { index, pixel: seen + off }
            };
            let corners = board.points().iter().enumerate().map(corner).collect();
            Sighting { world_from_camera: pose, camera: CAMERA, corners }
        })
        .collect()
}

#[test]
fn boards_of_every_kind_tell_the_unit() {
    for text in
        ["chessboard:9x6:0.08", "charuco:7x5:0.1:0.07", "aprilgrid:4x3:0.12:0.3", "aprilgrid:1x1:0.5:0.3"]
    {
        let board = board(text);
        let exact = scale_by_board(&board, &sightings(&board, 8, 0.8, 0.0)).expect(text);
        assert!((exact.metres / METRES - 1.0).abs() < 1e-6, "{text}: {exact}");
        assert!(exact.deviation < 1e-4 && exact.residual < 1e-3, "{text}: {exact}");
        let noisy = scale_by_board(&board, &sightings(&board, 12, 0.8, 0.5)).expect(text);
        let error = (noisy.metres / METRES - 1.0).abs();
        assert!(error < 0.01 && error < 4.0 * noisy.deviation, "{text}: {noisy}");
    }
}

/// Found the other way round in every second image, as it may be of a board that looks the same after half a turn, or a
/// quarter.
#[test]
fn a_chessboard_may_be_numbered_from_either_end() {
    for (text, turned) in [("chessboard:9x6:0.08", 53usize), ("chessboard:5x5:0.1", 24)] {
        let board = board(text);
        let mut views = sightings(&board, 9, 0.8, 0.1);
        for view in views.iter_mut().skip(1).step_by(2) {
            view.corners.iter_mut().for_each(|corner| corner.index = turned - corner.index);
        }
        for view in views.iter_mut().skip(2).step_by(4).filter(|_| turned == 24) {
            let quarter = |index: usize| index % 5 * 5 + (4 - index / 5);
            view.corners.iter_mut().for_each(|corner| corner.index = quarter(corner.index));
        }
        let found = scale_by_board(&board, &views).expect(text);
        assert!((found.metres / METRES - 1.0).abs() < 0.005, "{text}: {found}");
    }
}

#[test]
fn corners_found_wrongly_do_not_count_much() {
    let board = board("aprilgrid:4x3:0.12:0.3");
    let mut views = sightings(&board, 10, 0.8, 0.2);
    views[3].corners.iter_mut().take(8).for_each(|corner| corner.pixel += Vector2::new(60.0, -40.0));
    let found = scale_by_board(&board, &views).expect("a scale");
    assert!((found.metres / METRES - 1.0).abs() < 0.01, "{found}");
}

#[test]
fn what_does_not_determine_the_scale_is_refused() {
    let grid = board("aprilgrid:4x3:0.12:0.3");
    let other = board("aprilgrid:4x3:0.12:0.8");
    let refused = |board: &Board, views: &[Sighting], word: &str| {
        let error = scale_by_board(board, views).expect_err(word).to_string();
        assert!(error.contains(word) && error.contains("hint"), "{error}");
    };
    refused(&grid, &sightings(&grid, 2, 0.8, 0.1), "2 keyframes show");
    refused(&grid, &[], "0 keyframes show");
    refused(&grid, &sightings(&grid, 8, 0.0, 0.2), "scale");
    refused(&grid, &sightings(&grid, 8, 0.001, 0.3), "the scale");
    refused(&grid, &sightings(&other, 8, 0.8, 0.1), "another form");
    let mut few = sightings(&grid, 8, 0.8, 0.1);
    few.iter_mut().skip(1).for_each(|view| view.corners.truncate(3));
    refused(&grid, &few, "1 keyframes show");
}
