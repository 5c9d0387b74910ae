//! A folder of scans: which files there are, when they were taken, and what is known of their points.

use crate::tables::{Numbers, Table, natural_key};
use crate::{Scan, ScanError, SweepTiming, read_kitti, read_pcd, read_ply, rings_of};
use std::path::{Path, PathBuf};

/// What a folder does not say of itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FolderOptions {
    /// Scans a second, for folders without `times.txt`; by default 10.
    pub rate: Option<f64>,
    /// The file of stamps, where it is not `times.txt` in the folder.
    pub times: Option<PathBuf>,
    /// How the sensor turns, for KITTI scans without times of points. `None`: such scans are taken as rigid.
    pub timing: Option<SweepTiming>,
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
    timing: Option<SweepTiming>,
    remarks: Vec<String>,
}

/// Whether a path is a folder with files that may be scans.
pub fn is_folder_of_scans(path: &Path) -> bool {
    path.is_dir() && PLACES.iter().any(|place| holds_scans(&path.join(place)))
}

fn holds_scans(folder: &Path) -> bool {
    folder.is_dir() && scans_in(folder).is_ok_and(|found| !found.is_empty())
}

/// Where in a folder the scans of a recording may lie.
const PLACES: [&str; 4] = ["velodyne", ".", "velodyne_points/data", "data"];

/// The folder of the scans, and their times where nobody named another file.
fn places(path: &Path) -> (PathBuf, PathBuf) {
    let place = PLACES.iter().find(|place| holds_scans(&path.join(place))).filter(|place| **place != ".");
    let scans = place.map_or_else(|| path.to_owned(), |place| path.join(place));
    let beside =
        [path.join("times.txt"), path.join("timestamps.txt"), scans.with_file_name("timestamps.txt")];
    let times = beside.iter().find(|file| file.is_file()).unwrap_or(&beside[0]).clone();
    (scans, times)
}

/// File names that end so are scans.
const ENDINGS: [&str; 3] = ["bin", "pcd", "ply"];

/// Scans that are this far apart in time, in sweeps, were thinned out or put together by other software, which
/// undistorts: no times are derived for their points.
const THINNED: f64 = 3.0;

impl Folder {
    /// Looks through a folder.
    ///
    /// # Errors
    /// When it cannot be read, holds no scans or scans of several kinds, or its `times.txt` does not fit them.
    pub fn open(path: &Path, options: &FolderOptions) -> Result<Self, ScanError> {
        let (inner, times) = places(path);
        let scans = scans_in(&inner)?;
        let name = path.display().to_string();
        let times = options.times.clone().unwrap_or(times);
        let (stamps, remarks) = timed(&scans, &times, options, &name)?;
        let files: Vec<_> =
            scans.into_iter().zip(stamps).map(|(path, stamp)| ScanFile { path, stamp }).collect();
        let spacing = median_spacing(&files);
        let is_kitti = files.first().and_then(|file| file.path.extension()).is_some_and(|e| e == "bin");
        let timing =
            options.timing.filter(|t| is_kitti && spacing.is_none_or(|s| s < THINNED * f64::from(t.period)));
        Ok(Self { root: path.to_owned(), files, timing, remarks })
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
    pub fn kind(&self) -> &'static str {
        let ending = self.files.first().and_then(|file| file.path.extension()).unwrap_or_default();
        match ending.to_ascii_lowercase().to_str() {
            Some("pcd") => "PCD",
            Some("ply") => "PLY",
            _ => "KITTI",
        }
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
            _ => read_kitti(&bytes, &name)?,
        };
        scan.stamp = file.stamp;
        self.add_side_files(&mut scan, file)?;
        if scan.rings.is_empty() {
            scan.rings = rings_of(&scan.points);
        }
        if let (true, Some(timing)) = (scan.times.is_empty(), self.timing) {
            timing.apply(&mut scan);
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

fn scans_in(folder: &Path) -> Result<Vec<PathBuf>, ScanError> {
    let name = folder.display().to_string();
    let io = |source| ScanError::Io { name: name.clone(), source };
    let mut found: Vec<PathBuf> = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        let ending = path.extension().unwrap_or_default().to_ascii_lowercase();
        if ENDINGS.iter().any(|e| ending == *e) && path.is_file() {
            found.push(path);
        }
    }
    found.sort_by_cached_key(|path| natural_key(&path.file_name().unwrap_or_default().to_string_lossy()));
    let ending = |p: &PathBuf| p.extension().unwrap_or_default().to_ascii_lowercase();
    match found.first() {
        None => Err(ScanError::format(&name, "holds no scans (files ending in .bin, .pcd or .ply)")),
        Some(first) if found.iter().any(|p| ending(p) != ending(first)) => {
            Err(ScanError::format(&name, "holds scans of several kinds; give a folder of one"))
        }
        Some(_) => Ok(found),
    }
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
            let stand_still = stamps.len() > 1 && stamps.iter().all(|stamp| *stamp == stamps[0]);
            match (stand_still, options.rate) {
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

fn median_spacing(files: &[ScanFile]) -> Option<f64> {
    let mut gaps: Vec<f64> = files.windows(2).map(|w| w[1].stamp - w[0].stamp).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sweep of a cube's inside, as KITTI stores it.
    fn bytes(points: usize) -> Vec<u8> {
        let point = |i: usize| {
            let (azimuth, z) = (i as f32 * 0.01, (i % 7) as f32 * 0.3 - 1.0);
            [3.0 * azimuth.cos(), 3.0 * azimuth.sin(), z, 0.0]
        };
        (0..points).flat_map(point).flat_map(f32::to_le_bytes).collect()
    }

    fn folder(times: &str, scans: &[(&str, Vec<u8>)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in scans {
            std::fs::write(folder.path().join(name), bytes).unwrap();
        }
        if !times.is_empty() {
            std::fs::write(folder.path().join("times.txt"), times).unwrap();
        }
        folder
    }

    #[test]
    fn scans_come_in_order_with_their_stamps() {
        let dir =
            folder("0.5 000001\n0.6 000002\n", &[("000002.bin", bytes(900)), ("000001.bin", bytes(800))]);
        let found = Folder::open(
            dir.path(),
            &FolderOptions { timing: Some(SweepTiming::default()), ..FolderOptions::default() },
        )
        .unwrap();
        let scans: Vec<Scan> = found.files().iter().map(|f| found.read(f).unwrap()).collect();
        assert_eq!(
            scans.iter().map(|s| (s.stamp, s.points.len())).collect::<Vec<_>>(),
            [(0.5, 800), (0.6, 900)]
        );
        assert_eq!(scans[0].times.len(), 800);
    }

    #[test]
    fn what_is_of_no_use_is_refused_with_the_reason() {
        let cut = bytes(900)[..1003].to_vec();
        let mut nan = bytes(900);
        nan.chunks_exact_mut(16).for_each(|p| p[..4].copy_from_slice(&f32::NAN.to_le_bytes()));
        let ring: Vec<u8> = (0..900)
            .flat_map(|i| [(i as f32 * 0.007).cos(), (i as f32 * 0.007).sin(), 0.0, 0.0])
            .flat_map(f32::to_le_bytes)
            .collect();
        let dir = folder("", &[("0.bin", cut), ("1.bin", nan), ("2.bin", ring), ("3.bin", vec![])]);
        let found = Folder::open(dir.path(), &FolderOptions::default()).unwrap();
        let reasons: Vec<String> =
            found.files().iter().map(|f| found.read(f).unwrap_err().to_string()).collect();
        for (reason, part) in reasons.iter().zip(["cut off", "0 of 900", "one ring", "0 of 0"]) {
            assert!(reason.contains(part), "{reason}");
        }
        let dir = folder("1.0\n", &[("0.bin", bytes(900)), ("1.bin", bytes(900))]);
        let refused = Folder::open(dir.path(), &FolderOptions::default()).unwrap_err();
        assert!(refused.to_string().contains("1 times for 2 scans"), "{refused}");
    }

    /// The names and stamps of a folder of scans so named, and what is said of them.
    fn told(
        times: &str,
        names: &[&str],
        options: &FolderOptions,
    ) -> Result<(Vec<String>, Vec<f64>, String), ScanError> {
        let scans: Vec<_> = names.iter().map(|name| (*name, bytes(900))).collect();
        let dir = folder(times, &scans);
        let found = Folder::open(dir.path(), options)?;
        let name = |file: &ScanFile| file.path.file_name().unwrap().to_string_lossy().into_owned();
        let (names, stamps) = found.files().iter().map(|file| (name(file), file.stamp)).unzip();
        Ok((names, stamps, found.remarks().join("; ")))
    }

    #[test]
    fn scans_come_as_people_count() {
        let plain = FolderOptions::default();
        let (names, ..) = told("", &["0.bin", "1.bin", "10.bin", "100.bin", "2.bin"], &plain).unwrap();
        assert_eq!(names, ["0.bin", "1.bin", "2.bin", "10.bin", "100.bin"]);
        let (names, stamps, said) = told("", &["s9.bin", "s10.bin", "s14.bin", "s15.bin"], &plain).unwrap();
        assert_eq!((names[1].as_str(), stamps[3]), ("s10.bin", 0.3));
        assert!(said.contains("after 10 comes 14 (3 missing)"), "{said}");
        let (_, stamps, said) =
            told("0\n0.1\n0.2\n0.3\n0.4\n", &["000000.bin", "000003.bin"], &plain).unwrap();
        assert!(stamps == [0.0, 0.3] && said.contains("5 times for 2 scans"), "{stamps:?} {said}");
    }

    #[test]
    fn times_of_scans_are_told_as_those_of_images() {
        let (plain, names) = (FolderOptions::default(), ["0.bin", "1.bin", "2.bin"]);
        for table in [
            "0\n100000000\n200000000\n",
            "1600000000000000000\n1600000000100000000\n1600000000200000000\n",
            "time;scan\n0;0\n0,1;1\n0,2;2\n",
            "\u{feff}0.0 0\r\n0.1 1\r\n0.2 2\r\n",
            "2011-09-26 13:02:25.9\n2011-09-26 13:02:26.0\n2011-09-26 13:02:26.1\n",
        ] {
            let stamps = told(table, &names, &plain).unwrap().1;
            assert!(stamps.windows(2).all(|w| (w[1] - w[0] - 0.1).abs() < 1e-6), "{table}: {stamps:?}");
        }
        let error = told("7\n7\n7\n", &names, &plain).unwrap_err().to_string();
        assert!(error.contains("all 3 scans have the time 7") && error.contains("--rate"), "{error}");
        let options = FolderOptions { rate: Some(20.0), ..plain.clone() };
        assert_eq!(told("7\n7\n7\n", &names, &options).unwrap().1[2], 0.1);
        let raw = tempfile::tempdir().unwrap();
        let data = raw.path().join("velodyne_points/data");
        std::fs::create_dir_all(&data).unwrap();
        (0..2).for_each(|i| std::fs::write(data.join(format!("000000000{i}.bin")), bytes(900)).unwrap());
        let dates = "2011-09-26 13:02:25.900000000\n2011-09-26 13:02:26.000000000\n";
        std::fs::write(raw.path().join("velodyne_points/timestamps.txt"), dates).unwrap();
        assert!(is_folder_of_scans(raw.path()));
        let found = Folder::open(raw.path(), &plain).unwrap();
        assert!((found.files()[1].stamp - found.files()[0].stamp - 0.1).abs() < 1e-6);
    }

    #[test]
    fn thinned_recordings_get_no_times() {
        let dir = folder("0\n1\n", &[("0.bin", bytes(900)), ("1.bin", bytes(900))]);
        let found = Folder::open(
            dir.path(),
            &FolderOptions { timing: Some(SweepTiming::default()), ..FolderOptions::default() },
        )
        .unwrap();
        assert!(found.read(&found.files()[0]).unwrap().times.is_empty());
    }
}
