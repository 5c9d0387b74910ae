//! Scans in order, wherever they lie.

use crate::{Folder, Scan, ScanError};
use std::path::PathBuf;

/// Scans in order of time.
pub trait ScanSource {
    /// What is known before the scans are read.
    fn info(&self) -> &ScanInfo;

    /// The next scan; none after the last.
    fn next_scan(&mut self) -> Option<NextScan>;

    /// What is to be said of the recording as far as it was read, and how it was taken.
    fn remarks(&self) -> Vec<String> {
        Vec::new()
    }
}

/// What is known of a recording of scans before they are read.
#[derive(Clone, Debug, PartialEq)]
pub struct ScanInfo {
    /// Where it lies.
    pub path: PathBuf,
    /// Its kind, for people: `folder of KITTI scans`.
    pub kind: String,
    /// Scans in it, where that can be told.
    pub count: Option<u64>,
    /// Seconds from the first scan to the last, where that can be told.
    pub duration: Option<f64>,
    /// Whether it is laid out as KITTI's recordings are, whose sensor turns in a known way.
    pub is_kitti: bool,
    /// What else there is to say of it, as label and text.
    pub facts: Vec<(&'static str, String)>,
}

/// A scan as its source has it.
#[derive(Debug)]
pub struct NextScan {
    /// Index in the recording, from 0.
    pub index: u64,
    /// Its stamp, seconds.
    pub stamp: f64,
    /// The scan, or why it is of no use; the scans after it may be.
    pub scan: Result<Scan, ScanError>,
}

/// The scans of a folder.
#[derive(Clone, Debug)]
pub struct FolderSource {
    folder: Folder,
    info: ScanInfo,
    next: usize,
}

impl FolderSource {
    /// All scans of a folder, from the first on.
    pub fn new(folder: Folder) -> Self {
        let files = folder.files();
        let ends = files.first().zip(files.last());
        let info = ScanInfo {
            path: folder.root().to_owned(),
            kind: format!("folder of {} scans", folder.kind()),
            count: Some(files.len() as u64),
            duration: ends.map(|(first, last)| last.stamp - first.stamp).filter(|seconds| *seconds >= 0.0),
            is_kitti: folder.is_kitti(),
            facts: folder.facts(),
        };
        Self { folder, info, next: 0 }
    }
}

impl ScanSource for FolderSource {
    fn info(&self) -> &ScanInfo {
        &self.info
    }

    fn next_scan(&mut self) -> Option<NextScan> {
        let file = self.folder.files().get(self.next)?;
        let index = self.next as u64;
        self.next += 1;
        Some(NextScan { index, stamp: file.stamp, scan: self.folder.read(file) })
    }

    fn remarks(&self) -> Vec<String> {
        self.folder.remarks().to_vec()
    }
}
