//! Cameras of SVO: vikit's `cam_model`, `cam_fx`, … and the lists `cameras: - camera:` of rpg_svo_pro and maplab.

use super::{Model, SIZE_FIX, camera_of, focal_and_centre, named_terms, terms, unsupported};
use crate::CalibError;
use crate::camera_file::choice::{CameraHint, Named, choose};
use crate::node::Node;
use geometry::{Camera, CameraError};

/// Whether a file's keys are these.
pub(crate) fn is_form(root: &Node) -> bool {
    root.child(&["cam_model"]).is_some() || !cameras(root).is_empty()
}

/// Reads the camera, of several the one that `hint` tells.
pub(crate) fn parse(root: &Node, hint: &CameraHint) -> Result<Camera, CalibError> {
    if let Some(model) = root.child(&["cam_model"]) {
        return vikit(root, &model);
    }
    let cameras = cameras(root);
    let named: Vec<Named> = cameras.iter().enumerate().map(|(index, camera)| name(index, camera)).collect();
    of_list(&cameras[choose(root.file, &named, hint)?])
}

fn cameras<'a>(root: &Node<'a>) -> Vec<Node<'a>> {
    let list = root.child(&["cameras"]).map_or_else(Vec::new, |cameras| cameras.items());
    list.iter().filter_map(|item| item.child(&["camera"])).collect()
}

fn name(index: usize, camera: &Node) -> Named {
    let text = |key: &str| camera.child(&[key]).and_then(|node| node.text().ok()).map(str::to_owned);
    let topic = text("topic").or_else(|| text("rostopic"));
    Named { topic, ..Named::numbered(text("label"), index) }
}

/// `image_width`, `image_height`, `type`, `intrinsics`, and `distortion` with `type` and `parameters`.
fn of_list(camera: &Node) -> Result<Camera, CalibError> {
    let kind = camera.need(&["type"], "give pinhole")?;
    if kind.text()? != "pinhole" {
        return Err(unsupported(&kind, kind.text()?, "the"));
    }
    let pixels = |name| camera.need(&[name], SIZE_FIX)?.pixels();
    let numbers = camera.need(&["intrinsics"], "give [fx, fy, cx, cy]")?.exactly("give [fx, fy, cx, cy]")?;
    let distortion = match camera.child(&["distortion"]) {
        Some(distortion) => {
            let model = Model::read(&distortion.need(&["type"], "give the model")?)?;
            model.padded_distortion(&terms(&distortion, &["parameters"], model)?.0)
        }
        None => Model::Pinhole.distortion(&[]),
    };
    camera_of((camera, ""), (pixels("image_width")?, pixels("image_height")?), numbers, distortion)
}

fn vikit(root: &Node, model: &Node) -> Result<Camera, CalibError> {
    let pixels = |name| root.need(&[name], SIZE_FIX)?.pixels();
    let (width, height) = (pixels("cam_width")?, pixels("cam_height")?);
    let all = ["d0", "d1", "d2", "d3"];
    let terms = |count: usize| named_terms(root, "cam_", &all[..count]);
    let numbers = focal_and_centre(root, "cam_")?;
    let name = model.text()?.to_ascii_lowercase();
    let lens = |model: Model, count| -> Result<Result<_, CameraError>, CalibError> {
        Ok(model.padded_distortion(&terms(count)?))
    };
    let (numbers, distortion) = match name.as_str() {
        "pinhole" => (numbers, lens(Model::RadTan, 4)?),
        "equidistant" | "equidistantcamera" => (numbers, lens(Model::KannalaBrandt, 4)?),
        // PTAM's: relative to the size, measured from the corner of the first pixel.
        "atan" => {
            let [fx, fy, cx, cy] = numbers;
            let (w, h) = (width as f64, height as f64);
            ([fx * w, fy * h, cx * w - 0.5, cy * h - 0.5], lens(Model::Fov, 1)?)
        }
        _ => return Err(unsupported(model, model.text()?, "vikit's")),
    };
    camera_of((root, "cam_"), (width, height), numbers, distortion)
}
