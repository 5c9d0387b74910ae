//! Why a run could not start, told from its images, and where it lost its way.

use crate::run::Progress;
use crate::run::record::{FrameCounts, FrameRow};
use geometry::GrayImage;
use slam_direct::{Claim, FrameReport, LossReason, SPLIT_FOR, TrackingState};

/// Every how many pixels one is looked at: cheap, and enough for means.
const STRIDE: usize = 13;

/// Simple statistics of the images of a run.
#[derive(Debug, Default)]
pub struct ImageStatistics {
    count: u64,
    mean: f64,
    contrast: f64,
    change: f64,
    previous: Option<GrayImage>,
}

impl ImageStatistics {
    /// Takes in the next image.
    pub fn add(&mut self, image: &GrayImage) {
        let sample = || image.data().iter().step_by(STRIDE).map(|&v| v as f64);
        let n = image.data().len().div_ceil(STRIDE).max(1) as f64;
        let mean = sample().sum::<f64>() / n;
        let variance = sample().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
        if let Some(previous) = &self.previous {
            let before = previous.data().iter().step_by(STRIDE).map(|&v| v as f64);
            self.change += sample().zip(before).map(|(a, b)| (a - b).abs()).sum::<f64>() / n;
        }
        self.count += 1;
        self.mean += mean;
        self.contrast += variance.sqrt();
        self.previous = Some(image.clone());
    }

    /// What about the images kept a map from being made; `last_reason` is the agent's own word, `first_skip` what was wrong
    /// with the first frame that was skipped.
    pub fn why_nothing_was_tracked(&self, last_reason: Option<&str>, first_skip: Option<&str>) -> String {
        let per_frame = |sum: f64| sum / self.count.max(1) as f64;
        let agent = last_reason.map(|reason| format!(" ({reason})")).unwrap_or_default();
        if self.count == 0 {
            let first = first_skip.map(|detail| format!("; of the first: {detail}")).unwrap_or_default();
            format!("no image could be used{first}")
        } else if let (1, Some(detail)) = (self.count, first_skip) {
            format!("only one image could be used; of the first that could not: {detail}")
        } else if per_frame(self.mean) < 2.0 {
            "the images are black".into()
        } else if per_frame(self.contrast) < 2.0 {
            "the images show one even colour".into()
        } else if self.count == 1 {
            "there is only one image".into()
        } else if self.change / (self.count as f64 - 1.0) < 0.2 {
            "the images are all alike: the camera did not move".into()
        } else {
            format!("the camera did not move sideways enough, or what it sees has too little texture{agent}")
        }
    }
}

/// How often tracking was lost, told as it happens.
#[derive(Debug, Default)]
pub struct Losses {
    /// How often.
    pub count: u64,
    /// How often of these because the scale was lost ([`LossReason::Scale`]).
    pub of_scale: u64,
    /// Index and time stamp, seconds, of the first frame of each of these because something that was mapped moved
    /// ([`LossReason::TwoMotions`]).
    pub of_motion: Vec<(u64, f64)>,
    is_lost: bool,
    was_tracking: bool,
    /// The fragment that the newest tracked frame is in.
    fragment: usize,
}

impl Losses {
    /// Adds what became of the next frame.
    pub fn add(&mut self, report: &FrameReport, row: &FrameRow, progress: &dyn Progress) {
        let lost = self.was_tracking && report.state == TrackingState::Lost;
        self.was_tracking = report.state == TrackingState::Tracking;
        let at = format!("frame {} at {:.2} s", row.index, row.timestamp);
        if lost {
            self.count += 1;
            self.of_scale += u64::from(report.loss == Some(LossReason::Scale));
            if report.loss == Some(LossReason::TwoMotions) {
                self.of_motion.push((row.index, row.timestamp));
            }
            self.is_lost = true;
            let why = report.reason.map_or(String::new(), |reason| format!(": {reason}"));
            progress.warn_of("lost", &format!("tracking is lost since {at}{why}"));
        } else if self.is_lost && self.was_tracking {
            self.is_lost = false;
            let whose = if report.fragment == self.fragment { "" } else { ", in another map" };
            progress.note_of("lost", &format!("tracking goes on since {at}{whose}"));
        }
        if let Some(found) = report.scale_break {
            let text = format!(
                "the scale was not carried on some keyframes before {at}: {}; what came since is a map of its own, in a unit of its own",
                found.text()
            );
            progress.warn_of("scale", &text);
        }
        if report.claim == Some(Claim::Refused) {
            let what = "resembles a part of the map and is another place";
            progress.warn_of("claim", &format!("what is seen up to {at} {what}"));
        }
        if self.was_tracking {
            self.fragment = report.fragment;
        }
    }

    /// Whether frames from `first` to `last` lie between two losses, soon one after another, because something moved: what was mapped there may be
    /// what moves, which nothing tells.
    pub fn are_of_what_moves(&self, first: u64, last: u64) -> bool {
        let soon = |two: &&[(u64, f64)]| (two[1].1 - two[0].1).abs() < SPLIT_FOR;
        self.of_motion.windows(2).filter(soon).any(|two| first >= two[0].0 && last < two[1].0)
    }
}

/// The share of frames with a pose below which a run is not what its user wanted.
const FEW: f64 = 0.5;

/// What to say of a run in which most frames have no pose; nothing where most have one.
pub fn too_few_poses(frames: &FrameCounts) -> Option<String> {
    let taken = frames.offered - frames.dropped_late;
    let without = taken.saturating_sub(frames.tracked);
    let skipped: u64 = frames.skipped.values().sum();
    let reasons: Vec<String> =
        frames.skipped.iter().map(|(reason, count)| format!("{count} {reason}")).collect();
    let of_skipped = format!("frames are skipped before they are tracked: {}", reasons.join(", "));
    let mut hints = Vec::new();
    if frames.tracked_share < FEW {
        if 2 * skipped > without {
            hints.push(of_skipped.as_str());
        } else if frames.losses > 0 {
            hints.push(
                "move more slowly, keep part of what was seen before in view, and avoid blank walls and blur",
            );
        } else {
            hints.push("begin with a move sideways in front of something textured; is the calibration this camera's?");
        }
    }
    if frames.dropped_late > taken {
        hints.push("this machine is too slow for the rate: run recordings without --realtime, take smaller images or a lower rate");
    }
    let dropped = (frames.dropped_late > 0).then(|| format!(", {} were dropped late", frames.dropped_late));
    let (dropped, hints) = (dropped.unwrap_or_default(), hints.join("\nhint: "));
    (!hints.is_empty()).then(|| format!("{without} of {taken} frames have no pose{dropped}\nhint: {hints}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pattern(shift: usize) -> GrayImage {
        let data = (0..64 * 48).map(|i| ((i * 31 + shift * 17) % 251) as u8).collect();
        GrayImage::from_vec(64, 48, data).unwrap()
    }

    fn why(images: &[GrayImage]) -> String {
        let mut statistics = ImageStatistics::default();
        images.iter().for_each(|image| statistics.add(image));
        statistics.why_nothing_was_tracked(Some("too little parallax"), Some("a.jpg: it is truncated"))
    }

    #[test]
    fn frames_that_are_skipped_are_the_reason_and_not_the_texture() {
        use sources::ahead::SkipReason::{DuplicateTime, OutOfOrder, Unreadable};
        let counts = |tracked: u64, skipped: &[(_, u64)]| FrameCounts {
            offered: 120,
            tracked,
            tracked_share: tracked as f64 / 120.0,
            skipped: skipped.iter().copied().collect(),
            ..FrameCounts::default()
        };
        let diagnosed = |counts: FrameCounts| too_few_poses(&counts).unwrap_or_default();
        for (reason, word) in [
            (OutOfOrder, "109 out of order"),
            (DuplicateTime, "109 with a repeated time"),
            (Unreadable, "109 unreadable"),
        ] {
            let text_of = diagnosed(counts(11, &[(reason, 109)]));
            assert!(text_of.contains(word) && !text_of.contains("textured"), "{text_of}");
        }
        assert!(diagnosed(counts(11, &[(OutOfOrder, 3)])).contains("textured"));
        assert_eq!(diagnosed(counts(100, &[(OutOfOrder, 20)])), "");
    }

    #[test]
    fn what_is_mapped_between_two_losses_by_one_motion_may_be_what_moves() {
        let losses = |second: f64| Losses { of_motion: vec![(147, 4.9), (187, second)], ..Losses::default() };
        assert!(losses(6.2).are_of_what_moves(162, 186));
        assert!(!losses(6.2).are_of_what_moves(0, 146) && !losses(6.2).are_of_what_moves(150, 200));
        assert!(!losses(20.0).are_of_what_moves(162, 186), "what moved there is another thing");
    }

    #[test]
    fn losses_are_reported_with_their_causes() {
        let diagnosed = |losses, losses_of_scale, losses_of_motion| {
            FrameCounts { losses, losses_of_scale, losses_of_motion, ..FrameCounts::default() }.losses_text()
        };
        assert_eq!(diagnosed(0, 0, 0), "0");
        assert_eq!(diagnosed(3, 0, 0), "3");
        assert_eq!(diagnosed(1, 1, 0), "1, for want of known depth: the scale is lost");
        assert_eq!(diagnosed(3, 1, 0), "3, 1 of them for want of known depth: the scale is lost");
        assert_eq!(diagnosed(1, 0, 1), "1, because something that was mapped moved");
        assert_eq!(
            diagnosed(4, 1, 2),
            "4, 1 of them for want of known depth: the scale is lost, 2 because something that was mapped moved"
        );
    }

    #[test]
    fn each_cause_is_named() {
        let (black, grey) = (GrayImage::filled(64, 48, 0), GrayImage::filled(64, 48, 90));
        assert_eq!(why(&[]), "no image could be used; of the first: a.jpg: it is truncated");
        assert!(why(&[black.clone(), black]).contains("black"));
        assert!(why(&[grey.clone(), grey]).contains("even colour"));
        assert!(
            why(&[pattern(0)]).contains("only one image could be used; of the first that could not: a.jpg")
        );
        assert!(why(&[pattern(0), pattern(0)]).contains("did not move"));
        assert!(why(&[pattern(0), pattern(9)]).contains("too little parallax"));
    }
}
