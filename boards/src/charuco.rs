//! ChArUco boards.

use super::lattice::Lattice;
use super::{mirrored, view};
use anyhow::{Context, Result, anyhow, bail};
use calib::{Board, Corner};
use calib_targets_charuco::{
    CharucoBoardSpec, CharucoDetection, CharucoDetector, CharucoParams, Dictionary, builtins,
};
use chess_corners::UpscaleConfig;
use geometry::GrayImage;
use nalgebra::Vector2;
use std::collections::BTreeMap;

/// Part of the gap between a corner and the markers beside it that is looked at around each corner.
const WINDOW: f64 = 0.8;

/// A ChArUco board as OpenCV draws it since 4.6: black is the first square.
pub struct Charuco {
    columns: usize,
    dictionary: Dictionary,
    rows: usize,
    /// Side of a marker as a share of that of a square.
    marker: f64,
    /// Of the image as it is, and of one twice as large, which finds some boards of small squares that the first does not.
    detectors: Box<[CharucoDetector; 2]>,
}

impl Charuco {
    /// A detector of this board.
    ///
    /// # Errors
    /// When the dictionary is not known, or has fewer markers than the board.
    pub fn new(board: &Board) -> Result<Self> {
        let Board::Charuco { columns, rows, square, marker, dictionary: name } = board else {
            bail!("{board} is no ChArUco board");
        };
        let known = builtins::BUILTIN_DICTIONARY_NAMES.iter().find(|known| known.eq_ignore_ascii_case(name));
        let dictionary = known.and_then(|known| builtins::builtin_dictionary(known)).with_context(|| {
            format!(
                "--board {board}: no dictionary {name}\nhint: it is one of {}",
                builtins::BUILTIN_DICTIONARY_NAMES.join(" ")
            )
        })?;
        let (markers, has) = (columns * rows / 2, dictionary.codes().len());
        if markers > has {
            bail!(
                "--board {board}: needs {markers} markers, {name} has {has}\nhint: name the one it was printed with"
            );
        }
        let marker = marker / square;
        let detector = |upscale| {
            let made = detector((*columns, *rows), marker, dictionary, upscale);
            made.map_err(|problem| anyhow!("--board {board}: {problem}"))
        };
        let detectors = Box::new([detector(UpscaleConfig::Disabled)?, detector(UpscaleConfig::Fixed(2))?]);
        Ok(Self { columns: *columns, rows: *rows, dictionary, marker, detectors })
    }

    /// The corners that are seen, by their numbers.
    pub fn corners(&self, image: &GrayImage) -> Vec<Corner> {
        let Some(found) = self.detectors.iter().find_map(|detector| seen(detector, image)) else {
            return Vec::new();
        };
        let corner = |i: usize| {
            let at = found.corners[i].position;
            (found.corners[i].id as usize, Vector2::new(f64::from(at.x), f64::from(at.y)))
        };
        self.measured(image, (0..found.corners.len()).map(corner).collect())
    }

    /// The corners near those found and those that they lead to, to a fraction of a pixel.
    pub fn measured(&self, image: &GrayImage, rough: BTreeMap<usize, Vector2<f64>>) -> Vec<Corner> {
        let gap = 0.5 * (1.0 - self.marker);
        let lattice =
            Lattice { columns: self.columns - 1, rows: self.rows - 1, plain: (0.7 * gap).min(0.25) };
        let radius = (WINDOW * gap * lattice.least_distance(&rough)).round().clamp(2.0, 11.0) as usize;
        lattice.measured(image, rough, radius)
    }

    /// The dictionary by OpenCV's name.
    #[cfg(feature = "opencv")]
    pub fn dictionary_name(&self) -> &'static str {
        self.dictionary.name()
    }

    /// Squares of a row, rows of squares, and the side of a marker as a share of that of a square.
    #[cfg(feature = "opencv")]
    pub fn shape(&self) -> (usize, usize, f64) {
        (self.columns, self.rows, self.marker)
    }

    /// What these images show instead, for people.
    pub fn what_else(&self, images: &[GrayImage]) -> String {
        let markers = |detector: &CharucoDetector, image: &GrayImage| {
            seen(detector, image).map_or(0, |found| found.markers.len())
        };
        if images.iter().any(|image| markers(&self.detectors[0], &mirrored(image)) >= 3) {
            return "but its markers are there in the mirrored image\nhint: the images are mirrored (or the board was printed \
                    so): switch mirroring off in the camera"
                .into();
        }
        let others =
            builtins::BUILTIN_DICTIONARY_NAMES.iter().filter(|name| **name != self.dictionary.name());
        for name in others {
            let Some(dictionary) = builtins::builtin_dictionary(name) else { continue };
            let Ok(other) =
                detector((self.columns, self.rows), self.marker, dictionary, UpscaleConfig::Disabled)
            else {
                continue;
            };
            if images.iter().any(|image| markers(&other, image) >= 4) {
                return format!("markers of {name} are seen instead\nhint: end --board with :{name}");
            }
        }
        "no markers of another dictionary either\nhint: check the board's columns and rows, that it is large and sharp in the \
         images, and not mirrored"
            .into()
    }
}

fn detector(
    (columns, rows): (usize, usize),
    marker: f64,
    dictionary: Dictionary,
    upscale: UpscaleConfig,
) -> Result<CharucoDetector> {
    let (columns, rows) = (u32::try_from(columns)?, u32::try_from(rows)?);
    let board = CharucoBoardSpec::new(rows, columns, 1.0, marker as f32, dictionary);
    let mut params = CharucoParams::for_board(board);
    params.chess.upscale = upscale;
    CharucoDetector::new(params).map_err(|problem| anyhow!("{problem}"))
}

/// The board in an image; an error of the detector is that it is not there.
///
/// It goes by how likely cells are of the board's markers, and takes an AprilTag of another family for one of them. Of a cell in 50
/// words of 4×4 bits, turned by quarters, one in twenty is read by chance with a bit wrong; two where they belong to each other are no
/// chance. It is the least that OpenCV asks of a corner, too.
fn seen(detector: &CharucoDetector, image: &GrayImage) -> Option<CharucoDetection> {
    const LEAST_MARKERS: usize = 2;
    let found = detector.detect(&view(image)).ok()?;
    let read = found.markers.iter().filter(|marker| marker.hamming <= 1).count();
    (read >= LEAST_MARKERS).then_some(found)
}
