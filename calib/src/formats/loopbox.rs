//! loopbox's own `camera.yaml`.

use super::{Model, distortion_error, terms};
use crate::CalibError;
use crate::node::Node;
use geometry::{Camera, Distortion, Pinhole};

/// Reads the keys; others are for other readers and ignored.
pub(crate) fn parse(root: &Node) -> Result<(Camera, Option<f64>), CalibError> {
    let side = |key| root.need(&[key], "give the size of the recording's images in pixels")?.pixels();
    let focal = |key| root.need(&[key], "give the focal length in pixels")?.number();
    let centre = |key| root.need(&[key], "give the principal point in pixels")?.number();
    let model = Model::read(&root.need(&["model"], "give pinhole, radtan, kb4 or fov")?)?;
    let intrinsics = Pinhole {
        width: side("width")?,
        height: side("height")?,
        fx: focal("fx")?,
        fy: focal("fy")?,
        cx: centre("cx")?,
        cy: centre("cy")?,
    };
    let (terms, key) = terms(root, &["distortion"], model)?;
    let distortion = model.distortion(&terms).map_err(|error| distortion_error(root.file, &key, error))?;
    let camera = Camera::new(intrinsics, distortion)
        .map_err(|error| CalibError::from_camera(root.file, |key| key.into(), error))?;
    let fps = root.child(&["fps"]).map(|node| frame_rate(&node)).transpose()?;
    Ok((camera, fps))
}

/// A frame rate, which must be positive.
pub(crate) fn frame_rate(node: &Node) -> Result<f64, CalibError> {
    let value = node.number()?;
    if value > 0.0 {
        return Ok(value);
    }
    Err(node.bad(format!("{value} is no frame rate"), "give frames per second, or leave the key out"))
}

/// The text that [`parse`] reads back to the same camera.
pub(crate) fn format(camera: &Camera, fps: Option<f64>) -> String {
    let (model, terms) = match camera.distortion() {
        Distortion::None => ("pinhole", Vec::new()),
        Distortion::RadTan(lens) => ("radtan", lens.terms()),
        Distortion::KannalaBrandt(lens) => ("kb4", lens.terms().to_vec()),
        Distortion::Fov(lens) => ("fov", vec![lens.omega()]),
    };
    let Pinhole { width, height, fx, fy, cx, cy } = camera.intrinsics();
    // `{}` writes the shortest decimal that reads back to the same number, without an exponent.
    let terms: Vec<String> = terms.iter().map(f64::to_string).collect();
    let terms = terms.join(", ");
    let mut text = format!(
        "model: {model}\nwidth: {width}\nheight: {height}\nfx: {fx}\nfy: {fy}\ncx: {cx}\ncy: {cy}\n\
         distortion: [{terms}]\n"
    );
    if let Some(fps) = fps {
        text.push_str(&format!("fps: {fps}\n"));
    }
    text
}
