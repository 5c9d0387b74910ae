//! Calibration files beside a recording of which it is not known whether they belong to it: named, and not used.

use crate::SourceInfo;
use calib::{CalibError, CameraHint, read_camera_of};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// How names of calibration files end.
const ENDINGS: [&str; 9] = ["yaml", "yml", "xml", "json", "txt", "ini", "cfg", "conf", "cam"];
/// Folders of a recording in which programs put calibrations.
const PLACES: [&str; 7] = ["calib", "calibration", "sparse/0", "sparse", "colmap", "mav0/cam0", "dso"];
/// Larger files are none, bytes: a `transforms.json` has some hundred for each image.
const LARGEST: u64 = 8 << 20;
/// Of so many files in a folder it is seen what they are; a folder of more is no camera's.
const MOST_FILES: usize = 200;
/// So many are named.
const NAMED: usize = 3;

/// A note on each calibration file beside the recording: how to use it, or why it cannot be used.
pub fn sidecar_calibrations(info: &SourceInfo) -> Vec<String> {
    let mut seen = Vec::new();
    let descriptions = folders(info).into_iter().flat_map(|folder| files_in(&folder)).filter_map(|file| {
        let whole = file.canonicalize().unwrap_or_else(|_| file.clone());
        if seen.contains(&whole) {
            return None;
        }
        seen.push(whole);
        describe(&file, &info.camera)
    });
    descriptions.take(NAMED).collect()
}

/// Where calibrations of a recording may lie.
fn folders(info: &SourceInfo) -> Vec<PathBuf> {
    if !info.path.is_dir() {
        return info.path.parent().map(Path::to_owned).into_iter().collect();
    }
    let own = PLACES.iter().map(|place| info.path.join(place));
    // The camera's own folder, where it is not the recording's.
    let of_images =
        info.camera.folder.iter().flat_map(|images| images.ancestors().take(2).map(Path::to_owned));
    let root = info.path.canonicalize().unwrap_or_else(|_| info.path.clone());
    std::iter::once(info.path.clone())
        .chain(own)
        .chain(of_images.filter(|folder| folder.starts_with(&root)))
        .filter(|folder| folder.is_dir())
        .collect()
}

fn files_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    let is_candidate = |path: &PathBuf| {
        let ending = path.extension().unwrap_or_default().to_ascii_lowercase();
        ENDINGS.iter().any(|known| ending == *known)
            && std::fs::metadata(path).is_ok_and(|about| about.is_file() && about.len() <= LARGEST)
    };
    let mut files: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(is_candidate)
        .take(MOST_FILES + 1)
        .collect();
    files.sort();
    if files.len() > MOST_FILES { Vec::new() } else { files }
}

/// Whether a file may be a calibration, by what stands at its beginning: tables and texts are not read further.
fn may_be_one(file: &Path) -> bool {
    /// Words of which every form has one, but those of four lines of numbers.
    const WORDS: [&str; 12] = [
        "fx",
        "fl_x",
        "matrix",
        "intrinsics",
        "projection",
        "camera",
        "pinhole",
        "opencv",
        "radial",
        "p0:",
        "p_rect",
        ".k:",
    ];
    /// Files of four lines are shorter, bytes.
    const SHORT: usize = 300;
    const HEAD: u64 = 1 << 14;
    let mut head = Vec::new();
    let read = File::open(file).and_then(|file| file.take(HEAD).read_to_end(&mut head));
    let text = String::from_utf8_lossy(&head).to_ascii_lowercase();
    read.is_ok() && !is_table(&text) && (text.len() < SHORT || WORDS.iter().any(|word| text.contains(word)))
}

/// Whether a text has more rows of numbers than a calibration without words: a trajectory, say, whose heading names the camera.
fn is_table(text: &str) -> bool {
    const MOST_ROWS: usize = 8;
    let rows = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    let numbers = rows.take(MOST_ROWS + 1).filter(|row| {
        row.split([' ', '\t', ',', ';'])
            .filter(|part| !part.is_empty())
            .all(|part| part.parse::<f64>().is_ok())
    });
    numbers.count() > MOST_ROWS
}

/// What to say of a file; `None` of one that is no calibration.
fn describe(file: &Path, hint: &CameraHint) -> Option<String> {
    let name = file.display();
    if !may_be_one(file) {
        return None;
    }
    match read_camera_of(file, hint) {
        Ok(_) => Some(format!(
            "{name}: a calibration that nothing says is this camera's, and it is not used\nhint: --calib {name} takes it"
        )),
        Err(CalibError::WhichCamera { names, example, .. }) => Some(format!(
            "{name}: a calibration of several cameras ({names}), and it is not used\nhint: name one, as --calib {example}"
        )),
        // A key that is missing, a lens that is not read: somebody's calibration, as far as it could be told.
        Err(error @ (CalibError::MissingKey { .. } | CalibError::BadValue { .. })) => {
            Some(format!("a calibration lies beside, which cannot be used: {error}"))
        }
        Err(_) => None,
    }
}
