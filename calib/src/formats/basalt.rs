//! The JSON that Basalt calibrates to: `value0` with `intrinsics` and `resolution`, one for each camera.

use super::{Model, camera_of, focal_and_centre, named_terms, unsupported};
use crate::CalibError;
use crate::camera_file::choice::{CameraHint, Named, choose};
use crate::node::Node;
use geometry::Camera;

/// Whether a file's keys are these.
pub(crate) fn is_form(root: &Node) -> bool {
    root.child(&["value0"]).is_some_and(|value| value.child(&["intrinsics"]).is_some())
}

/// Reads the camera, of several the one that `hint` tells.
pub(crate) fn parse(root: &Node, hint: &CameraHint) -> Result<Camera, CalibError> {
    let value = root.need(&["value0"], "give the calibration there")?;
    let list = value.need(&["intrinsics"], "give a camera there")?;
    let named: Vec<Named> = (0..list.items().len()).map(|index| Named::numbered(None, index)).collect();
    let index = choose(root.file, &named, hint)?;
    let camera = list.items().into_iter().nth(index);
    let camera = camera.ok_or_else(|| list.bad("there is no camera".into(), "give one"))?;
    let sizes = value.need(&["resolution"], "give [width, height] of each camera's images in pixels")?;
    let size = sizes.items().into_iter().nth(index);
    let size =
        size.ok_or_else(|| sizes.bad(format!("there is none of camera {index}"), "give one"))?.size()?;
    let kind = camera.need(&["camera_type"], "give pinhole or kb4")?;
    let numbers = camera.need(&["intrinsics"], "give fx, fy, cx, cy and the terms")?;
    let (model, terms) = match kind.text()? {
        "pinhole" => (Model::Pinhole, &[][..]),
        "kb4" => (Model::KannalaBrandt, &["k1", "k2", "k3", "k4"][..]),
        "pinhole-radtan8" => (Model::RadTan, &["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"][..]),
        other => return Err(unsupported(&kind, other, "Basalt's")),
    };
    let distortion = model.padded_distortion(&named_terms(&numbers, "", terms)?);
    camera_of((&numbers, ""), size, focal_and_centre(&numbers, "")?, distortion)
}
