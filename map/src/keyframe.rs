//! Keyframes, their inverse depth, and the edges between them.

use crate::{AgentId, Color, Colors, Scan, Shared, SharedBytes};
use geometry::{Buffer, GrayImage, Sim3, Swap, median};
use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Names a keyframe within its map; an agent's grow with time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct KeyframeId(pub u32);

/// An image with known pose and inverse depth, or a LiDAR's scan with known pose.
///
/// All lengths inside (inverse depths, variances) are in the keyframe's own unit;
/// `world_from_keyframe.scale` turns that unit into the world's.
#[derive(Clone, Debug, PartialEq)]
pub struct Keyframe {
    /// Its name in the map.
    pub id: KeyframeId,
    /// Whose it is.
    pub agent: AgentId,
    /// Time stamp of the image, seconds.
    pub timestamp: f64,
    /// Index of the image in the recording, from 0.
    pub frame_index: u64,
    /// Pose and unit: maps points of the keyframe's camera frame to the world.
    pub world_from_keyframe: Sim3,
    /// The undistorted grey image, of the size of its agent's camera; without pixels where that is a LiDAR.
    pub image: Arc<GrayImage>,
    /// The colours of the image, where its source has some.
    pub color: Option<Color>,
    /// The scan, freed from the motion of its sweep, of a LiDAR's keyframe; none of a camera's.
    pub scan: Option<Arc<Scan>>,
    /// The semi-dense inverse-depth map.
    pub semi_dense: Shared<SemiDense>,
    /// The sparse points hosted here, with their observations: what the joint optimisation works on.
    pub points: Vec<Point>,
    /// The local features of the image, as the crate `features` encodes them; `None` if they were not extracted.
    pub features: Option<SharedBytes>,
    /// The words of these features, as the crate `place-recog` writes them; `None` if they were not looked up.
    pub words: Option<SharedBytes>,
}

impl Keyframe {
    /// A keyframe of an agent's own map as it begins: an image with its pose; depth, points and features come later.
    pub fn of_image(
        id: KeyframeId,
        timestamp: f64,
        frame_index: u64,
        world_from_keyframe: Sim3,
        image: Arc<GrayImage>,
    ) -> Self {
        Self {
            id,
            agent: AgentId::default(),
            timestamp,
            frame_index,
            world_from_keyframe,
            image,
            color: None,
            scan: None,
            semi_dense: SemiDense::default().into(),
            points: Vec::new(),
            features: None,
            words: None,
        }
    }

    /// The colours of the image, ready to be looked up; `None` without any, and of some that are damaged.
    pub fn colors(&self) -> Option<Colors> {
        self.color.as_ref()?.decoded((self.image.width(), self.image.height())).ok()
    }

    /// Keeps image, depth, features and words, of which others have no copies yet, where `swap` has room for them.
    pub fn swap_out(&mut self, swap: &dyn Swap) {
        if let Some(image) = self.image.swapped_out(swap) {
            self.image = Arc::new(image);
        }
        self.semi_dense = std::mem::take(&mut *self.semi_dense).swapped_out(swap).into();
        [&mut self.features, &mut self.words].into_iter().flatten().for_each(|bytes| bytes.swap_out(swap));
    }

    /// Frees the memory of image, depth, features and words, if they are swapped out, until they are used again.
    pub fn rest(&self) {
        self.image.rest();
        self.semi_dense.rest();
        [&self.features, &self.words].into_iter().flatten().for_each(|bytes| bytes.rest());
    }
}

/// Inverse depth with variance for the pixels that have one, in memory order of the image.
///
/// Inverse depth is 1/z along the optical axis, in 1/keyframe unit. The three columns have one length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SemiDense {
    /// Pixel indices `y · width + x`, strictly ascending.
    pub pixel: Buffer<u32>,
    /// Inverse depths, > 0.
    pub inverse_depth: Buffer<f32>,
    /// Variances of the inverse depths, as those of what lies within two pixels (see [`Point::variance`]).
    pub variance: Buffer<f32>,
}

impl SemiDense {
    /// How many pixels have a depth.
    pub fn len(&self) -> usize {
        self.pixel.len()
    }

    /// Whether no pixel has a depth.
    pub fn is_empty(&self) -> bool {
        self.pixel.is_empty()
    }

    /// The same keyframe with its image and depth kept by `swap`, as far as it has room.
    pub fn swapped_out(self, swap: &dyn Swap) -> Self {
        Self {
            pixel: self.pixel.swapped_out(swap).unwrap_or(self.pixel),
            inverse_depth: self.inverse_depth.swapped_out(swap).unwrap_or(self.inverse_depth),
            variance: self.variance.swapped_out(swap).unwrap_or(self.variance),
        }
    }

    /// Median depth, keyframe units; `None` without any.
    pub fn median_depth(&self) -> Option<f64> {
        median(&mut self.inverse_depth.to_vec()).map(|inverse| f64::from(inverse).recip())
    }

    /// Gives back the memory of what is swapped out, until it is looked at again.
    pub fn rest(&self) {
        self.pixel.rest();
        self.inverse_depth.rest();
        self.variance.rest();
    }

    /// `(pixel index, inverse depth, variance)` of each pixel in order.
    pub fn iter(&self) -> impl Iterator<Item = (u32, f32, f32)> + '_ {
        let values = self.inverse_depth.iter().zip(&self.variance);
        self.pixel.iter().zip(values).map(|(&p, (&d, &v))| (p, d, v))
    }
}

/// A sparse map point: a pixel of its host keyframe with an inverse depth along its ray.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// Position in the host image, pixels of level 0.
    pub pixel: [f32; 2],
    /// Inverse depth in the host frame, 1/keyframe unit.
    pub inverse_depth: f32,
    /// Variance of the inverse depth, as that of what the patch around the pixel shows: beside an edge of something in front it is the edge's, whatever
    /// the pixel itself shows.
    pub variance: f32,
    /// Where other keyframes see it: what one alone sees may be a wrong match.
    pub observations: Vec<Observation>,
}

/// Where a keyframe sees a point hosted by another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// The observing keyframe.
    pub keyframe: KeyframeId,
    /// The measured position in its image, pixels of level 0.
    pub pixel: [f32; 2],
    /// Information (inverse covariance) of the position, 1/pixel²: `[xx, xy, yy]`.
    pub information: [f32; 3],
}

/// The origin of an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum EdgeKind {
    /// Successive keyframes.
    Odometry,
    /// Keyframes that share points.
    Covisibility,
    /// A loop closed within one map.
    Loop,
    /// A merge of two agents' maps.
    Merge,
}

/// A relative-pose constraint between two keyframes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Edge {
    /// The one keyframe.
    pub from: KeyframeId,
    /// The other keyframe.
    pub to: KeyframeId,
    /// Maps points of `to`'s camera frame and unit into `from`'s.
    pub from_from_to: Sim3,
    /// Information of the left perturbation ε of the measurement, `true = exp(ε) ∘ from_from_to`, tangent
    /// order (υ, ω, λ): the residual is `log(from_from_world ∘ to_from_world⁻¹ ∘ from_from_to⁻¹)`.
    pub information: SMatrix<f64, 7, 7>,
    /// Its origin.
    pub kind: EdgeKind,
}

impl Edge {
    /// The odometry edge between two successive keyframes, from their poses. `deviations` are the standard deviations
    /// of translation (units of `from`), rotation (radians) and scale (its logarithm).
    pub fn odometry(from: &Keyframe, to: &Keyframe, deviations: [f64; 3]) -> Self {
        let [t, r, s] = deviations.map(|deviation| deviation.powi(-2));
        Self {
            from: from.id,
            to: to.id,
            from_from_to: from.world_from_keyframe.inverse() * to.world_from_keyframe,
            information: SMatrix::from_diagonal(&SVector::from([t, t, t, r, r, r, s])),
            kind: EdgeKind::Odometry,
        }
    }
}
