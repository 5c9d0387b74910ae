//! A folder of scans: which files there are, when they were taken, and what is known of their points.

use crate::bin_layout::{BinLayout, Sample, layout_of};
use crate::contents::{FolderContents, folder_contents};
use crate::tables::{Numbers, Table, stamps_of_names};
use crate::{Scan, ScanError, read_bin, read_pcd, read_ply, rings_of};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

/// What a folder does not say of itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FolderOptions {
    /// Scans a second, for folders without `times.txt`; by default 10.
    pub rate: Option<f64>,
    /// The file of stamps, where it is not `times.txt` in the folder.
    pub times: Option<PathBuf>,
}

/// One scan's files and stamp.
#[derive(Clone, Debug, PartialEq)]
pub struct ScanFile {
    /// The file of points.
    pub path: PathBuf,
    /// The stamp, seconds.
    pub stamp: f64,
}

/// A folder of KITTI `.bin`, PCD or PLY scans, in order of their names, in which 2 comes before 10.
///
/// Besides the scans it may hold `times.txt` (`stamp [index]` a line) or KITTI's `timestamps.txt`, `times/NAME.f32` (seconds after
/// the stamp, one little-endian float32 a point) and `rings/NAME.u8`; the scans themselves may lie in a folder `velodyne`, or as
/// KITTI's raw recordings have them in `velodyne_points/data`.
#[derive(Clone, Debug)]
pub struct Folder {
    root: PathBuf,
    files: Vec<ScanFile>,
    /// How `.bin` files are stored.
    layout: BinLayout,
    /// Files that look like scans of another kind, of which there are fewer, by ending.
    others: BTreeMap<String, Vec<PathBuf>>,
    remarks: Vec<String>,
}

/// The times of the scans that lie in `scans`, where nobody named another file.
fn sidecar_times(path: &Path, scans: &Path) -> PathBuf {
    let candidates =
        [path.join("times.txt"), path.join("timestamps.txt"), scans.with_file_name("timestamps.txt")];
    candidates.iter().find(|file| file.is_file()).unwrap_or(&candidates[0]).clone()
}

impl Folder {
    /// Looks through a folder.
    ///
    /// # Errors
    /// When it cannot be read, holds no scans or scans of several kinds, or its `times.txt` does not fit them.
    pub fn open(path: &Path, options: &FolderOptions) -> Result<Self, ScanError> {
        let FolderContents { folder, scans, others } = folder_contents(path)?;
        let name = path.display().to_string();
        if scans.is_empty() {
            return Err(ScanError::format(&name, "holds no scans (files ending in .bin, .pcd or .ply)"));
        }
        let layout = layout_of_files(&scans).map_err(|why| ScanError::format(&name, why))?;
        let times = options.times.clone().unwrap_or_else(|| sidecar_times(path, &folder));
        let (stamps, remarks) = timed(&scans, &times, options, &name)?;
        let files: Vec<_> =
            scans.into_iter().zip(stamps).map(|(path, stamp)| ScanFile { path, stamp }).collect();
        Ok(Self { root: path.to_owned(), files, layout, others, remarks })
    }

    /// What is to be said of how its files and times were taken.
    pub fn remarks(&self) -> &[String] {
        &self.remarks
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// What its scans are, for people.
    pub fn kind(&self) -> String {
        match self.ending().as_str() {
            "pcd" => "PCD".into(),
            "ply" => "PLY".into(),
            _ if self.is_kitti() => "KITTI".into(),
            _ => format!("binary ({})", self.layout.columns()),
        }
    }

    fn ending(&self) -> String {
        let ending = self.files.first().and_then(|file| file.path.extension()).unwrap_or_default();
        ending.to_ascii_lowercase().to_string_lossy().into_owned()
    }

    /// Whether it is laid out as KITTI's recordings are: points of four numbers in files that are called by six or ten digits, in a
    /// folder `velodyne`, or `data` of `velodyne_points`.
    pub fn is_kitti(&self) -> bool {
        let is_numbered = |path: &Path| {
            let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            matches!(stem.len(), 6 | 10) && stem.bytes().all(|b| b.is_ascii_digit())
        };
        let Some(first) = self.files.first() else { return false };
        let parent = first.path.parent().and_then(|parent| parent.canonicalize().ok()).unwrap_or_default();
        let is_named = |path: &Path, name: &str| path.file_name().is_some_and(|found| found == name);
        let is_raw =
            is_named(&parent, "data") && parent.parent().is_some_and(|up| is_named(up, "velodyne_points"));
        self.ending() == "bin"
            && self.layout.columns() == BinLayout::default().columns()
            && is_numbered(&first.path)
            && (is_named(&parent, "velodyne") || is_raw)
    }

    /// What there is to say of the folder, as label and text.
    pub fn facts(&self) -> Vec<(&'static str, String)> {
        let mut facts = Vec::new();
        if self.ending() == "bin" {
            let other = self.layout.other.map_or_else(String::new, |other| {
                format!("; points of {other} numbers fit as well, the richer is taken")
            });
            facts.push((
                "columns",
                format!("{} (float32, told from the numbers{other})", self.layout.columns()),
            ));
        }
        for (ending, files) in &self.others {
            let first = files.first().map_or_else(String::new, |path| path.display().to_string());
            facts.push(("left out", format!("{} files ending in .{ending}, {first} the first", files.len())));
        }
        facts
    }

    /// The scans in order of time.
    pub fn files(&self) -> &[ScanFile] {
        &self.files
    }

    /// Reads a scan; times and rings come from files beside it, from its own columns, or are derived.
    ///
    /// # Errors
    /// When the scan is of no use; others of the folder may be.
    pub fn read(&self, file: &ScanFile) -> Result<Scan, ScanError> {
        let name = file.path.display().to_string();
        let bytes = read(&file.path)?;
        let ending = file.path.extension().unwrap_or_default().to_ascii_lowercase();
        let mut scan = match ending.to_str() {
            Some("pcd") => read_pcd(&bytes, file.stamp, &name)?,
            Some("ply") => read_ply(&bytes, file.stamp, &name)?,
            _ => read_bin(&bytes, &self.layout, file.stamp, &name)?,
        };
        scan.stamp = file.stamp;
        self.add_side_files(&mut scan, file)?;
        if scan.rings.is_empty() {
            scan.rings = rings_of(&scan.points);
        }
        scan.checked(&name)
    }

    fn add_side_files(&self, scan: &mut Scan, file: &ScanFile) -> Result<(), ScanError> {
        let stem = file.path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let times = self.root.join("times").join(format!("{stem}.f32"));
        let points = scan.points.len();
        if times.is_file() {
            let bytes = read(&times)?;
            expect(&times, bytes.len(), 4 * points)?;
            scan.times =
                bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        }
        let rings = self.root.join("rings").join(format!("{stem}.u8"));
        if rings.is_file() {
            let bytes = read(&rings)?;
            expect(&rings, bytes.len(), points)?;
            scan.rings = bytes.into_iter().map(u16::from).collect();
        }
        Ok(())
    }
}

fn expect(path: &Path, found: usize, expected: usize) -> Result<(), ScanError> {
    let what = || format!("holds {found} bytes where the scan's points need {expected}");
    if found == expected { Ok(()) } else { Err(ScanError::format(&path.display().to_string(), what())) }
}

fn read(path: &Path) -> Result<Vec<u8>, ScanError> {
    std::fs::read(path).map_err(|source| ScanError::Io { name: path.display().to_string(), source })
}

/// The layout of `.bin` files, from some of them spread over the recording.
fn layout_of_files(scans: &[PathBuf]) -> Result<BinLayout, String> {
    /// So many files are looked at, and so many bytes of each.
    const SAMPLES: (usize, u64) = (5, 1 << 17);
    if scans.first().is_none_or(|path| path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("bin"))) {
        return Ok(BinLayout::default());
    }
    let step = scans.len().div_ceil(SAMPLES.0).max(1);
    let sample = |path: &PathBuf| {
        let mut head = Vec::new();
        let file = std::fs::File::open(path).ok()?;
        let length = file.metadata().ok()?.len();
        file.take(SAMPLES.1).read_to_end(&mut head).ok()?;
        Some(Sample { length, head })
    };
    layout_of(&scans.iter().step_by(step).filter_map(sample).collect::<Vec<_>>())
}

/// The stamps of scans from the file of times, or by their rate where there is none; and what is to be said of them.
fn timed(
    scans: &[PathBuf],
    times: &Path,
    options: &FolderOptions,
    name: &str,
) -> Result<(Vec<f64>, Vec<String>), ScanError> {
    let rate = options.rate.unwrap_or(10.0);
    if !(rate.is_finite() && rate > 0.0) {
        return Err(ScanError::format(name, format!("{rate} scans a second: expected a number above 0")));
    }
    let at_rate = || (0..scans.len()).map(|i| i as f64 / rate).collect();
    match Table::read(times) {
        Ok(table) => {
            let (stamps, remark) = stamps(&table, scans, &times.display().to_string())?;
            let are_constant = stamps.len() > 1 && stamps.iter().all(|stamp| *stamp == stamps[0]);
            match (are_constant, options.rate) {
                (false, _) => Ok((stamps, remark.into_iter().collect())),
                (true, Some(rate)) => {
                    let what =
                        format!("{}: all times are {}: taken as {rate} a second", times.display(), stamps[0]);
                    Ok((at_rate(), vec![what]))
                }
                (true, None) => {
                    let what = format!(
                        "all {} scans have the time {}; give their rate, such as --rate 10",
                        stamps.len(),
                        stamps[0]
                    );
                    Err(ScanError::format(&times.display().to_string(), what))
                }
            }
        }
        Err(source) if options.times.is_some() => {
            Err(ScanError::Io { name: times.display().to_string(), source })
        }
        Err(_)
            if options.rate.is_none()
                && let Some(stamps) = stamps_of_names(scans) =>
        {
            let what = stamps.remark().map(|remark| format!("the scans are named by their times, {remark}"));
            Ok((stamps.seconds, what.into_iter().collect()))
        }
        Err(_) => {
            let gaps = Numbers::of(scans.iter().map(PathBuf::as_path)).and_then(|numbers| numbers.gaps());
            let what =
                |gaps| format!("{gaps}: the scans that are there are taken as {rate} a second without them");
            Ok((at_rate(), gaps.map(what).into_iter().collect()))
        }
    }
}

/// One stamp per scan, seconds, and what is to be said of them. Where scans are missing, their numbers tell whose the stamps are.
fn stamps(table: &Table, scans: &[PathBuf], name: &str) -> Result<(Vec<f64>, Option<String>), ScanError> {
    let stamps = table.stamps().map_err(|row| {
        ScanError::format(name, format!("line {}: `{}` does not begin with a time", row.line, row.text()))
    })?;
    let remark = stamps.remark().map(|remark| format!("{name}: times are {remark}"));
    let (times, count) = (stamps.seconds, scans.len());
    if times.len() == count {
        return Ok((times, remark));
    }
    let numbers = Numbers::of(scans.iter().map(PathBuf::as_path));
    let missing = |which: &str| format!("has {} times for {count} scans{which}", times.len());
    let of_numbers = numbers.and_then(|numbers| numbers.places_in(times.len()));
    match of_numbers {
        Some(places) => {
            let what = format!("{name}: {}", missing(": those of the scans' numbers are taken"));
            // Of the first part of a sequence nothing is missing.
            let what = (!places.iter().copied().eq(0..count)).then_some(what);
            let remarks: Vec<String> = remark.into_iter().chain(what).collect();
            let remark = (!remarks.is_empty()).then(|| remarks.join("; "));
            Ok((places.into_iter().map(|place| times[place]).collect(), remark))
        }
        None => Err(ScanError::format(name, missing(""))),
    }
}

#[cfg(test)]
mod tests;
