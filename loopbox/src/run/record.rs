//! The numbers of a run: what `run.json` holds and the report shows.

use crate::run::diagnosis::WithoutDepth;
use crate::run::fragment_record::Fragment;
use crate::run::resuming::Resumed;
use geometry::{Camera, Pinhole, Se3};
use map::StampedPose;
use serde::{Serialize, Serializer};
use slam_direct::{Claim, FrameReport, LeftOut, Params, TrackingState};
use sources::SourceInfo;
use sources::ahead::SkipReason;
use sources::correction::ImageCorrection;
use std::cmp::Reverse;
use std::collections::BTreeMap;
use view::report;

/// Everything counted and measured in one run.
#[derive(Clone, Debug, Serialize)]
pub struct RunRecord {
    /// Version of the program.
    pub version: &'static str,
    /// The commit that it was built from, where it is known.
    pub commit: Option<&'static str>,
    /// The recording.
    pub source: SourceRecord,
    /// The camera of the undistorted images.
    pub camera: Pinhole,
    /// The lens that the images were undistorted by.
    pub calibration: CalibrationRecord,
    /// All parameters of the tracker and the mapper, as `loopbox params` prints them.
    pub params: Params,
    /// How much of the images was not used; nothing where all of them were.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left_out: Option<LeftOutRecord>,
    /// The map of an earlier run that it went on in. Frames are counted on from there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resumed: Option<Resumed>,
    /// Whether the user ended the run before the recording did.
    pub interrupted: bool,
    /// Frames by what became of them.
    pub frames: FrameCounts,
    /// Time and memory.
    pub cost: Cost,
    /// The map at the end: that of the first fragment.
    pub map: MapCounts,
    /// The parts of the run that hang together, that of most frames first; several where a loss parted them and they saw
    /// no place in common.
    pub fragments: Vec<Fragment>,
    /// The files of results, by names relative to their folder.
    pub files: Vec<String>,
    /// Each processed frame.
    pub rows: Vec<FrameRow>,
}

impl RunRecord {
    /// The numbers as `(label, value)`, the weightiest first.
    pub fn headline_numbers(&self) -> Vec<(String, String)> {
        let (frames, cost, map) = (&self.frames, &self.cost, &self.map);
        let memory = cost.peak_memory_bytes.map_or("unknown".into(), |bytes| format!("{} MiB", bytes >> 20));
        let cpu = cost.cpu_s.map_or("unknown".into(), |seconds| format!("{seconds:.1} s"));
        let skipped = frames.skipped.values().sum::<u64>();
        let latency = cost
            .latency_ms
            .map(|l| ("ms from image to pose, median · 99 %", format!("{:.1} · {:.1}", l.median, l.p99)));
        let missed = (frames.missed_by_driver > 0)
            .then(|| ("frames missed by the driver", frames.missed_by_driver.to_string()));
        let numbers = [
            ("frames tracked", format!("{} of {}", grouped(frames.tracked), grouped(frames.offered))),
            ("poses found later", grouped(frames.found_later)),
            ("fragments", self.fragments.len().to_string()),
            ("frames per second", format!("{:.1}", cost.frames_per_s)),
            ("ms per frame, mean", format!("{:.1}", cost.mean_ms)),
            ("keyframes", grouped(map.keyframes)),
            ("points", grouped(map.semi_dense)),
            ("peak memory", memory),
            ("ms per frame, 99 %", format!("{:.1}", cost.p99_ms)),
            ("ms per frame, worst", format!("{:.1}", cost.max_ms)),
            ("sparse points, tracked by", grouped(map.points)),
            ("loops closed", map.loops.to_string()),
            ("times lost", frames.losses_text()),
            ("frames skipped", skipped.to_string()),
            ("frames dropped late", frames.dropped_late.to_string()),
            ("wall time", format!("{:.1} s", cost.wall_s)),
            ("CPU time", cpu),
        ];
        let without = self.fragments.first().and_then(|first| first.without_depth);
        let without = without
            .filter(WithoutDepth::is_much)
            .map(|without| ("keyframes without depth", format!("{:.0} %", 100.0 * without.share)));
        let doubts = (frames.scale_doubts > 0)
            .then(|| ("frames at which the scale may have changed", frames.scale_doubts.to_string()));
        let breaks = (frames.scale_breaks > 0)
            .then(|| ("times the scale was not carried on", frames.scale_breaks.to_string()));
        let left_out = self.left_out.map(|left_out| ("of the image not used", percent(left_out.share)));
        let all = numbers
            .into_iter()
            .chain(latency)
            .chain(missed)
            .chain(without)
            .chain(breaks)
            .chain(doubts)
            .chain(left_out);
        all.map(|(label, value)| (label.to_owned(), value)).collect()
    }
}

/// How much of the images of a run was not used.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LeftOutRecord {
    /// The share of their pixels, 0–1.
    pub share: f64,
    /// That of the pixels which were found to move with the camera, and which no mask covers.
    pub found: f64,
}

impl LeftOutRecord {
    /// Of what an agent says; nothing where it used all of its images.
    pub fn new(left_out: LeftOut) -> Option<Self> {
        let LeftOut { given, found } = left_out;
        (given + found > 0.0).then_some(Self { share: given + found, found })
    }

    /// For people.
    pub fn text(self) -> String {
        let (share, found) = (percent(self.share), percent(self.found));
        let why = if self.found == 0.0 {
            ", by the mask".to_owned()
        } else if self.found == self.share {
            ": it moves with the camera".to_owned()
        } else {
            format!(": {found} moves with the camera, the rest by the mask")
        };
        format!("{share} of the image is not used{why}")
    }
}

fn percent(share: f64) -> String {
    match 100.0 * share {
        ..0.1 if share > 0.0 => "under 0.1 %".into(),
        percent => format!("{percent:.1} %"),
    }
}

/// The lens that the images of a run were undistorted by.
#[derive(Clone, Debug, Serialize)]
pub struct CalibrationRecord {
    /// Where it came from, for people: a file, the recording, or the images.
    pub origin: String,
    /// Its focal lengths, principal point and distortion, pixels of the images as they came.
    pub lens: Camera,
    /// How often the images were halved before they were undistorted.
    pub halvings: usize,
    /// Standard deviation of the focal length over the focal length, where the lens was found from the images.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focal_deviation: Option<f64>,
}

impl CalibrationRecord {
    /// What a correction undistorts images by, and how well its focal length was found.
    pub fn new(correction: &ImageCorrection, focal_deviation: Option<f64>) -> Self {
        let (origin, lens) = (correction.origin().to_owned(), *correction.calibrated());
        Self { origin, lens, halvings: correction.halvings(), focal_deviation }
    }
}

/// What is known of a run before its first frame.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The recording.
    pub source: SourceInfo,
    /// The camera of the undistorted images.
    pub camera: Pinhole,
    /// The lens that the images are undistorted by.
    pub calibration: CalibrationRecord,
    /// How it tracks and maps.
    pub params: Params,
}

/// The recording of a run.
#[derive(Clone, Debug, Serialize)]
pub struct SourceRecord {
    /// Its path as given.
    pub path: String,
    /// Its kind, for people.
    pub kind: String,
    /// Frames in it, where the source can tell.
    pub frames: Option<u64>,
    /// Seconds from the first to the last frame, where the source can tell.
    pub duration_s: Option<f64>,
}

impl SourceRecord {
    /// What a source says of itself.
    pub fn new(source: &SourceInfo) -> Self {
        Self {
            path: source.path.display().to_string(),
            kind: source.kind.to_owned(),
            frames: source.frame_count,
            duration_s: source.duration,
        }
    }
}

/// Frames by what became of them.
#[derive(Clone, Debug, Default, Serialize)]
pub struct FrameCounts {
    /// Frames of the part of the recording that was to be processed: the sum of the next three.
    pub offered: u64,
    /// Frames the agent got.
    pub processed: u64,
    /// Frames dropped because tracking was late (only of cameras and with `--realtime`).
    pub dropped_late: u64,
    /// Frames that the camera took and its driver could not deliver; not among those offered.
    pub missed_by_driver: u64,
    /// Frames skipped, by reason.
    pub skipped: BTreeMap<SkipReason, u64>,
    /// Frames with a pose in the trajectory of the first fragment.
    pub tracked: u64,
    /// Frames with a pose in those of the others.
    pub tracked_apart: u64,
    /// Those of both that had no pose when they were processed: frames from before a map, which it knows, and from before the camera was
    /// found again.
    pub found_later: u64,
    /// Frames without a pose that were found where no motion leads to, after a loss or in a map that was kept, and were not decided
    /// to show the place that they were found at.
    pub doubted: u64,
    /// `tracked / (offered − dropped_late)`: the share of the frames that could be tracked.
    pub tracked_share: f64,
    /// How often tracking was lost.
    pub losses: u64,
    /// How often of these because too few points of known depth were in view to carry the scale on.
    pub losses_of_scale: u64,
    /// How often because something that was mapped moved, and which of two motions is the camera's is not known.
    pub losses_of_motion: u64,
    /// How often the scale was not carried on though nothing was lost, so that a map was made of the rest.
    pub scale_breaks: u64,
    /// At how many frames the scale may have changed all the same, as `fragments` says.
    pub scale_doubts: u64,
}

impl FrameCounts {
    /// How often tracking was lost, for people.
    pub fn losses_text(&self) -> String {
        let causes = [
            (self.losses_of_scale, "for want of known depth: the scale is lost"),
            (self.losses_of_motion, "because something that was mapped moved"),
        ];
        let mut text = self.losses.to_string();
        let mut of_them = " of them";
        for (count, cause) in causes.into_iter().filter(|(count, _)| *count > 0) {
            if count == self.losses {
                text += &format!(", {cause}");
            } else {
                text += &format!(", {count}{of_them} {cause}");
                of_them = "";
            }
        }
        text
    }
}

/// Time and memory.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Cost {
    /// Seconds from the first frame to the finished map.
    pub wall_s: f64,
    /// CPU seconds of all threads, decoding included.
    pub cpu_s: Option<f64>,
    /// Processed frames per wall second.
    pub frames_per_s: f64,
    /// Mean time the agent took for a frame, milliseconds.
    pub mean_ms: f64,
    /// 99th percentile of it.
    pub p99_ms: f64,
    /// The longest.
    pub max_ms: f64,
    /// Largest resident memory of the process, bytes.
    pub peak_memory_bytes: Option<u64>,
    /// How old images were when their pose was known; of cameras and with `--realtime`.
    pub latency_ms: Option<Latency>,
}

/// From the moment an image is taken (in a replay by time stamps: is due) until its pose is known, milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Latency {
    /// Half of the frames are faster.
    pub median: f64,
    /// 99th percentile.
    pub p99: f64,
    /// The longest.
    pub max: f64,
}

impl Latency {
    /// Of frames that took so long each; `None` without frames.
    pub fn of(mut ms: Vec<f64>) -> Option<Self> {
        ms.sort_by(f64::total_cmp);
        Some(Self { median: percentile(&ms, 50)?, p99: percentile(&ms, 99)?, max: *ms.last()? })
    }
}

/// A number with commas between thousands, as the pages write them.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut out = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

/// The nearest-rank percentile of sorted values: the smallest that `percent` % of them do not exceed.
fn percentile(sorted: &[f64], percent: usize) -> Option<f64> {
    sorted.get((sorted.len() * percent).div_ceil(100).saturating_sub(1)).copied()
}

/// What the map holds.
#[derive(Clone, Debug, Default, Serialize)]
pub struct MapCounts {
    /// Keyframes.
    pub keyframes: u64,
    /// Sparse points.
    pub points: u64,
    /// Semi-dense pixels with a depth.
    pub semi_dense: u64,
    /// Edges between keyframes.
    pub edges: u64,
    /// Loops closed.
    pub loops: u64,
}

/// The file of a fragment: `map.mcap`, `map-2.mcap`, `map-3.mcap` …
pub fn numbered(name: &str, place: usize) -> String {
    match (place, name.rsplit_once('.')) {
        (0, _) | (_, None) => name.to_owned(),
        (_, Some((stem, extension))) => format!("{stem}-{}.{extension}", place + 1),
    }
}

/// The poses as they were handed out, of the fragment in which most frames have one: each fragment has a world of its own.
pub fn handed_out(rows: &[FrameRow]) -> Vec<StampedPose> {
    let found = || rows.iter().filter_map(|row| Some((row.fragment, row.timestamp, row.handed_out?)));
    let mut counts = BTreeMap::<usize, usize>::new();
    found().for_each(|(fragment, ..)| *counts.entry(fragment).or_default() += 1);
    // Of equals the earliest.
    let most = counts.into_iter().max_by_key(|&(fragment, count)| (count, Reverse(fragment)));
    let of_most = found().filter(|(fragment, ..)| Some(*fragment) == most.map(|(fragment, _)| fragment));
    of_most.map(|(_, timestamp, world_from_camera)| StampedPose { timestamp, world_from_camera }).collect()
}

/// One processed frame.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct FrameRow {
    /// Index in the recording.
    pub index: u64,
    /// Seconds, as recorded.
    pub timestamp: f64,
    /// The fragment it was given to, in the order in which they were begun.
    pub fragment: usize,
    /// State after the frame.
    #[serde(serialize_with = "state_as_name")]
    pub state: TrackingState,
    /// Time the agent took, milliseconds.
    pub ms: f64,
    /// From the moment the image was taken or due until its pose was known, milliseconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub latency_ms: Option<f64>,
    /// Share of the predicted points that were matched, 0–1.
    pub inlier_share: f32,
    /// Root mean square photometric residual, grey levels.
    pub rmse: f32,
    /// Points matched.
    pub matched_points: usize,
    /// Keyframe made from it.
    pub keyframe: Option<u32>,
    /// Loop closed after it: newer and older keyframe.
    pub loop_closed: Option<(u32, u32)>,
    /// Whether it was found where no motion leads to, and is not decided yet to show the place: it has a pose once it is.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub on_trial: bool,
    /// world_from_camera as it was handed out after the frame, in the fragment's world as it was then; nothing where the frame
    /// was not found. Later frames and loops move poses; who steers a robot has had this one.
    #[serde(skip)]
    pub handed_out: Option<Se3>,
}

impl FrameRow {
    /// The row of a frame and its report.
    pub fn new(index: u64, timestamp: f64, ms: f64, report: &FrameReport) -> Self {
        Self {
            index,
            timestamp,
            fragment: report.fragment,
            state: report.state,
            ms,
            latency_ms: None,
            inlier_share: report.inlier_share,
            rmse: report.rmse,
            matched_points: report.matched_points,
            keyframe: report.new_keyframe.map(|id| id.0),
            loop_closed: report.closed_loop.map(|(newer, older)| (newer.0, older.0)),
            on_trial: report.claim.is_some_and(|claim| claim != Claim::Accepted),
            handed_out: report.world_from_camera,
        }
    }

    /// The row as the report plots it.
    pub fn for_report(&self) -> report::FrameRow {
        report::FrameRow {
            frame_index: self.index,
            timestamp: self.timestamp,
            ms: self.ms as f32,
            matched_points: self.matched_points,
            inlier_share: self.inlier_share,
            rmse: self.rmse,
            state: self.state,
        }
    }
}

fn state_as_name<S: Serializer>(state: &TrackingState, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(state_name(*state))
}

/// The state as people and logs read it.
pub fn state_name(state: TrackingState) -> &'static str {
    match state {
        TrackingState::Starting => "starting",
        TrackingState::Tracking => "tracking",
        TrackingState::Lost => "lost",
    }
}

impl Cost {
    /// The cost of frames that took `ms` each, in a run of `wall_s` seconds.
    pub fn new(mut ms: Vec<f64>, wall_s: f64, cpu_s: Option<f64>, peak_memory_bytes: Option<u64>) -> Self {
        ms.sort_by(f64::total_cmp);
        let count = ms.len();
        Self {
            wall_s,
            cpu_s,
            frames_per_s: if wall_s > 0.0 { count as f64 / wall_s } else { 0.0 },
            mean_ms: if count > 0 { ms.iter().sum::<f64>() / count as f64 } else { 0.0 },
            p99_ms: percentile(&ms, 99).unwrap_or(0.0),
            max_ms: ms.last().copied().unwrap_or(0.0),
            peak_memory_bytes,
            latency_ms: None,
        }
    }
}

impl MapCounts {
    /// Counts what `map` holds.
    pub fn new(map: &map::Map) -> Self {
        Self {
            keyframes: map.keyframes.len() as u64,
            points: map.keyframes.values().map(|k| k.points.len() as u64).sum(),
            semi_dense: map.keyframes.values().map(|k| k.semi_dense.len() as u64).sum(),
            edges: map.edges.len() as u64,
            loops: map.edges.iter().filter(|e| e.kind == map::EdgeKind::Loop).count() as u64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    #[test]
    fn poses_handed_out_are_those_of_one_world() {
        let row = |fragment: usize, second: u32, x: f64| FrameRow {
            index: u64::from(second),
            timestamp: f64::from(second),
            fragment,
            state: TrackingState::Tracking,
            ms: 1.0,
            latency_ms: None,
            inlier_share: 1.0,
            rmse: 1.0,
            matched_points: 100,
            keyframe: None,
            on_trial: false,
            loop_closed: None,
            handed_out: Some(Se3::new(UnitQuaternion::identity(), Vector3::new(x, 0.0, 0.0))),
        };
        let lost = FrameRow { handed_out: None, ..row(0, 2, 0.0) };
        let rows = [row(0, 0, 0.0), row(0, 1, 0.1), lost, row(1, 3, 7.0), row(0, 4, 0.4), row(1, 5, 7.1)];
        let times: Vec<f64> = handed_out(&rows).iter().map(|pose| pose.timestamp).collect();
        assert_eq!(times, [0.0, 1.0, 4.0]);
        assert_eq!(handed_out(&rows)[2].world_from_camera.translation.x, 0.4);
        assert!(handed_out(&[]).is_empty());
    }

    #[test]
    fn what_is_not_used_is_reported_with_its_reason() {
        let text = |given, found| LeftOutRecord::new(LeftOut { given, found }).map(LeftOutRecord::text);
        assert_eq!(text(0.0, 0.0), None);
        let text_of = |given, found| text(given, found).unwrap_or_default();
        assert_eq!(text_of(0.1, 0.0), "10.0 % of the image is not used, by the mask");
        assert_eq!(text_of(0.0, 0.02), "2.0 % of the image is not used: it moves with the camera");
        assert_eq!(
            text_of(0.1, 0.02),
            "12.0 % of the image is not used: 2.0 % moves with the camera, the rest by the mask"
        );
    }

    #[test]
    fn fragments_have_files_of_their_own() {
        assert_eq!(numbered("map.mcap", 0), "map.mcap");
        assert_eq!(numbered("map.mcap", 1), "map-2.mcap");
        assert_eq!(numbered("trajectory.txt", 2), "trajectory-3.txt");
    }

    #[test]
    fn thousands_are_parted() {
        assert_eq!(
            [0, 999, 1000, 21_918, 2_942_060].map(grouped),
            ["0", "999", "1,000", "21,918", "2,942,060"]
        );
    }

    #[test]
    fn the_percentile_is_the_nearest_rank() {
        let cost = Cost::new((1..=200).map(f64::from).collect(), 10.0, None, None);
        assert_eq!((cost.p99_ms, cost.max_ms, cost.frames_per_s), (198.0, 200.0, 20.0));
        assert_eq!(cost.mean_ms, 100.5);
        assert_eq!(Cost::new(vec![5.0], 1.0, None, None).p99_ms, 5.0);
        assert_eq!(Cost::new(vec![], 0.0, None, None).p99_ms, 0.0);
        let latency = Latency::of((1..=200).rev().map(f64::from).collect()).unwrap();
        assert_eq!((latency.median, latency.p99, latency.max), (100.0, 198.0, 200.0));
        assert_eq!(Latency::of(vec![]), None);
    }
}
