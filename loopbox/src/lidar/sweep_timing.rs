//! How the sensor of scans without times turns, found from the scans themselves.
//!
//! A sweep is taken while the sensor moves. With each point's time told from its direction by the right rotation, scans lie on each
//! other; by another, or as if taken at once, less of them does. So a window of scans in which the sensor moves is tracked with
//! every rotation there may be, and the one with which most points agree is taken, where it is better than all of another sense and than
//! none by more than chance.
//!
//! Only turns tell it: where the sensor drives straight on, all scans are distorted alike and lie on each other whatever their times.
//! Tried in a hall of boxes, at 1 m/s straight on, all rotations and none had 0.72 to 0.73 of the points agree.
//!
//! What the stamp means (begin, middle or end of a sweep) moves all scans alike: no scan tells it.

use geometry::Se3;
use scans::{NextScan, Scan, ScanInfo, ScanSource, ScanTiming, Spin, StampAt, SweepTiming};
use slam_lidar::odometry::{Odometry, OdometryParams};
use std::f32::consts::{FRAC_PI_4, TAU};

/// Longest sweep of a spinning LiDAR, seconds: scans further apart were thinned out or put together by other software, which undistorts.
const LONGEST: f64 = 0.7;
/// So many scans are tracked with each rotation.
const WINDOW: usize = 20;
/// Of these the first find the motion they begin with, and do not count.
const WARM_UP: usize = 3;
/// So many scans are looked through for a window in which the sensor turns.
const SEARCHED: usize = 600;
/// Points of a scan that are used: as many as a sensor of 16 rings has.
const POINTS: usize = 16_000;
/// During a sweep the sensor's turn must move the points it sees by so much, metres: twice the noise of spinning sensors' ranges (2–3 cm).
const MOVED: f64 = 0.05;
/// A window is good enough to end the search when its scans turn by so much.
const MOVED_WELL: f64 = 0.3;
/// After so many lost scans in a row tracking begins anew.
const GIVE_UP: usize = 3;
/// Azimuths at which sweeps may begin, and how finely the best is refined, halving from a half of their distance.
const STARTS: usize = 8;
const REFINEMENTS: i32 = 3;
/// One rotation is better than another when the share that agrees is larger by more than the standard error of that, and by at least
/// this: straight on, where none can be told, shares of rotations differed by up to 0.013; in turns the true one led by 0.06 and more.
const SIGNIFICANT: (f64, f64) = (1.0, 0.03);

/// What is known of the times of a recording's points.
#[derive(Clone, Debug, PartialEq)]
pub enum PointTimes {
    /// The recording says them.
    Recorded,
    /// They are told from directions, by this rotation.
    Derived(SweepTiming, Why),
    /// Scans are taken as undistorted.
    Rigid(Why),
    /// There is no scan that can be used.
    Unknown,
}

/// Why points' times are told so.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Why {
    /// The user says so.
    Given,
    /// The layout is KITTI's, and nothing in the scans contradicts it.
    Kitti,
    /// It fits best: the share of the points that agrees with it, and without.
    Fits {
        /// With it.
        share: f64,
        /// With the best of the others.
        other: f64,
    },
    /// Scans are too far apart for sweeps, seconds.
    Apart(f64),
    /// The sensor hardly turns in the scans that were looked through.
    AtRest,
    /// No rotation fits better than none.
    Undistorted,
    /// Rotations in both senses fit.
    Unclear,
}

impl PointTimes {
    /// What is known, for people.
    pub fn text(&self) -> String {
        let option = "--scan-timing says another";
        match self {
            Self::Recorded => "known, in the recording".into(),
            Self::Unknown => "unknown: no scan can be used".into(),
            Self::Derived(timing, why) => match why {
                Why::Given => format!("told from directions as given: {timing}"),
                Why::Kitti => format!("told from directions as the layout is KITTI's: {timing}; {option}"),
                Why::Fits { share, other } => format!(
                    "told from directions by what fits the scans: {timing} (not known); {share:.2} of the points agree, {other:.2} \
                     by any other; {option}"
                ),
                _ => format!("told from directions: {timing}"),
            },
            Self::Rigid(why) => {
                let why = match why {
                    Why::Given => "as given".to_owned(),
                    Why::Apart(seconds) => format!("scans are {seconds:.1} s apart, too far for sweeps"),
                    Why::AtRest => format!(
                        "the sensor drives straight on or rests, so that the scans do not tell how its head turns; {option}"
                    ),
                    Why::Undistorted => format!("no rotation fits better than none; {option}"),
                    Why::Unclear | Why::Kitti | Why::Fits { .. } => {
                        format!("the scans do not tell how the sensor turns; {option}")
                    }
                };
                format!("none: scans are taken as undistorted ({why})")
            }
        }
    }

    /// The rotation by which times are told.
    pub fn timing(&self) -> Option<SweepTiming> {
        match self {
            Self::Derived(timing, _) => Some(*timing),
            _ => None,
        }
    }
}

/// Scans whose points get times where they have none.
pub struct Timed {
    source: Box<dyn ScanSource>,
    timing: Option<SweepTiming>,
}

impl Timed {
    /// Those of `source`, as `times` says.
    pub fn new(source: Box<dyn ScanSource>, times: &PointTimes) -> Self {
        Self { source, timing: times.timing() }
    }
}

/// Scans whose lengths are another unit's.
pub struct Scaled {
    source: Box<dyn ScanSource>,
    metres: f32,
}

impl Scaled {
    /// Those of `source`, whose unit is so many metres.
    pub fn new(source: Box<dyn ScanSource>, metres: f32) -> Self {
        Self { source, metres }
    }
}

impl ScanSource for Scaled {
    fn info(&self) -> &ScanInfo {
        self.source.info()
    }

    fn next_scan(&mut self) -> Option<NextScan> {
        let mut next = self.source.next_scan()?;
        if let Ok(scan) = &mut next.scan {
            scan.points.iter_mut().flatten().for_each(|value| *value *= self.metres);
        }
        Some(next)
    }

    fn remarks(&self) -> Vec<String> {
        self.source.remarks()
    }
}

impl ScanSource for Timed {
    fn info(&self) -> &ScanInfo {
        self.source.info()
    }

    fn next_scan(&mut self) -> Option<NextScan> {
        let mut next = self.source.next_scan()?;
        if let (Ok(scan), Some(timing)) = (&mut next.scan, self.timing)
            && scan.times.is_empty()
        {
            timing.apply(scan);
        }
        Some(next)
    }

    fn remarks(&self) -> Vec<String> {
        self.source.remarks()
    }
}

/// What is known of the times of the points of `source`, which is read as far as it takes; `wanted` is what the user says.
pub fn point_times(source: &mut dyn ScanSource, wanted: ScanTiming) -> PointTimes {
    let is_kitti = source.info().is_kitti;
    let mut scans = std::iter::from_fn(|| source.next_scan()).filter_map(|next| next.scan.ok());
    let Some(first) = scans.next() else { return PointTimes::Unknown };
    if !first.times.is_empty() {
        return PointTimes::Recorded;
    }
    let beginning: Vec<Scan> =
        std::iter::once(first).chain(scans.by_ref().take(WINDOW - 1)).map(thinned).collect();
    let Some(period) = spacing(&beginning) else { return PointTimes::Rigid(Why::Apart(0.0)) };
    let of =
        |spin, start_azimuth, stamp_at| SweepTiming { period: period as f32, spin, stamp_at, start_azimuth };
    let kitti = SweepTiming { period: period as f32, ..SweepTiming::default() };
    match wanted {
        ScanTiming::Rigid => return PointTimes::Rigid(Why::Given),
        ScanTiming::Kitti => return PointTimes::Derived(kitti, Why::Given),
        ScanTiming::Turning { spin, start_azimuth, stamp_at } => {
            return PointTimes::Derived(of(spin, start_azimuth, stamp_at), Why::Given);
        }
        ScanTiming::Found => {}
    }
    if period > LONGEST {
        return PointTimes::Rigid(Why::Apart(period));
    }
    let window = moving_window(beginning, &mut scans);
    let found = window.map_or(PointTimes::Rigid(Why::AtRest), |window| {
        best(&window, period as f32, is_kitti.then_some(kitti))
    });
    match found {
        // It is known how KITTI's sensor turns: what the scans leave open is not open.
        PointTimes::Rigid(Why::AtRest | Why::Unclear) if is_kitti => PointTimes::Derived(kitti, Why::Kitti),
        found => found,
    }
}

/// Median distance of scans in time, seconds; that of usual sensors where there is one scan alone.
fn spacing(scans: &[Scan]) -> Option<f64> {
    let mut gaps: Vec<f64> = scans.windows(2).map(|pair| pair[1].stamp - pair[0].stamp).collect();
    gaps.sort_by(f64::total_cmp);
    let usual = f64::from(SweepTiming::default().period);
    Some(gaps.get(gaps.len() / 2).copied().unwrap_or(usual)).filter(|gap| *gap > 0.0)
}

/// A scan with fewer points, evenly over it.
fn thinned(mut scan: Scan) -> Scan {
    let step = scan.points.len().div_ceil(POINTS).max(1);
    scan.retain(|_, i| i % step == 0);
    scan
}

/// The scans in which the sensor turns most, as far as must be looked; none where it hardly does.
fn moving_window(beginning: Vec<Scan>, rest: &mut dyn Iterator<Item = Scan>) -> Option<Vec<Scan>> {
    let mut odometry = Odometry::new(OdometryParams::default()).without_search();
    let mut scans: Vec<(Scan, f64)> = Vec::new();
    let mut last: Option<Se3> = None;
    let mut lost = 0;
    let mut best: Option<(f64, Vec<Scan>)> = None;
    for scan in beginning.into_iter().chain(rest.map(thinned)).take(SEARCHED) {
        let range = median_range(&scan);
        let tracked = odometry.track(&scan);
        let turned = |before: Se3| (before.inverse() * tracked.world_from_sensor).rotation.angle() * range;
        // Taken at once, the scans of a quick turn are lost: they are what is looked for.
        let step = if tracked.lost { MOVED_WELL } else { last.map_or(0.0, turned) };
        lost = if tracked.lost { lost + 1 } else { 0 };
        if lost == GIVE_UP {
            (odometry, lost) = (Odometry::new(OdometryParams::default()).without_search(), 0);
        }
        last = (!tracked.lost).then_some(tracked.world_from_sensor);
        scans.push((scan, step));
        if scans.len() > WINDOW {
            scans.remove(0);
        }
        if scans.len() < WINDOW {
            continue;
        }
        let moved = scans.iter().map(|(_, step)| *step).sum::<f64>() / WINDOW as f64;
        if best.as_ref().is_none_or(|(most, _)| moved > 1.2 * most) && moved > MOVED {
            best = Some((moved, scans.iter().map(|(scan, _)| scan.clone()).collect()));
        }
        if moved > MOVED_WELL {
            break;
        }
    }
    best.map(|(_, window)| window)
}

/// Median distance of points from the sensor, metres.
fn median_range(scan: &Scan) -> f64 {
    let mut squared: Vec<f32> = scan.points.iter().map(|p| p.iter().map(|v| v * v).sum()).collect();
    geometry::median(&mut squared).map_or(0.0, |squared| f64::from(squared).sqrt())
}

/// The shares of the points that agree, scan by scan, with times told by a rotation.
struct Trial {
    timing: Option<SweepTiming>,
    shares: Vec<f64>,
}

impl Trial {
    fn of(window: &[Scan], timing: Option<SweepTiming>) -> Self {
        let mut odometry = Odometry::new(OdometryParams::default()).without_search();
        let share = |scan: &Scan| {
            let mut scan = scan.clone();
            timing.iter().for_each(|timing| timing.apply(&mut scan));
            let tracked = odometry.track(&scan);
            if tracked.lost { 0.0 } else { tracked.inlier_share }
        };
        let shares: Vec<f64> = window.iter().map(share).collect();
        Self { timing, shares: shares[WARM_UP.min(shares.len())..].to_vec() }
    }

    fn share(&self) -> f64 {
        self.shares.iter().sum::<f64>() / self.shares.len().max(1) as f64
    }

    /// Whether more agrees than with another by more than chance.
    fn is_better_than(&self, other: &Self) -> bool {
        let differences: Vec<f64> = self.shares.iter().zip(&other.shares).map(|(a, b)| a - b).collect();
        let count = differences.len().max(2) as f64;
        let mean = differences.iter().sum::<f64>() / count;
        let variance = differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (count - 1.0);
        mean > SIGNIFICANT.1 && mean > SIGNIFICANT.0 * (variance / count).sqrt()
    }
}

/// The rotation that fits a window best, or that none does.
fn best(window: &[Scan], period: f32, kitti: Option<SweepTiming>) -> PointTimes {
    let of = |spin, start_azimuth| {
        let timing = SweepTiming { period, spin, stamp_at: StampAt::Start, start_azimuth };
        Trial::of(window, Some(timing))
    };
    let rigid = Trial::of(window, None);
    let [mut best, mut other] = [Spin::Clockwise, Spin::CounterClockwise].map(|spin| {
        let trials = (0..STARTS).map(|step| of(spin, step as f32 * TAU / STARTS as f32));
        trials.reduce(|a, b| if b.share() > a.share() { b } else { a }).unwrap_or_else(|| of(spin, 0.0))
    });
    if other.share() > best.share() {
        std::mem::swap(&mut best, &mut other);
    }
    for refinement in 0..REFINEMENTS {
        let Some(timing) = best.timing else { break };
        let step = 0.5 * FRAC_PI_4 * 0.5f32.powi(refinement);
        for turned in [-step, step] {
            let next = of(timing.spin, timing.start_azimuth + turned);
            if next.share() > best.share() {
                best = next;
            }
        }
    }
    if let Some(kitti) = kitti {
        let usual = Trial::of(window, Some(kitti));
        if !best.is_better_than(&usual) && !rigid.is_better_than(&usual) {
            return PointTimes::Derived(kitti, Why::Kitti);
        }
    }
    let Some(timing) = best.timing else { return PointTimes::Rigid(Why::Unclear) };
    if !best.is_better_than(&rigid) {
        let why = if rigid.is_better_than(&best) { Why::Undistorted } else { Why::Unclear };
        return PointTimes::Rigid(why);
    }
    if !best.is_better_than(&other) {
        return PointTimes::Rigid(Why::Unclear);
    }
    PointTimes::Derived(timing, Why::Fits { share: best.share(), other: other.share().max(rigid.share()) })
}

#[cfg(test)]
mod tests;
