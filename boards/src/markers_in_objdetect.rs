//! Markers from OpenCV 4.7 on, in its module `objdetect`.

use super::{Board, Settings, vector};
use nalgebra::Vector2;
use opencv::core::{Mat, Point2f, Size, Vector, no_array};
use opencv::objdetect::{
    ArucoDetector, CharucoBoard, CharucoDetector, DetectorParameters, RefineParameters,
    get_predefined_dictionary_i32,
};
use opencv::prelude::*;

/// Dictionaries that there are.
pub const DICTIONARY_COUNT: usize = 22;

/// A marker's number and its corners.
pub type Marker = (usize, [Vector2<f64>; 4]);

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
    let marker = |(quad, id): (Vector<Point2f>, i32)| {
        let quad: Vec<Vector2<f64>> = quad.iter().map(|point| vector(&point)).collect();
        Some((usize::try_from(id).ok()?, quad.try_into().ok()?))
    };
    Ok(corners.iter().zip(ids.iter()).filter_map(marker).collect())
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
    let pairs = corners.iter().zip(numbers.iter());
    Ok(pairs.filter_map(|(at, id)| Some((usize::try_from(id).ok()?, vector(&at)))).collect())
}
