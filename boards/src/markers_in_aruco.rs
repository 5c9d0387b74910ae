//! Markers until OpenCV 4.6, in its contributed module `aruco`.

use super::{Board, Settings, vector};
use nalgebra::Vector2;
use opencv::aruco::{
    CharucoBoard, DetectorParameters, Dictionary, detect_markers, get_predefined_dictionary_i32,
    interpolate_corners_charuco_def,
};
use opencv::core::{Mat, Point2f, Ptr, Vector, no_array};
use opencv::prelude::*;

/// Dictionaries that there are.
pub const DICTIONARY_COUNT: usize = 21;

/// A marker's number and its corners.
pub type Marker = (usize, [Vector2<f64>; 4]);
type Found = (Vector<Vector<Point2f>>, Vector<i32>);

/// The markers in an image.
///
/// # Errors
/// When OpenCV fails.
pub fn markers(image: &Mat, settings: &Settings) -> opencv::Result<Vec<Marker>> {
    let (corners, numbers) = found(image, settings, &get_predefined_dictionary_i32(settings.dictionary)?)?;
    let marker = |(quad, id): (Vector<Point2f>, i32)| {
        let quad: Vec<Vector2<f64>> = quad.iter().map(|point| vector(&point)).collect();
        Some((usize::try_from(id).ok()?, quad.try_into().ok()?))
    };
    Ok(corners.iter().zip(numbers.iter()).filter_map(marker).collect())
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
    let pairs = corners.iter().zip(numbers.iter());
    Ok(pairs.filter_map(|(at, id)| Some((usize::try_from(id).ok()?, vector(&at)))).collect())
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
