//! Maps brought to metres by a board that stands in the recording.

use crate::support::{Case, Outcome, RATE, loopbox};
use eval::{AlignMode, DEFAULT_MAX_DIFF, align, associate, read_trajectory};
use geometry::Se3;
use loopbox_tests::{Recording, Texture, World, trajectory};
use nalgebra::{UnitQuaternion, Vector3};
use std::path::Path;

/// A chessboard of 9 × 6 inner corners, twelve squares wide with its margin.
fn chessboard() -> Texture {
    let square = Texture::SIZE as f32 / 12.0;
    Texture::painted(|x, y| {
        let (column, row) = ((x as f32 / square).floor() as i32 - 1, (y as f32 / square).floor() as i32 - 2);
        let black = (0..10).contains(&column) && (0..7).contains(&row) && (column + row) % 2 == 0;
        if black { 25.0 } else { 225.0 }
    })
}

/// The tag 36h11 with number 0 (Olson 2011), ten cells wide with its black border and a white margin.
fn tag() -> Texture {
    const BITS: u64 = 0xd5d628584;
    let cell = Texture::SIZE as f32 / 10.0;
    Texture::painted(|x, y| {
        let (column, row) = ((x as f32 / cell).floor() as i32 - 1, (y as f32 / cell).floor() as i32 - 1);
        let inside = (0..8).contains(&column) && (0..8).contains(&row);
        let coded = (1..7).contains(&column) && (1..7).contains(&row);
        let white = || BITS >> (35 - ((row - 1) * 6 + column - 1)) & 1 == 1;
        if (inside && !coded) || (coded && !white()) { 25.0 } else { 225.0 }
    })
}

/// A yard in which a poster of `side` metres stands somewhat turned before the boxes, seen by a hand-held camera.
fn recording(texture: Texture, side: f64) -> Case {
    let mut world = World::yard(1);
    let rotation = UnitQuaternion::from_euler_angles(0.1, -0.3, 0.05);
    world.put_up(texture, Se3::new(rotation, Vector3::new(-0.2, -1.2, 7.7)), side);
    Case::new(&Recording::render(&world, Recording::SMALL_CAMERA, &trajectory::hand_held(60, 0.4), RATE))
}

fn export(case: &Case, board: &str, out: &Path) -> Outcome {
    let mut command = loopbox();
    command.arg("export").arg(case.out()).args(["--board", board, "--tum"]).arg(out);
    Outcome::of(command)
}

/// How many times as long the true way is as the exported one.
fn scale(case: &Case, trajectory: &Path) -> f64 {
    let read = |path: &Path| read_trajectory(path).expect("a trajectory");
    let truth = read(&case.source().join("groundtruth.txt"));
    let pairs = associate(&read(trajectory), &truth, DEFAULT_MAX_DIFF).expect("times overlap");
    align(&pairs, AlignMode::Sim3).expect("a trajectory of some extent").0.scale
}

#[test]
fn a_board_of_known_size_gives_metres() {
    for (texture, side, board, other) in [
        (chessboard(), 1.8, "chessboard:9x6:0.15", "chessboard:7x4:0.15"),
        (tag(), 1.0, "aprilgrid:1x1:0.8:1", "charuco:7x5:0.04:0.03"),
    ] {
        let case = recording(texture, side);
        case.run(&[]).assert_success();
        let out = case.out().join("metric.txt");
        let outcome = export(&case, board, &out);
        outcome.assert_success();
        outcome.assert_says(&["a unit of the map is", "keyframes"]);
        let scale = scale(&case, &out);
        assert!((scale - 1.0).abs() < 0.01, "{board}: {scale}\n{outcome}");
        export(&case, other, &out).assert_refused(&["no keyframe", "hint"]);
    }
}

#[test]
fn a_board_is_one_of_those_that_are_known() {
    let case = Case::empty();
    export(&case, "poster:3x3:1", &case.out().join("metric.txt")).assert_refused(&["no board", "chessboard"]);
}
