//! The four-line text form of LSD-SLAM and DSO.
//!
//! ```text
//! RadTan 458.654 457.296 367.215 248.375 -0.2834 0.0739 0.0002 0.0000176   input camera
//! 752 480                                                                  input size
//! crop                                                                     output camera
//! 640 480                                                                  output size
//! ```
//! Numbers relative to the size (principal point below 1) measure from the upper left pixel's corner,
//! so the principal point becomes `cx · width − ½`; numbers in pixels measure from its centre.

use super::{Model, distortion_error};
use crate::{CalibError, CalibrationFile, CameraFormat};
use geometry::{Camera, Crop, Pinhole};

/// The names that may begin the first line.
const NAMES: [(&str, Model); 6] = [
    ("pinhole", Model::Pinhole),
    ("radtan", Model::RadTan),
    ("fov", Model::Fov),
    ("atan", Model::Fov),
    ("equidistant", Model::KannalaBrandt),
    ("kannalabrandt", Model::KannalaBrandt),
];

/// Whether the text begins like this form: a model's name or a number, then numbers.
pub(crate) fn is_text_form(text: &str) -> bool {
    let mut words = lines(text).next().unwrap_or("").split_whitespace();
    let Some(first) = words.next() else { return false };
    // Words with a colon or comma are YAML.
    let known = named(first).is_some() || first.parse::<f64>().is_ok();
    known && words.next().is_some_and(|word| word.parse::<f64>().is_ok())
}

/// Reads the four lines; the third and fourth may be missing.
pub(crate) fn parse(text: &str, file: &str) -> Result<CalibrationFile, CalibError> {
    let mut lines = lines(text);
    let (model, numbers) = first_line(lines.next().unwrap_or(""), file)?;
    let sizes = |line: Option<&str>, key: &str| match line {
        Some(line) => size(line, key, file),
        None => Err(missing(file, key, "give width and height of the recording's images in pixels")),
    };
    let (width, height) = sizes(lines.next(), "line 2")?;
    let [fx, fy, cx, cy] = scaled([numbers[0], numbers[1], numbers[2], numbers[3]], width, height);
    let distortion =
        model.padded_distortion(&numbers[4..]).map_err(|error| distortion_error(file, "line 1", error))?;
    let camera = Camera::new(Pinhole { width, height, fx, fy, cx, cy }, distortion)
        .map_err(|error| CalibError::from_camera(file, |key| format!("line 1 ({key})"), error))?;
    let crop = match lines.next() {
        Some(line) => Some(crop(line, lines.next(), (width, height), file)?),
        None => None,
    };
    Ok(CalibrationFile { camera, crop, fps: None, format: CameraFormat::LsdDso })
}

/// The lines that say something.
fn lines(text: &str) -> impl Iterator<Item = &str> {
    text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'))
}

fn named(word: &str) -> Option<Model> {
    let word = word.to_ascii_lowercase();
    NAMES.iter().find(|(name, _)| *name == word).map(|&(_, model)| model)
}

/// Model and numbers of the first line: at least `fx fy cx cy`.
fn first_line(line: &str, file: &str) -> Result<(Model, Vec<f64>), CalibError> {
    let first = line.split_whitespace().next().unwrap_or("");
    let name = named(first);
    let numbers = numbers(if name.is_some() { &line[first.len()..] } else { line }, "line 1", file)?;
    // Without a name, five numbers end in ω (0: none), eight in k1 k2 p1 p2.
    let model = match (name, numbers.len()) {
        (Some(model), 4..) => model,
        (None, 5) => Model::Fov,
        (None, 8..) => Model::RadTan,
        (_, count) => {
            let fix = "give [Pinhole|RadTan|FOV|EquiDistant|KannalaBrandt] fx fy cx cy and the model's terms";
            return Err(bad(file, "line 1", format!("{count} numbers are not a camera"), fix));
        }
    };
    Ok((model, numbers))
}

/// The output camera: `crop`, `full`, `none`, or `fx fy cx cy 0` with the size in the next line.
fn crop(line: &str, size_line: Option<&str>, input: (usize, usize), file: &str) -> Result<Crop, CalibError> {
    match line.split_whitespace().next().unwrap_or("").to_ascii_lowercase().as_str() {
        "crop" => return Ok(Crop::Valid),
        // "Full" shows all that was seen, with borders of what was not; the nearest that stays useful
        // for wide lenses is the unchanged focal length.
        "full" | "none" => return Ok(Crop::KeepFocal),
        _ => {}
    }
    let numbers = numbers(line, "line 3", file)?;
    let (width, height) = match size_line {
        Some(line) => size(line, "line 4", file)?,
        None => input,
    };
    let fix = "give crop, none, or fx fy cx cy 0 of the output camera";
    let Some(&[fx, fy, cx, cy]) = numbers.first_chunk::<4>() else {
        return Err(bad(file, "line 3", format!("{} numbers are no output camera", numbers.len()), fix));
    };
    if numbers[4..].iter().any(|&term| term != 0.0) {
        return Err(bad(file, "line 3", "an output camera with distortion".into(), fix));
    }
    let [fx, fy, cx, cy] = scaled([fx, fy, cx, cy], width, height);
    let pinhole = Pinhole { width, height, fx, fy, cx, cy };
    // The output must be a camera too; only its principal point may lie anywhere.
    let centred = Pinhole { cx: 0.0, cy: 0.0, ..pinhole };
    Camera::new(centred, geometry::Distortion::None)
        .map_err(|error| CalibError::from_camera(file, |key| format!("line 3 ({key})"), error))?;
    Ok(Crop::Explicit(pinhole))
}

/// Numbers relative to the size in pixels; numbers in pixels as they are.
fn scaled([fx, fy, cx, cy]: [f64; 4], width: usize, height: usize) -> [f64; 4] {
    if cx < 1.0 && cy < 1.0 {
        let (width, height) = (width as f64, height as f64);
        [fx * width, fy * height, cx * width - 0.5, cy * height - 0.5]
    } else {
        [fx, fy, cx, cy]
    }
}

/// All numbers of a line, finite.
fn numbers(line: &str, key: &str, file: &str) -> Result<Vec<f64>, CalibError> {
    line.split_whitespace()
        .map(|word| match word.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            Ok(value) => {
                let fix = "calibrate again, or correct the number";
                Err(bad(file, key, format!("{value} is not a finite number"), fix))
            }
            Err(_) => {
                Err(bad(file, key, format!("\"{word}\" is not a number"), "separate numbers by spaces"))
            }
        })
        .collect()
}

/// Width and height in a line.
fn size(line: &str, key: &str, file: &str) -> Result<(usize, usize), CalibError> {
    let numbers = numbers(line, key, file)?;
    let whole = |value: f64| value.fract() == 0.0 && (1.0..=65535.0).contains(&value);
    match numbers[..] {
        [width, height] if whole(width) && whole(height) => Ok((width as usize, height as usize)),
        _ => Err(bad(file, key, format!("\"{line}\" is no image size"), "give width and height in pixels")),
    }
}

fn bad(file: &str, key: &str, problem: String, fix: &str) -> CalibError {
    CalibError::BadValue { file: file.into(), key: key.into(), problem, fix: fix.into() }
}

fn missing(file: &str, key: &str, fix: &str) -> CalibError {
    CalibError::MissingKey { file: file.into(), key: key.into(), fix: fix.into() }
}
