//! What an agent is given, and why it may find no pose for it.

use geometry::GrayImage;
use map::Color;
use std::fmt;
use std::sync::Arc;

/// One image to process.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Index in the recording, from 0.
    pub index: u64,
    /// Time stamp, seconds, strictly growing from frame to frame.
    pub timestamp: f64,
    /// Undistorted grey image, of the size of the agent's camera.
    pub image: GrayImage,
    /// Its colours, where it has some. Tracking does not look at them; a keyframe keeps them.
    pub color: Option<LazyColor>,
}

/// Colours of an image that are computed when the frame becomes a keyframe, which few do.
#[derive(Clone)]
pub struct LazyColor(Arc<dyn Fn() -> Option<Color> + Send + Sync>);

impl LazyColor {
    /// The colours that `compute` gives: the same each time, or none.
    pub fn new(compute: impl Fn() -> Option<Color> + Send + Sync + 'static) -> Self {
        Self(Arc::new(compute))
    }

    /// Computes them.
    pub fn get(&self) -> Option<Color> {
        (self.0)()
    }
}

impl fmt::Debug for LazyColor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("LazyColor")
    }
}

/// Why a frame has no pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LossReason {
    /// It was found nowhere.
    #[default]
    NotFound,
    /// It agrees with the map, but too few points of known depth are in view to give the length of the camera's motion. A map that
    /// begins there has a scale of its own.
    Scale,
    /// What was mapped moves in two ways, and either may be what stands still. A map that begins there holds what moves together.
    TwoMotions,
}

impl LossReason {
    /// The same for people.
    pub fn text(self) -> &'static str {
        match self {
            Self::NotFound => "the view matches no part of the map",
            Self::Scale => {
                "the scale is lost: too few points of known depth are in view to tell how far the camera moves"
            }
            Self::TwoMotions => {
                "a part of what was mapped moves against the rest, and nothing tells which of them stands still"
            }
        }
    }
}
