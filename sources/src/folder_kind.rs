//! The kind of recording in a folder, by all of its files: one file of another kind does not change it.

use crate::image_list::images_in;
use crate::rosbag2::files_with;
use scans::folder_contents;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Where recordings of folders have their images.
const IMAGE_FOLDERS: [&str; 10] = [
    ".",
    "images",
    "rgb",
    "image_0",
    "image_2",
    "image_00/data",
    "mav0/cam0/data",
    "cam0/data",
    "data",
    "color",
];
/// Fewest scans of a recording that also has images.
const LEAST_SCANS: usize = 2;

/// How many frames a folder holds for each sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FolderKind {
    /// Scans of a LiDAR.
    pub scans: usize,
    /// Images of a camera.
    pub images: usize,
}

impl FolderKind {
    /// The counts for the folder at `path`; zero for anything else.
    pub fn of(path: &Path) -> Self {
        if !path.is_dir() {
            return Self::default();
        }
        let scans = folder_contents(path).map_or(0, |found| found.scans.len());
        let folders = IMAGE_FOLDERS.map(|name| path.join(name)).into_iter().filter(|folder| folder.is_dir());
        let images =
            folders.map(|folder| images_in(&folder).map_or(0, |images| images.len())).max().unwrap_or(0);
        Self { scans, images }
    }

    /// Whether it is a LiDAR's recording: there are scans, and no more images than scans.
    pub fn is_of_lidar(self) -> bool {
        self.scans > 0 && (self.images == 0 || self.scans >= LEAST_SCANS.max(self.images))
    }

    /// A note on the kind that is not used; `None` if the folder holds one kind.
    pub fn other(self) -> Option<String> {
        match (self.scans, self.images, self.is_of_lidar()) {
            (0, ..) | (_, 0, _) => None,
            (_, images, true) => {
                Some(format!("{images} images; --sensor camera takes them in place of the scans"))
            }
            (scans, _, false) => {
                Some(format!("{scans} scans; --sensor lidar takes them in place of the images"))
            }
        }
    }
}

/// How names of video files end.
const VIDEOS: [&str; 10] = ["mp4", "mov", "avi", "mkv", "webm", "m4v", "mts", "m2ts", "mpg", "wmv"];

/// The video files of a folder.
pub fn videos_in(folder: &Path) -> Vec<PathBuf> {
    let of_ending = |ending: &&str| files_with(folder, ending).unwrap_or_default();
    VIDEOS.iter().flat_map(of_ending).collect()
}

/// The error for a folder without a recording: what is there, and what loopbox looked for.
pub fn nothing_in(folder: &Path) -> anyhow::Error {
    let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let videos: Vec<String> = videos_in(folder).iter().map(name).collect();
    let has_images = |path: &PathBuf| images_in(path).is_ok_and(|images| !images.is_empty());
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    let folders = entries.filter_map(|entry| Some(entry.ok()?.path())).filter(|path| path.is_dir());
    let mut folders: Vec<String> = folders.filter(has_images).map(|path| name(&path) + "/").collect();
    folders.sort();
    let hint = match (&folders[..], &videos[..]) {
        ([], []) => "looked for times.txt with images/, rgb.txt (TUM), mav0/cam0/data.csv (EuRoC), image_0/ or image_2/ with \
             times.txt (KITTI), image_00/data with timestamps.txt (KITTI raw), .mcap, .db3 and .bag files, .png, .jpg, .pgm, .tiff or \
             .bmp files, a video, and a LiDAR's .bin, .pcd or .ply"
            .to_owned(),
        (which, videos) => format!(
            "a recording is one camera's: give that folder or file itself, of {}",
            which.iter().chain(videos).cloned().collect::<Vec<_>>().join(", ")
        ),
    };
    anyhow::anyhow!("{}: no recording here: {}\nhint: {hint}", folder.display(), listed(folder))
}

/// The content of a folder for an error message: files by ending, and folders with their numbers of images.
pub fn listed(folder: &Path) -> String {
    /// So many kinds are named.
    const NAMED: usize = 8;
    let Ok(entries) = std::fs::read_dir(folder) else { return "it cannot be read".into() };
    let (mut files, mut folders) = (BTreeMap::<String, usize>::new(), Vec::new());
    for path in entries.filter_map(|entry| Some(entry.ok()?.path())) {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if name.starts_with('.') {
            continue;
        }
        if path.is_dir() {
            folders.push(match images_in(&path).map_or(0, |images| images.len()) {
                0 => format!("{name}/"),
                images => format!("{name}/ ({images} images)"),
            });
            continue;
        }
        let ending = path.extension().map_or(name, |ending| format!(".{}", ending.to_string_lossy()));
        *files.entry(ending).or_default() += 1;
    }
    folders.sort();
    let mut files: Vec<(String, usize)> = files.into_iter().collect();
    files.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    let output = |(ending, count): &(String, usize)| match ending.starts_with('.') {
        true => format!("{count} {ending}"),
        false => ending.clone(),
    };
    let whole: Vec<String> = folders.into_iter().chain(files.iter().map(output)).collect();
    match whole.len() {
        0 => "it is empty".into(),
        count if count > NAMED => format!("it holds {}, and more", whole[..NAMED].join(", ")),
        _ => format!("it holds {}", whole.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(files: &[(&str, usize, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, count, text) in files {
            for i in 0..*count {
                let path = folder.path().join(name.replace('#', &format!("{i:03}")));
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, text).unwrap();
            }
        }
        folder
    }

    fn kind(files: &[(&str, usize, &str)]) -> (FolderKind, bool) {
        let folder = folder(files);
        let kind = FolderKind::of(folder.path());
        (kind, kind.is_of_lidar())
    }

    #[test]
    fn a_stray_cloud_does_not_make_a_cameras_recording_a_lidars() {
        for stray in [("cloud.ply", "ply\n"), ("map.pcd", "# .PCD v0.7\n"), ("imu.bin", "xxxx")] {
            for images in ["#.png", "images/#.jpg", "rgb/#.png"] {
                let (kind, is_lidar) = kind(&[(images, 12, ""), (stray.0, 1, stray.1)]);
                assert_eq!(
                    (kind, is_lidar),
                    (FolderKind { scans: 1, images: 12 }, false),
                    "{stray:?} {images}"
                );
                assert!(kind.other().is_some_and(|other| other.contains("--sensor lidar")));
            }
        }
        // Clouds of a reconstruction beside its images, and an icon beside scans.
        assert!(!kind(&[("images/#.png", 30, ""), ("dense_#.ply", 5, "ply\n")]).1);
        assert!(kind(&[("#.bin", 30, "xxxx"), ("preview.png", 1, "")]).1);
    }

    #[test]
    fn hidden_files_are_no_frames() {
        let (kind, is_lidar) =
            kind(&[("#.png", 9, ""), ("._#.png", 9, ""), ("._#.bin", 9, "xxxx"), (".#.ply", 9, "ply")]);
        assert_eq!((kind, is_lidar), (FolderKind { scans: 0, images: 9 }, false));
    }

    #[test]
    fn where_both_are_a_recording_both_are_named() {
        let (kind, is_lidar) = kind(&[("image_0/#.png", 20, ""), ("velodyne/#.bin", 20, "xxxx")]);
        assert!(is_lidar && kind.other().is_some_and(|other| other.contains("--sensor camera")), "{kind:?}");
        let (kind, is_lidar) = kind_of_pairs();
        assert!(is_lidar && kind.images == 7);
    }

    fn kind_of_pairs() -> (FolderKind, bool) {
        kind(&[("#.png", 7, ""), ("#.pcd", 7, "VERSION .7\n")])
    }

    #[test]
    fn what_lies_in_a_folder_is_listed() {
        let folder = folder(&[
            ("left/#.png", 3, ""),
            ("calib/a", 1, ""),
            ("#.webp", 4, ""),
            ("notes", 1, ""),
            (".x", 1, ""),
        ]);
        assert_eq!(listed(folder.path()), "it holds calib/, left/ (3 images), 4 .webp, notes");
        assert_eq!(listed(tempfile::tempdir().unwrap().path()), "it is empty");
    }
}
