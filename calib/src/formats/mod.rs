//! One file per form; what they share.

pub(crate) mod camchain;
pub(crate) mod camera_info;
pub(crate) mod loopbox;
pub(crate) mod opencv;
pub(crate) mod text;

use crate::CalibError;
use crate::node::Node;
use geometry::{CameraError, Distortion, Fov, KannalaBrandt, RadTan};

/// The distortion models, by any of their names.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Model {
    Pinhole,
    RadTan,
    KannalaBrandt,
    Fov,
}

/// What to do about an unknown model.
const MODEL_FIX: &str =
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
        self.distortion(if used <= limit && terms.len() > limit { &terms[..limit] } else { terms })
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
