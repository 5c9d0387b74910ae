//! What can be said of a recording of scans before it is run, and what of its scans makes a map doubtful.

use super::record::ScanCounts;
use super::sweep_timing::PointTimes;
use geometry::median;
use scans::{LEAST_POINTS, Scan, ScanError, ScanSource};
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt;

/// So many scans are looked at.
const LOOKED_AT: usize = 5;
/// The share of scans with a pose below which a run is not what its user wanted, as of cameras' frames.
const FEW: f64 = 0.5;
/// The share of points out of the range that is used from which something is wrong with the lengths.
const MOSTLY: f64 = 0.5;
/// No LiDAR has half of its points farther away than this, metres: the longest ranges of spinning sensors are 200–300 m.
const FARTHEST_MEDIAN: f32 = 300.0;

/// How far the points of some scans are from the sensor.
#[derive(Clone, Debug, Default)]
pub struct Ranges {
    medians: Vec<f32>,
    beyond: usize,
    points: usize,
}

impl Ranges {
    /// Takes a scan in; points farther than `farthest`, metres, are not used.
    pub fn add(&mut self, scan: &Scan, farthest: f32) {
        let mut ranges: Vec<f32> =
            scan.points.iter().map(|p| p.iter().map(|v| v * v).sum::<f32>().sqrt()).collect();
        self.beyond += ranges.iter().filter(|range| **range > farthest).count();
        self.points += ranges.len();
        self.medians.extend(median(&mut ranges));
    }

    /// Whether most points are farther away than is used.
    pub fn are_mostly_beyond(&self) -> bool {
        self.beyond as f64 >= MOSTLY * self.points.max(1) as f64
    }

    /// How many scans were taken in.
    pub fn count(&self) -> usize {
        self.medians.len()
    }

    /// Median distance of the points from the sensor, in the unit of the clouds.
    pub fn median(&self) -> Option<f32> {
        median(&mut self.medians.clone())
    }

    /// What is wrong with them, where that is so.
    pub fn warning(&self, farthest: f32) -> Option<String> {
        let median = self.median()?;
        let share = self.beyond as f64 / self.points.max(1) as f64;
        if !self.are_mostly_beyond() {
            return None;
        }
        // Rooms in millimetres are as large as streets in centimetres.
        let unit = match median / FARTHEST_MEDIAN {
            ..=1.0 => "centimetres? --scan-unit cm says so",
            ..=10.0 => "millimetres or centimetres? --scan-unit mm or cm says so",
            _ => "millimetres? --scan-unit mm says so",
        };
        Some(format!(
            "{:.0} % of the points lie farther than {farthest} m, beyond what is used, half of them than {median:.0}: are the clouds in \
             {unit}",
            100.0 * share
        ))
    }
}

/// Why a scan, most points of which are farther away than `farthest`, metres, gives no pose; `None` where the others suffice.
pub fn too_far(scan: &Scan, farthest: f32) -> Option<String> {
    let mut ranges = Ranges::default();
    ranges.add(scan, farthest);
    let near = ranges.points - ranges.beyond;
    if near >= LEAST_POINTS || !ranges.are_mostly_beyond() {
        return None;
    }
    let what = format!("{near} of {} points lie within {farthest} m, too few for a pose", ranges.points);
    Some(ranges.warning(farthest).map_or(what.clone(), |warning| format!("{what}: {warning}")))
}

/// What to say of a run in which few scans have a pose; nothing where most have.
pub fn too_few_scans(scans: &ScanCounts) -> Option<String> {
    let share = scans.tracked as f64 / scans.offered.max(1) as f64;
    let why = scans.skipped.iter().max_by_key(|(_, count)| **count);
    let why = why.map_or_else(String::new, |(reason, count)| {
        let first = scans.skipped_first.get(reason).cloned().unwrap_or_default();
        format!("; {count} were skipped: {first}")
    });
    (share < FEW)
        .then(|| format!("only {} of {} scans have a pose in the map{why}", scans.tracked, scans.offered))
}

/// What can be said of scans without reading them all.
#[derive(Debug, Serialize)]
pub struct ScanOutlook {
    /// Where it lies.
    pub path: String,
    /// Its kind, for people.
    pub kind: String,
    /// Scans in it, where that can be told.
    pub scans: Option<u64>,
    /// Seconds from the first to the last, where that can be told.
    pub duration_s: Option<f64>,
    /// Scans a second.
    pub scans_per_s: Option<f64>,
    /// Points of the first scan that can be used.
    pub points: Option<usize>,
    /// Its rings; 0 where they are not known.
    pub rings: Option<usize>,
    /// Median distance of the points of the first scans, metres.
    pub range_m: Option<f32>,
    /// Whether points have times, from the recording or told from their directions.
    pub point_times: Option<bool>,
    /// Whence they are known or why they are not, in words.
    pub point_times_from: String,
    /// What else there is to say, as label and text.
    pub facts: Vec<(&'static str, String)>,
    /// What is wrong with the first scans.
    pub problems: Vec<String>,
    /// Why a run over them is refused; `None` where it is not.
    pub refused: Option<String>,
}

impl ScanOutlook {
    /// What `source` holds, whose points' times are known so; points farther than `farthest`, metres, are not used.
    pub fn of(source: &mut dyn ScanSource, times: &PointTimes, farthest: f32) -> Self {
        let info = source.info().clone();
        let rate = info.count.zip(info.duration).filter(|(count, duration)| *count > 1 && *duration > 0.0);
        let mut outlook = Self {
            path: info.path.display().to_string(),
            kind: info.kind,
            scans: info.count,
            duration_s: info.duration,
            scans_per_s: rate.map(|(count, duration)| (count - 1) as f64 / duration),
            points: None,
            rings: None,
            range_m: None,
            point_times: match times {
                PointTimes::Recorded | PointTimes::Derived(..) => Some(true),
                PointTimes::Rigid(_) => Some(false),
                PointTimes::Unknown => None,
            },
            point_times_from: times.text(),
            facts: info.facts,
            problems: Vec::new(),
            refused: None,
        };
        outlook.look_at(source, farthest);
        outlook
    }

    /// Takes the first scans in, and where none of them can be used those behind, until one can.
    fn look_at(&mut self, source: &mut dyn ScanSource, farthest: f32) {
        let (mut ranges, mut stale) = (Ranges::default(), 0);
        let (mut usable, mut why) = (0, None);
        let mut index = 0;
        while (index < LOOKED_AT || usable == 0)
            && let Some(next) = source.next_scan()
        {
            let is_reported = index < LOOKED_AT;
            index += 1;
            let unusable = match &next.scan {
                Ok(scan) => {
                    if is_reported {
                        self.take(scan);
                        ranges.add(scan, farthest);
                        stale += scan.stale;
                    }
                    too_far(scan, farthest)
                }
                Err(error) => {
                    let what = match error {
                        ScanError::Io { name, source } => format!("{name}: {source}"),
                        error => error.to_string(),
                    };
                    self.problems.extend(is_reported.then(|| what.clone()));
                    Some(what)
                }
            };
            usable += usize::from(unusable.is_none());
            why = why.or(unusable);
        }
        if usable == 0 {
            let first = why.unwrap_or_else(|| "there is none".into());
            self.refused = Some(format!("no scan can be used: {first}"));
        }
        self.range_m = ranges.median();
        self.problems.extend(source.remarks());
        self.problems.extend(ranges.warning(farthest));
        if stale > 0 {
            let problem = format!(
                "{stale} points of the first scans have times that are not of their sweep: they are left out"
            );
            self.problems.push(problem);
        }
    }

    fn take(&mut self, scan: &Scan) {
        let rings: BTreeSet<u16> = scan.rings.iter().copied().collect();
        self.points.get_or_insert(scan.points.len());
        self.rings.get_or_insert(rings.len());
    }
}

impl fmt::Display for ScanOutlook {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unknown = || "unknown".to_owned();
        writeln!(f, "recording    {}", self.path)?;
        writeln!(f, "kind         {}", self.kind)?;
        writeln!(f, "scans        {}", self.scans.map_or_else(unknown, |n| n.to_string()))?;
        writeln!(f, "duration     {}", self.duration_s.map_or_else(unknown, |s| format!("{s:.2} s")))?;
        writeln!(f, "rate         {}", self.scans_per_s.map_or_else(unknown, |s| format!("{s:.2} scans/s")))?;
        writeln!(
            f,
            "points       {} in the first scan",
            self.points.map_or_else(unknown, |n| n.to_string())
        )?;
        let rings = match self.rings {
            Some(0) | None => "unknown".into(),
            Some(rings) => rings.to_string(),
        };
        writeln!(f, "rings        {rings}")?;
        let range =
            self.range_m.map_or_else(unknown, |range| format!("half of the points within {range:.1} m"));
        writeln!(f, "range        {range}")?;
        writeln!(f, "point times  {}", self.point_times_from)?;
        self.facts.iter().try_for_each(|(label, text)| writeln!(f, "{label:<12} {text}"))?;
        self.problems.iter().try_for_each(|problem| writeln!(f, "problem      {problem}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use loopbox_tests::lidar::{HALL, sweep};

    fn hall(scale: f32) -> Option<String> {
        let points = sweep(&HALL, |_| geometry::Se3::identity(), 0.0)
            .iter()
            .map(|r| r.point.map(|v| v * scale))
            .collect();
        let mut ranges = Ranges::default();
        ranges.add(&Scan { points, ..Scan::default() }, 100.0);
        ranges.warning(100.0)
    }

    #[test]
    fn clouds_in_other_units_are_reported() {
        assert_eq!(hall(1.0), None);
        assert!(
            hall(1000.0)
                .is_some_and(|message| message.contains("millimetres or centimetres? --scan-unit mm or cm"))
        );
        assert!(
            hall(100.0).is_some_and(|message| message.contains("centimetres? --scan-unit cm")),
            "{:?}",
            hall(100.0)
        );
    }

    #[test]
    fn a_run_of_one_scan_is_reported() {
        let scans = ScanCounts { offered: 80, tracked: 1, ..ScanCounts::default() };
        assert!(too_few_scans(&scans).is_some_and(|message| message.contains("only 1 of 80 scans")));
        assert_eq!(too_few_scans(&ScanCounts { tracked: 79, ..scans }), None);
    }
}
