//! Cameras of VINS-Mono, VINS-Fusion and camodocal: `model_type`, `projection_parameters`, `distortion_parameters`.

use super::{Model, SIZE_FIX, camera_of, focal_and_centre, named_terms, number, unsupported};
use crate::CalibError;
use crate::node::Node;
use geometry::Camera;

/// Whether a file's keys are these, or name files that have them.
pub(crate) fn is_form(root: &Node) -> bool {
    root.child(&["model_type", "cam0_calib"]).is_some()
}

/// Reads the camera.
pub(crate) fn parse(root: &Node) -> Result<Camera, CalibError> {
    let fix = "give PINHOLE or KANNALA_BRANDT";
    if let (None, Some(other)) = (root.child(&["model_type"]), root.child(&["cam0_calib"])) {
        let problem = format!("the cameras are in other files, \"{}\" the first of them", other.text()?);
        return Err(other.bad(problem, "give the one of the recording's camera"));
    }
    let model = root.need(&["model_type"], fix)?;
    let pixels = |name| root.need(&[name], SIZE_FIX)?.pixels();
    let size = (pixels("image_width")?, pixels("image_height")?);
    let projection = root.need(&["projection_parameters"], "give the projection's parameters")?;
    match model.text()?.to_ascii_uppercase().as_str() {
        "PINHOLE" => {
            let distortion = root.need(&["distortion_parameters"], "give k1, k2, p1 and p2")?;
            let terms = named_terms(&distortion, "", &["k1", "k2", "p1", "p2"])?;
            let numbers = focal_and_centre(&projection, "")?;
            camera_of((&projection, ""), size, numbers, Model::RadTan.padded_distortion(&terms))
        }
        "KANNALA_BRANDT" => {
            let of = |name| number(&projection, &[name], "give it in pixels");
            let numbers = [of("mu")?, of("mv")?, of("u0")?, of("v0")?];
            let terms = named_terms(&projection, "", &["k2", "k3", "k4", "k5"])?;
            camera_of((&projection, ""), size, numbers, Model::KannalaBrandt.padded_distortion(&terms))
        }
        name => Err(unsupported(&model, name, "camodocal's")),
    }
}
