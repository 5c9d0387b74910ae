//! A pose that no motion leads to is a claim, and on trial. Its frames are not published and make no keyframes until
//! the frames that follow have decided whether they show the place.

use super::{Agent, Claim, FrameReport, LossReason, ResumeMode, State, TrackingState};
use crate::background::Task;
use crate::judge::{ClaimedPlace, JudgePlace, PlacedView};
use crate::local_map::LocalMap;
use crate::publish;
use crate::tracker::{Located, Tracker};
use backend::verdict::Answer;
use geometry::sensor::Twist;
use geometry::{GrayImage, Pyramid, Se3, Sim3};
use map::{FramePose, Keyframe};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Most images of a trial that are kept: of more every other one is left out, as are every other of those that follow.
const KEPT: usize = 16;
/// Those of them that are judged first, evenly spread; all when it is asked again.
const EVALUATED_POSES: usize = 8;
/// Fewest frames that are judged: one alone may show one thing.
const FEWEST: usize = 5;
/// Times the frames that were judged before, after which it is judged again.
const AGAIN: f64 = 1.5;
/// Keyframes that share points with one that frames refer to, those with most of them, which are compared with the frames.
const SHARING: usize = 6;
/// Keyframes before and after these by which it is told how the map sees its own surface.
const AROUND: usize = 10;

/// A claim on trial.
pub(super) struct Trial {
    /// Time stamp of its first frame, seconds.
    since: f64,
    /// The frames whose images are kept.
    seen: Vec<TrialFrame>,
    /// Every how many frames one is kept.
    stride: usize,
    /// All frames.
    poses: Vec<FramePose>,
    asked: Option<Asked>,
    /// How many frames there were when it was judged last; 0 before.
    evaluated: usize,
}

/// A frame with its image.
struct TrialFrame {
    pose: FramePose,
    image: Arc<GrayImage>,
    /// In map units a second.
    motion: Twist,
}

/// A claim that is being judged.
struct Asked {
    task: Task<Answer>,
    /// From which frame on the answer is taken up, as counted by `Agent::processed`.
    due: u64,
}

/// A frame that was found where a claim has it.
pub(super) struct FoundFrame {
    pub pose: FramePose,
    pub image: Arc<GrayImage>,
    pub motion: Twist,
}

impl Trial {
    fn new(since: f64) -> Self {
        Self { since, seen: Vec::new(), stride: 1, poses: Vec::new(), asked: None, evaluated: 0 }
    }

    fn add(&mut self, found: FoundFrame) {
        let FoundFrame { pose, image, motion } = found;
        if self.poses.len().is_multiple_of(self.stride) {
            self.seen.push(TrialFrame { pose, image, motion });
        }
        self.poses.push(pose);
        if self.seen.len() > KEPT {
            let mut place = 0;
            self.seen.retain(|_| (place % 2 == 0, place += 1).0);
            self.stride *= 2;
        }
    }

    /// Whether there is enough to ask about.
    fn is_due(&self, seconds: f64) -> bool {
        let last = self.poses.last().map_or(self.since, |pose| pose.timestamp);
        let enough = (AGAIN * self.evaluated as f64) as usize;
        self.asked.is_none() && last - self.since >= seconds && self.poses.len() >= enough.max(FEWEST)
    }

    /// The frames that are judged.
    fn chosen(&self) -> impl Iterator<Item = &TrialFrame> {
        let all = self.seen.len();
        let count = if self.evaluated == 0 { all.min(EVALUATED_POSES) } else { all };
        (0..count).map(move |i| &self.seen[(i * (all - 1)) / (count - 1).max(1)])
    }
}

impl Agent {
    /// Sets the judge of poses that no motion leads to; without a judge they are accepted.
    pub fn judge_by(&mut self, judge: Arc<dyn JudgePlace>) {
        self.judge = Some(judge);
    }

    /// Whether a pose is on trial.
    pub(crate) fn is_on_trial(&self) -> bool {
        self.trial.is_some()
    }

    /// What became of the claim with the newest frame, where there is one.
    pub(crate) fn claim(&self) -> Option<Claim> {
        self.claim
    }

    /// Gives the claim up: the camera goes on elsewhere.
    pub(crate) fn drop_claim(&mut self) {
        self.trial = None;
    }

    /// Whether a frame of this time that is found is a claim: nothing leads from the newest pose to it, or something that was mapped
    /// moves since.
    pub(super) fn is_cut_off(&self, tracker: &Tracker, timestamp: f64) -> bool {
        let begin_after = self.params.atlas.begin_after;
        let is_cut_off = || tracker.saw_two_motions() || tracker.is_cut_off(timestamp, begin_after);
        self.judge.is_some() && (self.is_relocalising || self.is_unsettled || is_cut_off())
    }

    /// Takes a frame that was found while nothing leads to it: on trial, or into the map once it is decided.
    pub(super) fn try_claim(
        &mut self,
        mut tracker: Box<Tracker>,
        located: &Located,
        pyramid: Pyramid,
        at: (f64, u64),
        report: FrameReport,
    ) -> FrameReport {
        if self.tells_too_little(located) {
            self.state = State::Running(tracker);
            return FrameReport::tells_too_little();
        }
        if !located.is_of_most() {
            self.end_claim(tracker, Claim::Undecided);
            return FrameReport::lost(LossReason::TwoMotions);
        }
        let answer = self.answer();
        if answer.is_some_and(Answer::joins) {
            let (known, trial_frames) = (self.map.frames.len(), self.accept_claim());
            let report = self.go_on(tracker, located, pyramid, at, report);
            // The newest may have become the keyframe that those before it are told by.
            self.insert_frames(known, trial_frames);
            return report;
        }
        tracker.change_reference(&self.view, located, &self.params);
        let found = self.found_at(at, &pyramid, &tracker, located.motion);
        if answer == Some(Answer::Different) {
            self.end_claim(tracker, Claim::Refused);
            return FrameReport::other_place();
        }
        self.put_on_trial([found]);
        // It is due and nobody is asked: the map has no depth to compare the frames with, as one of a single keyframe.
        let is_undecidable = self.trial.as_ref().is_some_and(|trial| trial.is_due(self.params.atlas.trial));
        let is_pending = answer.is_none() && !is_undecidable;
        self.claim = Some(if is_pending { Claim::Pending } else { Claim::Undecided });
        self.state = State::Running(tracker);
        FrameReport { adopted: report.adopted, ..FrameReport::on_trial() }
    }

    /// Ends the trial without the claim being believed; the camera is searched anew.
    fn end_claim(&mut self, tracker: Box<Tracker>, claim: Claim) {
        self.trial = None;
        self.claim = Some(claim);
        self.state = State::Running(Box::new(tracker.seeking()));
    }

    /// Puts frames on trial, and has them judged when there are enough.
    pub(super) fn put_on_trial(&mut self, found: impl IntoIterator<Item = FoundFrame>) {
        let mut found = found.into_iter().peekable();
        let Some(first) = found.peek() else { return };
        let since = first.pose.timestamp;
        // The motion to the next frame is not that of a keyframe before the loss.
        self.fresh = None;
        self.is_unsettled = true;
        let trial = self.trial.get_or_insert_with(|| Trial::new(since));
        found.for_each(|found| trial.add(found));
        if !trial.is_due(self.params.atlas.trial) {
            return;
        }
        let (claim, judge) = (self.claimed_place(), self.judge.clone());
        let (Some(claim), Some(judge), Some(trial)) = (claim, judge, &mut self.trial) else { return };
        trial.evaluated = trial.poses.len();
        let lag = self.params.atlas.recognition_lag.max(5 * self.params.mapping.lag) as u64;
        let task = Task::spawn(move || judge.judge(&claim));
        trial.asked = Some(Asked { task, due: self.processed + lag });
    }

    /// Ends a trial that is too long ago for a frame of this time to go on with it.
    pub(super) fn end_stale_claim(&mut self, tracker: &Tracker, timestamp: f64) {
        if self.trial.is_some() && tracker.is_cut_off(timestamp, self.params.atlas.begin_after) {
            self.trial = None;
        }
    }

    /// Decides on what is on trial by what there is, as no more comes; tells whether it is the place.
    pub(crate) fn decide_claim(&mut self) -> bool {
        let is_same = self.is_believed();
        if is_same {
            let trial_frames = self.accept_claim();
            self.insert_frames(self.map.frames.len(), trial_frames);
        }
        self.trial = None;
        is_same
    }

    /// Whether what is on trial is the place, by what there is.
    fn is_believed(&mut self) -> bool {
        let Some(trial) = &mut self.trial else { return false };
        let pending = trial.asked.take().map(|asked| asked.task.join());
        let judge = self.judge.clone().filter(|_| trial.poses.len() >= FEWEST);
        pending.is_some_and(Answer::joins) || {
            let claim = self.claimed_place();
            judge.zip(claim).is_some_and(|(judge, claim)| judge.judge(&claim).joins())
        }
    }

    /// The poses of frames that no motion leads to, in order of time, if they show the place; none otherwise.
    pub(super) fn decided(&mut self, found: impl Iterator<Item = FoundFrame>) -> Vec<FramePose> {
        let mut trial = Trial::new(0.0);
        found.for_each(|found| trial.add(found));
        self.trial = Some(trial);
        let is_same = self.is_believed();
        self.trial.take().filter(|_| is_same).map_or(Vec::new(), |trial| trial.poses)
    }

    /// The answer, where one is due.
    fn answer(&mut self) -> Option<Answer> {
        let processed = self.processed;
        let asked = self.trial.as_mut()?.asked.take_if(|asked| asked.due <= processed)?;
        Some(asked.task.join())
    }

    /// Ends the trial, as the claim is believed; gives the frames on which that was decided.
    fn accept_claim(&mut self) -> Vec<FramePose> {
        (self.is_unsettled, self.is_relocalising) = (false, false);
        self.claim = Some(Claim::Accepted);
        self.trial.take().map_or(Vec::new(), |trial| trial.poses)
    }

    /// Takes frames of the working map into the one that is handed out, behind so many that are known.
    pub(super) fn insert_frames(&mut self, known: usize, frames: Vec<FramePose>) {
        let frames: Vec<FramePose> = frames.into_iter().filter_map(|frame| self.own_frame(frame)).collect();
        self.map.frames.splice(known..known, frames);
    }

    /// Whether a frame shows too little of a map that is localised in to tell where it is.
    pub(super) fn tells_too_little(&self, located: &Located) -> bool {
        self.resumed == Some(ResumeMode::Localising)
            && located.position_deviation(&self.view) > f64::from(self.params.track.max_deviation)
    }

    /// What is on trial, with the keyframes around it; `None` where there is nothing to compare.
    fn claimed_place(&self) -> Option<ClaimedPlace> {
        let trial = self.trial.as_ref()?;
        let frame = |(number, seen): (usize, &TrialFrame)| {
            let pose = seen.pose;
            let camera_from_world =
                self.view.camera_from_world(pose.reference.0 as usize, &pose.keyframe_from_frame);
            view_of_frame(number, &seen.image, camera_from_world, seen.motion)
        };
        let frames: Vec<PlacedView> = trial.chosen().enumerate().map(frame).collect();
        let references = trial.chosen().map(|seen| seen.pose.reference.0 as usize);
        let near = around(&self.view, references.collect());
        let keyframes: Vec<PlacedView> =
            near.into_iter().filter_map(|k| view_of_keyframe(&self.view, k)).collect();
        let (camera, sensor) = (self.camera, self.view.sensor);
        (!keyframes.is_empty()).then_some(ClaimedPlace { camera, sensor, keyframes, frames })
    }
}

/// Keyframes that see what those that frames refer to see, and those around them in order of time.
pub(super) fn around(map: &LocalMap, references: BTreeSet<usize>) -> BTreeSet<usize> {
    let sharing = |&reference: &usize| map.covisible(reference).into_iter().take(SHARING).map(|c| c.0);
    let shared: Vec<usize> = references.iter().flat_map(sharing).collect();
    let near = |k: usize| k.saturating_sub(AROUND)..(k + AROUND + 1).min(map.keyframes.len());
    references.into_iter().chain(shared).flat_map(near).collect()
}

/// A keyframe of the working map; `None` without depth.
pub(super) fn view_of_keyframe(map: &LocalMap, keyframe: usize) -> Option<PlacedView> {
    let motion = map.keyframes[keyframe].motion;
    let timestamp = keyframe as f64;
    let keyframe = Keyframe { timestamp, frame_index: 0, ..publish::keyframe(map, keyframe) };
    (!keyframe.semi_dense.is_empty()).then_some(PlacedView { keyframe, motion })
}

/// A frame with its pose in the working map's world and unit.
pub(super) fn view_of_frame(
    number: usize,
    image: &Arc<GrayImage>,
    camera_from_world: Se3,
    motion: Twist,
) -> PlacedView {
    let pose = Sim3::from(camera_from_world.inverse());
    let id = LocalMap::id(number);
    PlacedView { keyframe: Keyframe::of_image(id, number as f64, 0, pose, Arc::clone(image)), motion }
}

impl FrameReport {
    /// A report on a frame that was found where nothing leads to, and is to be confirmed.
    pub(crate) fn on_trial() -> Self {
        let reason = "the view resembles a part of the map, which the frames that follow are to confirm";
        Self { reason: Some(reason), claim: Some(Claim::Pending), ..Self::of(TrackingState::Lost) }
    }

    /// A report on a frame that shows another place than the one it was found at.
    fn other_place() -> Self {
        let reason =
            "the view shares things with a part of the map and differs in others: it is another place";
        Self { reason: Some(reason), ..Self::of(TrackingState::Lost) }
    }

    /// A report on a frame that shows too little of a map that is localised in.
    pub(super) fn tells_too_little() -> Self {
        let reason = "the view shows too little of the map to tell where it is";
        Self { reason: Some(reason), ..Self::lost(LossReason::NotFound) }
    }
}
