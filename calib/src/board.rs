//! Calibration boards: what they are called and where their corners lie.

use nalgebra::Vector3;
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// Most corners along one side; more is a slip of the pen.
const MAX_SIDE: usize = 100;

/// A flat calibration board.
///
/// Board frame: the board is the plane z = 0, lengths in metres. Chessboard and ChArUco: x along the rows, y from row
/// to row, origin at the first inner corner. AprilGrid as in Kalibr: origin at the outer corner of the tag with
/// number 0, x along the rows, y from row to row.
#[derive(Clone, Debug, PartialEq)]
pub enum Board {
    /// Black and white squares; `columns × rows` inner corners.
    Chessboard {
        /// Inner corners of a row.
        columns: usize,
        /// Rows of inner corners.
        rows: usize,
        /// Side of a square, metres.
        square: f64,
    },
    /// A chessboard with markers in its white squares; `columns × rows` squares, as OpenCV counts.
    Charuco {
        /// Squares of a row.
        columns: usize,
        /// Rows of squares.
        rows: usize,
        /// Side of a square, metres.
        square: f64,
        /// Side of a marker, metres.
        marker: f64,
        /// OpenCV's name of the dictionary, such as `DICT_4X4_50`.
        dictionary: String,
    },
    /// Kalibr's grid of AprilTags (36h11), numbered row by row, with black squares between their corners.
    AprilGrid {
        /// Tags of a row.
        columns: usize,
        /// Rows of tags.
        rows: usize,
        /// Side of a tag, metres.
        tag: f64,
        /// Gap between tags as a share of the side of a tag.
        spacing: f64,
    },
}

/// The text does not name a board.
#[derive(Clone, Debug, PartialEq, Error)]
#[error(
    "\"{text}\" is no board ({problem}); give chessboard:COLUMNSxROWS:SQUARE (inner corners, metres), \
     charuco:COLUMNSxROWS:SQUARE:MARKER[:DICTIONARY] (squares, metres) or aprilgrid:COLUMNSxROWS:TAG:SPACING (tags, \
     metres, share of a tag)"
)]
pub struct BoardError {
    text: String,
    problem: String,
}

impl Board {
    /// All corners that can be measured, by their number.
    ///
    /// Chessboard and ChArUco: row by row. AprilGrid: four of each tag, tag by tag, in the order (0, 0), (1, 0),
    /// (1, 1), (0, 1) along x and y.
    pub fn points(&self) -> Vec<Vector3<f64>> {
        match *self {
            Self::Chessboard { columns, rows, square } => lattice(columns, rows, square),
            Self::Charuco { columns, rows, square, .. } => lattice(columns - 1, rows - 1, square),
            Self::AprilGrid { columns, rows, tag, spacing } => {
                let pitch = tag * (1.0 + spacing);
                let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
                let of_tag = |id: usize| {
                    let (x, y) = ((id % columns) as f64 * pitch, (id / columns) as f64 * pitch);
                    corners.map(|(i, j)| Vector3::new(x + i * tag, y + j * tag, 0.0))
                };
                (0..columns * rows).flat_map(of_tag).collect()
            }
        }
    }

    /// Number of corners that can be measured.
    pub fn corner_count(&self) -> usize {
        match *self {
            Self::Chessboard { columns, rows, .. } => columns * rows,
            Self::Charuco { columns, rows, .. } => (columns - 1) * (rows - 1),
            Self::AprilGrid { columns, rows, .. } => 4 * columns * rows,
        }
    }

    /// Least distance between neighbouring corners, metres.
    pub fn corner_distance(&self) -> f64 {
        match *self {
            Self::Chessboard { square, .. } | Self::Charuco { square, .. } => square,
            Self::AprilGrid { tag, spacing, .. } => tag * spacing.min(1.0),
        }
    }

    /// Length of the diagonal across all corners, metres.
    pub fn diagonal(&self) -> f64 {
        self.points().iter().map(|point| point.norm()).fold(0.0, f64::max)
    }
}

fn lattice(columns: usize, rows: usize, square: f64) -> Vec<Vector3<f64>> {
    let corner = |i: usize| Vector3::new((i % columns) as f64 * square, (i / columns) as f64 * square, 0.0);
    (0..columns * rows).map(corner).collect()
}

impl FromStr for Board {
    type Err = BoardError;

    fn from_str(text: &str) -> Result<Self, BoardError> {
        let parts: Vec<&str> = text.split(':').collect();
        let board = match parts[..] {
            ["chessboard", size, square] => pair(size)
                .and_then(|(columns, rows)| Ok(Self::Chessboard { columns, rows, square: length(square)? })),
            ["charuco", size, square, marker] => charuco(size, square, marker, "DICT_4X4_50"),
            ["charuco", size, square, marker, dictionary] => charuco(size, square, marker, dictionary),
            ["aprilgrid", size, tag, spacing] => pair(size).and_then(|(columns, rows)| {
                Ok(Self::AprilGrid { columns, rows, tag: length(tag)?, spacing: length(spacing)? })
            }),
            ["chessboard" | "charuco" | "aprilgrid", ..] => Err("the number of parts is another".into()),
            _ => Err("the kind is not known".into()),
        };
        let board = board.and_then(Self::checked);
        board.map_err(|problem| BoardError { text: text.into(), problem })
    }
}

impl Board {
    fn checked(self) -> Result<Self, String> {
        let (columns, rows) = match self {
            Self::Chessboard { columns, rows, .. } | Self::AprilGrid { columns, rows, .. } => (columns, rows),
            Self::Charuco { columns, rows, .. } => (columns, rows),
        };
        let least = match self {
            Self::Chessboard { .. } | Self::Charuco { .. } => 3,
            Self::AprilGrid { .. } => 1,
        };
        if columns < least || rows < least || columns > MAX_SIDE || rows > MAX_SIDE {
            return Err(format!("{columns}x{rows} is not within {least} to {MAX_SIDE}"));
        }
        // The family has 587 tags.
        if matches!(self, Self::AprilGrid { .. }) && columns * rows > 587 {
            return Err("there are 587 tags".into());
        }
        match self {
            Self::Charuco { square, marker, .. } if marker >= square => {
                Err("the marker must be smaller than the square".into())
            }
            _ => Ok(self),
        }
    }
}

fn charuco(size: &str, square: &str, marker: &str, dictionary: &str) -> Result<Board, String> {
    let (columns, rows) = pair(size)?;
    let dictionary = dictionary.to_ascii_uppercase();
    let dictionary = if dictionary.starts_with("DICT_") { dictionary } else { format!("DICT_{dictionary}") };
    Ok(Board::Charuco { columns, rows, square: length(square)?, marker: length(marker)?, dictionary })
}

/// `9x6`.
fn pair(text: &str) -> Result<(usize, usize), String> {
    let parsed = text.split_once(['x', 'X']).and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
    parsed.ok_or_else(|| format!("\"{text}\" is no size such as 9x6"))
}

fn length(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|value| value.is_finite() && *value > 0.0 && *value < 1e3);
    value.ok_or_else(|| format!("\"{text}\" is no length above zero"))
}

/// As it is given on the command line.
impl fmt::Display for Board {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Chessboard { columns, rows, square } => write!(f, "chessboard:{columns}x{rows}:{square}"),
            Self::Charuco { columns, rows, square, marker, dictionary } => {
                write!(f, "charuco:{columns}x{rows}:{square}:{marker}:{dictionary}")
            }
            Self::AprilGrid { columns, rows, tag, spacing } => {
                write!(f, "aprilgrid:{columns}x{rows}:{tag}:{spacing}")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boards_are_understood_and_written_back() {
        for text in ["chessboard:9x6:0.025", "charuco:7x5:0.04:0.03:DICT_5X5_100", "aprilgrid:6x6:0.088:0.3"]
        {
            let board: Board = text.parse().unwrap();
            assert_eq!(board.to_string(), text);
            assert_eq!(board.points().len(), board.corner_count());
        }
        let short: Board = "charuco:7x5:0.04:0.03:4x4_50".parse().unwrap();
        assert_eq!(short, "charuco:7x5:0.04:0.03".parse().unwrap());
    }

    #[test]
    fn wrong_texts_say_what_is_wrong() {
        for (text, word) in [
            ("chess:9x6:1", "kind"),
            ("chessboard:9:1", "no size"),
            ("chessboard:9x6", "parts"),
            ("chessboard:9x6:0", "length"),
            ("chessboard:9x6:nan", "length"),
            ("chessboard:1x6:1", "within"),
            ("chessboard:9x600:1", "within"),
            ("charuco:7x5:0.03:0.04", "smaller"),
            ("aprilgrid:60x60:0.1:0.3", "587"),
        ] {
            let message = text.parse::<Board>().unwrap_err().to_string();
            assert!(
                message.contains(word) && message.contains("chessboard:COLUMNSxROWS"),
                "{text}: {message}"
            );
        }
    }

    #[test]
    fn corners_lie_where_they_should() {
        let grid: Board = "aprilgrid:6x6:0.1:0.3".parse().unwrap();
        let points = grid.points();
        // Tag 7 is the second of the second row.
        assert!((points[4 * 7 + 2] - Vector3::new(0.23, 0.23, 0.0)).norm() < 1e-12);
        let board: Board = "chessboard:9x6:0.5".parse().unwrap();
        assert_eq!(board.points()[10], Vector3::new(0.5, 0.5, 0.0));
    }
}
