//! KITTI's `calib.txt` (odometry: `P0: …` to `P3: …`, rectified projections) and `calib_cam_to_cam.txt` (raw recordings: size, matrix and
//! distortion of each camera as it takes images and rectified).

use super::distortion_error;
use crate::CalibError;
use crate::camera_file::choice::{CameraHint, Named, choose};
use geometry::{Camera, Distortion, Pinhole, RadTan};

/// KITTI has four cameras.
const CAMERAS: usize = 4;

/// Whether a text is one of these.
pub(crate) fn is_form(text: &str) -> bool {
    values(text, "P0").is_some() && values(text, "P1").is_some() || values(text, "P_rect_00").is_some()
}

/// The camera that `hint` tells: by its folder (`image_02`, `image_2`) or name.
pub(crate) fn parse(text: &str, file: &str, hint: &CameraHint) -> Result<Camera, CalibError> {
    let is_raw = values(text, "P_rect_00").is_some();
    let row = |index: usize| if is_raw { format!("P_rect_0{index}") } else { format!("P{index}") };
    let present: Vec<usize> = (0..CAMERAS).filter(|index| values(text, &row(*index)).is_some()).collect();
    let named: Vec<Named> =
        present.iter().map(|index| Named::numbered(Some(format!("image_0{index}")), *index)).collect();
    let index = present.get(choose(file, &named, hint)?).copied().unwrap_or_default();
    let raw_size = numbers::<2>(text, &format!("S_0{index}"), file).ok().map(|size| pixels(&size));
    let rectified = match numbers::<2>(text, &format!("S_rect_0{index}"), file) {
        Ok(size) => Some(pixels(&size)),
        Err(error) if is_raw => return Err(error),
        Err(_) => None,
    };
    let as_taken = is_raw && hint.size.is_some() && hint.size == raw_size && hint.size != rectified;
    if as_taken {
        let [fx, _, cx, _, fy, cy, ..] = numbers::<9>(text, &format!("K_0{index}"), file)?;
        let key = format!("D_0{index}");
        let distortion = RadTan::new(&numbers::<5>(text, &key, file)?);
        let distortion =
            distortion.map(Distortion::RadTan).map_err(|error| distortion_error(file, &key, error))?;
        return camera(file, &key, hint.size.unwrap_or_default(), [fx, fy, cx, cy], distortion);
    }
    let key = row(index);
    let [fx, _, cx, _, _, fy, cy, ..] = numbers::<12>(text, &key, file)?;
    let size = rectified.or(hint.size).ok_or_else(|| CalibError::MissingKey {
        file: file.into(),
        key: "size".into(),
        fix:
            "this file does not tell the image size, and no image does: write a camera.yaml with its numbers"
                .into(),
    })?;
    camera(file, &key, size, [fx, fy, cx, cy], Distortion::None)
}

fn camera(
    file: &str,
    key: &str,
    (width, height): (usize, usize),
    [fx, fy, cx, cy]: [f64; 4],
    distortion: Distortion,
) -> Result<Camera, CalibError> {
    Camera::new(Pinhole { width, height, fx, fy, cx, cy }, distortion)
        .map_err(|error| CalibError::from_camera(file, |_| key.into(), error))
}

fn pixels(size: &[f64; 2]) -> (usize, usize) {
    (size[0] as usize, size[1] as usize)
}

/// What stands behind `key:`.
fn values<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    text.lines().find_map(|line| line.trim().strip_prefix(key)?.trim_start().strip_prefix(':'))
}

fn numbers<const N: usize>(text: &str, key: &str, file: &str) -> Result<[f64; N], CalibError> {
    let fix = || format!("give {N} numbers there");
    let row = values(text, key).ok_or_else(|| CalibError::MissingKey {
        file: file.into(),
        key: key.into(),
        fix: fix(),
    })?;
    let found: Vec<f64> = row.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    let count = found.len();
    found.try_into().map_err(|_| CalibError::BadValue {
        file: file.into(),
        key: key.into(),
        problem: format!("{count} numbers can be read"),
        fix: fix(),
    })
}
