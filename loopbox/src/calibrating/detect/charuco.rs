//! ChArUco boards.

use super::sub_pixel::vector;
use super::{mat, mirrored};
use anyhow::{Context, Result, bail};
use calib::{Board, Corner};
use geometry::GrayImage;
use opencv::aruco::{
    CharucoBoard, DetectorParameters, Dictionary, detect_markers, get_predefined_dictionary_i32,
    interpolate_corners_charuco_def,
};
use opencv::core::{Mat, Point2f, Ptr, Vector, no_array};
use opencv::prelude::*;

/// The dictionaries in OpenCV's order.
const DICTIONARIES: [&str; 21] = [
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
];

/// A ChArUco board as OpenCV knows it.
pub struct Charuco {
    dictionary: i32,
    columns: i32,
    rows: i32,
    square: f32,
    marker: f32,
}

impl Charuco {
    pub fn new(board: &Board) -> Result<Self> {
        let Board::Charuco { columns, rows, square, marker, dictionary } = board else {
            bail!("{board} is no ChArUco board");
        };
        let index = DICTIONARIES.iter().position(|name| name == dictionary).with_context(|| {
            format!(
                "--board {board}: no dictionary {dictionary}\nhint: it is one of {}",
                DICTIONARIES.join(" ")
            )
        })?;
        let (markers, has) = (columns * rows / 2, markers_in(index as i32)?);
        if markers > has {
            bail!(
                "--board {board}: needs {markers} markers, {dictionary} has {has}\nhint: name the one it was printed with"
            );
        }
        Ok(Self {
            dictionary: index as i32,
            columns: *columns as i32,
            rows: *rows as i32,
            square: *square as f32,
            marker: *marker as f32,
        })
    }

    pub fn corners(&self, image: &GrayImage) -> Result<Vec<Corner>> {
        let pixels = mat(image)?;
        let dictionary = get_predefined_dictionary_i32(self.dictionary)?;
        let (markers, ids) = markers(&pixels, &dictionary)?;
        if ids.is_empty() {
            return Ok(Vec::new());
        }
        let board = CharucoBoard::create(self.columns, self.rows, self.square, self.marker, &dictionary)?;
        let (mut corners, mut numbers) = (Vector::<Point2f>::new(), Vector::<i32>::new());
        interpolate_corners_charuco_def(&markers, &ids, &pixels, &board, &mut corners, &mut numbers)?;
        let pairs = corners.iter().zip(numbers.iter());
        Ok(pairs
            .filter_map(|(at, id)| Some(Corner { index: usize::try_from(id).ok()?, pixel: vector(&at) }))
            .collect())
    }

    pub fn what_else(&self, images: &[GrayImage]) -> Result<String> {
        let count = |index: i32, image: &GrayImage| -> Result<usize> {
            Ok(markers(&mat(image)?, &get_predefined_dictionary_i32(index)?)?.1.len())
        };
        for image in images {
            if count(self.dictionary, &mirrored(image))? >= 3 {
                return Ok("but its markers are there in the mirrored image\nhint: the images are mirrored (or the board was \
                           printed so): switch mirroring off in the camera"
                    .into());
            }
            for (index, name) in DICTIONARIES.iter().enumerate() {
                if index as i32 != self.dictionary && count(index as i32, image)? >= 4 {
                    return Ok(format!("markers of {name} are seen instead\nhint: end --board with :{name}"));
                }
            }
        }
        Ok("no markers of another dictionary either\nhint: check that the board is large and sharp in the images, and not \
            mirrored"
            .into())
    }
}

fn markers_in(dictionary: i32) -> Result<usize> {
    Ok(get_predefined_dictionary_i32(dictionary)?.bytes_list().rows().max(0) as usize)
}

fn markers(image: &Mat, dictionary: &Ptr<Dictionary>) -> Result<(Vector<Vector<Point2f>>, Vector<i32>)> {
    let (mut corners, mut ids) = (Vector::<Vector<Point2f>>::new(), Vector::<i32>::new());
    let parameters = DetectorParameters::create()?;
    detect_markers(image, dictionary, &mut corners, &mut ids, &parameters, &mut no_array())?;
    Ok((corners, ids))
}
