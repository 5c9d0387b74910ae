//! Cameras of public data sets that come without a calibration, recognised by their layout.

use super::FoundCalibration;
use geometry::{Camera, Distortion, Pinhole, RadTan};
use std::path::Path;

/// The colour cameras of the TUM RGB-D benchmark as its authors calibrated them (Sturm et al. 2012; page *File formats*):
/// `fx fy cx cy`, and `k1 k2 p1 p2 k3`. Images of the third are published without distortion.
const TUM: [([f64; 4], [f64; 5]); 3] = [
    ([517.306408, 516.469215, 318.643040, 255.313989], [0.262383, -0.953104, -0.005358, 0.002628, 1.163314]),
    ([520.908620, 521.007327, 325.141442, 249.701764], [0.231222, -0.784899, -0.003257, -0.000105, 0.917205]),
    ([535.4, 539.2, 320.1, 247.6], [0.0; 5]),
];
const TUM_SIZE: (usize, usize) = (640, 480);

/// The rectified cameras of KITTI's odometry sequences (Geiger et al. 2012, `calib.txt`), told by the size of their images:
/// width, height, focal length, principal point, and which sequences.
const KITTI: [(usize, usize, f64, f64, f64, &str); 3] = [
    (1241, 376, 718.856, 607.1928, 185.2157, "00 to 02 and 13 to 21"),
    (1242, 375, 721.5377, 609.5593, 172.854, "03"),
    (1226, 370, 707.0912, 601.8873, 183.1104, "04 to 12"),
];

/// The camera of a folder in the layout of the TUM RGB-D benchmark, by its name or by the comments of its `rgb.txt`
/// (`# file: 'rgbd_dataset_freiburg1_xyz.bag'`). `None` if they name no camera, or images have another size.
pub fn tum(folder: &Path, table: &Path, first: &Path) -> Option<FoundCalibration> {
    let whole = folder.canonicalize().ok();
    let name = whole.as_deref().unwrap_or(folder).file_name().map(|name| name.to_string_lossy().into_owned());
    let text = std::fs::read_to_string(table).unwrap_or_default();
    let comments = text.lines().map_while(|line| line.strip_prefix('#').map(str::to_owned));
    let number = name.into_iter().chain(comments).find_map(|text| freiburg(&text))?;
    let ([fx, fy, cx, cy], terms) = TUM[number - 1];
    let distortion = match terms[0] {
        0.0 => Distortion::None,
        _ => Distortion::RadTan(RadTan::new(&terms).ok()?),
    };
    let (width, height) = TUM_SIZE;
    preset(
        Pinhole { width, height, fx, fy, cx, cy },
        distortion,
        first,
        format!("TUM RGB-D, freiburg{number}"),
    )
}

/// The camera of a KITTI odometry sequence without its `calib.txt`; `None` where images have another size.
pub fn kitti(first: &Path) -> Option<FoundCalibration> {
    let size = size(first)?;
    let &(width, height, focal, cx, cy, which) = KITTI.iter().find(|row| (row.0, row.1) == size)?;
    let pinhole = Pinhole { width, height, fx: focal, fy: focal, cx, cy };
    preset(pinhole, Distortion::None, first, format!("KITTI odometry, sequences {which}"))
}

fn preset(
    pinhole: Pinhole,
    distortion: Distortion,
    first: &Path,
    data_set: String,
) -> Option<FoundCalibration> {
    if size(first) != Some((pinhole.width, pinhole.height)) {
        return None;
    }
    let camera = Box::new(Camera::new(pinhole, distortion).ok()?);
    Some(FoundCalibration::Preset { origin: format!("preset for {data_set}"), camera })
}

fn size(image: &Path) -> Option<(usize, usize)> {
    let (width, height) = image::image_dimensions(image).ok()?;
    Some((width as usize, height as usize))
}

/// The number in `freiburg2` or, as a word of its own, `fr2`; 1 to 3.
fn freiburg(text: &str) -> Option<usize> {
    let text = text.to_ascii_lowercase();
    let number = |rest: &str| rest.chars().next()?.to_digit(10).filter(|n| (1..=3).contains(n));
    let long = text.split("freiburg").skip(1).find_map(number);
    let words = || text.split(|c: char| !c.is_ascii_alphanumeric());
    let short = || words().filter(|word| word.len() == 3).find_map(|word| number(word.strip_prefix("fr")?));
    long.or_else(short).map(|n| n as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_of_freiburg_are_recognised_by_name() {
        for (text, expected) in [
            ("rgbd_dataset_freiburg1_xyz", Some(1)),
            (" file: 'rgbd_dataset_freiburg3_long_office_household.bag'", Some(3)),
            ("fr2_desk", Some(2)),
            ("tum-FR1", Some(1)),
            ("freiburg4", None),
            ("fr12", None),
            ("afr1", None),
            ("desk", None),
        ] {
            assert_eq!(freiburg(text), expected, "{text}");
        }
    }
}
