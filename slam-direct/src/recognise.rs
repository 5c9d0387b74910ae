//! Recognition of a place from another side, from nearer or farther, or with the camera rolled.
//!
//! Direct tracking and small images of keyframes find a lost frame only near a keyframe. Features reach farther and
//! take longer, so [`Recognise`] works in the background, and the agent adopts its proposals a fixed number of frames
//! later. A proposal is no more than that: the agent searches the points of its map around it, as strictly as after a
//! loss.

use crate::background::Task;
use crate::frame::Frame;
use geometry::{GrayImage, Pinhole, Se3, Sim3};
use map::{KeyframeId, SemiDense, Shared, SharedBytes};
use std::sync::Arc;

/// A keyframe with depth, by which a frame may be recognised.
#[derive(Clone, Debug)]
pub struct KnownView {
    /// The fragment it is in; each has a world of its own.
    pub fragment: usize,
    /// Its name there.
    pub keyframe: KeyframeId,
    /// Its image.
    pub image: Arc<GrayImage>,
    /// Its pose and unit.
    pub world_from_keyframe: Sim3,
    /// Its depth, in its unit.
    pub semi_dense: Shared<SemiDense>,
    /// Its features as maps store them, if they were found already.
    pub features: Option<SharedBytes>,
}

/// Where a frame may have been taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hypothesis {
    /// The fragment.
    pub fragment: usize,
    /// A keyframe that shows the same.
    pub keyframe: KeyframeId,
    /// The frame's pose relative to it, in its unit.
    pub keyframe_from_frame: Se3,
}

/// Proposes from a frame's image where it was taken.
pub trait Recognise: Send {
    /// Poses at which `image` may have been taken, the likeliest first; `camera` is that of all images.
    ///
    /// The result must depend on these values and on earlier calls alone, not on time, so that runs repeat.
    fn recognise(&mut self, image: &GrayImage, camera: &Pinhole, views: &[KnownView]) -> Vec<Hypothesis>;
}

/// Who recognises frames, and what is being asked.
pub(crate) struct Recognition {
    /// Nobody while an answer is awaited, or where nobody recognises.
    recogniser: Option<Box<dyn Recognise>>,
    asked: Option<Asked>,
    /// The last frames that nothing was found of.
    recent: Vec<Frame>,
}

/// A frame that is being recognised.
struct Asked {
    task: Task<(Box<dyn Recognise>, Vec<Hypothesis>)>,
    /// The frame.
    frame: Frame,
    /// Frames before and after it, in order of time.
    before: Vec<Frame>,
    after: Vec<Frame>,
    /// Frames since it was asked.
    since: usize,
    /// Nobody wants to know any more.
    is_void: bool,
}

/// What was proposed.
pub(crate) struct Answer {
    /// Where the frame may have been taken.
    pub hypotheses: Vec<Hypothesis>,
    /// The frame.
    pub frame: Frame,
    /// Frames before it, in order of time.
    pub before: Vec<Frame>,
    /// Frames after it, the newest last.
    pub after: Vec<Frame>,
}

impl Recognition {
    /// Most frames that are kept before the one that is asked about, and after it: of more of these every other one is left
    /// out.
    const KEPT: usize = 16;

    /// By `recogniser`.
    pub fn by(recogniser: Box<dyn Recognise>) -> Self {
        Self { recogniser: Some(recogniser), asked: None, recent: Vec::new() }
    }

    /// By nobody.
    pub fn none() -> Self {
        Self { recogniser: None, asked: None, recent: Vec::new() }
    }

    /// Whether a frame may be asked about.
    pub fn is_idle(&self) -> bool {
        self.recogniser.is_some()
    }

    /// Begins to recognise a frame, which shows `image`, among `views`.
    pub fn ask(&mut self, frame: &Frame, image: GrayImage, camera: Pinhole, views: Vec<KnownView>) {
        let Some(mut recogniser) = self.recogniser.take() else { return };
        let task = Task::spawn(move || {
            let hypotheses = recogniser.recognise(&image, &camera, &views);
            (recogniser, hypotheses)
        });
        let before = self.recent.iter().filter(|recent| recent.index < frame.index).cloned().collect();
        let (frame, after) = (frame.clone(), Vec::new());
        self.asked = Some(Asked { task, frame, before, after, since: 0, is_void: false });
    }

    /// The next frame: gives the answer once it is due, `lag` frames after it was asked.
    pub fn next(&mut self, frame: &Frame, lag: usize) -> Option<Answer> {
        if self.recent.len() == Self::KEPT {
            self.recent.remove(0);
        }
        self.recent.push(frame.clone());
        let asked = self.asked.as_mut()?;
        asked.since += 1;
        asked.after.push(frame.clone());
        if asked.after.len() > Self::KEPT {
            // The newest stays: there is one more than an even number.
            let mut place = 0;
            asked.after.retain(|_| (place % 2 == 0, place += 1).0);
        }
        self.answer(lag)
    }

    /// A frame of a camera that is not lost: whatever is being asked, nobody wants to know any more.
    pub fn pass(&mut self, lag: usize) {
        self.recent.clear();
        if let Some(asked) = &mut self.asked {
            asked.since += 1;
            asked.is_void = true;
            (asked.before, asked.after) = (Vec::new(), Vec::new());
            self.answer(lag);
        }
    }

    /// The answer, once it is due; waited for, so that what comes of it does not depend on time.
    fn answer(&mut self, lag: usize) -> Option<Answer> {
        let is_due = |asked: &mut Asked| asked.since >= lag;
        let Asked { task, frame, before, after, is_void, .. } = self.asked.take_if(is_due)?;
        let (recogniser, hypotheses) = task.join();
        self.recogniser = Some(recogniser);
        (!is_void).then_some(Answer { hypotheses, frame, before, after })
    }
}
