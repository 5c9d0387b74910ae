//! The steps from a picture to a frame: selection by time, decoding, undistortion.

use super::Item;
use crate::correction::ImageCorrection;
use crate::pictures::Picture;
use crate::{FrameSource, SourceFrame, time};
use serde::Serialize;
use slam_direct::Frame;
use std::sync::Arc;

/// Why a frame of the source was not tracked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SkipReason {
    /// The image could not be read or decoded.
    Unreadable,
    /// The image's size is not the calibration's.
    WrongSize,
    /// The recording attributes it to another camera, or to another zoom.
    OtherCalibration,
    /// Its time stamp is before that of an earlier frame, or lies off those around it.
    OutOfOrder,
    /// Its time stamp is that of the frame before.
    DuplicateTime,
    /// Its time stamp is not a finite number.
    InvalidTime,
}

impl std::fmt::Display for SkipReason {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Unreadable => "unreadable",
            Self::WrongSize => "of a wrong size",
            Self::OtherCalibration => "of another calibration",
            Self::OutOfOrder => "out of order",
            Self::DuplicateTime => "with a repeated time",
            Self::InvalidTime => "with no time",
        })
    }
}

/// A frame that was skipped.
#[derive(Clone, Debug, PartialEq)]
pub struct Skip {
    /// Index in the recording.
    pub index: u64,
    /// Seconds, as recorded.
    pub timestamp: f64,
    /// Why.
    pub reason: SkipReason,
    /// Why, for people.
    pub detail: String,
}

/// Whether a frame lies in the part of the recording to be processed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Admission {
    /// It does.
    Wanted,
    /// It comes before.
    Before,
    /// It comes after, and so do all that follow.
    After,
}

/// Makes the agent's frames from a source's.
pub struct Preparation {
    correction: Arc<ImageCorrection>,
    start: f64,
    end: f64,
    first_timestamp: Option<f64>,
    last_timestamp: Option<f64>,
    /// An image had the calibration's size.
    fits: bool,
}

impl Preparation {
    /// Takes frames from `start` to `end`, seconds after the recording's first frame.
    pub fn new(correction: ImageCorrection, start: Option<f64>, end: Option<f64>) -> Self {
        Self {
            correction: Arc::new(correction),
            start: start.unwrap_or(f64::NEG_INFINITY),
            end: end.unwrap_or(f64::INFINITY),
            first_timestamp: None,
            last_timestamp: None,
            fits: false,
        }
    }

    /// Lets a source skip the part before the start.
    pub fn skip_in(&mut self, source: &mut dyn FrameSource) {
        if self.start > 0.0 {
            self.first_timestamp = source.skip_to(self.start).map(time::on_grid);
        }
    }

    /// Judges a frame by its time stamp.
    ///
    /// # Errors
    /// When time does not go forward.
    pub fn admit(&mut self, frame: &SourceFrame) -> Result<Admission, Skip> {
        let t = frame.timestamp;
        let skip = |reason, detail| Skip { index: frame.index, timestamp: t, reason, detail };
        if let Picture::Mistimed(detail) = &frame.picture {
            return Err(skip(SkipReason::OutOfOrder, detail.clone()));
        }
        if !t.is_finite() {
            return Err(skip(SkipReason::InvalidTime, format!("its time stamp is {t}")));
        }
        let since_start = t - *self.first_timestamp.get_or_insert(t);
        match self.last_timestamp {
            Some(last) if t == last => {
                return Err(skip(SkipReason::DuplicateTime, format!("its time stamp {t} repeats")));
            }
            Some(last) if t < last => {
                return Err(skip(
                    SkipReason::OutOfOrder,
                    format!("its time stamp {t} is earlier than the {last} before it"),
                ));
            }
            _ => self.last_timestamp = Some(t),
        }
        Ok(if since_start < self.start {
            Admission::Before
        } else if since_start > self.end {
            Admission::After
        } else {
            Admission::Wanted
        })
    }

    /// Decodes and corrects an admitted frame. Where the first image that can be decoded is not of the calibration's
    /// size, none is.
    pub fn prepare(&mut self, frame: SourceFrame) -> Item {
        let SourceFrame { index, timestamp, captured, picture } = frame;
        if let Picture::OfOther(detail) = picture {
            return Item::Skipped(Skip { index, timestamp, reason: SkipReason::OtherCalibration, detail });
        }
        let corrected =
            picture.into_grey_and_color().map_err(|detail| (SkipReason::Unreadable, detail)).and_then(
                |picture| self.correction.frame(picture).map_err(|detail| (SkipReason::WrongSize, detail)),
            );
        match corrected {
            Ok((image, color)) => {
                self.fits = true;
                Item::Frame(Frame { index, timestamp, image, color }, captured)
            }
            Err((SkipReason::WrongSize, detail)) if !self.fits => Item::Failed(detail),
            Err((reason, detail)) => Item::Skipped(Skip { index, timestamp, reason, detail }),
        }
    }
}
