//! Image files without a table: numbered, or named by their times.

use super::image_list::{ImageList, Timed, first_existing, images_in};
use super::{FoundCalibration, SourceOptions};
use anyhow::{Result, bail};
use scans::tables::{Numbers, stamps_of_names};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Folders above one of images that may be the recording: of EuRoC's `mav0/cam0/data` it is the third.
const ABOVE: usize = 3;
/// Words in names of images that are no pictures of the scene by the camera that is taken.
const OTHERS: [&str; 9] =
    ["depth", "disp", "disparity", "mask", "label", "semantic", "seg", "normal", "right"];

/// How images without times get them: from the recording that the folder is a part of, if it is one.
fn hint_for_times(folder: &Path) -> String {
    let found = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let above = found.ancestors().skip(1).take(ABOVE);
    match above.into_iter().find(|above| crate::open(above, &SourceOptions::default()).is_ok()) {
        Some(recording) => format!(
            "the recording is the folder {}, which has their times; --fps 30 takes these images alone, as 30 a second",
            recording.display()
        ),
        None => {
            "give their frame rate, such as --fps 30, or a times.txt with a line 'seconds image' for each"
                .into()
        }
    }
}

/// Opens the folder if it, its `images/` or the only other folder in it that shows a scene holds image files.
///
/// # Errors
/// When there are images but no frame rate to time them by.
pub fn open(folder: &Path, fps: Option<f64>) -> Result<Option<ImageList>> {
    for images in
        [Some(folder.to_owned()), Some(folder.join("images")), folder_of_scene(folder)].into_iter().flatten()
    {
        if !images.is_dir() {
            continue;
        }
        let (files, mut remarks) = pictures(images_in(&images)?);
        if files.is_empty() {
            continue;
        }
        let calibration =
            first_existing(folder, &["camera.yaml", "camera.yml", "camera.txt"]).map(FoundCalibration::File);
        let (kind, frames, facts) = match (fps, stamps_of_names(&files)) {
            (None, Some(stamps)) => {
                let remark = stamps.remark().map_or(String::new(), |remark| format!(" {remark}"));
                let facts = vec![("times", format!("the names of the images{remark}"))];
                ("folder of images named by their times", in_order(stamps.seconds, files), facts)
            }
            (Some(fps), _) => {
                let gaps = Numbers::of(files.iter().map(PathBuf::as_path)).and_then(|numbers| numbers.gaps());
                remarks.extend(gaps.map(|gaps| {
                    format!("{gaps}: the images that are there are taken as {fps} a second without them")
                }));
                let frames = files.into_iter().enumerate().map(|(i, file)| (i as f64 / fps, file)).collect();
                ("folder of numbered images", frames, Vec::new())
            }
            (None, None) => bail!(
                "{}: {} images but no time stamps\nhint: {}",
                folder.display(),
                files.len(),
                hint_for_times(folder)
            ),
        };
        let list = ImageList::new(kind, folder, &images, frames, calibration)?;
        return Ok(Some(list.remarked(remarks, facts)));
    }
    Ok(None)
}

/// The only folder in this one that holds images by its camera: `color` beside `depth`.
fn folder_of_scene(folder: &Path) -> Option<PathBuf> {
    let entries = std::fs::read_dir(folder).ok()?;
    let folders = entries.filter_map(|entry| Some(entry.ok()?.path())).filter(|path| path.is_dir());
    let mut of_scene = folders.filter(|path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        shows_scene(&name) && !name.starts_with('.') && images_in(path).is_ok_and(|images| !images.is_empty())
    });
    of_scene.next().filter(|_| of_scene.next().is_none())
}

/// Whether a name may be of an image of the scene: not of depth or another kind that shows no scene, nor of another
/// camera than the one in use.
pub fn shows_scene(name: &str) -> bool {
    let mut words = name.split(|c: char| !c.is_alphanumeric());
    !words.any(|word| OTHERS.contains(&&*word.to_ascii_lowercase()))
}

fn in_order(times: Vec<f64>, files: Vec<PathBuf>) -> Vec<Timed> {
    let mut frames: Vec<Timed> = times.into_iter().zip(files).collect();
    frames.sort_by(|a, b| a.0.total_cmp(&b.0));
    frames
}

/// The images that show the scene, where a folder holds several kinds of image by their names: `frame-000000.color.png` beside
/// `frame-000000.depth.png`. Says what was left out.
fn pictures(files: Vec<PathBuf>) -> (Vec<PathBuf>, Vec<String>) {
    let mut kinds: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for file in &files {
        kinds.entry(pattern(file)).or_default().push(file.clone());
    }
    let shows = |kind: &String| shows_scene(kind);
    let left: Vec<&String> = kinds.keys().filter(|kind| !shows(kind)).collect();
    if left.is_empty() || left.len() == kinds.len() {
        return (files, Vec::new());
    }
    let remark = format!("images named as {} are left out: they are no pictures of this camera", text(&left));
    let kept: Vec<PathBuf> = files.into_iter().filter(|file| shows(&pattern(file))).collect();
    (kept, vec![remark])
}

fn text(kinds: &[&String]) -> String {
    kinds.iter().map(|kind| kind.as_str()).collect::<Vec<_>>().join(" and ")
}

/// A file's name with `#` for each number.
fn pattern(file: &Path) -> String {
    let mut pattern = String::new();
    for c in file.file_name().unwrap_or_default().to_string_lossy().chars() {
        match c.is_ascii_digit() {
            true if pattern.ends_with('#') => {}
            true => pattern.push('#'),
            false => pattern.push(c),
        }
    }
    pattern
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paths(names: &[&str]) -> Vec<PathBuf> {
        names.iter().map(PathBuf::from).collect()
    }

    #[test]
    fn names_that_are_stamps_are_times() {
        let seconds = |names: &[&str]| stamps_of_names(&paths(names)).map(|stamps| stamps.seconds);
        let step = |names: &[&str]| seconds(names).map(|all| ((all[1] - all[0]) * 1e4).round() / 1e4);
        assert_eq!(step(&["1403636579763555584.png", "1403636579813555456.png"]), Some(0.05));
        assert_eq!(step(&["1305031102.175304.png", "1305031102.211214.png"]), Some(0.0359));
        assert_eq!(step(&["frame_1614600000033.jpg", "frame_1614600000066.jpg"]), Some(0.033));
        assert_eq!(step(&["1614600000033123.png", "1614600000083123.png"]), Some(0.05));
        assert_eq!(step(&["12.50.png", "12.60.png"]), Some(0.1));
        assert_eq!(step(&["2024_05_01_10_00_00_100.png", "2024_05_01_10_00_00_300.png"]), Some(0.2));
        for numbers in [
            ["000000.png", "000001.png"],
            ["0000000010.png", "0000000020.png"],
            ["1000000001.png", "1000000002.png"],
            ["a.png", "b.png"],
            ["frame-000000.color.png", "frame-000001.color.png"],
        ] {
            assert_eq!(seconds(&numbers), None, "{numbers:?}");
        }
    }

    #[test]
    fn other_images_than_the_scene_are_left_out() {
        let kept = |names: &[&str]| {
            let (kept, remarks) = pictures(paths(names));
            (kept.iter().map(|path| path.display().to_string()).collect::<Vec<_>>(), remarks.len())
        };
        let seven = [
            "frame-000000.color.png",
            "frame-000000.depth.png",
            "frame-000001.color.png",
            "frame-000001.depth.png",
        ];
        assert_eq!(kept(&seven), (vec![seven[0].into(), seven[2].into()], 1));
        assert_eq!(kept(&["1_depth.png", "1_rgb.png"]), (vec!["1_rgb.png".into()], 1));
        assert_eq!(kept(&["left_1.png", "right_1.png"]), (vec!["left_1.png".into()], 1));
        assert_eq!(kept(&["1.png", "1_mask.png"]), (vec!["1.png".into()], 1));
        assert_eq!(kept(&["depth_1.png", "depth_2.png"]).1, 0);
        assert_eq!(kept(&["IMG_1.png", "DSC_2.png"]).1, 0);
    }
}
