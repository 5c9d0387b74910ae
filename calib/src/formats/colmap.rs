//! COLMAP's `cameras.txt`: `CAMERA_ID MODEL WIDTH HEIGHT PARAMETERS` a line.
//!
//! Principal points measure from the corner of the first pixel.

use super::{Model, distortion_error};
use crate::CalibError;
use crate::camera_file::choice::{CameraHint, Named, choose};
use geometry::{Camera, Pinhole};

/// A model: its name, whether one focal length is that of both axes, ours, and where in its terms the parameters belong.
type Lens = (&'static str, bool, Model, &'static [usize]);

/// The models of COLMAP's `models.h` that are read.
const MODELS: [Lens; 10] = [
    ("SIMPLE_PINHOLE", true, Model::Pinhole, &[]),
    ("PINHOLE", false, Model::Pinhole, &[]),
    ("SIMPLE_RADIAL", true, Model::RadTan, &[0]),
    ("RADIAL", true, Model::RadTan, &[0, 1]),
    ("OPENCV", false, Model::RadTan, &[0, 1, 2, 3]),
    ("FULL_OPENCV", false, Model::RadTan, &[0, 1, 2, 3, 4, 5, 6, 7]),
    ("OPENCV_FISHEYE", false, Model::KannalaBrandt, &[0, 1, 2, 3]),
    ("SIMPLE_RADIAL_FISHEYE", true, Model::KannalaBrandt, &[0]),
    ("RADIAL_FISHEYE", true, Model::KannalaBrandt, &[0, 1]),
    ("FOV", false, Model::Fov, &[0]),
];

/// Names that begin with a number and a model's, read or not, are COLMAP's.
fn row(line: &str) -> Option<(&str, &str, Vec<&str>)> {
    let mut words = line.split_whitespace();
    let (id, model) = (words.next()?, words.next()?);
    let is_model =
        model.len() > 2 && model.bytes().all(|b| b.is_ascii_uppercase() || b == b'_' || b.is_ascii_digit());
    (id.parse::<u64>().is_ok() && is_model && model.starts_with(|c: char| c.is_ascii_uppercase()))
        .then(|| (id, model, words.collect()))
}

fn lines(text: &str) -> impl Iterator<Item = &str> {
    text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'))
}

/// Whether the text is of this form.
pub(crate) fn is_form(text: &str) -> bool {
    lines(text).next().and_then(row).is_some()
}

/// Reads the camera, of several that differ the one that `hint` tells.
pub(crate) fn parse(text: &str, file: &str, hint: &CameraHint) -> Result<Camera, CalibError> {
    let rows: Vec<_> = lines(text).filter_map(row).collect();
    let is_one = rows.windows(2).all(|pair| (pair[0].1, &pair[0].2) == (pair[1].1, &pair[1].2));
    let named: Vec<Named> = rows.iter().map(|(id, ..)| Named::of((*id).to_owned())).collect();
    let index = if is_one { 0 } else { choose(file, &named, hint)? };
    rows.get(index)
        .map_or_else(|| Err(CalibError::UnknownForm { file: file.into() }), |row| camera(row, file))
}

fn camera((id, model, words): &(&str, &str, Vec<&str>), file: &str) -> Result<Camera, CalibError> {
    let key = format!("camera {id}");
    let bad = |problem: String, fix: &str| CalibError::BadValue {
        file: file.into(),
        key: key.clone(),
        problem,
        fix: fix.into(),
    };
    let numbers = words.iter().map(|word| word.parse::<f64>().ok().filter(|number| number.is_finite()));
    let numbers: Option<Vec<f64>> = numbers.collect();
    let Some(&(_, one_focal, lens, places)) = MODELS.iter().find(|row| row.0 == *model) else {
        let names = MODELS.map(|row| row.0).join(", ");
        return Err(bad(
            format!("COLMAP's model {model} is not supported"),
            &format!("reconstruct with one of {names}"),
        ));
    };
    let expected = 2 + if one_focal { 3 } else { 4 } + places.len();
    let numbers = numbers.filter(|numbers| numbers.len() == expected).ok_or_else(|| {
        bad(format!("not the {expected} numbers of {model}"), "give width, height and the model's parameters")
    })?;
    let side =
        |value: f64| (value.fract() == 0.0 && (1.0..=65535.0).contains(&value)).then_some(value as usize);
    let (Some(width), Some(height)) = (side(numbers[0]), side(numbers[1])) else {
        return Err(bad(format!("{} × {} is no image size", numbers[0], numbers[1]), "give it in pixels"));
    };
    let (fx, rest) = (numbers[2], &numbers[if one_focal { 3 } else { 4 }..]);
    let fy = if one_focal { fx } else { numbers[3] };
    let mut terms = vec![0.0; places.iter().max().map_or(0, |most| (most + 1).max(4))];
    places.iter().zip(&rest[2..]).for_each(|(&place, &term)| terms[place] = term);
    let distortion = lens.padded_distortion(&terms).map_err(|error| distortion_error(file, &key, error))?;
    let pinhole = Pinhole { width, height, fx, fy, cx: rest[0] - 0.5, cy: rest[1] - 0.5 };
    Camera::new(pinhole, distortion).map_err(|error| CalibError::from_camera(file, |_| key.clone(), error))
}
