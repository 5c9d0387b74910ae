//! Settling keyframes: once their neighbours are known, their semi-dense depth is computed in the background.

use crate::background::Task;
use crate::dense::StereoJob;
use crate::depth::DepthParams;
use crate::local_map::LocalMap;
use crate::mapping::UnitChange;
use crate::publish;
use map::{KeyframeId, Map, SemiDense};

/// Computes the semi-dense depths, keyframe after keyframe.
#[derive(Default)]
pub(super) struct Settler {
    /// The first keyframe whose depth is not begun.
    next: usize,
    /// Depths being computed, in order of their keyframes.
    settling: Vec<Settling>,
}

/// A keyframe whose semi-dense depth is computed in the background.
struct Settling {
    keyframe: usize,
    /// Change of its unit since the computation was begun.
    factor: f64,
    depth: Task<SemiDense>,
}

impl Settler {
    /// Whether the depth of a keyframe is still to be begun, so that a companion is of use to it.
    pub fn is_open(&self, keyframe: usize) -> bool {
        keyframe >= self.next
    }

    /// Begins the depth of the keyframes that are at least `behind` keyframes old.
    pub fn begin(&mut self, local: &mut LocalMap, behind: usize, params: &DepthParams) {
        let ready = local.keyframes.len().saturating_sub(behind);
        for keyframe in self.next..ready {
            let job = StereoJob::new(local, keyframe, params);
            local.keyframes[keyframe].companions = Vec::new();
            self.settling.push(Settling { keyframe, factor: 1.0, depth: Task::spawn(move || job.run()) });
        }
        self.next = self.next.max(ready);
    }

    /// Takes up the depths begun before, waiting for them, and makes them public.
    pub fn take_up(&mut self, public: &mut Map, local: &LocalMap) -> Vec<KeyframeId> {
        let take_up = |settling: Settling| {
            let mut depth = settling.depth.join();
            publish::scale_depth(&mut depth, settling.factor);
            publish::set_depth(public, local, settling.keyframe, depth);
            LocalMap::id(settling.keyframe)
        };
        self.settling.drain(..).map(take_up).collect()
    }

    /// Notes that the unit of a keyframe has changed while its depth is computed.
    pub fn absorb(&mut self, change: &UnitChange) {
        for settling in self.settling.iter_mut().filter(|s| s.keyframe == change.keyframe) {
            settling.factor *= change.factor;
        }
    }
}
