//! Markers until OpenCV 4.6, in its contributed module `aruco`.

use super::{Board, Marker, Settings, numbered_corners, numbered_markers};
use nalgebra::Vector2;
use opencv::aruco::{
    CharucoBoard, DetectorParameters, Dictionary, detect_markers, get_predefined_dictionary_i32,
    interpolate_corners_charuco_def,
};
use opencv::core::{Mat, Point2f, Ptr, Vector, no_array};
use opencv::prelude::*;

/// Dictionaries that there are.
pub const DICTIONARY_COUNT: usize = 21;

type Found = (Vector<Vector<Point2f>>, Vector<i32>);

/// The markers in an image.
///
/// # Errors
/// When OpenCV fails.
pub fn markers(image: &Mat, settings: &Settings) -> opencv::Result<Vec<Marker>> {
    let (corners, numbers) = found(image, settings, &get_predefined_dictionary_i32(settings.dictionary)?)?;
    Ok(numbered_markers(&corners, &numbers))
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
    let (markers, ids) = found(image, settings, &dictionary)?;
    if ids.is_empty() {
        return Ok(Vec::new());
    }
    let board = CharucoBoard::create(board.columns, board.rows, 1.0, board.marker, &dictionary)?;
    let (mut corners, mut numbers) = (Vector::<Point2f>::new(), Vector::<i32>::new());
    interpolate_corners_charuco_def(&markers, &ids, image, &board, &mut corners, &mut numbers)?;
    Ok(numbered_corners(&corners, &numbers))
}

fn found(image: &Mat, settings: &Settings, dictionary: &Ptr<Dictionary>) -> opencv::Result<Found> {
    let mut parameters = DetectorParameters::create()?;
    if let Some(border) = settings.border {
        parameters.set_marker_border_bits(border);
        parameters.set_adaptive_thresh_win_size_max(33);
        parameters.set_adaptive_thresh_win_size_step(6);
        parameters.set_min_marker_perimeter_rate(0.02);
    }
    let (mut corners, mut ids) = (Vector::<Vector<Point2f>>::new(), Vector::<i32>::new());
    detect_markers(image, dictionary, &mut corners, &mut ids, &parameters, &mut no_array())?;
    Ok((corners, ids))
}
