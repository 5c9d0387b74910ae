//! One file per form; what they share.

pub(crate) mod basalt;
pub(crate) mod camchain;
pub(crate) mod camera_info;
pub(crate) mod colmap;
pub(crate) mod kitti;
pub(crate) mod loopbox;
pub(crate) mod nerfstudio;
pub(crate) mod opencv;
pub(crate) mod orb_slam;
pub(crate) mod svo;
pub(crate) mod text;
pub(crate) mod vins;
pub(crate) mod xml;

use crate::CalibError;
use crate::node::Node;
use geometry::{Camera, CameraError, Distortion, Fov, KannalaBrandt, Pinhole, RadTan};

/// The distortion models, by any of their names.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Model {
    Pinhole,
    RadTan,
    KannalaBrandt,
    Fov,
}

/// What to do about an unknown model.
pub(crate) const MODEL_FIX: &str =
    "give pinhole (none), radtan (plumb_bob, rational_polynomial), kb4 (equidistant) or fov";

impl Model {
    /// The model of a name; `None` for an unknown one.
    fn of_name(name: &str) -> Option<Self> {
        match name.to_ascii_lowercase().as_str() {
            "pinhole" | "none" | "" => Some(Self::Pinhole),
            "radtan" | "radial-tangential" | "plumb_bob" | "rational_polynomial" => Some(Self::RadTan),
            "kb4" | "kannala_brandt" | "kannalabrandt" | "equidistant" | "fisheye" => {
                Some(Self::KannalaBrandt)
            }
            "fov" | "atan" => Some(Self::Fov),
            _ => None,
        }
    }

    /// The model of a ROS `CameraInfo`: where its name is empty, radial-tangential unless there is nothing.
    pub(crate) fn of_camera_info(name: &str, terms: &[f64]) -> Option<Self> {
        match name {
            "" if terms.iter().any(|&term| term != 0.0) => Some(Self::RadTan),
            name => Self::of_name(name),
        }
    }

    /// The model that a value names.
    pub(crate) fn read(node: &Node) -> Result<Self, CalibError> {
        let name = node.text()?;
        Self::of_name(name).ok_or_else(|| node.bad(format!("unknown model \"{name}\""), MODEL_FIX))
    }

    /// The distortion of this model with these terms.
    pub(crate) fn distortion(self, terms: &[f64]) -> Result<Distortion, CameraError> {
        match self {
            Self::Pinhole if terms.iter().all(|&term| term == 0.0) => Ok(Distortion::None),
            Self::Pinhole => {
                Err(CameraError::TermCount { model: "pinhole", expected: "0", found: terms.len() })
            }
            Self::RadTan => RadTan::new(terms).map(Distortion::RadTan),
            Self::KannalaBrandt => KannalaBrandt::new(terms).map(Distortion::KannalaBrandt),
            Self::Fov => Fov::new(terms).map(Distortion::Fov),
        }
    }

    /// As [`distortion`](Self::distortion), for writers that fill up with zeros: none at all are
    /// no distortion, and trailing zeros beyond the model's terms are dropped.
    pub(crate) fn padded_distortion(self, terms: &[f64]) -> Result<Distortion, CameraError> {
        let limit = match self {
            Self::Pinhole => 0,
            Self::RadTan => 8,
            Self::KannalaBrandt => 4,
            Self::Fov => 1,
        };
        let used = terms.iter().rposition(|&term| term != 0.0).map_or(0, |last| last + 1);
        if used == 0 && self != Self::KannalaBrandt {
            return Ok(Distortion::None);
        }
        // OpenCV's radial-tangential terms come in these numbers.
        let counts = if self == Self::RadTan { &[4, 5, 8][..] } else { &[limit] };
        let kept = counts.iter().find(|&&count| used <= count && count < terms.len());
        let is_whole = counts.contains(&terms.len());
        self.distortion(kept.filter(|_| !is_whole).map_or(terms, |&count| &terms[..count]))
    }
}

/// The distortion terms under one of these keys, and the key's path; a pinhole needs none.
pub(crate) fn terms(root: &Node, names: &[&str], model: Model) -> Result<(Vec<f64>, String), CalibError> {
    match root.child(names) {
        None if model == Model::Pinhole => Ok((Vec::new(), root.path_of(names[0]))),
        _ => {
            let node =
                root.need(names, "give the terms of the distortion model, or name the model pinhole")?;
            Ok((node.numbers()?, node.path))
        }
    }
}

/// An error about the distortion at `key`.
pub(crate) fn distortion_error(file: &str, key: &str, error: CameraError) -> CalibError {
    CalibError::from_camera(file, |_| key.into(), error)
}

/// The number under one of these keys.
pub(crate) fn number(node: &Node, names: &[&str], fix: &str) -> Result<f64, CalibError> {
    node.need(names, fix)?.number()
}

/// What to give as an image size.
pub(crate) const SIZE_FIX: &str = "give the size of the recording's images in pixels";

/// `fx`, `fy`, `cx` and `cy` under `prefix` before their names.
pub(crate) fn focal_and_centre(node: &Node, prefix: &str) -> Result<[f64; 4], CalibError> {
    let of = |name: &str, fix| number(node, &[&format!("{prefix}{name}")], fix);
    let (focal, centre) = ("give the focal length in pixels", "give the principal point in pixels");
    Ok([of("fx", focal)?, of("fy", focal)?, of("cx", centre)?, of("cy", centre)?])
}

/// Terms that have a key each, `prefix` before it; those that are missing are 0.
pub(crate) fn named_terms(node: &Node, prefix: &str, names: &[&str]) -> Result<Vec<f64>, CalibError> {
    let of = |name: &&str| match node.child(&[&format!("{prefix}{name}")]) {
        Some(term) => term.number(),
        None => Ok(0.0),
    };
    names.iter().map(of).collect()
}

/// The camera of numbers that lie under `node`, whose messages name them after `prefix`.
pub(crate) fn camera_of(
    (node, prefix): (&Node, &str),
    (width, height): (usize, usize),
    [fx, fy, cx, cy]: [f64; 4],
    distortion: Result<Distortion, CameraError>,
) -> Result<Camera, CalibError> {
    let key_of = |name: &str| node.path_of(&format!("{prefix}{name}"));
    let distortion = distortion.map_err(|error| CalibError::from_camera(node.file, key_of, error))?;
    Camera::new(Pinhole { width, height, fx, fy, cx, cy }, distortion)
        .map_err(|error| CalibError::from_camera(node.file, key_of, error))
}

/// What is said of a lens that is not read.
pub(crate) fn unsupported(node: &Node, model: &str, whose: &str) -> CalibError {
    node.bad(
        format!("{whose} camera model \"{model}\" is not supported"),
        "calibrate again with a pinhole (radial-tangential) or an equidistant (Kannala-Brandt, kb4) model; `loopbox calib` does",
    )
}
