//! Markers from OpenCV 4.7 on, in its module `objdetect`.

use super::{Board, Marker, Settings, numbered_corners, numbered_markers};
use nalgebra::Vector2;
use opencv::core::{Mat, Point2f, Size, Vector, no_array};
use opencv::objdetect::{
    ArucoDetector, CharucoBoard, CharucoDetector, DetectorParameters, RefineParameters,
    get_predefined_dictionary_i32,
};
use opencv::prelude::*;

/// Dictionaries that there are.
pub const DICTIONARY_COUNT: usize = 22;

/// The markers in an image.
///
/// # Errors
/// When OpenCV fails.
pub fn markers(image: &Mat, settings: &Settings) -> opencv::Result<Vec<Marker>> {
    let dictionary = get_predefined_dictionary_i32(settings.dictionary)?;
    let mut parameters = DetectorParameters::default()?;
    if let Some(border) = settings.border {
        parameters.set_marker_border_bits(border);
        parameters.set_adaptive_thresh_win_size_max(33);
        parameters.set_adaptive_thresh_win_size_step(6);
        parameters.set_min_marker_perimeter_rate(0.02);
    }
    let detector = ArucoDetector::new(&dictionary, &parameters, RefineParameters::new_def()?)?;
    let (mut corners, mut ids) = (Vector::<Vector<Point2f>>::new(), Vector::<i32>::new());
    detector.detect_markers(image, &mut corners, &mut ids, &mut no_array())?;
    Ok(numbered_markers(&corners, &ids))
}

/// The corners of a ChArUco board with their numbers.
///
/// # Errors
/// When OpenCV fails.
pub fn charuco_corners(
    image: &Mat,
    settings: &Settings,
    board: &Board,
) -> opencv::Result<Vec<(usize, Vector2<f64>)>> {
    let dictionary = get_predefined_dictionary_i32(settings.dictionary)?;
    let board = CharucoBoard::new_def(Size::new(board.columns, board.rows), 1.0, board.marker, &dictionary)?;
    let detector = CharucoDetector::new_def(&board)?;
    let (mut corners, mut numbers) = (Vector::<Point2f>::new(), Vector::<i32>::new());
    detector.detect_board_def(image, &mut corners, &mut numbers)?;
    Ok(numbered_corners(&corners, &numbers))
}
