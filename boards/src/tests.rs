use super::drawn::drawn;
use super::*;
use nalgebra::Vector2;

/// Boards of each kind, in images of 640 × 480 pixels.
fn boards() -> Vec<(Board, f64)> {
    let board = |text: &str| text.parse().expect("a board");
    vec![
        (board("chessboard:9x6:0.03"), 1500.0),
        (board("charuco:7x5:0.04:0.03"), 1500.0),
        (board("charuco:6x8:0.03:0.02:DICT_6X6_250"), 1600.0),
        (board("aprilgrid:6x6:0.088:0.3"), 550.0),
        (board("aprilgrid:1x1:0.16:1"), 1000.0),
    ]
}

/// How far a corner may be from where it is, pixels: in images that are sharp to the pixel, as drawn ones are, OpenCV's
/// `cornerSubPix` and what is made after it are off so far.
const MAX_OFF: f64 = 0.15;

/// Fails unless `found` are nearly all of the corners, each where it is.
fn assert_right(board: &Board, found: &[Corner], truth: &[Vector2<f64>], who: &str) {
    assert!(
        found.len() * 10 >= truth.len() * 9,
        "{board}: {who}: {} of {} corners",
        found.len(),
        truth.len()
    );
    for corner in found {
        let off = (corner.pixel - truth[corner.index]).norm();
        assert!(off < MAX_OFF, "{board}: {who}: corner {} is {off:.2} px off", corner.index);
    }
}

#[test]
fn drawn_boards_are_found_with_their_corners_in_order() {
    for (board, scale) in boards() {
        let (image, truth) = drawn(&board, (640, 480), scale);
        let detector = Detector::new(&board, None).unwrap();
        let own = match &detector {
            Detector::Chessboard(detector) => detector.corners(&image),
            Detector::Charuco(detector) => detector.corners(&image),
            Detector::AprilGrid(detector) => detector.corners(&image),
        };
        assert_right(&board, &own, &truth, "loopbox");
    }
}

#[cfg(feature = "opencv")]
#[test]
fn opencv_finds_the_same_corners() {
    for (board, scale) in boards() {
        let (image, truth) = drawn(&board, (640, 480), scale);
        let detector = Detector::new(&board, None).unwrap();
        assert_right(&board, &by_opencv::corners(&detector, &image).unwrap(), &truth, "OpenCV");
    }
}

#[test]
fn corners_that_are_left_out_are_found_between_the_others_unless_they_are_covered() {
    for (name, radius, plain) in [("chessboard:9x6:0.03", 5, 0.25), ("charuco:7x5:0.04:0.03", 3, 0.08)] {
        let board: Board = name.parse().unwrap();
        let (mut image, truth) = drawn(&board, (640, 480), 1500.0);
        let (columns, rows) = if matches!(board, Board::Chessboard { .. }) { (9, 6) } else { (6, 4) };
        let lattice = lattice::Lattice { columns, rows, plain };
        let covered = columns + 2;
        let at = truth[covered];
        for (dx, dy) in (-12..=12).flat_map(|dy| (-12..=12).map(move |dx| (dx, dy))) {
            image.set((at.x as i32 + dx) as usize, (at.y as i32 + dy) as usize, 120);
        }
        let left_out = [0, 2, covered, columns * rows - 1];
        let rest = truth.iter().copied().enumerate().filter(|(index, _)| !left_out.contains(index));
        let mut corners: std::collections::BTreeMap<usize, Vector2<f64>> = rest.collect();
        lattice.complete(&image, &mut corners, radius);
        assert!(!corners.contains_key(&covered), "{name}");
        for index in left_out.into_iter().filter(|index| *index != covered) {
            let off = (corners[&index] - truth[index]).norm();
            assert!(off < MAX_OFF, "{name}: corner {index} is {off:.2} px off");
        }
    }
}

#[test]
fn no_board_is_found_where_there_is_none_and_what_is_there_is_reported() {
    let (image, _) = drawn(&"chessboard:9x6:0.03".parse().unwrap(), (640, 480), 1500.0);
    let output = |board: &str| {
        let detector = Detector::new(&board.parse().unwrap(), None).unwrap();
        assert!(detector.corners(&image).unwrap().is_empty(), "{board}");
        detector.what_else(std::slice::from_ref(&image))
    };
    assert!(output("chessboard:10x7:0.03").contains("9×6 inner corners"));
    assert!(output("aprilgrid:6x6:0.088:0.3").contains("no tag 36h11"));
    assert!(output("charuco:7x5:0.04:0.03").contains("no markers"));
    let (image, _) = drawn(&"charuco:7x5:0.04:0.03".parse().unwrap(), (640, 480), 1500.0);
    let other = Detector::new(&"charuco:7x5:0.04:0.03:DICT_5X5_100".parse().unwrap(), None).unwrap();
    assert!(other.corners(&image).unwrap().is_empty());
    let output = other.what_else(std::slice::from_ref(&image));
    assert!(output.contains("markers of DICT_4X4_"), "{output}");
    let detector = Detector::new(&"charuco:7x5:0.04:0.03".parse().unwrap(), None).unwrap();
    assert!(detector.what_else(&[mirrored(&image)]).contains("mirrored"));
}

#[test]
fn a_board_that_cannot_be_is_refused() {
    let refused =
        |board: &str| Detector::new(&board.parse().unwrap(), None).err().expect("refused").to_string();
    assert!(refused("charuco:7x5:0.04:0.03:DICT_9X9").contains("it is one of DICT_"));
    assert!(refused("charuco:20x20:0.04:0.03:DICT_4X4_50").contains("needs 200 markers"));
}
