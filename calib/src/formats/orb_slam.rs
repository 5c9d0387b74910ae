//! The settings of ORB-SLAM2 and 3, and those of OpenVSLAM and stella_vslam, which descend from them: `Camera.fx` and the like as
//! keys with a dot, `Camera1.fx` where there may be two, or `Camera:` with `fx` in it.

use super::loopbox::frame_rate;
use super::{Model, SIZE_FIX, camera_of, focal_and_centre, named_terms, opencv, unsupported};
use crate::CalibError;
use crate::camera_file::choice::{CameraHint, Named, choose};
use crate::node::Node;
use geometry::Camera;

/// Whether a file's keys are these.
pub(crate) fn is_form(root: &Node) -> bool {
    root.child(&["Camera.fx", "Camera1.fx", "LEFT.K"]).is_some()
        || root.child(&["Camera"]).is_some_and(|camera| camera.child(&["fx", "model"]).is_some())
        || root.child(&["Camera.model"]).is_some()
}

/// Reads the camera, of two the one that `hint` tells.
pub(crate) fn parse(root: &Node, hint: &CameraHint) -> Result<(Camera, Option<f64>), CalibError> {
    let nested = root.child(&["Camera"]).filter(Node::is_mapping);
    let (node, shared) = match &nested {
        Some(nested) => (nested, ""),
        None => (root, "Camera."),
    };
    let fps = node.child(&[&format!("{shared}fps")]).map(|fps| frame_rate(&fps)).transpose()?;
    // With both sides' matrices the images are as taken, and `Camera.fx` is that of rectified ones.
    if root.child(&["LEFT.K"]).is_some() {
        let side =
            choose(root.file, &["LEFT", "RIGHT"].map(|side| Named::side(side, side == "RIGHT")), hint)?;
        return Ok((of_matrices(root, ["LEFT", "RIGHT"][side])?, fps));
    }
    let own = match (root.child(&["Camera1.fx"]), root.child(&["Camera2.fx"])) {
        (Some(_), Some(_)) => {
            let names = ["Camera1", "Camera2"].map(|name| Named::side(name, name == "Camera2"));
            ["Camera1.", "Camera2."][choose(root.file, &names, hint)?]
        }
        (Some(_), None) => "Camera1.",
        (None, _) => shared,
    };
    Ok((of_keys(node, shared, own, hint.size)?, fps))
}

/// `LEFT.K`, `LEFT.D`, `LEFT.width`, `LEFT.height`.
fn of_matrices(root: &Node, side: &str) -> Result<Camera, CalibError> {
    let key = |name: &str| format!("{side}.{name}");
    let pixels = |name: &str| root.need(&[&key(name)], SIZE_FIX)?.pixels();
    let matrix = root.need(&[&key("K")], opencv::MATRIX_FIX)?;
    let terms = root.need(&[&key("D")], "give the distortion coefficients")?;
    let distortion = Model::RadTan
        .padded_distortion(&terms.numbers()?)
        .map_err(|error| super::distortion_error(root.file, &terms.path, error))?;
    opencv::camera((pixels("width")?, pixels("height")?), &matrix, distortion)
}

/// Keys of the size after `shared`, of the numbers after `own`. ORB-SLAM2's own files have no size, which is that of the images then.
fn of_keys(
    node: &Node,
    shared: &str,
    own: &str,
    images: Option<(usize, usize)>,
) -> Result<Camera, CalibError> {
    let keys = |names: [&str; 2]| names.map(|name| format!("{shared}{name}"));
    let pixels = |names: [&str; 2]| {
        let [one, other] = keys(names);
        let fix = "this file does not tell the image size: add the key, in pixels";
        node.need(&[&one, &other], fix)?.pixels()
    };
    let names = [["width", "cols"], ["height", "rows"]];
    let is_given = names.iter().any(|names| {
        let [one, other] = keys(*names);
        node.child(&[&one, &other]).is_some()
    });
    let size = match images.filter(|_| !is_given) {
        Some(size) => size,
        None => (pixels(names[0])?, pixels(names[1])?),
    };
    let model = node.child(&[&format!("{shared}type"), &format!("{shared}model")]);
    let name = model.as_ref().map_or(Ok("PinHole"), Node::text)?;
    let numbers = focal_and_centre(node, own)?;
    let (model, terms) = match name.to_ascii_lowercase().as_str() {
        "pinhole" | "perspective" => (Model::RadTan, &["k1", "k2", "p1", "p2", "k3"][..]),
        "rectified" => (Model::Pinhole, &[][..]),
        "kannalabrandt8" | "fisheye" => (Model::KannalaBrandt, &["k1", "k2", "k3", "k4"][..]),
        _ => return Err(unsupported(model.as_ref().unwrap_or(node), name, "the")),
    };
    let distortion = model.padded_distortion(&named_terms(node, own, terms)?);
    camera_of((node, own), size, numbers, distortion)
}
