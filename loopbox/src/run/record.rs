//! The numbers of a run: what `run.json` holds and the report shows.

mod cost;
mod frame_row;

pub use cost::{Cost, Latency};
pub use frame_row::{FrameRow, state_name};

use crate::run::fragment_record::Fragment;
use crate::run::resuming::Resumed;
use crate::run::revisits::Revisit;
use crate::run::without_depth::WithoutDepth;
use geometry::{Camera, Pinhole};
use map::StampedPose;
use serde::Serialize;
use slam_direct::{LeftOut, Params};
use sources::SourceInfo;
use sources::ahead::SkipReason;
use sources::correction::ImageCorrection;
use std::cmp::Reverse;
use std::collections::BTreeMap;

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
    /// The rolling shutter that the recording revealed; nothing where all of an image is read at once.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shutter: Option<ShutterRecord>,
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
    /// Places that features proposed in the finished maps as seen twice, and whether the map was corrected by each or why not; those that
    /// were tracked or closed before are not among them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub revisits: Vec<Revisit>,
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
        let refused = self.revisits.iter().filter(|one| one.refused.is_some()).count();
        let refused =
            (refused > 0).then(|| ("places seen twice that were not believed", refused.to_string()));
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
            .chain(refused)
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

/// A rolling shutter, of the map at the end.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ShutterRecord {
    /// From the first column to the last, and from the first row to the last, seconds; one of them is zero, and negative is what
    /// reads the last one first.
    pub readout: [f64; 2],
    /// Standard deviation of the one that is not zero, seconds.
    pub deviation: f64,
}

impl ShutterRecord {
    /// What a map says of its agent's camera.
    pub fn new(map: &map::Map) -> Option<Self> {
        let sensor = map.agents.values().find_map(map::AgentInfo::image_sensor)?;
        sensor.is_rolling().then_some(Self { readout: sensor.readout, deviation: sensor.readout_deviation })
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
mod tests;
