//! `transforms.json` of nerfstudio and instant-ngp: `fl_x`, `fl_y`, `cx`, `cy`, `w`, `h` and terms, of all images or of each.
//!
//! Principal points are COLMAP's: they measure from the corner of the first pixel.

use super::{Model, SIZE_FIX, camera_of, named_terms, number, unsupported};
use crate::CalibError;
use crate::node::Node;
use geometry::Camera;

/// Whether a file's keys are these.
pub(crate) fn is_form(root: &Node) -> bool {
    let of_frames = || root.child(&["frames"]).is_some_and(|frames| !frames.items().is_empty());
    root.child(&["fl_x"]).is_some() || root.child(&["camera_angle_x"]).is_some() || of_frames()
}

/// Reads the camera, which must be that of all images.
pub(crate) fn parse(root: &Node) -> Result<Camera, CalibError> {
    if root.child(&["fl_x", "camera_angle_x"]).is_some() {
        return camera(root, root);
    }
    let frames = root.need(&["frames"], "give fl_x, fl_y, cx, cy, w and h")?;
    let mut found: Option<Camera> = None;
    for frame in frames.items() {
        let own = camera(&frame, root)?;
        if *found.get_or_insert(own) != own {
            return Err(frame.bad(
                "its lens is another than that of the images before".into(),
                "give the calibration of one camera",
            ));
        }
    }
    found.ok_or_else(|| frames.bad("there is none".into(), "give fl_x, fl_y, cx, cy, w and h"))
}

fn camera(node: &Node, root: &Node) -> Result<Camera, CalibError> {
    let size = |name| node.child(&[name]).map_or_else(|| root.need(&[name], SIZE_FIX), Ok)?.pixels();
    let (width, height) = (size("w")?, size("h")?);
    let optional = |names: &[&str]| node.child(names).map(|number| number.number()).transpose();
    let from_angle = |angle: f64, side: usize| 0.5 * side as f64 / (0.5 * angle).tan();
    let fx = match optional(&["camera_angle_x"])?.filter(|_| node.child(&["fl_x"]).is_none()) {
        Some(angle) => from_angle(angle, width),
        None => number(node, &["fl_x"], "give the focal length in pixels")?,
    };
    let fy = match (optional(&["fl_y"])?, optional(&["camera_angle_y"])?) {
        (Some(fy), _) => fy,
        (None, Some(angle)) => from_angle(angle, height),
        (None, None) => fx,
    };
    let cx = optional(&["cx"])?.unwrap_or(0.5 * width as f64) - 0.5;
    let cy = optional(&["cy"])?.unwrap_or(0.5 * height as f64) - 0.5;
    let model = root.child(&["camera_model"]);
    let name = model.as_ref().map_or(Ok("OPENCV"), Node::text)?;
    let is_fisheye = node.child(&["is_fisheye"]).is_some_and(|value| value.is_true());
    let (model, terms) = match name {
        _ if is_fisheye => (Model::KannalaBrandt, &["k1", "k2", "k3", "k4"][..]),
        "OPENCV_FISHEYE" => (Model::KannalaBrandt, &["k1", "k2", "k3", "k4"][..]),
        "OPENCV" | "SIMPLE_RADIAL" | "RADIAL" => (Model::RadTan, &["k1", "k2", "p1", "p2", "k3"][..]),
        "FULL_OPENCV" => (Model::RadTan, &["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"][..]),
        "PINHOLE" | "SIMPLE_PINHOLE" | "perspective" => (Model::Pinhole, &[][..]),
        other => return Err(unsupported(model.as_ref().unwrap_or(root), other, "the")),
    };
    let distortion = model.padded_distortion(&named_terms(node, "", terms)?);
    camera_of((node, ""), (width, height), [fx, fy, cx, cy], distortion)
}
