//! Boards that OpenCV finds. Their corners' exact places are found as those of others are.

use super::Detector;
use super::april_grid::{BORDERS, ORDER};
use super::tag::Tag;
use anyhow::Result;
use calib::Corner;
use geometry::GrayImage;
use markers::{DICTIONARY_COUNT, charuco_corners, markers};
use nalgebra::Vector2;
use opencv::boxed_ref::BoxedRef;
use opencv::calib3d::{
    CALIB_CB_ADAPTIVE_THRESH, CALIB_CB_FAST_CHECK, CALIB_CB_NORMALIZE_IMAGE, find_chessboard_corners,
};
use opencv::core::{Mat, Point2f, Size, Vector};
use opencv::prelude::*;
use std::collections::BTreeMap;

#[cfg_attr(markers_in_objdetect, path = "markers_in_objdetect.rs")]
#[cfg_attr(not(markers_in_objdetect), path = "markers_in_aruco.rs")]
mod markers;

/// OpenCV's number of the dictionary of tags 36h11.
const APRIL_36H11: i32 = 20;
/// The dictionaries in OpenCV's order.
const DICTIONARIES: [&str; 22] = [
    "DICT_4X4_50",
    "DICT_4X4_100",
    "DICT_4X4_250",
    "DICT_4X4_1000",
    "DICT_5X5_50",
    "DICT_5X5_100",
    "DICT_5X5_250",
    "DICT_5X5_1000",
    "DICT_6X6_50",
    "DICT_6X6_100",
    "DICT_6X6_250",
    "DICT_6X6_1000",
    "DICT_7X7_50",
    "DICT_7X7_100",
    "DICT_7X7_250",
    "DICT_7X7_1000",
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_16H5",
    "DICT_APRILTAG_25H9",
    "DICT_APRILTAG_36H10",
    "DICT_APRILTAG_36H11",
    "DICT_ARUCO_MIP_36H12",
];

/// How markers are looked for.
struct Settings {
    /// OpenCV's number of the dictionary.
    dictionary: i32,
    /// Width of the black border in bits, and smaller markers and larger thresholds than by default; else the defaults.
    border: Option<i32>,
}

/// A marker's number and its corners.
type Marker = (usize, [Vector2<f64>; 4]);

/// A ChArUco board as OpenCV is told of it.
struct Board {
    columns: i32,
    rows: i32,
    /// Side of a marker as a share of that of a square.
    marker: f32,
}

/// The corners of a board in an image, by OpenCV.
///
/// # Errors
/// When OpenCV fails.
pub fn corners(detector: &Detector, image: &GrayImage) -> Result<Vec<Corner>> {
    let pixels = mat(image)?;
    match detector {
        Detector::Chessboard(board) => {
            let size = Size::new(board.columns as i32, board.rows as i32);
            let flags = CALIB_CB_ADAPTIVE_THRESH | CALIB_CB_NORMALIZE_IMAGE | CALIB_CB_FAST_CHECK;
            let mut found = Vector::<Point2f>::new();
            let whole = find_chessboard_corners(&pixels, size, &mut found, flags)?;
            let rough: BTreeMap<usize, Vector2<f64>> =
                found.iter().map(|point| vector(&point)).enumerate().collect();
            Ok(if whole { board.measured(image, rough) } else { Vec::new() })
        }
        Detector::Charuco(board) => {
            let name = board.dictionary_name();
            let Some(dictionary) =
                DICTIONARIES[..DICTIONARY_COUNT].iter().position(|known| known.eq_ignore_ascii_case(name))
            else {
                return Ok(Vec::new());
            };
            let settings = Settings { dictionary: dictionary as i32, border: None };
            let (columns, rows, marker) = board.shape();
            let shape = Board { columns: columns as i32, rows: rows as i32, marker: marker as f32 };
            Ok(board.measured(image, charuco_corners(&pixels, &settings, &shape)?.into_iter().collect()))
        }
        Detector::AprilGrid(grid) => {
            for border in BORDERS {
                let settings = Settings { dictionary: APRIL_36H11, border: Some(border as i32) };
                let corners =
                    grid.completed(image, border, unambiguous(markers(&pixels, &settings)?, grid.count()));
                if !corners.is_empty() {
                    return Ok(corners);
                }
            }
            Ok(Vec::new())
        }
    }
}

/// Tags with numbers below `count`, none that is there twice.
fn unambiguous(markers: Vec<Marker>, count: usize) -> BTreeMap<usize, Tag> {
    let (mut tags, mut twice) = (BTreeMap::new(), Vec::new());
    for (id, quad) in markers.into_iter().filter(|(id, _)| *id < count) {
        if tags.insert(id, ORDER.map(|k| quad[k])).is_some() {
            twice.push(id);
        }
    }
    tags.retain(|id, _| !twice.contains(id));
    tags
}

/// Markers that OpenCV found, by their corners and numbers.
fn numbered_markers(corners: &Vector<Vector<Point2f>>, ids: &Vector<i32>) -> Vec<Marker> {
    let marker = |(quad, id): (Vector<Point2f>, i32)| {
        let quad: Vec<Vector2<f64>> = quad.iter().map(|point| vector(&point)).collect();
        Some((usize::try_from(id).ok()?, quad.try_into().ok()?))
    };
    corners.iter().zip(ids.iter()).filter_map(marker).collect()
}

/// Corners of a board that OpenCV found, with their numbers.
fn numbered_corners(corners: &Vector<Point2f>, ids: &Vector<i32>) -> Vec<(usize, Vector2<f64>)> {
    let pairs = corners.iter().zip(ids.iter());
    pairs.filter_map(|(at, id)| Some((usize::try_from(id).ok()?, vector(&at)))).collect()
}

/// OpenCV's view of an image's pixels.
fn mat(image: &GrayImage) -> opencv::Result<Mat> {
    let flat = Mat::from_slice(image.data())?;
    let shaped: BoxedRef<Mat> = flat.reshape(1, image.height() as i32)?;
    shaped.try_clone()
}

/// A point of OpenCV's.
fn vector(point: &Point2f) -> Vector2<f64> {
    Vector2::new(f64::from(point.x), f64::from(point.y))
}
